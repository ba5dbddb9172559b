"""Joined samples say what their members said."""

import numpy as np
import pytest

from imu_rig.gait.coarse import coarse_inputs, joined, joined_number, joined_rows
from imu_rig.kernels.foot_types import FootInputs


@pytest.mark.parametrize(("rate", "number"), [(50, 1), (100, 1), (200, 2), (400, 4), (1000, 10)])
def test_samples_are_joined_to_a_hundred_a_second(rate, number):
    assert joined_number(np.arange(5 * rate) / rate) == number


def test_joined_readings_are_means_and_what_they_say_counts_as_much():
    rng = np.random.default_rng(8)
    t = np.cumsum(rng.uniform(0.004, 0.006, 11))
    sigma = np.array([0.1, np.inf, np.inf, np.inf, 0.3, 0.4, np.inf, np.inf, np.inf, 0.2, 0.1])
    gyro, accel = rng.normal(size=(2, 11, 3))
    unseen = rng.uniform(0.0, 1.0, 11)
    none, step = np.full(11, np.inf), np.zeros(11)
    fine = FootInputs(
        np.diff(t, prepend=t[0]), gyro, accel, sigma, none, none, step, np.zeros(4), np.zeros(3),
        unseen, None,
    )  # fmt: skip
    coarse = coarse_inputs(fine, t, 2)
    assert coarse.gyro[1] == pytest.approx(gyro[2:4].mean(axis=0))
    assert coarse.velocity_sigma == pytest.approx([0.1, np.inf, 0.24, np.inf, 0.2])
    assert coarse.unseen_turn[3] == pytest.approx(np.hypot(unseen[6], unseen[7]))
    assert np.cumsum(coarse.dt) == pytest.approx(joined(t, 2) - joined(t, 2)[0])
    assert joined_rows(np.array([0, 3, 9, 10]), t, 2).tolist() == [0, 1, 4, 4]
    assert coarse_inputs(fine, t, 1) is fine
