"""What a gyroscope reads while its foot stands for a while, and how far that is its bias."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from imu_rig.arrays import AnyArray, BoolArray, FloatArray, IntArray
from imu_rig.gait.footfalls import runs
from imu_rig.kernels.rolling import cell_sums
from imu_rig.units import DEG

CELL_S = 0.25
"""Windows are two neighbouring cells of this length: half a second, longer than any stance of a
brisk walk is quiet."""

SETTLING_CELLS, APART = 6, 2.0
"""Who stands sets out so gently that it shows only after a while, and comes to rest likewise: the
accelerometer takes that for a tilt, which the gyroscope does not see. Of so many cells, 1.5 s, or
more the first or last is left out where the two differ by so many times `TILT_SIGMA`."""

QUIET_RATE = 1.2 * DEG
QUIET_FORCE = 0.1
"""Standard deviations of a foot that stands [rad/s, m/s^2], without the sensor's own noise: a
tenth of what a stance in walking has."""

CHUNK = 32
"""Readings in a piece from which the noise is estimated."""

NOISE_MARGIN = 1.5
"""Of the sensor's noise, so much more may be in a window by chance and by vibration."""

STANDING_TURN = 0.5 * DEG
"""A standing foot creeps by about a degree; that about the vertical goes unseen [rad], and adds to
what is guessed from how far it tilts, which the accelerometer sees."""

TILT_SIGMA = 0.1 * DEG
"""To which the accelerometer tells a change of tilt of a standing foot [rad]: of its own noise and
the sway of the foot's owner."""

LARGEST_BIAS = 25.0 * DEG
"""What turns faster turns, however evenly [rad/s]: the worst gyroscopes are off by 20 deg/s."""

OUTLIER = 6.0
"""A still so many sigma from what the others say was none ..."""

DRIFT = 0.1 * DEG
"""... where a bias may well change by this in a recording, as a sensor warms up [rad/s]."""

