"""What a gyroscope reads while its foot stands for a while, and how far that is its bias."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.gait.footfalls import runs
from imu_rig.units import DEG

CELL_S = 0.25
"""Windows are two neighbouring cells of this length: half a second, longer than any stance of a
brisk walk is quiet."""

QUIET_RATE = 1.2 * DEG
QUIET_FORCE = 0.1
"""Standard deviations of a foot that stands [rad/s, m/s^2], without the sensor's own noise: a
tenth of what a stance in walking has."""

NOISE_MARGIN = 1.5
"""Of the sensor's noise, so much more may be in a window by chance and by vibration."""

CREEP_SHARE = 3.0
"""A foot that tilts by some angle in a still may well have turned about the vertical by so many
times that."""

LEAST_CREEP = 0.1 * DEG
"""That a standing foot creeps at least [rad]."""

SUBTRACT_SIGMA = 3.0
SUBTRACT_FLOOR = 0.1 * DEG
"""A rough bias is subtracted beyond so many times its uncertainty and this [rad/s] together."""


@dataclass(frozen=True, eq=False)
class Stills:
    """Spans in which a foot stood.

    Attributes
    ----------
    begin, end : shape (k,)
        Rows of the recording; ``begin:end`` is a still.
    t : shape (k,)
        Middle of each [s].
    duration : shape (k,)
        [s]
    rate : shape (k, 3)
        Mean reading of the gyroscope less what the accelerometer saw of a turn [rad/s].
    sigma : shape (k,)
        Standard uncertainty of "this is the bias", each axis [rad/s].
    """

    begin: IntArray
    end: IntArray
    t: FloatArray
    duration: FloatArray
    rate: FloatArray
    sigma: FloatArray

    def __len__(self) -> int:
        """Return the number of stills."""
        return len(self.t)


@dataclass(frozen=True, eq=False)
class _Cells:
    edges: IntArray
    """Rows at which cells begin, and the end, shape (c + 1,)."""
    count: FloatArray
    rate: FloatArray
    force: FloatArray
    rate_square: FloatArray
    force_square: FloatArray


def find_stills(t: FloatArray, accel: FloatArray, gyro: FloatArray) -> Stills:
    """Find where a foot stands for half a second or more, and read the gyroscope there.

    Quiet is what varies little; a constant bias of any size does not matter. The bound adapts to
    the noise of the sensor, taken from the differences of neighbouring readings.

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    accel, gyro : shape (n, 3)
        Readings [m/s^2, rad/s].
    """
    cells = _cut(t, accel, gyro)
    quiet = _quiet_cells(cells, _noise(gyro), _noise(accel))
    first, last = runs(quiet)
    longer = last > first
    first, last = first[longer], last[longer]
    begin, end = cells.edges[first], cells.edges[last + 1]
    count = _over(cells.count, first, last)
    rate = _over(cells.rate, first, last) / count[:, np.newaxis]
    square = _over(cells.rate_square, first, last) / count
    spread = np.sqrt(np.maximum(square - np.einsum("ij,ij->i", rate, rate), 0.0) / 3.0)
    duration = np.maximum(t[end - 1] - t[begin], CELL_S) if len(end) else np.empty(0)
    turn = _turn_seen(cells, first, last)
    creep = np.maximum(CREEP_SHARE * np.linalg.norm(turn, axis=1), LEAST_CREEP)
    sigma = np.hypot(creep / duration, spread * np.sqrt(CELL_S / duration))
    middle = 0.5 * (t[begin] + t[end - 1]) if len(end) else np.empty(0)
    return Stills(begin, end, middle, duration, rate - turn / duration[:, np.newaxis], sigma)


def rough_gyro_bias(stills: Stills) -> FloatArray:
    """Return a bias worth taking off before anything else, shape (3,) [rad/s]; mostly zero.

    It keeps the motion statistic of a sensor with a large bias from never being small.
    """
    if len(stills) == 0:
        return np.zeros(3)
    weight = 1.0 / np.square(stills.sigma)
    bias = np.asarray(weight @ stills.rate / weight.sum())
    sigma = float(weight.sum() ** -0.5)
    worth = np.linalg.norm(bias) > np.hypot(SUBTRACT_SIGMA * sigma, SUBTRACT_FLOOR)
    return bias if worth else np.zeros(3)


def _cut(t: FloatArray, accel: FloatArray, gyro: FloatArray) -> _Cells:
    """Sum readings over cells of time; cells without a reading are left out."""
    number = int((t[-1] - t[0]) / CELL_S) if len(t) else 0
    marks = t[0] + CELL_S * np.arange(number + 1) if number else np.empty(0)
    edges = np.unique(np.searchsorted(t, marks))
    if len(edges) < 2:
        none = np.empty((0, 3))
        return _Cells(np.zeros(1, np.int64), *(np.empty(0), none, none, np.empty(0), np.empty(0)))
    columns = np.empty((edges[-1], 8))
    columns[:, :3] = gyro[: edges[-1]]
    columns[:, 3:6] = accel[: edges[-1]]
    columns[:, 6] = np.einsum("ij,ij->i", columns[:, :3], columns[:, :3])
    columns[:, 7] = np.einsum("ij,ij->i", columns[:, 3:6], columns[:, 3:6])
    sums = np.add.reduceat(columns, edges[:-1], axis=0)
    count = np.diff(edges).astype(float)
    return _Cells(edges, count, sums[:, :3], sums[:, 3:6], sums[:, 6], sums[:, 7])


def _quiet_cells(cells: _Cells, rate_noise: float, force_noise: float) -> BoolArray:
    """Return which cells are in a quiet window of two."""
    quiet = np.zeros(len(cells.count), dtype=bool)
    if len(quiet) < 2:
        return quiet
    count = cells.count[:-1] + cells.count[1:]
    window = np.ones(len(count), dtype=bool)
    for sums, squares, most in (
        (cells.rate, cells.rate_square, np.hypot(QUIET_RATE, NOISE_MARGIN * rate_noise)),
        (cells.force, cells.force_square, np.hypot(QUIET_FORCE, NOISE_MARGIN * force_noise)),
    ):
        mean = (sums[:-1] + sums[1:]) / count[:, np.newaxis]
        square = (squares[:-1] + squares[1:]) / count
        window &= square - np.einsum("ij,ij->i", mean, mean) < 3.0 * most**2
    quiet[:-1] |= window
    quiet[1:] |= window
    return quiet


def _noise(readings: FloatArray) -> float:
    """Return the standard deviation of a sensor's white noise, by its quietest moments.

    Second differences of readings hardly contain the motion of a foot near rest.
    """
    if len(readings) < 64:
        return 0.0
    second = readings[2:] - 2.0 * readings[1:-1] + readings[:-2]
    square = np.einsum("ij,ij->i", second, second)
    rows = len(square) // 32 * 32
    by_chunk = np.sort(square[:rows].reshape(-1, 32).mean(axis=1))
    return float(np.sqrt(by_chunk[len(by_chunk) // 20] / 18.0))


def _over(per_cell: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    total = np.cumsum(np.concatenate((np.zeros_like(per_cell[:1]), per_cell)), axis=0)
    return np.asarray(total[last + 1] - total[first])


def _turn_seen(cells: _Cells, first: IntArray, last: IntArray) -> FloatArray:
    """Return by how much each still turned about horizontal axes, sensor axes [rad], (k, 3)."""
    if len(first) == 0:
        return np.empty((0, 3))
    up = cells.force / np.linalg.norm(cells.force, axis=1, keepdims=True)
    # The vertical turns the other way in the axes of what turns.
    return np.asarray(np.cross(up[last], up[first]))
