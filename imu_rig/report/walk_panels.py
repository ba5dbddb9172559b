"""What the figures of walks share: panels, bands, axes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.gait.trajectory import FootTrack
from imu_rig.report.numbers import significant

LEFT, PANEL_WIDTH = 66.0, 442.0
STANCE = "#cfe3d4"
Z_95 = 1.959964
MOST_POINTS = 2500
"""Of a line: more are not seen, and make the page large."""
MANY_STRIDES = 60
"""Above so many, marks are small, and bands take the place of bars."""
MINUTES_ABOVE_S = 300.0
STEPS = [1, 2, 2.5, 5, 10]


@dataclass(frozen=True)
class TimeUnit:
    """In which time is shown."""

    name: str
    seconds: float


def time_axis(track: FootTrack) -> tuple[FloatArray, TimeUnit]:
    """Return the time of each sample since the first, and the unit it is in."""
    t = track.trajectory.t - track.trajectory.t[0]
    unit = TimeUnit("min", 60.0) if t[-1] > MINUTES_ABOVE_S else TimeUnit("s", 1.0)
    return t / unit.seconds, unit


def at_least(axes: Axes, span: float) -> None:
    """Widen the y axis to a span, lest small errors look large."""
    low, high = axes.get_ylim()
    if high - low < span:
        centre = 0.5 * (low + high)
        axes.set_ylim(centre - 0.5 * span, centre + 0.5 * span)


def align_labels(figure: Figure) -> None:
    """Put the labels of panels one above another, whatever their numbers."""
    for axes in figure.axes:
        axes.yaxis.set_label_coords(-0.122, 0.5)


def thinned(count: int) -> slice:
    """Return which of many points are drawn."""
    return slice(None, None, max(1, math.ceil(count / MOST_POINTS)))


def stance_bands(axes: Axes, t: FloatArray, still: BoolArray, label: str = "") -> None:
    """Colour the times ``t`` (n,) at which a foot stands."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(int), [0]))))
    for number, (first, stop) in enumerate(zip(edges[::2], edges[1::2], strict=True)):
        axes.axvspan(
            t[first], t[min(stop, len(t) - 1)], color=STANCE, linewidth=0,
            label=label if number == 0 else "",
        )  # fmt: skip


def log_axis(axes: Axes, values: FloatArray) -> None:
    """Set a logarithmic y axis with plain numbers at every decade, and few more."""
    there = values[np.isfinite(values) & (values > 0.0)]
    if len(there) == 0:
        return
    low, high = float(there.min()) / 1.3, float(there.max()) * 1.3
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1.0,) if high / low > 100.0 else (1.0, 3.0) if high / low > 8.0 else (1.0, 2.0, 5.0)
    ticks = [s * 10.0**d for d in decades for s in steps if low <= s * 10.0**d <= high]
    axes.yaxis.set_major_locator(FixedLocator(ticks))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: significant(value, 1)))
    axes.yaxis.set_minor_locator(NullLocator())


def legend(axes: Axes, columns: int) -> None:
    """Put a legend above a panel."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.01, 0.98), ncols=columns, borderaxespad=0.2,
        handletextpad=0.4, columnspacing=1.6, borderpad=0.2, handlelength=1.4,
    )  # fmt: skip
