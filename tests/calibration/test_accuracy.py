"""The uncertainty of a reading and of a turn, against errors that are drawn at random."""

import numpy as np
import pytest
from simulated_sessions import random_sensor

from imu_rig import rotation
from imu_rig.calibration.accuracy import in_sensor_frame, sphere, sphere_error, turn_error
from imu_rig.calibration.model import Affine

DEG = np.pi / 180.0
G = 9.80665


def uncertain(affine, sigma_K, sigma_b, rng):
    """The model with a random dense covariance of about these sizes."""
    root = rng.standard_normal((12, 12)) * np.r_[np.full(9, sigma_K), np.full(3, sigma_b)][:, None]
    return Affine(affine.K, affine.b, root @ root.T / 12)


def test_the_sphere_is_covered_evenly():
    directions = sphere()
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert np.allclose(directions.T @ directions / len(directions), np.eye(3) / 3, atol=1e-3)
    nearest = np.max(directions @ directions[777] - 2 * (np.arange(2000) == 777))
    assert 3 * DEG < np.arccos(nearest) < 6 * DEG


def test_an_uncertain_offset_counts_alike_in_every_direction():
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.diag([0.01, 0.02, 0.02]) ** 2
    found = sphere_error(Affine(np.eye(3), np.zeros(3), covariance))
    # K is upper triangular already and known exactly, so its frame turns nothing
    assert found.rms == pytest.approx(0.03, rel=1e-6)
    assert found.maximum == pytest.approx(0.03, rel=1e-6)


def test_an_uncertain_scale_counts_along_its_axis():
    covariance = np.zeros((12, 12))
    covariance[4, 4] = 0.001**2
    found = sphere_error(Affine(np.eye(3), np.zeros(3), covariance), gravity=10.0)
    assert found.maximum == pytest.approx(0.01, rel=2e-3)
    assert abs(found.worst[1]) > 0.999
    assert found.rms == pytest.approx(0.01 / np.sqrt(3), rel=2e-3)


def test_a_turn_adds_the_offset_times_its_duration():
    covariance = np.zeros((12, 12))
    covariance[0, 0] = 0.001**2
    covariance[9, 9] = (0.02 * DEG) ** 2
    gyro = Affine(np.eye(3), np.zeros(3), covariance)
    found = turn_error(gyro, 90 * DEG, 1.5)
    assert found.maximum == pytest.approx(np.hypot(0.09, 0.03) * DEG, rel=2e-3)
    assert turn_error(gyro, 90 * DEG, 60.0).maximum > 10 * found.maximum


def test_the_propagation_agrees_with_random_draws():
    rng = np.random.default_rng(3)
    gyro = uncertain(random_sensor(rng).gyro, 0.002, 0.001, rng)
    draws = rng.multivariate_normal(np.r_[gyro.K.ravel(), gyro.b], gyro.covariance, 20_000)
    worst = turn_error(gyro).worst
    raw = gyro.undo(worst * 60 * DEG)
    errors = 1.5 * (draws[:, :9].reshape(-1, 3, 3) @ raw - draws[:, 9:] - worst * 60 * DEG)
    drawn = np.sqrt(np.mean(np.sum(errors**2, axis=1)))
    assert turn_error(gyro).maximum == pytest.approx(drawn, rel=0.02)


def test_the_frame_of_the_calibration_has_no_part_in_it():
    """A jig's frame is uncertain by degrees; what the sensor reads at rest is not."""
    rng = np.random.default_rng(4)
    accel = uncertain(random_sensor(rng).accel, 1e-4, 1e-3, rng)
    sensor = in_sensor_frame(accel)
    Q = rotation.to_matrix(rotation.from_rotation_vector(np.array([0.3, -0.2, 0.5])))
    turned = sensor.rotated(Q)
    generators = [np.cross(np.eye(3), axis) for axis in np.eye(3)]
    frame = np.stack([np.r_[(A @ turned.K).ravel(), A @ turned.b] for A in generators], axis=1)
    vague = Affine(turned.K, turned.b, turned.covariance + (2 * DEG) ** 2 * frame @ frame.T)
    expected, found = sphere_error(accel), sphere_error(vague)
    assert found.rms == pytest.approx(expected.rms, rel=1e-5)
    assert found.maximum == pytest.approx(expected.maximum, rel=1e-5)
