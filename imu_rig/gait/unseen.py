"""Motion that a sensor did not see: between samples, in gaps, and beyond the end of its range."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.gait.footfalls import runs
from imu_rig.gait.trajectory import Footfalls, TrajectoryCovariance
from imu_rig.kernels.columns import extent, repeated, scatter
from imu_rig.units import DEG, STANDARD_GRAVITY

GAP_S, GAP_RATIO = 0.03, 1.8
"""A gap is an interval longer than both this [s] and this many usual ones: motion of a foot goes up
to about 15 Hz, and is seen by samples 30 ms apart."""

STEP_S = 0.35
"""In a gap as long as this between two moments of rest, a whole swing may be hidden [s]."""

REST_RATE, REST_FORCE = 1.0, 2.0
"""Beside a gap, a foot rests that turns and is accelerated by less than this [rad/s, m/s^2]."""

SWING_S = 0.15
"""Of a swing, which takes 0.35 s or longer, a part this long cannot be bridged [s]: the foot turns
by 60 deg and more meanwhile."""

BESIDE_S = 0.03

TOP, BELOW = 0.01, 0.06
"""Peaks end anywhere; those that are cut off end together. The axis is taken to be cut off when the
uppermost hundredth of its range holds..."""
PILED, LEAST_PILED = 3.0, 10
"""... so many times what each of the next five hundredths holds, and so many samples more."""

CLIP_ABOVE_GYRO, CLIP_ABOVE_ACCEL = 240.0 * DEG, 1.95 * STANDARD_GRAVITY
"""The smallest ranges are 250 deg/s and 2 g, less an error of scale [rad/s, m/s^2]. Below, readings
pile up at rest."""


@dataclass(frozen=True, eq=False)
class Gaps:
    """Intervals without samples.

    Attributes
    ----------
    row : shape (k,)
        First sample after each.
    length : shape (k,)
        [s]
    resting : shape (k,)
        Whether the foot rests at both ends of it.
    """

    row: IntArray
    length: FloatArray
    resting: BoolArray

    def __len__(self) -> int:
        """Return their number."""
        return len(self.row)


@dataclass(frozen=True, eq=False)
class Clipping:
    """Readings at the end of a range.

    Attributes
    ----------
    cut : shape (n, 3)
        Which readings are.
    limit : shape (3,)
        The range of each axis; infinite where none was reached.
    """

    cut: BoolArray
    limit: FloatArray

    @property
    def any(self) -> bool:
        """Whether a range was reached."""
        return bool(np.isfinite(self.limit).any())


@dataclass(frozen=True, eq=False)
class Unseen:
    """What may have happened unseen from each sample to the next, standard deviations.

    Attributes
    ----------
    turn : shape (n,)
        About each axis since the sample before [rad].
    velocity : shape (n,)
        Along each axis [m/s].
    place : shape (n,)
        Along each axis, what is left when turn and velocity are known [m].
    """

    turn: FloatArray
    velocity: FloatArray
    place: FloatArray

    def __getitem__(self, rows: slice) -> Unseen:
        """Return some of the samples."""
        return Unseen(self.turn[rows], self.velocity[rows], self.place[rows])


@dataclass(frozen=True, eq=False)
class Holes:
    """Where motion went unseen: missing samples, and readings at the end of their range."""

    gaps: Gaps
    gyro: Clipping
    accel: Clipping


def find_holes(block: ImuBlock) -> Holes:
    """Return where samples are missing and readings are cut off."""
    return Holes(
        find_gaps(block),
        find_clipping(block.gyro, CLIP_ABOVE_GYRO),
        find_clipping(block.accel, CLIP_ABOVE_ACCEL),
    )


def find_gaps(block: ImuBlock) -> Gaps:
    """Return where samples are missing.

    A sample of a moving foot that repeats the one before counts as missing; a foot that stands may
    well read the same for a while.
    """
    t = block.t
    rows = np.arange(len(t))
    again = repeated(_floats(block.accel), _floats(block.gyro))
    if again.any():
        moves = np.einsum("ij,ij->i", block.gyro, block.gyro) > REST_RATE**2
        rows = np.flatnonzero(~(moves & again))
        t = t[rows]
    dt = np.diff(t)
    if dt.max(initial=0.0) <= GAP_S:
        return Gaps(np.empty(0, np.int64), np.empty(0), np.empty(0, dtype=bool))
    positive = dt[dt > 0.0]
    usual = float(np.median(positive)) if len(positive) else 0.0
    after = np.flatnonzero(dt > max(GAP_S, GAP_RATIO * usual)) + 1
    row = rows[after].astype(np.int64)
    resting = np.array(
        [_rests(block, rows[k - 1], -1) and _rests(block, rows[k], 1) for k in after], dtype=bool
    )
    return Gaps(row, dt[after - 1], resting)


def find_clipping(values: FloatArray, least: float) -> Clipping:
    """Return which readings, shape (n, 3), are at the end of the range of their axis.

    Parameters
    ----------
    values : shape (n, 3)
    least : float
        Ranges below this are none.
    """
    limit = np.full(3, np.inf)
    cut = np.zeros(values.shape, dtype=bool)
    if len(values) == 0:
        return Clipping(cut, limit)
    largest = np.abs(extent(_floats(values))[:2]).max(axis=0)
    for axis in np.flatnonzero(largest >= least):
        size, most = np.abs(values[:, axis]), float(largest[axis])
        top = int(np.count_nonzero(size >= (1 - TOP) * most))
        below = int(np.count_nonzero(size >= (1 - BELOW) * most)) - top
        if top > PILED * below * TOP / (BELOW - TOP) + LEAST_PILED:
            limit[axis] = most
            cut[:, axis] = size >= (1 - TOP) * most
    return Clipping(cut, limit)


def unseen_motion(block: ImuBlock, holes: Holes | None = None) -> Unseen:
    """Return by how much attitude and velocity may have changed unseen, sample by sample.

    Over a gap of length T, readings are taken to go straight from one end to the other. What they
    really did is taken for a random walk tied at both ends, whose integral has the standard
    deviation ``D(T) T / sqrt(12)`` with D(T) the root mean square of the difference of readings T
    apart, as measured around the gap. A whole swing of the acceleration in between leaves the
    velocity as it is and moves the foot by ``D(T) T^2 / (2 pi)``. Where a range ended, a parabola
    with the slopes at its edges rises above it: its area, ``slope d^2 / 6``, is what is missing.

    A shoe rings when it strikes, and many sensors do not smooth their readings before they sample
    them. Where neighbouring readings are as good as independent, with the standard deviation s,
    each stands for an unknown mean over its interval, and the integral is off by ``s dt`` every
    sample. The same is true of noise.

    Parameters
    ----------
    block : ImuBlock
    holes : Holes, optional
        `find_holes` of it, where they are known already.
    """
    holes = find_holes(block) if holes is None else holes
    place = np.zeros(len(block))
    dt = np.diff(block.t, prepend=block.t[:1])
    turn, velocity = (dt * np.sqrt(scatter(_floats(x))) for x in (block.gyro, block.accel))
    gaps = holes.gaps
    for row, length, resting in zip(gaps.row, gaps.length, gaps.resting, strict=True):
        if not resting:
            scale = length / np.sqrt(12.0)
            turn[row] += scale * _difference(block.t, block.gyro, row, length)
            force = _difference(block.t, block.accel, row, length)
            velocity[row] += scale * force
            place[row] += length**2 / (2.0 * np.pi) * force
    if holes.gyro.any:
        turn += _cut_off(block.t, block.gyro, holes.gyro)
    if holes.accel.any:
        velocity += _cut_off(block.t, block.accel, holes.accel)
    return Unseen(turn, velocity, place)


def widened(
    covariance: TrajectoryCovariance, unseen: Unseen, footfalls: Footfalls
) -> TrajectoryCovariance:
    """Return the covariance with what the foot may have moved unseen added to it."""
    if not unseen.place.any():
        return covariance
    moved = np.cumsum(unseen.place**2)
    values, strides = covariance.values.copy(), covariance.strides.copy()
    axes = np.arange(3)
    since = moved[covariance.rows] - moved[covariance.rows[0]]
    values[:, 6 + axes, 6 + axes] += since[:, np.newaxis]
    rows = footfalls.quietest
    strides[:, axes, axes] += (moved[rows[1:]] - moved[rows[:-1]])[:, np.newaxis]
    return replace(covariance, values=values, strides=strides)


def _floats(values: FloatArray) -> FloatArray:
    return np.ascontiguousarray(values, dtype=float)


def _rests(block: ImuBlock, row: int, way: int) -> bool:
    end = block.t[row] + way * BESIDE_S
    low, high = sorted((block.t[row], end))
    first, last = np.searchsorted(block.t, [low - 1e-9, high + 1e-9])
    some = slice(first, max(last, first + 1))
    rate = np.linalg.norm(block.gyro[some], axis=1)
    force = np.abs(np.linalg.norm(block.accel[some], axis=1) - STANDARD_GRAVITY)
    return bool(rate.max() < REST_RATE and force.max() < REST_FORCE)


def _difference(t: FloatArray, values: FloatArray, row: int, length: float) -> float:
    """Return how far readings so long apart differ, per axis, in the second around a row."""
    begin, end = np.searchsorted(t, [t[row] - length - 0.5, t[row] + 0.5])
    times = t[begin:end]
    later = np.searchsorted(times, times + length)
    fit = later < len(times)
    if not fit.any():
        return float(np.sqrt(np.mean((values[row] - values[row - 1]) ** 2)))
    change = values[begin:end][later[fit]] - values[begin:end][fit]
    return float(np.sqrt(np.mean(change**2)))


def _cut_off(t: FloatArray, values: FloatArray, clipping: Clipping) -> FloatArray:
    """Return what is missing of the integral of readings, per sample, shape (n,)."""
    variance = np.zeros(len(t))
    for axis in np.flatnonzero(np.isfinite(clipping.limit)):
        cut, column = clipping.cut[:, axis], values[:, axis]
        first, last = runs(cut)
        before, after = np.maximum(first - 1, 0), np.minimum(last + 1, len(t) - 1)
        slopes = [
            np.abs(column[a] - column[b]) / np.maximum(t[a] - t[b], 1e-4)
            for a, b in ((first, before), (after, last))
        ]
        missing = np.maximum(*slopes) * (t[after] - t[before]) ** 2 / 6.0
        rows = last - first + 1
        variance[cut] += np.repeat(missing**2 / rows, rows)
    return np.sqrt(variance)
