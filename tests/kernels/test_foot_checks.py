"""What is summed up of a track in one pass is what numpy says of the whole tables."""

import numpy as np
import pytest

from imu_rig.kernels.foot_checks import means_around, stride_changes, turned_between
from imu_rig.kernels.rolling import moving_mean
from imu_rig.rotation import normalize, rotate

N = 300
ROWS = np.array([3, 40, 41, 200, N - 1])
BIAS = np.array([0.1, -0.2, 0.05])


@pytest.fixture(scope="module")
def tables():
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.choice([0.0, 0.004, 0.006, 0.1], N, p=[0.05, 0.45, 0.45, 0.05]))
    return t, normalize(rng.normal(size=(N, 4))), *rng.normal(size=(2, N, 3))


def test_changes_of_velocity_are_trapezoids(tables):
    t, quaternion, accel, velocity = tables
    pull = rotate(quaternion, accel - BIAS) - [0.0, 0.0, 9.81]
    steps = 0.5 * np.diff(t)[:, None] * (pull[1:] + pull[:-1])
    told = stride_changes(t, accel, BIAS, quaternion, velocity, ROWS, 9.81)
    for one, begin, end in zip(told, ROWS[:-1], ROWS[1:], strict=True):
        assert one[:3] == pytest.approx(steps[begin:end].sum(axis=0), abs=1e-12)
        assert one[3] == pytest.approx(np.linalg.norm(velocity[begin:end], axis=1).max())


def test_means_around_rows_are_moving_means(tables):
    t, _, accel, _ = tables
    for half in (0.0, 0.025, 100.0):
        assert means_around(t, accel, ROWS, half) == pytest.approx(
            moving_mean(t, accel, half)[ROWS], abs=1e-12
        )


def test_turns_are_sums_of_rates(tables):
    t, _, gyro, _ = tables
    swept = np.cumsum(gyro * np.diff(t, prepend=t[0])[:, None], axis=0)
    told = turned_between(t, gyro, ROWS[:-1], ROWS[1:])
    assert told == pytest.approx(np.diff(swept[ROWS], axis=0), abs=1e-12)
