"""Means of the motion over sample intervals, as an ideal low-pass with decimation gives them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from simulators.jig import JOINTS, Jig, Motion
from simulators.servo import STEP_S


@dataclass(frozen=True)
class Means:
    """Mean force, rate and field over the intervals that end at ``t``, in sensor axes.

    Attributes
    ----------
    t : shape (n,)
        End of each interval, in world time [s].
    duration : shape (n,)
        Length of each interval [s].
    force, rate, field : shape (n, 3)
    """

    t: FloatArray
    duration: FloatArray
    force: FloatArray
    rate: FloatArray
    field: FloatArray

    def __len__(self) -> int:
        """Return the number of intervals."""
        return len(self.t)


class Sampler:
    """Collects the steps of the mechanics and averages them between sample instants.

    The mean rate times its interval, summed, is the integral of the rate: nothing of a turn is
    lost between samples.

    Parameters
    ----------
    jig : Jig
    t_s : float
        World time at which the collection starts, and the first interval with it.

    Attributes
    ----------
    steps : list of float
        Where the mechanics appends angle, rate and acceleration in the middle of each step, joint
        after joint.
    """

    def __init__(self, jig: Jig, t_s: float) -> None:
        self._jig = jig
        self.steps: list[float] = []
        self._rest: tuple[bytes, Motion] | None = None
        self.restart(t_s)

    def restart(self, t_s: float) -> None:
        """Forget everything before ``t_s``, which becomes the start of the next interval."""
        self.steps.clear()
        self._from_s = t_s
        self._last_s = t_s
        self._partial = np.zeros(9)

    def remount(self, jig: Jig) -> None:
        """Go on with a jig on which the sensor sits in another way."""
        self._jig = jig
        self._rest = None

    def means(self, instants: FloatArray) -> Means:
        """Average up to each of the instants, and use up the steps collected so far.

        Parameters
        ----------
        instants : shape (n,)
            Ends of intervals, increasing, in world time [s]; none is later than the last step.
        """
        table = np.array(self.steps).reshape(-1, JOINTS, 3)
        self.steps.clear()
        return self.means_of(table, instants)

    def means_of(self, table: FloatArray, instants: FloatArray) -> Means:
        """Average steps that come as a table instead of one by one.

        Parameters
        ----------
        table : shape (m, 6, 3)
            Angle, rate and acceleration of every joint in the middle of the next m steps.
        instants : shape (n,)
            As for :meth:`means`.
        """
        integral = self._integrate(table)
        ends = self._from_s + STEP_S * np.arange(len(integral))
        at = _interpolate(instants, self._from_s, integral)
        before = np.vstack((np.zeros((1, 9)), at[:-1])) if len(at) else at
        duration = np.diff(instants, prepend=self._last_s)
        mean = (at - before) / duration[:, np.newaxis]
        if len(instants):
            self._last_s = float(instants[-1])
            self._partial = integral[-1] - at[-1]
        else:
            self._partial = integral[-1]
        self._from_s = float(ends[-1])
        return Means(instants, duration, mean[:, :3], mean[:, 3:6], mean[:, 6:])

    def _integrate(self, table: FloatArray) -> FloatArray:
        """Return the integral since the last instant at the ends of the steps, shape (m + 1, 9)."""
        integral = np.empty((len(table) + 1, 9))
        integral[0] = self._partial
        if len(table):
            motion = self._motion(table)
            integral[1:, :3] = motion.force
            integral[1:, 3:6] = motion.rate
            integral[1:, 6:] = motion.field
            integral[1:] *= STEP_S
            np.cumsum(integral, axis=0, out=integral)
        return integral

    def _motion(self, table: FloatArray) -> Motion:
        """Return the motion of steps (m, 6, 3); of one row only where all stands still."""
        if table[:, :, 1:].any():
            return self._jig.motion(table[:, :, 0], table[:, :, 1], table[:, :, 2])
        pose = table[:1].tobytes()
        if self._rest is None or self._rest[0] != pose:
            row = table[:1]
            self._rest = pose, self._jig.motion(row[:, :, 0], row[:, :, 1], row[:, :, 2])
        return self._rest[1]


def _interpolate(instants: FloatArray, from_s: float, integral: FloatArray) -> FloatArray:
    place = (instants - from_s) / STEP_S
    left = np.clip(place.astype(np.int64), 0, max(len(integral) - 2, 0))
    right = np.minimum(left + 1, len(integral) - 1)
    share = (place - left)[:, np.newaxis]
    return integral[left] * (1.0 - share) + integral[right] * share
