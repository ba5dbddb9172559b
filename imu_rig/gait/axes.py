"""Whether gyroscope and accelerometer are the same right-handed axes, told by the strides."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.gait.stills import find_stills, rough_gyro_bias
from imu_rig.kernels.rolling import moving_mean, moving_minimum
from imu_rig.kernels.stride_velocity import stride_velocities
from imu_rig.units import DEG, STANDARD_GRAVITY

TYPICAL_RATE = 2.5
"""Root mean square of the angular rate of a foot that walks [rad/s]. With the gyroscope scaled to
it, rests are found whatever its unit."""
LEVER_M, SETTLING_S = 0.1, 0.0175
"""Make velocities of a foot's angular rate and acceleration, as in `gait.options`."""
WINDOW_S = 0.05
REST_SHARE = 0.35
"""The foot rests where its motion is below this share of that of its swings..."""
REST_RATIO, REST_WITHIN_S = 2.5, 0.8
"""... and at most so many times the least within that time: the middle of a swing is quiet too."""
STRIDE_S = (0.25, 3.0)
SWING_SHARE = 0.4
MOST_STRIDES = 12
FEWEST_STRIDES = 4
PIECE_S, PIECES = 15.0, 4
"""Of a long recording, so many pieces of that length with the most motion are looked at: how a
sensor's axes lie does not change."""

CLEARLY = 0.7
"""Another reading of the axes is taken to be the right one if it leaves at most this share of the
velocity at the end of the middle stride..."""
MOSTLY = 0.75
"""... and is the better one in this share of the strides. In simulated walks with uncalibrated
sensors the right reading always leaves the least, by a factor of 1.2 at least."""


@dataclass(frozen=True, eq=False)
class AxesAgreement:
    """How well strides end at rest if the gyroscope is read as it is, and as would fit best.

    Attributes
    ----------
    strides : int
        Compared.
    left : float
        Median speed left at the end of a stride integrated from its beginning [m/s].
    best : shape (3, 3)
        What the gyroscope's readings would have to be multiplied by for the least of it.
    left_by_best : float
        [m/s]
    share : float
        Of the strides in which that is better.
    """

    strides: int
    left: float
    best: FloatArray
    left_by_best: float
    share: float

    @property
    def agree(self) -> bool:
        """Whether nothing fits clearly better than the axes as they are."""
        return (
            self.strides < FEWEST_STRIDES
            or self.left_by_best > CLEARLY * self.left
            or self.share < MOSTLY
        )


def compare_axes(block: ImuBlock, gravity: float = STANDARD_GRAVITY) -> AxesAgreement:
    """Integrate strides with every order and sign of the gyroscope's axes, and in other units.

    A consistent mirror image of all six axes (an accelerometer that shows -1 g on the axis that
    points up, for one) obeys the same laws and cannot be told: left and right are exchanged then,
    distances are right.

    Parameters
    ----------
    block : ImuBlock
        Of a foot, finite, times never decreasing.
    gravity : float
        [m/s^2]

    Returns
    -------
    AxesAgreement
    """
    bias, size = _at_rest(block, gravity)
    parts = [(part, *_strides(part, gravity)) for part in _pieces(block)]
    found = sum(len(first) for _, first, _ in parts)
    if not found:
        return AxesAgreement(0, 0.0, np.eye(3), 0.0, 0.0)
    every = max(1, -(-found // MOST_STRIDES))
    axes = _readings()
    left = []
    for part, first, last in parts:
        some = slice(None, None, every)
        up = moving_mean(part.t, part.accel, 0.5 * WINDOW_S)[first[some]]
        dt = np.diff(part.t, prepend=part.t[0])
        rate = part.gyro - bias
        left.append(
            stride_velocities(dt, rate, part.accel, first[some], last[some], up, size, axes)
        )
    return _compared(np.concatenate(left, axis=1), axes)


def _compared(left: FloatArray, axes: FloatArray) -> AxesAgreement:
    speeds = np.linalg.norm(left, axis=2)
    medians = np.median(speeds, axis=1)
    best = int(np.argmin(medians))
    return AxesAgreement(
        speeds.shape[1],
        float(medians[0]),
        axes[best],
        float(medians[best]),
        float(np.mean(speeds[best] < speeds[0])),
    )


def _readings() -> FloatArray:
    """Return all ways of reading a gyroscope, shape (h, 3, 3), the first as it is."""
    ways = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            axes = np.zeros((3, 3))
            axes[range(3), order] = signs
            ways.append(axes)
    return np.array([*ways, np.eye(3) * DEG, np.eye(3) / DEG])


def _strides(block: ImuBlock, gravity: float) -> tuple[IntArray, IntArray]:
    """Return first and last sample of strides from rest to rest, in whatever unit the gyro is."""
    t = block.t
    rate = np.linalg.norm(block.gyro, axis=1)
    typical = float(np.sqrt(np.mean(rate**2)))
    if typical == 0.0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    around = moving_mean(t, block.accel, 0.125)
    size = np.maximum(np.linalg.norm(around, axis=1, keepdims=True), 1e-9)
    shaken = np.linalg.norm(block.accel - gravity * around / size, axis=1)
    square = (LEVER_M * TYPICAL_RATE / typical * rate) ** 2 + (SETTLING_S * shaken) ** 2
    motion = np.sqrt(np.maximum(moving_mean(t, square[:, None], 0.5 * WINDOW_S)[:, 0], 0.0))
    swings = float(np.percentile(motion, 90))
    rests = np.flatnonzero(
        (motion <= moving_minimum(t, motion, 0.15))
        & (motion < REST_SHARE * swings)
        & (motion <= REST_RATIO * moving_minimum(t, motion, REST_WITHIN_S) + 0.01 * swings)
    )
    if len(rests) < 2:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    first, last = rests[:-1], rests[1:]
    took = t[last] - t[first]
    highest = np.maximum.reduceat(motion, rests)[:-1]
    fit = (took >= STRIDE_S[0]) & (took <= STRIDE_S[1]) & (highest > SWING_SHARE * swings)
    return first[fit].astype(np.int64), last[fit].astype(np.int64)


def _at_rest(block: ImuBlock, gravity: float) -> tuple[FloatArray, float]:
    """Return the gyroscope's bias and the size of gravity by the accelerometer, if it rests."""
    stills = find_stills(block.t, block.accel, block.gyro)
    if not len(stills):
        return np.zeros(3), gravity
    sizes = [
        np.linalg.norm(block.accel[begin:end].mean(axis=0))
        for begin, end in zip(stills.begin, stills.end, strict=True)
    ]
    return rough_gyro_bias(stills), float(np.median(sizes))


def _pieces(block: ImuBlock) -> list[ImuBlock]:
    """Return the block, or the pieces of a long one with the most motion."""
    t = block.t
    if t[-1] - t[0] <= PIECE_S * PIECES:
        return [_contiguous(block)]
    marks = np.arange(t[0], t[-1], PIECE_S)
    edges = np.unique(np.append(np.searchsorted(t, marks), len(t)))
    energy = np.add.reduceat(np.einsum("ij,ij->i", block.gyro, block.gyro), edges[:-1])
    most = np.sort(np.argsort(energy)[-PIECES:])
    return [_contiguous(block[edges[k] : edges[k + 1]]) for k in most]


def _contiguous(block: ImuBlock) -> ImuBlock:
    """Return the block as kernels read it."""
    accel, gyro = (np.ascontiguousarray(a, dtype=float) for a in (block.accel, block.gyro))
    return replace(block, accel=accel, gyro=gyro)
