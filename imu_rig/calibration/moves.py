"""Moves between neighbouring stills, and the rotation that the gyroscope saw in each.

The product of all samples' small rotations is taken as a tree of pairs over all moves at once;
its derivative with respect to gain and bias comes out of the same tree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.stills import Stills, gaps

LONGEST_S = 60.0
"""A longer move carries more gyroscope drift than it tells about the gain."""
END_S = 3.0
"""Part of a still next to a move whose gravity counts for it. A hand or a table trembles by a
tenth of a degree, which the gyroscope follows over this time without its bias mattering."""
SLOPES = 15
"""Parameters that a turn depends on: K row by row, bias at its begin, bias at its end."""
BATCH = 100_000
"""Samples integrated at once, which bounds the memory."""


@dataclass(frozen=True, eq=False)
class Moves:
    """``n`` moves, each from the end of one still to the begin of the next.

    Attributes
    ----------
    first, last : shape (n,)
        Indices of the stills at the ends.
    rate : shape (s, 3)
        Mean raw rate of each sample interval of all moves in turn (trapezoid) [rad/s].
    dt : shape (s,)
        Length of each interval by the measured time stamps [s].
    share : shape (s,)
        How far into its move each interval lies, 0 to 1.
    length : shape (n,)
        Intervals of each move; their sum is s.
    duration : shape (n,)
        Time each move took [s].
    gravity_before, gravity_after : shape (n, 3)
        Raw mean specific force of the neighbouring stills, turned by the gyroscope to the
        attitude at the very begin and end of the move [m/s^2].
    gravity_sem : shape (n,)
        Standard error per axis of either, root sum of squares of both [m/s^2].
    """

    first: IntArray
    last: IntArray
    rate: FloatArray
    dt: FloatArray
    share: FloatArray
    length: IntArray
    duration: FloatArray
    gravity_before: FloatArray
    gravity_after: FloatArray
    gravity_sem: FloatArray

    def __len__(self) -> int:
        """Return the number of moves."""
        return int(self.first.shape[0])

    def scaled(self, factor: float) -> Moves:
        """Return the moves with every rate times ``factor``, as another unit would have it."""
        return replace(self, rate=self.rate * factor)

    def with_gravity(self, calibrate: Callable[[FloatArray], FloatArray]) -> Moves:
        """Return the moves with calibrated gravity at their ends."""
        return replace(
            self,
            gravity_before=calibrate(self.gravity_before),
            gravity_after=calibrate(self.gravity_after),
        )

    def only(self, keep: BoolArray) -> Moves:
        """Return the moves that ``keep`` (n,) marks."""
        rows = np.repeat(keep, self.length)
        return Moves(
            self.first[keep],
            self.last[keep],
            self.rate[rows],
            self.dt[rows],
            self.share[rows],
            self.length[keep],
            self.duration[keep],
            self.gravity_before[keep],
            self.gravity_after[keep],
            self.gravity_sem[keep],
        )


def moves_between(
    block: ImuBlock, stills: Stills, bias: FloatArray, bad: BoolArray | None = None
) -> Moves:
    """Collect the moves between neighbouring stills that can be integrated.

    A move that spans a gap in the samples, lasts longer than `LONGEST_S` or contains a bad reading
    is left out.

    Parameters
    ----------
    block : ImuBlock
        The recording.
    stills : Stills
        Its ``m`` still intervals.
    bias : shape (m, 3)
        Raw gyroscope bias at each still [rad/s].
    bad : shape (n, 3), optional
        Readings at the gyroscope's range limit.
    """
    holes = gaps(block.t)
    first, rates, steps, shares = [], [], [], []
    for i in range(len(stills) - 1):
        a, b = int(stills.stop[i]) - 1, int(stills.start[i + 1])
        if np.any((holes >= a) & (holes < b)) or block.t[b] - block.t[a] > LONGEST_S:
            continue
        if bad is not None and np.any(bad[a : b + 1]):
            continue
        t, w = block.t[a : b + 1], block.gyro[a : b + 1]
        first.append(i)
        rates.append(0.5 * (w[1:] + w[:-1]))
        steps.append(np.diff(t))
        shares.append((0.5 * (t[1:] + t[:-1]) - t[0]) / (t[-1] - t[0]))
    start = np.array(first, dtype=np.int64)
    before = [_gravity_at_end(block, stills, bias, i) for i in first]
    after = [_gravity_at_begin(block, stills, bias, i + 1) for i in first]
    return Moves(
        first=start,
        last=start + 1,
        rate=np.concatenate(rates) if rates else np.empty((0, 3)),
        dt=np.concatenate(steps) if steps else np.empty(0),
        share=np.concatenate(shares) if shares else np.empty(0),
        length=np.array([len(s) for s in steps], dtype=np.int64),
        duration=np.array([s.sum() for s in steps]),
        gravity_before=np.array([mean for mean, _ in before]).reshape(-1, 3),
        gravity_after=np.array([mean for mean, _ in after]).reshape(-1, 3),
        gravity_sem=np.hypot([sem for _, sem in before], [sem for _, sem in after]),
    )


def _gravity_at_end(
    block: ImuBlock, stills: Stills, bias: FloatArray, i: int
) -> tuple[FloatArray, float]:
    rows = slice(int(stills.start[i]), int(stills.stop[i]))
    near = block.t[rows] >= block.t[rows][-1] - END_S
    return _gravity_seen_from(block[rows][near], stills, bias[i], i, row=-1)


def _gravity_at_begin(
    block: ImuBlock, stills: Stills, bias: FloatArray, i: int
) -> tuple[FloatArray, float]:
    rows = slice(int(stills.start[i]), int(stills.stop[i]))
    near = block.t[rows] <= block.t[rows][0] + END_S
    return _gravity_seen_from(block[rows][near], stills, bias[i], i, row=0)


def _gravity_seen_from(
    part: ImuBlock, stills: Stills, bias: FloatArray, i: int, *, row: int
) -> tuple[FloatArray, float]:
    """Mean specific force as it would be in the attitude of one ``row``, and its error."""
    rate = part.gyro - bias
    turns = 0.5 * (rate[1:] + rate[:-1]) * np.diff(part.t)[:, None]
    angle = np.concatenate((np.zeros((1, 3)), np.cumsum(turns, axis=0)))
    angle -= angle[row]
    mean = part.accel.mean(axis=0) + np.cross(angle, part.accel).mean(axis=0)
    # Along gravity only the sensor's own noise shows: the gyroscope has followed the tremor.
    up = mean / np.linalg.norm(mean)
    spread = float(up @ stills.accel_cov[i] @ up) * float(stills.count[i]) / len(part)
    return mean, float(np.sqrt(spread))


def integrate(moves: Moves, K: FloatArray, bias: FloatArray) -> FloatArray:
    """Quaternions (n, 4) from the end of each move to its begin, body axes.

    Parameters
    ----------
    moves : Moves
        The moves.
    K : shape (3, 3)
        Gyroscope gain.
    bias : shape (m, 3)
        Raw bias at every still [rad/s], interpolated linearly over a move.
    """
    return _integrate(moves, K, bias, slopes=False)[0]


def integrate_with_slopes(
    moves: Moves, K: FloatArray, bias: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Quaternions as `integrate`, and their derivative.

    Returns
    -------
    q : shape (n, 4)
        Rotations.
    J : shape (n, 3, 15)
        Derivative of the rotation vector of ``conj(q0) * q`` with respect to K row by row, to the
        bias at the begin and to the bias at the end of the move.
    """
    return _integrate(moves, K, bias, slopes=True)


