"""Whether gyroscope and accelerometer are the same right-handed axes, told by the strides."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.gait.stills import Stills
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
FEWEST_STRIDES, MANY_STRIDES = 4, 8
PIECE_S, PIECES = 15.0, 4
"""Of a long recording, so many pieces of that length with the most motion are looked at: how a
sensor's axes lie does not change."""

ENOUGH_HZ = 100.0
"""Swings are well integrated at this rate."""

CLEARLY, WELL, FAR_BETTER = 0.6, 0.4, 0.5
"""Another reading of the axes is taken to be the right one if it leaves at most this share of the
velocity at the ends of strides, and less than so much [m/s], or a still smaller share. In simulated
walks with uncalibrated sensors the right reading leaves the least; a bias that is not known, for
want of rest, may leave as much as a wrong one, and of few strides one in fifty fits by chance."""

FITS = 0.15
"""With no more left than this [m/s], the axes are right: wrong ones leave 0.23 m/s at least, in
straight walks with little use of the axis that is wrong, and mostly 0.5 to 1."""

MOST_SPEED = 1.0
"""What is left of a stride counts up to this [m/s]: rests that were none, and stumbles, leave any
speed; turns leave as much where an axis is wrong that is hardly used in walking straight on."""

LIKE_THE_BEST = 1.1
"""Of readings that leave little more than the best one, the one that changes least is given."""


@dataclass(frozen=True, eq=False)
class AxesAgreement:
    """How well strides end at rest if the gyroscope is read as it is, and as would fit best.

    Attributes
    ----------
    strides : int
        Compared.
    left : float
        Speed left at the end of strides integrated from their beginning, root mean square [m/s].
    best : shape (3, 3)
        What the gyroscope's readings would have to be multiplied by for the least of it.
    left_by_best : float
        [m/s]
    """

    strides: int
    left: float
    best: FloatArray
    left_by_best: float

    @property
    def agree(self) -> bool:
        """Whether nothing fits clearly better than the axes as they are."""
        sure = self.left_by_best < WELL and self.strides >= MANY_STRIDES
        share = CLEARLY if sure else FAR_BETTER
        return self.strides < FEWEST_STRIDES or self.left_by_best > share * self.left


@dataclass(frozen=True, eq=False)
class StrideSample:
    """Some strides of a recording, each from rest to rest.

    Attributes
    ----------
    parts : list
        Of each piece of the recording: it, and first and last sample of its strides.
    bias : shape (3,)
        Of the gyroscope [rad/s].
    gravity : float
        As the accelerometer reads it at rest [m/s^2].
    """

    parts: list[tuple[ImuBlock, IntArray, IntArray]]
    bias: FloatArray
    gravity: float

    def __len__(self) -> int:
        """Return the number of strides."""
        return sum(len(first) for _, first, _ in self.parts)

    def up(self) -> FloatArray:
        """Return the direction of what the accelerometer reads at rest, shape (3,)."""
        read = [
            moving_mean(part.t, part.accel, 0.5 * WINDOW_S)[first]
            for part, first, _ in self.parts
            if len(first)
        ]
        mean = np.median(np.concatenate(read), axis=0)
        return np.asarray(mean / np.linalg.norm(mean))

    def left(self, axes: FloatArray, delay: int = 0, force: FloatArray | None = None) -> FloatArray:
        """Return the velocity left at the end of each stride, shape (h, k, 3) [m/s].

        Parameters
        ----------
        axes : shape (h, 3, 3)
            What the gyroscope's readings are multiplied by.
        delay : int
            Samples by which they are put off.
        force : shape (4, 3), optional
            What the accelerometer's readings, with a 1 [m/s^2] behind them, are multiplied by.
        """
        left = [np.empty((len(axes), 0, 3))]
        for part, first, last in self.parts:
            accel, gravity = part.accel, self.gravity
            up = moving_mean(part.t, accel, 0.5 * WINDOW_S)[first]
            if force is not None and len(first):
                read = up
                accel, up = accel @ force[:3] + force[3], up @ force[:3] + force[3]
                # Gravity is what is read at rest.
                gravity *= float(np.median(np.linalg.norm(up, axis=1)))
                gravity /= float(np.median(np.linalg.norm(read, axis=1)))
            dt = np.diff(part.t, prepend=part.t[0])
            rate = np.roll(part.gyro - self.bias, delay, axis=0)
            left.append(stride_velocities(dt, rate, accel, first, last, up, gravity, axes))
        return np.concatenate(left, axis=1)


