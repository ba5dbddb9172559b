"""A sensor that a hand slides along an arc on a board, at rest before and after."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.units import DEG
from simulators.walker.channels import Track
from simulators.walker.feet import Phase
from simulators.walker.jets import Jet, cosine, sine
from simulators.walker.motion import Motion


class Slider:
    """A body on a board that follows an arc with its x axis.

    Parameters
    ----------
    radius_m, angle_deg : float
        Of the arc; a positive angle bends left.
    rest_s : float
        Before and after.
    seconds : float
        That the arc takes.
    """

    def __init__(self, radius_m: float, angle_deg: float, rest_s: float, seconds: float) -> None:
        self._radius = radius_m if angle_deg > 0 else -radius_m
        track = Track(0.0, 0.0)
        times = [rest_s + share * seconds for share in (0.0, 0.4, 0.6, 1.0)]
        track.go(times, (0.0, 1.0, 1.0, 0.0), angle_deg * DEG)
        self._heading = track.channel()
        self._slides = (times[0], times[-1])
        self.end_s = times[-1] + rest_s
        self.breaks: FloatArray = self._heading.breaks

    def motion(self, t: FloatArray) -> Motion:
        """Return the motion at times [s], shape (n,)."""
        heading = self._heading.jet(t)
        zero = np.zeros_like(t)
        rest = Jet(zero, zero, zero)
        x = self._radius * sine(heading)
        y = self._radius * (1.0 - cosine(heading))
        return Motion((x, y, rest), heading, rest, rest)

    def phase(self, t: FloatArray) -> IntArray:
        """Return `Phase.SWING` while it slides and `Phase.FLAT` while it rests."""
        begin, end = self._slides
        slides = (t >= begin) & (t < end)
        return np.where(slides, int(Phase.SWING), int(Phase.FLAT)).astype(np.int64)
