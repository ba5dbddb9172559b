"""The affine model, its uncertainty and its physical meaning."""

import numpy as np
import pytest
from simulated_sessions import random_sensor

from imu_rig import rotation
from imu_rig.calibration.gravity import Gravity, normal_gravity
from imu_rig.calibration.model import (
    Affine,
    physical_figures,
    sensor_frame,
    student_factor,
)
from imu_rig.errors import InputError


def covariance(rng):
    root = 1e-3 * rng.standard_normal((12, 12))
    return root @ root.T


def any_affine(rng):
    truth = random_sensor(rng)
    return Affine(truth.gyro.K, truth.gyro.b, covariance(rng))


def test_apply_is_gain_times_raw_minus_offset_and_undo_is_its_inverse():
    rng = np.random.default_rng(1)
    affine = any_affine(rng)
    raw = rng.standard_normal((50, 3))
    one_by_one = np.array([affine.K @ u - affine.b for u in raw])
    assert np.allclose(affine.apply(raw), one_by_one, atol=1e-14)
    assert np.allclose(affine.undo(affine.apply(raw)), raw, atol=1e-12)


def test_uncertainties_are_in_the_order_of_K_row_by_row_then_b():
    affine = Affine(np.eye(3), np.zeros(3), np.diag(np.arange(12.0) ** 2))
    assert np.array_equal(affine.K_uncertainty, np.arange(9.0).reshape(3, 3))
    assert np.array_equal(affine.b_uncertainty, [9.0, 10.0, 11.0])


@pytest.mark.parametrize("part", ["K", "b", "covariance"])
def test_wrong_shapes_and_values_are_refused(part):
    good = {"K": np.eye(3), "b": np.zeros(3), "covariance": np.zeros((12, 12))}
    with pytest.raises(ValueError, match=part):
        Affine(**good | {part: np.zeros(2)})
    bad = good[part].copy()
    bad.flat[0] = np.nan
    with pytest.raises(ValueError, match="finite"):
        Affine(**good | {part: bad})


def test_arrays_of_a_model_cannot_be_changed_behind_its_back():
    affine = Affine.identity()
    with pytest.raises(ValueError, match="read-only"):
        affine.K[0, 0] = 2.0


def test_a_rotated_model_gives_rotated_output_and_turns_its_covariance_with_it():
    rng = np.random.default_rng(2)
    affine = any_affine(rng)
    Q = rotation.to_matrix(rotation.normalize(rng.standard_normal(4)))
    turned = affine.rotated(Q)
    raw = rng.standard_normal((20, 3))
    assert np.allclose(turned.apply(raw), affine.apply(raw) @ Q.T, atol=1e-13)
    # The spread of an output vector has the same size in any frame.
    lever = np.hstack((np.kron(np.eye(3), raw[0]), -np.eye(3)))
    before = np.trace(lever @ affine.covariance @ lever.T)
    after = np.trace(lever @ turned.covariance @ lever.T)
    assert after == pytest.approx(before, rel=1e-10)


def test_sensor_frame_splits_any_gain_into_rotation_and_upper_triangle():
    rng = np.random.default_rng(3)
    for _ in range(20):
        K = rng.standard_normal((3, 3))
        Q, T = sensor_frame(K)
        assert np.allclose(Q @ T, K, atol=1e-12)
        assert np.allclose(Q @ Q.T, np.eye(3), atol=1e-12)
        assert np.all(np.diag(T) > 0)
        assert np.allclose(np.tril(T, -1), 0, atol=1e-12)


def test_figures_are_what_a_data_sheet_means_by_them():
    # x reads 2 % too much, y senses 10 mrad toward z, z has a bias of 0.3.
    S = np.array([[1.02, 0.0, 0.0], [0.0, np.cos(0.01), np.sin(0.01)], [0.0, 0.0, 1.0]])
    K = np.linalg.inv(S)
    affine = Affine(K, K @ [0.0, 0.0, 0.3], np.zeros((12, 12)))
    figures = physical_figures(affine)
    assert np.allclose(figures.scale_percent, [2.0, 0.0, 0.0], atol=1e-9)
    assert figures.cross_names == ("xy", "xz", "yz")
    assert np.allclose(figures.cross_rad, [0.0, 0.0, np.sin(0.01)], atol=1e-12)
    assert np.allclose(figures.bias, [0.0, 0.0, 0.3], atol=1e-12)


def test_figures_do_not_depend_on_the_frame_of_the_output():
    rng = np.random.default_rng(4)
    truth = random_sensor(rng)
    accel = Affine(truth.accel.K, truth.accel.b, covariance(rng))
    gyro = Affine(truth.gyro.K, truth.gyro.b, covariance(rng))
    Q = rotation.to_matrix(rotation.normalize(rng.standard_normal(4)))
    for ours, theirs in (
        (physical_figures(accel), physical_figures(accel.rotated(Q))),
        (physical_figures(gyro, accel), physical_figures(gyro.rotated(Q), accel.rotated(Q))),
    ):
        for name in ("scale_percent", "cross_rad", "bias", "scale_percent_u", "bias_u"):
            assert np.allclose(getattr(ours, name), getattr(theirs, name), atol=1e-7), name


def test_uncertainty_of_the_figures_is_the_scatter_of_their_values():
    rng = np.random.default_rng(5)
    affine = any_affine(rng)
    stated = physical_figures(affine)
    draws = rng.multivariate_normal(
        np.concatenate((affine.K.ravel(), affine.b)), affine.covariance, size=300
    )
    values = [
        physical_figures(Affine(d[:9].reshape(3, 3), d[9:], np.zeros((12, 12)))) for d in draws
    ]
    for name in ("scale_percent", "cross_rad", "bias"):
        scatter = np.std([getattr(v, name) for v in values], axis=0)
        assert np.allclose(scatter, getattr(stated, name + "_u"), rtol=0.2), name


@pytest.mark.parametrize(
    ("dof", "table"), [(2, 4.303), (3, 3.182), (5, 2.571), (10, 2.228), (30, 2.042), (1e9, 1.960)]
)
def test_student_factor_against_a_printed_table(dof, table):
    assert student_factor(dof) == pytest.approx(table, rel=0.01)


def test_interval_widens_with_few_degrees_of_freedom_and_is_normal_without_a_number():
    assert Affine(np.eye(3), np.zeros(3), np.eye(12), dof=3).coverage_factor > 3.1
    assert Affine.identity().coverage_factor == pytest.approx(1.96, abs=1e-3)


@pytest.mark.parametrize(
    ("latitude", "height", "value"),
    # WGS-84 on the ellipsoid: equator, 45 deg, pole; then 3.086e-6 /s^2 per metre of height.
    [(0, 0, 9.780325336), (45, 0, 9.806197769), (-90, 0, 9.832184938), (45, 1000, 9.80311295)],
)
def test_normal_gravity(latitude, height, value):
    assert normal_gravity(latitude, height) == pytest.approx(value, abs=2e-6)


def test_gravity_says_where_it_comes_from_and_refuses_the_impossible():
    assert "was not given" in Gravity().statement
    assert "37.5 deg" in Gravity.at(37.5, 50.0).statement
    for wrong in (
        lambda: Gravity.given(1.0),
        lambda: normal_gravity(91),
        lambda: normal_gravity(0, 1e5),
    ):
        with pytest.raises(InputError):
            wrong()


def test_endless_degrees_of_freedom_are_the_normal_distribution():
    assert student_factor(1e308) == pytest.approx(1.959964, abs=1e-6)
    assert student_factor(np.inf) == pytest.approx(1.959964, abs=1e-6)
