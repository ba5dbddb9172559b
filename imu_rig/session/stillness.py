"""Live stillness of a sensor: quiet in accelerometer and gyroscope, and not turning slowly."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.units import DEG, MILLI_G

WINDOW_S = 0.4  # long enough to see a servo hunt at a few hertz, short beside a hold
QUIET_FACTOR = 3.0  # over the scatter of the sensor at rest, measured before the session
ACCEL_FLOOR = 3 * MILLI_G  # below this an accelerometer's resolution, not motion, is seen
GYRO_FLOOR = 0.15 * DEG
ACCEL_CEILING = 60 * MILLI_G  # more than this at rest is no rest
GYRO_CEILING = 1.0 * DEG
TURN_LIMIT = 0.6 * DEG  # mean rate off the bias: a turn about the vertical leaves gravity alone


@dataclass(frozen=True)
class Quiet:
    """What the sensor shows at rest: scatter per axis (rms over axes) and gyroscope bias.

    ``accel`` [m/s^2], ``gyro`` [rad/s], ``gyro_bias`` shape (3,) [rad/s]; zero all of them for a
    gyroscope that the sensor does not have.
    """

    accel: float
    gyro: float
    gyro_bias: FloatArray

    @property
    def is_rest(self) -> bool:
        """Whether this is quiet enough to be a sensor at rest."""
        return self.accel <= ACCEL_CEILING and self.gyro <= GYRO_CEILING


def scatter(block: ImuBlock) -> Quiet:
    """Scatter of a block of at least two samples and its mean rate."""
    accel = float(np.sqrt(np.mean(np.var(block.accel, axis=0))))
    if not has_gyro(block):
        return Quiet(accel, 0.0, np.zeros(3))
    return Quiet(
        accel=accel,
        gyro=float(np.sqrt(np.mean(np.var(block.gyro, axis=0)))),
        gyro_bias=np.mean(block.gyro, axis=0),
    )


def has_gyro(block: ImuBlock) -> bool:
    """Whether the sensor has a gyroscope: readings of one that it lacks are NaN."""
    return not bool(np.all(np.isnan(block.gyro)))


class StillnessMonitor:
    """Judges the most recent samples against what the sensor shows at rest.

    The gyroscope's bias is followed from one still interval to the next, because it walks.
    """

    def __init__(self, quiet: Quiet) -> None:
        self._accel_limit = max(QUIET_FACTOR * quiet.accel, ACCEL_FLOOR)
        self._gyro_limit = max(QUIET_FACTOR * quiet.gyro, GYRO_FLOOR)
        self._bias = quiet.gyro_bias
        self._recent: deque[ImuBlock] = deque()

    def update(self, block: ImuBlock) -> None:
        """Take in new samples and forget those older than the window."""
        if not len(block):
            return
        self._recent.append(block)
        oldest = float(block.t[-1]) - WINDOW_S
        while self._recent and float(self._recent[0].t[-1]) < oldest:
            self._recent.popleft()

    def clear(self) -> None:
        """Forget everything recent, after a move or a gap."""
        self._recent.clear()

    def window(self, since_s: float = -np.inf) -> ImuBlock:
        """Return the samples that are judged: those of the window after ``since_s``."""
        recent = ImuBlock.concatenate(list(self._recent))
        if not len(recent):
            return recent
        return recent[(recent.t > since_s) & (recent.t > recent.t[-1] - WINDOW_S)]

    def excess(self, since_s: float = -np.inf) -> float:
        """Largest of the motion figures over its limit, from samples after ``since_s``.

        Below 1 the sensor is still. Infinite until the window is filled.
        """
        window = self.window(since_s)
        if len(window) < 4 or window.t[-1] - window.t[0] < 0.7 * WINDOW_S:
            return float("inf")
        now = scatter(window)
        turning = float(np.max(np.abs(now.gyro_bias - self._bias)))
        return max(now.accel / self._accel_limit, now.gyro / self._gyro_limit, turning / TURN_LIMIT)

    def follow_bias(self, still: ImuBlock) -> None:
        """Take the gyroscope's bias from a still interval."""
        self._bias = scatter(still).gyro_bias
