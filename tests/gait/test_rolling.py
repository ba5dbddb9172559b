"""Moving windows over jittery, repeated and missing stamps, against the plain definition."""

import numpy as np
import pytest

from imu_rig.kernels.rolling import SLACK_S, moving_mean, moving_minimum

rng = np.random.default_rng(5)
STAMPS = {
    "even": np.arange(400) * 0.005,
    "jittery": np.cumsum(rng.uniform(0.0, 0.012, 400)),
    "repeated": np.repeat(np.arange(200) * 0.01, 2),
    "with a gap": np.concatenate((np.arange(200) * 0.005, 3.0 + np.arange(200) * 0.005)),
}


def in_window(t, k, half):
    return np.abs(t - t[k]) <= half + SLACK_S


@pytest.mark.parametrize("stamps", STAMPS)
@pytest.mark.parametrize("half", [0.0, 0.0275, 0.6])
def test_means_and_minima_are_those_of_the_samples_in_the_window(stamps, half):
    t = STAMPS[stamps]
    values = rng.normal(size=(len(t), 2))
    mean = moving_mean(t, values, half)
    least = moving_minimum(t, np.ascontiguousarray(values[:, 0]), half)
    for k in range(0, len(t), 7):
        inside = in_window(t, k, half)
        np.testing.assert_allclose(mean[k], values[inside].mean(axis=0), atol=1e-12)
        assert least[k] == values[inside, 0].min()


def test_a_mean_after_a_huge_value_is_as_exact_as_before():
    t = np.arange(5000) * 0.005
    values = np.full((5000, 1), 1e-3)
    values[2000:2100] = 1e6
    mean = moving_mean(t, values, 0.05)
    np.testing.assert_allclose(mean[2300:], 1e-3, rtol=1e-9)
