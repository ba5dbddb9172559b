"""One coordinate of a motion as a smooth piecewise polynomial that is written down by its speeds.

Between two knots the speed goes over from one value to the next along the polynomial of degree 9
that has four derivatives of zero at both ends: a coordinate has five continuous derivatives, and
samples of its second still integrate back to it at 400 Hz. Where the speed is zero at both knots,
the coordinate rests exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from imu_rig.arrays import FloatArray
from simulators.walker.jets import Jet

STEP_INTEGRAL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 21.0, -60.0, 67.5, -35.0, 7.0)
DEGREE = len(STEP_INTEGRAL) - 1
"""Integral of the smooth step from 0 to u, by powers of u; one half at u = 1."""


class Channel:
    """A piecewise polynomial of time; before its first break and after its last it rests.

    Parameters
    ----------
    breaks : shape (k,)
        Begin of every piece [s], increasing.
    coefficients : shape (k, m)
        Of every piece, by powers of the time since its begin; the last piece lasts for ever.
    """

    def __init__(self, breaks: FloatArray, coefficients: FloatArray) -> None:
        self.breaks = breaks
        self._powers = np.ascontiguousarray(coefficients.T)

    def jet(self, t: FloatArray) -> Jet:
        """Return value, rate and acceleration at times [s], shape (n,)."""
        piece = np.maximum(np.searchsorted(self.breaks, t, side="right") - 1, 0)
        since = np.maximum(t - self.breaks[piece], 0.0)
        value, rate, half = np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
        for power in self._powers[::-1]:
            half = half * since + rate
            rate = rate * since + value
            value = value * since + power[piece]
        return Jet(value, rate, 2.0 * half)


class Track:
    """Writes a channel from its begin to its end.

    Parameters
    ----------
    t : float
        Where it begins [s].
    value : float
        At the begin, at rest.
    """

    def __init__(self, t: float, value: float) -> None:
        self.t = t
        self.value = value
        self._breaks = [t]
        self._pieces: list[tuple[float, ...]] = [(value, *[0.0] * DEGREE)]

    def run(self, times: Sequence[float], speeds: Sequence[float]) -> None:
        """Go through speeds at times; the first and the last speed are zero.

        Raises
        ------
        ValueError
            If it begins before the last motion ended, or times do not increase.
        """
        # a walk is made of thousands of these, too short for arrays
        if times[0] < self.t - 1e-9 or any(b <= a for a, b in pairwise(times)):
            raise ValueError(f"a motion at {times} cannot follow one that ends at {self.t}")
        if not any(speeds):
            return
        for begin, end, slow, fast in zip(times, times[1:], speeds, speeds[1:], strict=False):
            span, change = end - begin, fast - slow
            # Integral of slow + change * step(u) with u = (t - begin) / span.
            piece = [change * span * c / span**power for power, c in enumerate(STEP_INTEGRAL)]
            piece[0], piece[1] = self.value, slow
            self._put(begin, piece)
            self.value += 0.5 * (slow + fast) * span
        self.t = times[-1]
        self._put(self.t, [self.value, *[0.0] * DEGREE])

    def go(self, times: Sequence[float], shape: Sequence[float], change: float) -> None:
        """Change by so much in all, with speeds in the proportions of a shape."""
        area = swept(times, shape)
        self.run(times, [change / area * speed for speed in shape])

    def jump(self, t: float, value: float) -> None:
        """Go on from another value."""
        self.t = max(self.t, t)
        self.value = value
        self._put(t, [self.value, *[0.0] * DEGREE])

    def channel(self) -> Channel:
        """Return what was written."""
        return Channel(np.array(self._breaks), np.array(self._pieces))

    def _put(self, t: float, piece: Sequence[float]) -> None:
        if t <= self._breaks[-1] + 1e-12:
            self._pieces[-1] = tuple(piece)
        else:
            self._breaks.append(t)
            self._pieces.append(tuple(piece))


def swept(times: Sequence[float], speeds: Sequence[float]) -> float:
    """Return how far a run with these speeds goes."""
    spans = zip(times, times[1:], speeds, speeds[1:], strict=False)
    return sum(0.5 * (slow + fast) * (end - begin) for begin, end, slow, fast in spans)
