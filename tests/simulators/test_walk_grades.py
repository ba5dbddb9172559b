"""Sensors of a grade err by what the grade says, in the same motion."""

import numpy as np
import pytest

from imu_rig.units import DEG, MILLI_G, STANDARD_GRAVITY
from simulators.sampling import Means
from simulators.walker.grades import GRADES, read_as

N, RATE_HZ = 400, 200.0
REST = Means(
    np.arange(1, N + 1) / RATE_HZ,
    np.full(N, 1.0 / RATE_HZ),
    np.tile((0.0, 0.0, STANDARD_GRAVITY), (N, 1)),
    np.tile((0.0, 4.0, 0.0), (N, 1)),
    np.zeros((N, 3)),
)


@pytest.mark.parametrize("name", list(GRADES))
def test_errors_have_the_size_of_their_grade(name):
    grade = GRADES[name]
    readings = [read_as(grade, REST, seed) for seed in range(60)]
    gyro = np.array([reading.gyro.mean(axis=0) for reading in readings]) - (0.0, 4.0, 0.0)
    accel = np.array([reading.accel.mean(axis=0) for reading in readings])
    accel -= (0.0, 0.0, STANDARD_GRAVITY)
    rate = np.hypot(grade.gyro_bias_dps * DEG, 4.0 * grade.matrix)
    force = np.hypot(grade.accel_bias_mg * MILLI_G, STANDARD_GRAVITY * grade.matrix)
    assert np.sqrt(np.mean(gyro**2)) == pytest.approx(rate, rel=0.2)
    assert np.sqrt(np.mean(accel**2)) == pytest.approx(force, rel=0.2)
    white = np.mean([reading.gyro.std(axis=0) for reading in readings])
    assert white == pytest.approx(
        np.hypot(grade.gyro_noise_dps * np.sqrt(RATE_HZ / 2.0), 0.29 / 16.4) * DEG, rel=0.1
    )


def test_a_seed_is_a_sensor():
    one, same, other = (read_as("poor", REST, seed) for seed in (1, 1, 2))
    assert np.array_equal(one.gyro, same.gyro)
    assert np.abs(one.gyro - other.gyro).max() > 0.1 * DEG
