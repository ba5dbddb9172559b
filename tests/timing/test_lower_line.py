"""The line below all points against looking at every pair of them."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imu_rig.timing.lower_line import scatter, slopes_below

POINTS = st.lists(st.floats(-10, 10).map(lambda v: round(v, 3)), min_size=2, max_size=12)


def height_at_mean(x, y, slope):
    return np.min(y - slope * x) + slope * np.mean(x)


@given(heights=st.lists(POINTS, min_size=1, max_size=3), seed=st.integers(0, 1000))
def test_no_line_through_two_points_is_below_all_and_higher_at_the_mean(heights, seed):
    count = np.array([len(row) for row in heights])
    width = int(count.max())
    x = np.cumsum(np.random.default_rng(seed).uniform(0.1, 3.0, (len(heights), width)), axis=1)
    y = np.array([row + [np.inf] * (width - len(row)) for row in heights])
    slopes = slopes_below(x, y, count)
    for k, n in enumerate(count):
        px, py = x[k, :n], y[k, :n]
        best = max(
            height_at_mean(px, py, (py[j] - py[i]) / (px[j] - px[i]))
            for i, j in combinations(range(n), 2)
        )
        assert height_at_mean(px, py, slopes[k]) == pytest.approx(best, abs=1e-6)


def test_scatter_is_that_of_the_blocks_minima_without_the_two_latest():
    above = np.full(80, 9.0)
    above[5::10] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 8.0, 8.5]
    padded = np.concatenate((above, np.full(13, np.inf)))[None]
    assert scatter(padded, np.array([80]))[0] == pytest.approx(np.mean([0, 1, 2, 3, 4, 5]))