LEAST_DRIFT = 0.02 * DEG
"""By which the bias of a walking foot differs from that of a standing one at least [rad/s], of
bias instability and of vibration."""

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
    up : shape (k, 3)
        The vertical in sensor axes.
    tilt_sigma, turn_sigma : shape (k,)
        Standard uncertainties of "this is the bias" about horizontal axes and about the vertical
        [rad/s].
    """

    begin: IntArray
    end: IntArray
    t: FloatArray
    duration: FloatArray
    rate: FloatArray
    up: FloatArray
    tilt_sigma: FloatArray
    turn_sigma: FloatArray

    def __getitem__(self, rows: AnyArray) -> Stills:
        """Return the stills that ``rows`` (a mask or index array) selects."""
        return Stills(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def information(self, drift: float = 0.0) -> FloatArray:
        """Return the inverse covariances of the rates, shape (k, 3, 3) [s^2/rad^2].

        Each taken for a bias that may have been off by ``drift`` [rad/s] per axis at that time.
        """
        vertical = self.up[:, :, np.newaxis] * self.up[:, np.newaxis, :]
        flat = 1.0 / (np.square(self.tilt_sigma) + drift**2)
        turn = 1.0 / (np.square(self.turn_sigma) + drift**2)
        return np.asarray(
            flat[:, np.newaxis, np.newaxis] * np.eye(3)
            + (turn - flat)[:, np.newaxis, np.newaxis] * vertical
        )

    def __len__(self) -> int:
        """Return the number of stills."""
        return len(self.t)


@dataclass(frozen=True, eq=False)
class _Cells:
    edges: IntArray
    """Rows at which cells begin, and the end, shape (c + 1,)."""
    middle: FloatArray
    duration: FloatArray
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
    rate_noise = _noise(gyro)
    quiet = _quiet_cells(cells, rate_noise, _noise(accel))
    first, last = runs(quiet)
    first, last = _settled(cells, first, last)
    longer = last > first
    first, last = first[longer], last[longer]
    if len(first) == 0:
        none = np.empty((0, 3))
        return Stills(first, first, np.empty(0), np.empty(0), none, none, np.empty(0), np.empty(0))
    # From the middle of the first cell to that of the last one, between which the tilt is read.
    middle = cells.middle
    duration = middle[last] - middle[first]
    swept = cells.rate / cells.count[:, np.newaxis] * cells.duration[:, np.newaxis]
    turned = _over(swept, first, last) - 0.5 * (swept[first] + swept[last])
    rate = (turned - _turn_seen(cells, first, last)) / duration[:, np.newaxis]
    up, wander = _tilt(cells, first, last)
    count = _over(cells.count, first, last)
    noise = NOISE_MARGIN * rate_noise / np.sqrt(count)
    turn = np.hypot(wander, STANDING_TURN)
    stills = Stills(
        cells.edges[first],
        cells.edges[last + 1],
        0.5 * (middle[first] + middle[last]),
        duration,
        rate,
        up,
        tilt_sigma=np.hypot(TILT_SIGMA / duration, noise),
        turn_sigma=np.hypot(turn / duration, noise),
    )
    return _consistent(stills)


def rough_gyro_bias(stills: Stills) -> FloatArray:
    """Return a bias worth taking off before anything else, shape (3,) [rad/s]; mostly zero.

    It keeps the motion statistic of a sensor with a large bias from never being small.
    """
    if len(stills) == 0:
        return np.zeros(3)
    bias, covariance = _mean(stills)
    sigma = np.sqrt(np.trace(covariance))
    worth = np.linalg.norm(bias) > np.hypot(SUBTRACT_SIGMA * sigma, SUBTRACT_FLOOR)
    return bias if worth else np.zeros(3)


def drift_between(stills: Stills) -> float:
    """Return by how much the bias wandered between stills, standard deviation per axis [rad/s].

    What the rates about horizontal axes, which are measured best, scatter beyond their own
    uncertainties: the estimate of DerSimonian and Laird (Controlled Clinical Trials 7, 1986) for
    the variance between groups.
    """
    if len(stills) < 2:
        return LEAST_DRIFT
    weight = stills.tilt_sigma**-2.0
    flat = stills.rate - np.einsum("ki,ki->k", stills.rate, stills.up)[:, np.newaxis] * stills.up
    off = flat - weight @ flat / weight.sum()
    excess = weight @ np.einsum("ki,ki->k", off, off) - 2.0 * (len(stills) - 1)
    scale = 2.0 * (weight.sum() - np.square(weight).sum() / weight.sum())
    return float(max(np.sqrt(max(excess, 0.0) / scale), LEAST_DRIFT))


def _mean(stills: Stills) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean rate (3,) and its covariance (3, 3)."""
    information = stills.information()
    covariance = np.linalg.inv(information.sum(axis=0))
    pointed = np.einsum("kij,kj->i", information, stills.rate)
    return np.asarray(covariance @ pointed), covariance


def _consistent(stills: Stills) -> Stills:
    """Leave out what turns evenly, as a sensor on a turntable, and what does not fit the rest."""
    stills = stills[np.linalg.norm(stills.rate, axis=1) < LARGEST_BIAS]
    while len(stills) > 1:
        weight = stills.information(DRIFT)
        covariance = np.linalg.inv(weight)
        others = weight.sum(axis=0) - weight
        pointed = np.einsum("kij,kj->ki", weight, stills.rate)
        centre = np.linalg.solve(others, (pointed.sum(axis=0) - pointed)[..., np.newaxis])[..., 0]
        off = stills.rate - centre
        spread = covariance + np.linalg.inv(others)
        far = np.einsum("ki,ki->k", off, np.linalg.solve(spread, off[..., np.newaxis])[..., 0])
        if far.max() < OUTLIER**2:
            break
        # Of two that differ both are far from each other: the lesser one goes.
        size = np.einsum("kii->k", weight)
        suspects = np.flatnonzero(far > 0.9 * far.max())
        stills = stills[np.arange(len(stills)) != suspects[np.argmin(size[suspects])]]
    return stills


