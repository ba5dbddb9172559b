"""The range of a plot's axis: fixed while it fits, and chosen anew as rarely as possible.

A plot that is redrawn in part cannot change its ticks, so a change of range costs a whole drawing.
"""

from __future__ import annotations

import math

MARGIN = 0.08  # of the span of the data, above and below
LEAST_SHARE = 0.25  # of the range that the data fill, below which it is too wide
SHRINK_S = 4.0  # for which it must be too wide
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
PARTS = 4  # of a range, each a round number
LEAST_OF_SIZE = 3e-7  # of the data's size: ticks closer than that cannot be told apart
LARGEST = 1e100  # that is drawn; a device that is out of its mind may send any number

Range = tuple[float, float]


def round_range(low: float, high: float, least: float) -> Range:
    """Return a range with round ends around the data, at least ``least`` wide.

    Data beyond ``LARGEST`` are outside.
    """
    low, high = (max(-LARGEST, min(LARGEST, end)) for end in (low, high))
    middle = (low + high) / 2.0
    span = max(high - low, least, LEAST_OF_SIZE * abs(middle))
    low, high = middle - span * (0.5 + MARGIN), middle + span * (0.5 + MARGIN)
    rough = (high - low) / PARTS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(s * power for s in STEPS if s * power >= rough * (1 - 1e-9))
    return math.floor(low / step) * step, math.ceil(high / step) * step


class Scale:
    """The range of one axis.

    Parameters
    ----------
    least : float
        Smallest span that is worth showing: less is noise.
    """

    def __init__(self, least: float) -> None:
        self.range: Range = (-least, least)
        self._least = least
        self._wide_since_s: float | None = None
        self._empty = True

    def fit(self, low: float, high: float, now_s: float) -> bool:
        """Look at the data's extremes; True if the range had to change."""
        if not (math.isfinite(low) and math.isfinite(high)):
            return False
        bottom, top = self.range
        if self._empty or low < bottom or high > top:
            return self._change(low, high)
        if max(high - low, self._least) > LEAST_SHARE * (top - bottom):
            self._wide_since_s = None
            return False
        if self._wide_since_s is None:
            self._wide_since_s = now_s
        return now_s - self._wide_since_s >= SHRINK_S and self._change(low, high)

    def _change(self, low: float, high: float) -> bool:
        self._wide_since_s, self._empty = None, False
        before, self.range = self.range, round_range(low, high, self._least)
        return self.range != before
