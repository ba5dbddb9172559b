"""Stills, and how a gyroscope's bias is weighed from all that is known of it."""

from dataclasses import replace

import numpy as np
import pytest

from imu_rig.gait.bias import fuse_gyro_bias, without_bias
from imu_rig.gait.filter_inputs import WIDE_BIAS
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.start import first_attitude, level_attitude
from imu_rig.gait.stills import drift_between, find_stills, rough_gyro_bias
from imu_rig.rotation import conjugate, from_rotation_vector, rotate
from imu_rig.units import DEG, STANDARD_GRAVITY

RNG = np.random.default_rng(4)
T = np.arange(2400) * 0.005
UP = np.array([0.48, -0.6, 0.64])
BIAS = np.array([0.3, -0.2, 0.5]) * DEG


def recording(moving=(4.0, 8.0), creep=0.0, noise=0.05 * DEG):
    """A foot that stands, moves about, and stands, with a bias; it tilts by ``creep`` a second."""
    begin, end = moving
    swing = ((begin < T) & (end > T))[:, np.newaxis]
    rate = np.where(swing, 3.0 * np.sin(9.0 * T)[:, np.newaxis] * [0.2, 1.0, 0.1], 0.0)
    axis = np.cross(UP, [0.0, 0.0, 1.0])
    axis /= np.linalg.norm(axis)
    up = rotate(from_rotation_vector(-creep * T[:, np.newaxis] * axis), UP)
    gyro = rate + creep * axis + BIAS + RNG.normal(0.0, noise, (len(T), 3))
    accel = STANDARD_GRAVITY * up + RNG.normal(0.0, 0.02, (len(T), 3))
    return T, accel + np.where(swing, 5.0 * np.cos(9.0 * T)[:, np.newaxis], 0.0), gyro


def test_stills_are_found_and_read_the_bias():
    stills = find_stills(*recording())
    assert len(stills) == 2
    np.testing.assert_allclose(stills.t, [2.0, 10.0], atol=0.3)
    for rate, information in zip(stills.rate, stills.information(), strict=True):
        off = rate - BIAS
        assert off @ information @ off < 16.0
    # The accelerometer sees no turn about the vertical.
    assert np.all(stills.turn_sigma > 3.0 * stills.tilt_sigma)


def test_a_tilt_of_the_standing_foot_is_not_taken_for_a_bias():
    """0.3 deg/s about a horizontal axis is as large as the bias."""
    stills = find_stills(*recording(creep=0.3 * DEG))
    level = np.eye(3) - np.outer(UP, UP)
    np.testing.assert_allclose(stills.rate @ level, np.tile(level @ BIAS, (2, 1)), atol=0.06 * DEG)


def test_who_sets_out_gently_is_not_taken_for_a_tilting_foot():
    """A sensor slid over a table from 4 s on, whose acceleration grows by 0.5 m/s^2 a second."""
    t, accel, gyro = recording(moving=(4.3, 8.0))
    along = np.cross(UP, [0.0, 0.0, 1.0])
    slides = np.clip(t - 4.0, 0.0, 0.3) * (t < 8.0)
    stills = find_stills(t, accel + 0.5 * slides[:, np.newaxis] * along, gyro)
    level = np.eye(3) - np.outer(UP, UP)
    off = np.linalg.norm((stills.rate - BIAS) @ level, axis=1)
    assert np.all(off < 2.0 * np.sqrt(2.0) * stills.tilt_sigma)


def test_a_noisy_sensor_has_stills_too():
    assert len(find_stills(*recording(noise=2.0 * DEG))) == 2


def test_a_sensor_on_a_turntable_is_not_still():
    t, accel, gyro = recording()
    stills = find_stills(t, accel, gyro + 60.0 * DEG * UP)
    assert len(stills) == 0


def test_walking_all_the_time_has_no_still():
    stills = find_stills(*recording(moving=(0.0, 12.1)))
    assert len(stills) == 0
    assert np.all(rough_gyro_bias(stills) == 0.0)


def test_a_large_bias_is_taken_off_beforehand_and_a_small_one_is_not():
    t, accel, gyro = recording()
    small, large = (find_stills(t, accel, gyro - BIAS + b * UP) for b in (0.02 * DEG, 3.0 * DEG))
    assert np.all(rough_gyro_bias(small) == 0.0)
    np.testing.assert_allclose(rough_gyro_bias(large), 3.0 * DEG * UP, atol=0.1 * DEG)


def test_stills_that_differ_tell_that_the_bias_wanders():
    stills = find_stills(*recording())
    wandered = replace(stills, rate=stills.rate + np.array([[0.2], [-0.2]]) * DEG)
    assert drift_between(wandered) > 0.1 * DEG > drift_between(stills)


