"""Takes gravity out of a recording by the attitude that gradient descent finds, eq. (8)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.gait.start import level_attitude
from imu_rig.kernels.madgwick import gradient_descent
from imu_rig.kernels.windows import scatter
from imu_rig.rotation import from_rotation_vector, multiply, rotate
from imu_rig.units import DEG, STANDARD_GRAVITY

STILL_S = 1.0
"""A foot that stands still for so long shows where up is."""

STILL_RATE = 1.2 * DEG
STILL_FORCE = 0.1
"""Standard deviations [rad/s, m/s^2] below which it does, over all axes: several times
the noise of consumer sensors at 100 to 400 Hz, a tenth of the least that walking does. A bias does
no harm."""

SEARCH_S = 10.0
"""So long is waited for such a second; then the quietest moment so far has to do."""

MOMENT_S = 0.1
"""Of a foot that walks already: a stance is a few times as long."""

MADGWICK_GAIN = math.sqrt(0.75) * 0.5 * DEG
"""By Madgwick's rule for a gyroscope that errs by 0.5 deg/s on each axis: a calibrated consumer
sensor some months later. A bias of more than twice the gain, 0.87 deg/s, is not made up for, and
the attitude tumbles. A higher gain bears more, but takes a swing for a tilt: the attitude goes
astray by 0.35 deg in 0.4 s, which shortens a walk by 2 %, and with the paper's 0.033 by 8 %."""


@dataclass(frozen=True, eq=False)
class Freed:
    """Samples of which the attitude is known.

    Attributes
    ----------
    t : shape (n,)
        Times [s].
    quaternion : shape (n, 4)
        Attitude, sensor to navigation axes.
    acceleration : shape (n, 3)
        Without gravity, navigation axes [m/s^2].
    """

    t: FloatArray
    quaternion: FloatArray
    acceleration: FloatArray


class GravityRemoval:
    """Attitude and gravity-free acceleration of a recording that comes in pieces of any size.

    The start is in the first second in which the foot stands still: its mean specific force is up;
    of a foot that does not, in its quietest moment. What was before is gone through backwards.
    Pieces give exactly what the whole does; no more than the first 10 s are kept back.

    Parameters
    ----------
    gain : float
        Speed of the correction [rad/s]; see `imu_rig.kernels.madgwick.gradient_descent`.
    gravity : float
        [m/s^2]
    magnetometer : bool
        Whether the magnetic field, where there is one, draws the yaw; x is then magnetic north.
        Otherwise the sensor's x axis (its y axis, if that is nearer to the horizontal) points
        along x at the start.

    Attributes
    ----------
    still_start : bool or None
        Whether it stood still at the start; None as long as none was found.
    rest_force : float
        Norm of the mean specific force there [m/s^2]: gravity, as this sensor reads it.
    """

    def __init__(
        self,
        gain: float = MADGWICK_GAIN,
        gravity: float = STANDARD_GRAVITY,
        *,
        magnetometer: bool = False,
    ) -> None:
        self._gain, self._gravity, self._magnetometer = gain, gravity, magnetometer
        self._waiting = ImuBlock.empty()
        self._loud = np.empty(0)  # at those of them that were looked at
        self._last: ImuBlock | None = None
        self._attitude = np.empty(4)
        self.still_start: bool | None = None
        self.rest_force = math.nan

    def update(self, block: ImuBlock) -> Freed:
        """Take the next samples; return those of which the attitude is known, in order."""
        if self.still_start is None:
            self._waiting = ImuBlock.concatenate([self._waiting, block])
            return self._begun(over=False)
        return self._followed(block)

    def finish(self) -> Freed:
        """Return what was kept back; the recording is over."""
        return self._begun(over=True) if self.still_start is None else _freed_none()

    def _begun(self, *, over: bool) -> Freed:
        """Begin if a still second was found, or there is no point in waiting for one."""
        waiting = self._waiting
        if not len(waiting):
            return _freed_none()
        # By time from the first sample on, so that how the pieces are cut changes nothing.
        early = int(np.searchsorted(waiting.t, waiting.t[0] + SEARCH_S, side="right"))
        self._loud = np.append(self._loud, _loudness(waiting[:early], len(self._loud)))
        quiet = np.flatnonzero(self._loud < 1.0)
        if not len(quiet) and early == len(waiting) and not over:
            return _freed_none()
        self.still_start = bool(len(quiet))
        if self.still_start:
            end, rested = int(quiet[0]), STILL_S
        else:
            end, rested = int(np.argmin(_loudness(waiting[:early], 0, MOMENT_S))), MOMENT_S
        rest = waiting[_begin_of(waiting.t, end, rested) : end + 1]
        self.rest_force = float(np.linalg.norm(rest.accel.mean(axis=0)))
        attitude = _upright(rest, self._magnetometer)
        backwards = waiting[end::-1]
        before = gradient_descent(
            -np.ascontiguousarray(backwards.t),
            np.ascontiguousarray(backwards.accel),
            -np.ascontiguousarray(backwards.gyro),
            self._field(backwards),
            attitude,
            self._gain,
        )[::-1]
        self._last, self._attitude = waiting[end : end + 1], attitude
        self._waiting = ImuBlock.empty()
        begun = self._free(waiting[: end + 1], before)
        return _freed_joined(begun, self._followed(waiting[end + 1 :]))

    def _followed(self, block: ImuBlock) -> Freed:
        if not len(block) or self._last is None:
            return _freed_none()
        run = ImuBlock.concatenate([self._last, block])
        t, accel, gyro = (np.ascontiguousarray(c) for c in (run.t, run.accel, run.gyro))
        q = gradient_descent(t, accel, gyro, self._field(run), self._attitude, self._gain)
        self._last, self._attitude = run[len(run) - 1 :], q[-1]
        return self._free(block, q[1:])

    def _field(self, block: ImuBlock) -> FloatArray:
        if not self._magnetometer or block.mag is None:
            return np.empty((0, 3))
        return np.ascontiguousarray(block.mag)

    def _free(self, block: ImuBlock, q: FloatArray) -> Freed:
        up = np.array([0.0, 0.0, self._gravity])
        return Freed(block.t, q, rotate(q, block.accel) - up)


