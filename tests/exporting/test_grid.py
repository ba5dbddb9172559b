"""Placing samples on equal steps: the nearest in time, none where there was none."""

import numpy as np
import pytest

from imu_rig.exporting.grid import common_grid, fit_steps, place
from imu_rig.recording.contents import Missing


def test_the_rate_is_measured_over_losses() -> None:
    t = 3.0 + np.delete(np.arange(5000), np.r_[700:900, 3000]) / 399.98
    rate, first = fit_steps(t)
    assert rate == pytest.approx(399.98, rel=1e-9)
    assert first == pytest.approx(3.0, abs=1e-9)


def test_one_device_fills_its_own_grid_and_its_gap_stays_empty() -> None:
    kept = np.delete(np.arange(1000), np.r_[300:400, 500])
    t = 1.0 + kept / 200.04
    gaps = [Missing(t[299], t[300], 100, "x"), Missing(t[399], t[400], 1, "x")]
    grid = common_grid([t])
    placed = place(grid, t, gaps)
    assert grid.count == 1000
    expected = np.full(1000, -1)
    expected[kept] = np.arange(len(kept))
    assert np.array_equal(placed.rows, expected)
    assert (placed.repeated, placed.left_out, placed.empty) == (0, 0, 101)


@pytest.mark.parametrize("skew", [-3e-3, 3e-3])
@pytest.mark.parametrize("offset_s", [0.0, 0.0024, -0.0016])
def test_a_second_device_of_another_clock_is_never_off_by_more_than_half_a_step(
    skew: float, offset_s: float
) -> None:
    fast, slow = np.arange(2000) / 200.0, offset_s + np.arange(1500) / (200.0 * (1 + skew))
    grid = common_grid([fast, slow])
    placed = place(grid, slow, [])
    taken = placed.rows >= 0
    half = 0.5 * max(1 / 200.0, 1 / (200.0 * (1 + skew)))
    assert np.abs(grid.t[taken] - slow[placed.rows[taken]]).max() <= half * (1 + 1e-6)
    inside = (grid.t >= slow[0]) & (grid.t <= slow[-1])
    assert np.all(taken[inside])
    assert placed.left_out + len(np.unique(placed.rows[taken])) == len(slow)
    assert (placed.repeated > 0) == (grid.rate_hz > 200.0 * (1 + skew) * (1 + 1e-6))
    assert np.all(np.diff(placed.rows[taken]) >= 0)


def test_a_single_lost_sample_is_not_hidden_by_its_neighbours() -> None:
    fast = np.arange(1000) / 100.0
    for offset_s in (0.0, 0.0045, -0.004):
        slow = np.delete(offset_s + np.arange(1000) / 100.0, 500)
        gap = Missing(slow[499], slow[500], 1, "lost on the way")
        placed = place(common_grid([fast]), slow, [gap])
        inner = placed.rows[5:-5]
        assert np.count_nonzero(inner == -1) == 1
        assert placed.repeated == 0


def test_a_slow_device_is_held_for_its_own_period_only() -> None:
    fast, slow = np.arange(400) / 400.0, np.array([0.2, 0.3, 0.4])
    placed = place(common_grid([fast, slow]), slow, [])
    taken = np.flatnonzero(placed.rows >= 0) / 400.0
    assert taken[0] == pytest.approx(0.15, abs=0.003)
    assert taken[-1] == pytest.approx(0.45, abs=0.003)
    assert placed.left_out == 0


def test_devices_with_one_sample_or_none() -> None:
    one, none = np.array([2.0]), np.empty(0)
    grid = common_grid([one, none])
    assert grid.count == 1
    assert place(grid, one, []).rows.tolist() == [0]
    assert place(grid, none, []).rows.tolist() == [-1]