def _integrate(
    moves: Moves, K: FloatArray, bias: FloatArray, *, slopes: bool
) -> tuple[FloatArray, FloatArray]:
    q = np.empty((len(moves), 4))
    J = np.empty((len(moves), 3, SLOPES))
    ends = np.cumsum(moves.length)
    i = 0
    while i < len(moves):
        begin = int(ends[i] - moves.length[i])
        j = max(i + 1, int(np.searchsorted(ends, begin + BATCH, side="right")))
        rows = slice(begin, int(ends[j - 1]))
        share = moves.share[rows, None]
        low = np.repeat(bias[moves.first[i:j]], moves.length[i:j], axis=0)
        high = np.repeat(bias[moves.last[i:j]], moves.length[i:j], axis=0)
        turn = (moves.rate[rows] - low - share * (high - low)) * moves.dt[rows, None]
        theta = turn @ K.T
        steps = rotation.from_rotation_vector(theta)
        slope = _step_slopes(theta, turn, moves.dt[rows], share[:, 0], K) if slopes else None
        q[i:j], J[i:j] = _tree(steps, slope, moves.length[i:j])
        i = j
    return rotation.normalize(q), J


def _step_slopes(
    theta: FloatArray, turn: FloatArray, dt: FloatArray, share: FloatArray, K: FloatArray
) -> FloatArray:
    """Differentiate each small rotation (right perturbation): (s, 3, 15)."""
    X = rotation.skew(theta)
    # The right Jacobian of a rotation to second order: a sample turns by a few hundredths.
    right = np.eye(3) - 0.5 * X + X @ X / 6.0
    slope = np.empty((len(theta), 3, SLOPES))
    slope[:, :, :9] = (right[:, :, :, None] * turn[:, None, None, :]).reshape(-1, 3, 9)
    late = (right @ K) * (share * dt)[:, None, None]
    slope[:, :, 9:12] = late - (right @ K) * dt[:, None, None]
    slope[:, :, 12:] = -late
    return slope


def _tree(
    q: FloatArray, slope: FloatArray | None, length: IntArray
) -> tuple[FloatArray, FloatArray | float]:
    """Multiply neighbours in pairs until one rotation per move is left."""
    length = length.copy()
    while np.any(length > 1):
        offset = np.cumsum(length) - length
        place = np.arange(len(q)) - np.repeat(offset, length)
        left = np.flatnonzero(place % 2 == 0)
        paired = place[left] + 1 < np.repeat(length, length)[left]
        one, two = left[paired], left[paired] + 1
        product = q[left]
        product[paired] = rotation.multiply(q[one], q[two])
        if slope is not None:
            joined = slope[left]
            back = np.swapaxes(rotation.to_matrix(q[two]), 1, 2)
            joined[paired] = back @ slope[one] + slope[two]
            slope = joined
        q = product
        length = (length + 1) // 2
    return q, 0.0 if slope is None else slope
