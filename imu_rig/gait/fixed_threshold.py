"""System 1's detector: the norm of the acceleration without gravity below a threshold, eq. (9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.gait.detector_stream import Passed, Preparation, WindowDetector
from imu_rig.gait.gravity_removal import MADGWICK_GAIN, Freed, GravityRemoval
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.kernels.windows import largest_norm, window_edges
from imu_rig.units import STANDARD_GRAVITY


@dataclass(frozen=True)
class FixedThreshold(WindowDetector):
    """The acceleration without gravity is small, eq. (9) of the gait distance paper.

    The largest ``|a|`` [m/s^2] in the window. The paper compares each sample by itself; as the
    acceleration of a swinging foot passes near zero on its way from one sign to the other, a stance
    must be quiet for as long as the window. One of a microsecond is the paper's own.

    Attributes
    ----------
    threshold : float
        [m/s^2]. An accelerometer that was not calibrated reads up to 1.3 too much at rest, a tilt
        of 2 deg adds 0.3; in every swing from 0.5 m/s on it is above 4 at some time in 0.15 s.
    window : float
        [s]. A longer one leaves out the rolling at both ends of a stance, in which the foot moves
        already; but at 1.8 m/s hardly 0.15 s are left.
    gain : float
        Of the attitude by which gravity is taken off [rad/s].
    gravity : float
        [m/s^2]
    """

    name: ClassVar[str] = "threshold"
    threshold: float = 2.0
    window: float = 0.15
    gain: float = MADGWICK_GAIN
    gravity: float = STANDARD_GRAVITY

    def statistic(self, passed: Passed, first: IntArray, last: IntArray) -> FloatArray:
        """Return the statistic of each window, of accelerations without gravity."""
        return largest_norm(passed.accel, first, last)

    def preparation(self) -> Preparation:
        """Return what takes off gravity."""
        return _WithoutGravity(GravityRemoval(self.gain, self.gravity))

    def of_acceleration(self, t: FloatArray, acceleration: FloatArray) -> ZeroVelocity:
        """Return when a foot stands by accelerations without gravity, (n,) and (n, 3)."""
        first, last, _ = window_edges(t, 0.5 * self.window, 0, len(t))
        return self.judged(largest_norm(acceleration, first, last))


class _WithoutGravity(Preparation):
    """Samples whose specific force is an acceleration; angular rates are not looked at."""

    def __init__(self, removal: GravityRemoval) -> None:
        self._removal = removal

    def update(self, block: ImuBlock) -> Passed:
        return _passed(self._removal.update(block))

    def finish(self) -> Passed:
        return _passed(self._removal.finish())


def _passed(freed: Freed) -> Passed:
    return Passed(freed.t, freed.acceleration, np.zeros_like(freed.acceleration))