def sample_strides(
    block: ImuBlock, stills: Stills, gravity: float = STANDARD_GRAVITY
) -> StrideSample:
    """Find strides to compare gyroscope and accelerometer by, in whatever unit the former is.

    Parameters
    ----------
    block : ImuBlock
        Of a foot, finite and contiguous, times never decreasing.
    stills : Stills
        Of it.
    gravity : float
        [m/s^2]
    """
    bias, size = np.zeros(3), gravity
    if len(stills):
        longest = int(np.argmax(stills.duration))
        bias = block.gyro[stills.begin[longest] : stills.end[longest]].mean(axis=0)
        size = gravity_at_rest(block, stills)
    parts = [(part, *_strides(part, gravity)) for part in _pieces(block)]
    if not len(stills):
        resting = [
            moving_mean(part.t, part.accel, 0.5 * WINDOW_S)[first]
            for part, first, _ in parts
            if len(first)
        ]
        if resting:
            size = float(np.median(np.linalg.norm(np.concatenate(resting), axis=1)))
    found = sum(len(first) for _, first, _ in parts)
    some = slice(None, None, max(1, -(-found // MOST_STRIDES)))
    return StrideSample([(part, a[some], b[some]) for part, a, b in parts], bias, size)


def gravity_at_rest(block: ImuBlock, stills: Stills) -> float:
    """Return the size of the mean specific force in the middle one of the stills [m/s^2]."""
    sizes = [
        np.linalg.norm(block.accel[begin:end].mean(axis=0))
        for begin, end in zip(stills.begin, stills.end, strict=True)
    ]
    return float(np.median(sizes))


def compare_axes(strides: StrideSample) -> AxesAgreement:
    """Integrate strides with every order and sign of the gyroscope's axes, and in other units.

    A consistent mirror image of all six axes (an accelerometer that shows -1 g on the axis that
    points up, for one) obeys the same laws and cannot be told: left and right are exchanged then,
    distances are right.
    """
    if not len(strides):
        return AxesAgreement(0, 0.0, np.eye(3), 0.0)
    axes = _readings()
    as_it_is = _compared(strides.left(axes[:1]), axes[:1])
    if as_it_is.left < FITS:
        return as_it_is
    return _compared(strides.left(axes), axes)


def _compared(left: FloatArray, axes: FloatArray) -> AxesAgreement:
    speeds = np.minimum(np.linalg.norm(left, axis=2), MOST_SPEED)
    typical = np.sqrt(np.mean(speeds**2, axis=1))
    changed = np.count_nonzero(axes != axes[0], axis=(1, 2))
    nearly = typical <= LIKE_THE_BEST * typical.min()
    best = int(np.argmin(np.where(nearly, changed, np.inf)))
    return AxesAgreement(
        speeds.shape[1],
        float(typical[0]),
        axes[best],
        float(typical[best]),
    )


@cache
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


def _pieces(block: ImuBlock) -> list[ImuBlock]:
    """Return the block, or the pieces of a long one with the most motion, at about 100 Hz."""
    t = block.t
    if t[-1] - t[0] <= PIECE_S * PIECES:
        return [_thinned(block)]
    marks = np.arange(t[0], t[-1], PIECE_S)
    edges = np.unique(np.append(np.searchsorted(t, marks), len(t)))
    energy = np.add.reduceat(np.einsum("ij,ij->i", block.gyro, block.gyro), edges[:-1])
    most = np.sort(np.argsort(energy)[-PIECES:])
    return [_thinned(block[edges[k] : edges[k + 1]]) for k in most]


def _thinned(block: ImuBlock) -> ImuBlock:
    """Return means of neighbouring samples, no fewer than 100 per second."""
    rate = (len(block) - 1) / max(block.t[-1] - block.t[0], 1e-9)
    every = int(rate / ENOUGH_HZ + 1e-3)
    if every < 2:
        return block
    rows = len(block) // every * every
    t = block.t[:rows].reshape(-1, every).mean(axis=1)
    accel, gyro = (
        np.add.reduceat(values[:rows], np.arange(0, rows, every), axis=0) / every
        for values in (block.accel, block.gyro)
    )
    return ImuBlock(t, accel, gyro, t)
