"""Samples placed on a grid of equal steps, for formats that have no times of their own.

Nothing is interpolated: a point of the grid takes the sample that is nearest in time, and none
where the device's samples are missing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.recording.contents import Missing


@dataclass(frozen=True)
class Grid:
    """Points at ``start_s + k / rate_hz`` for k from 0 to ``count - 1``."""

    start_s: float
    rate_hz: float
    count: int

    @property
    def t(self) -> FloatArray:
        """Time of the points [s], shape (count,)."""
        return self.start_s + np.arange(self.count) / self.rate_hz


@dataclass(frozen=True, eq=False)
class Placed:
    """Which sample each point of a grid takes.

    Attributes
    ----------
    rows : shape (count,)
        Number of the sample; -1 for none.
    repeated : int
        Points that take a sample that the point before took too.
    left_out : int
        Samples that no point takes.
    empty : int
        Points without a sample.
    """

    rows: IntArray
    repeated: int
    left_out: int
    empty: int


def fit_steps(t: FloatArray) -> tuple[float, float] | None:
    """Fit equal steps to all samples of a device: rate [Hz] and time of the first [s].

    None for fewer than two samples. A step that is a multiple of the usual one counts as so many.
    """
    if len(t) < 2:
        return None
    steps = np.diff(t)
    number = np.zeros(len(t))
    np.cumsum(np.maximum(np.rint(steps / np.median(steps)), 1.0), out=number[1:])
    centred = number - number.mean()
    rate = float(centred @ centred / (centred @ (t - t.mean())))
    return rate, float(t.mean() - number.mean() / rate)


def common_grid(times: Sequence[FloatArray], alone_hz: float = 1.0) -> Grid:
    """Return the grid of the fastest device, in step with it and over the time of all.

    The rate is one that a 32-bit float holds, for that is how it will be stored. ``alone_hz``
    counts where no device has two samples.
    """
    first = min(float(t[0]) for t in times if len(t))
    last = max(float(t[-1]) for t in times if len(t))
    fits = [fit for t in times if (fit := fit_steps(t)) is not None]
    fastest, begin = max(fits) if fits else (alone_hz, first)
    rate = float(np.float32(fastest))
    start = begin - math.ceil((begin - first) * rate - 0.5) / rate
    return Grid(start, rate, math.floor((last - start) * rate + 0.5) + 1)


def place(grid: Grid, t: FloatArray, missing: Sequence[Missing]) -> Placed:
    """Find the sample for each point of a grid.

    Parameters
    ----------
    grid : Grid
    t : shape (n,)
        Time of the samples [s], increasing.
    missing : sequence of Missing
        Where samples of the device are missing: there, and before the first sample and after the
        last, a sample reaches half a period of the device only.
    """
    points = grid.t
    if not len(t):
        return Placed(np.full(grid.count, -1, np.int64), 0, 0, grid.count)
    after = np.searchsorted(t, points).clip(0, len(t) - 1)
    before = (after - 1).clip(0)
    rows = np.where(points - t[before] < t[after] - points, before, after).astype(np.int64)
    edges = np.zeros(grid.count + 1, np.int64)
    starts = np.array([gap.start_s for gap in missing])
    stops = np.array([gap.stop_s for gap in missing])
    np.add.at(edges, np.searchsorted(points, starts), 1)
    np.add.at(edges, np.searchsorted(points, stops, side="right"), -1)
    known = (np.cumsum(edges[:-1]) == 0) & (points >= t[0]) & (points <= t[-1])
    fit = fit_steps(t)
    reach = 0.5 / (grid.rate_hz if fit is None else fit[0])
    rows[~known & (np.abs(points - t[rows]) > reach)] = -1
    there = rows[rows >= 0]
    taken = len(np.unique(there))
    return Placed(rows, len(there) - taken, len(t) - taken, grid.count - len(there))