def fused(bias, grade=SensorGrade(), walking_sigma=0.5 * DEG):  # noqa: B008
    """Fuse stills of 4 s with a filter that knows little."""
    t, accel, gyro = recording()
    stills = find_stills(t, accel, gyro - BIAS + bias)
    return fuse_gyro_bias(np.zeros(3), bias, walking_sigma**2 * np.eye(3), UP, stills, grade)


def test_a_calibrated_sensor_keeps_its_word():
    """Its horizontal axes show no bias, so that a false one about the vertical is not believed."""
    result = fused(0.1 * DEG * UP)
    assert np.linalg.norm(result.value) < 0.05 * DEG
    assert result.raw_probability < 0.5


def test_a_bias_that_gravity_shows_lets_one_about_the_vertical_be_believed():
    bias = np.array([0.6, -0.5, 0.7]) * DEG
    result = fused(bias)
    assert result.raw_probability > 0.9
    np.testing.assert_allclose(result.value, bias, atol=0.15 * DEG)
    off = result.value - bias
    assert off @ np.linalg.solve(result.covariance, off) < 16.0


def test_a_certificate_is_believed_more_than_a_filter():
    known = SensorGrade(gyro_bias=0.01 * DEG, raw_odds=0.0)
    result = fused(0.2 * DEG * UP, known)
    assert np.linalg.norm(result.value) < 0.05 * DEG
    assert result.raw_probability == 0.0


def test_axes_of_the_sensor_do_not_matter_to_the_fusion():
    t, accel, gyro = recording()
    q = from_rotation_vector(np.array([0.5, 2.0, -1.0]))
    results = []
    for turn in (np.array([1.0, 0.0, 0.0, 0.0]), q):
        stills = find_stills(t, rotate(turn, accel), rotate(turn, gyro))
        walking = rotate(turn, BIAS)
        found = fuse_gyro_bias(
            np.zeros(3), walking, 1e-4 * np.eye(3), rotate(turn, UP), stills, SensorGrade()
        )
        results.append(rotate(conjugate(turn), found.value))
    np.testing.assert_allclose(results[0], results[1], atol=1e-6)


# --- start ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.3, -0.5, -0.8)])
def test_level_brings_up_to_the_vertical(up):
    q = level_attitude(np.array(up, dtype=float))
    there = rotate(q, np.array(up) / np.linalg.norm(up))
    np.testing.assert_allclose(there, [0.0, 0.0, 1.0], atol=1e-12)


def test_the_first_attitude_is_taken_back_from_a_later_rest():
    """The sensor turns for a second and then rests: its tilt at the begin is known all the same."""
    t = np.arange(600) * 0.005
    rate = np.where(t[:, np.newaxis] < 1.0, [0.8, -0.4, 0.3], 0.0)
    accel = np.tile(STANDARD_GRAVITY * UP, (600, 1))
    accel[t < 1.0] += [3.0, 1.0, 0.0]  # the foot is accelerated meanwhile
    statistic = np.linalg.norm(rate, axis=1) + np.where(t < 1.1, 0.1, 0.0)
    q, quietest = first_attitude(t, accel, rate, statistic)
    assert t[quietest] > 1.0
    # The rotation from then to the begin, as a series of small ones by hand.
    up = UP.copy()
    for w in rate[199::-1]:
        up = rotate(from_rotation_vector(w * 0.005), up)
    np.testing.assert_allclose(rotate(q, up), [0.0, 0.0, 1.0], atol=6e-3)


def test_a_bias_that_changes_between_stills_is_followed():
    t, accel, gyro = recording(noise=0.02 * DEG)
    warming = 0.3 * DEG * (t / t[-1] - 0.5)[:, np.newaxis] * np.cross(UP, [1.0, 0.0, 0.0])
    stills = find_stills(t, accel, gyro + warming)
    away = -BIAS - without_bias(np.zeros((len(t), 3)), t, stills, BIAS)
    assert np.abs(away - warming)[800:1600].max() < 0.05 * DEG
    steady = -BIAS - without_bias(np.zeros((len(t), 3)), t, find_stills(t, accel, gyro), BIAS)
    assert np.abs(steady).max() < 0.05 * DEG
    np.testing.assert_array_equal(without_bias(gyro, t, stills[:1], BIAS), gyro - BIAS)


def test_the_prior_of_the_filter_does_not_pull_large_biases():
    true = np.array([6.0, -4.0, 9.0]) * DEG
    of_strides = np.diag(np.square(np.array([0.2, 0.3, 0.9]) * DEG) ** -1.0)
    both = of_strides + np.eye(3) / WIDE_BIAS**2
    pulled = np.linalg.solve(both, of_strides @ true)
    assert pulled[2] < 0.6 * true[2]
    anything = SensorGrade(gyro_bias=1e4 * DEG, raw_odds=0.0)
    none = find_stills(*recording(moving=(-1.0, 100.0)))
    assert len(none) == 0
    bias = fuse_gyro_bias(np.zeros(3), pulled, np.linalg.inv(both), UP, none, anything)
    np.testing.assert_allclose(bias.value, true, atol=0.001 * DEG)
