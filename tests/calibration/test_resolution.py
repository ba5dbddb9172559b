"""Counts in place of numbers: how large they are, and what they hide of a mean."""

import numpy as np
import pytest
from jig_sessions import session_of, solved

from imu_rig.calibration.model import Affine, physical_figures
from imu_rig.calibration.resolution import Counts, counts_of, lost_variance


def rounded(values, count, *, cut=False):
    if cut:
        whole = np.trunc(values / count)
        return count * (whole + 0.5 * np.sign(whole))
    return count * np.rint(values / count)


@pytest.mark.parametrize(("count", "cut"), [(0.0327, False), (1e-3, False), (1e-3, True)])
def test_counts_are_found_by_the_steps_of_the_readings(count, cut):
    rng = np.random.default_rng(1)
    readings = rounded(rng.normal(0.0, 3.0 * count, (500, 3)), count, cut=cut)
    found = counts_of(readings, "accel")
    assert found.size == pytest.approx(count)
    assert found.about_zero == pytest.approx(2.0 * count if cut else count)


def test_numbers_in_full_and_recordings_of_few_values_have_no_counts():
    rng = np.random.default_rng(2)
    assert not counts_of(rng.normal(0.0, 0.01, (500, 3)), "gyro").size.any()
    faces = np.repeat(9.8 * np.vstack((np.eye(3), -np.eye(3))), 50, axis=0)
    assert not counts_of(faces, "accel").size.any()
    assert not counts_of(np.zeros((50, 3)), "gyro").size.any()


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6])
def test_what_a_mean_loses_is_neither_understated_nor_much_overstated(noise):
    """Over all places of the true value between two counts, in counts."""
    rng = np.random.default_rng(3)
    true = rng.uniform(-0.5, 0.5, 400)
    readings = rounded(true[:, None, None] + noise * rng.standard_normal((400, 1000, 3)), 1.0)
    means, variance = readings.mean(axis=1), readings.var(axis=1)
    one = np.ones(3)
    stated = lost_variance(variance, means + 10.0, Counts(one, one))
    sampling = noise**2 / 1000
    lost = np.mean((means - true[:, None]) ** 2)
    assert lost < 1.3 * stated.mean() + 3.0 * sampling
    assert stated.mean() < max(10.0 * lost, 1e-3), "three times what it is at most"


def test_cutting_off_hides_twice_as_much_about_zero():
    counts = Counts(np.ones(3), np.full(3, 2.0))
    means = np.array([[0.0, 1.5, 5.5]])
    assert lost_variance(np.zeros((1, 3)), means, counts)[0] == pytest.approx(
        [1 / 3, 1 / 3, 1 / 12]
    )


def test_a_sensor_quieter_than_its_counts_is_no_dead_one_and_states_what_they_cost():
    session = session_of(5, accel_noise_ug=20.0, gyro_noise_dps=0.00025)
    result = solved(session)
    line = session.accel_line
    true = physical_figures(exact(line))
    found = physical_figures(result.accel)
    assert np.all(np.abs(found.bias - true.bias) < 4.5 * found.bias_u)
    assert np.all(np.abs(found.scale_percent - true.scale_percent) < 4.5 * found.scale_percent_u)
    gyro = session.truth.gyro
    turned = physical_figures(exact(gyro), exact(line))
    assert result.gyro_figures is not None
    off = np.abs(result.gyro_figures.bias - turned.bias)
    assert np.all(off < 4.5 * result.gyro_figures.bias_u)
    # a count of 0.03 deg/s, over root twelve, and not over the root of the stills besides
    assert np.max(result.gyro_figures.bias_u) > np.deg2rad(0.0005)


def exact(line):
    return Affine(line.K, line.b, np.zeros((12, 12)))