def _cut(t: FloatArray, accel: FloatArray, gyro: FloatArray) -> _Cells:
    """Sum readings over cells of time; cells without a reading are left out."""
    number = int((t[-1] - t[0]) / CELL_S) if len(t) else 0
    marks = t[0] + CELL_S * np.arange(number + 1) if number else np.empty(0)
    edges = np.unique(np.searchsorted(t, marks))
    if len(edges) < 2:
        none = np.empty((0, 3))
        empty = np.empty(0)
        return _Cells(np.zeros(1, np.int64), empty, empty, empty, none, none, empty, empty)
    sums = cell_sums(edges, np.asarray(gyro, dtype=float), np.asarray(accel, dtype=float))
    count = np.diff(edges).astype(float)
    begin, end = t[edges[:-1]], t[np.minimum(edges[1:], len(t) - 1)]
    middle = 0.5 * (begin + end)
    return _Cells(
        edges, middle, end - begin, count, sums[:, :3], sums[:, 3:6], sums[:, 6], sums[:, 7]
    )


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


def _settled(cells: _Cells, first: IntArray, last: IntArray) -> tuple[IntArray, IntArray]:
    """Return where stills begin and end, without those ends of long ones that set out gently."""
    begin, end = first.copy(), last.copy()
    rows = np.flatnonzero(last - first + 1 >= SETTLING_CELLS)
    if len(rows) == 0:
        return begin, end
    a, b = first[rows], last[rows]
    up = cells.force / np.linalg.norm(cells.force, axis=1, keepdims=True)
    swept = cells.rate / cells.count[:, np.newaxis] * cells.duration[:, np.newaxis]
    # From cell to cell: what the gyroscope says of a turn less what the accelerometer does.
    off = 0.5 * (swept[1:] + swept[:-1]) - np.cross(up[1:], up[:-1])
    off -= np.einsum("ij,ij->i", off, up[1:])[:, np.newaxis] * up[1:]
    inner = _over(off, a + 1, b - 2) / (b - a - 2)[:, np.newaxis]
    begin[rows] += np.linalg.norm(off[a] - inner, axis=1) > APART * TILT_SIGMA
    end[rows] -= np.linalg.norm(off[b - 1] - inner, axis=1) > APART * TILT_SIGMA
    return begin, end


def _noise(readings: FloatArray) -> float:
    """Return the standard deviation of a sensor's white noise, by its quietest moments.

    Second differences of readings hardly contain the motion of a foot near rest.
    """
    if len(readings) < 2 * CHUNK:
        return 0.0
    # A thousand pieces tell as well as all.
    chunks = len(readings) // CHUNK
    begin = CHUNK * np.unique(np.linspace(0, chunks - 1, min(chunks, 1000)).astype(np.int64))
    pieces = readings[begin[:, np.newaxis] + np.arange(CHUNK)]
    second = pieces[:, 2:] - 2.0 * pieces[:, 1:-1] + pieces[:, :-2]
    square = np.sort(np.einsum("kij,kij->k", second, second) / (CHUNK - 2))
    return float(np.sqrt(square[len(square) // 20] / 18.0))


def _over(per_cell: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    total = np.cumsum(np.concatenate((np.zeros_like(per_cell[:1]), per_cell)), axis=0)
    return np.asarray(total[last + 1] - total[first])


def _tilt(cells: _Cells, first: IntArray, last: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return where up is in each still (k, 3), and how far it wanders about an axis [rad], (k,)."""
    up = cells.force / np.linalg.norm(cells.force, axis=1, keepdims=True)
    mean = _over(up, first, last) / (last - first + 1)[:, np.newaxis]
    size = np.linalg.norm(mean, axis=1)
    # Of unit vectors about their mean: 1 - |mean|^2 is the sum of the variances of both axes.
    number = last - first + 1
    variance = 0.5 * np.maximum(1.0 - size**2, 0.0) * number / np.maximum(number - 1, 1)
    return mean / size[:, np.newaxis], np.sqrt(2.0 * variance)


def _turn_seen(cells: _Cells, first: IntArray, last: IntArray) -> FloatArray:
    """Return by how much each still turned about horizontal axes, sensor axes [rad], (k, 3)."""
    up = cells.force / np.linalg.norm(cells.force, axis=1, keepdims=True)
    # The vertical turns the other way in the axes of what turns.
    return np.asarray(np.cross(up[last], up[first]))