def _freed_none() -> Freed:
    return Freed(np.empty(0), np.empty((0, 4)), np.empty((0, 3)))


def _freed_joined(one: Freed, other: Freed) -> Freed:
    return Freed(
        np.concatenate((one.t, other.t)),
        np.concatenate((one.quaternion, other.quaternion)),
        np.concatenate((one.acceleration, other.acceleration)),
    )


def _begin_of(t: FloatArray, end: int, seconds: float) -> int:
    """Return where the time that ends with a sample begins."""
    return int(np.searchsorted(t, t[end] - seconds, side="left"))


def _loudness(block: ImuBlock, begin: int, seconds: float = STILL_S) -> FloatArray:
    """Return how much the foot moved in some time before each sample from ``begin`` on.

    Below 1 it stood still. Infinite as long as there is not that much, and where values are
    missing.
    """
    t, ends = block.t, np.arange(begin, len(block))
    first = np.searchsorted(t, t[ends] - seconds, side="left").astype(np.int64)
    loud = [
        np.sqrt(scatter(np.ascontiguousarray(values), 0.0, first, ends + 1)) / least
        for values, least in ((block.accel, STILL_FORCE), (block.gyro, STILL_RATE))
    ]
    known = (t[ends] - t[0] >= seconds) & np.isfinite(loud[0] + loud[1])
    return np.where(known, np.maximum(*loud), np.inf)


def _upright(rest: ImuBlock, field: bool) -> FloatArray:
    """Return the attitude of a sensor at rest: up by its force, x where its field points."""
    attitude = level_attitude(rest.accel.mean(axis=0))
    if not field or rest.mag is None:
        return attitude
    pointed = rotate(attitude, rest.mag.mean(axis=0))
    yaw = -math.atan2(pointed[1], pointed[0])
    return multiply(from_rotation_vector(np.array([0.0, 0.0, yaw])), attitude)
