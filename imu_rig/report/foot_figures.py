"""The figures of a walk: where a foot went, how high it stood, which way it pointed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from imu_rig.arrays import FloatArray
from imu_rig.gait.trajectory import FootTrack
from imu_rig.report.svg import AFTER, INK, LEFT_OUT, TRUTH, new_figure, panel
from imu_rig.report.walk_panels import (
    LEFT,
    MANY_STRIDES,
    PANEL_WIDTH,
    STEPS,
    Z_95,
    align_labels,
    at_least,
    legend,
    thinned,
    time_axis,
)
from imu_rig.units import DEG

COLOURS = (AFTER, LEFT_OUT)
"""Of the first and the second foot."""
RADIUS_95 = math.sqrt(-2.0 * math.log(0.05))
"""95 % of two-component normal errors lie within so many of their sigmas."""
PLAN_HEIGHT = (150.0, 430.0)
MARGIN = 0.06
LEAST_HEIGHT = 0.2
"""What an axis of heights shows at least [m]."""


@dataclass(frozen=True, eq=False)
class SeenPath:
    """Where another instrument saw the foot, on the axes and the time of the track.

    Attributes
    ----------
    t : shape (n,)
        Time [s].
    position : shape (n, 3)
        In the track's axes [m]; NaN where it was lost.
    name : str
        For the legend.
    """

    t: FloatArray
    position: FloatArray
    name: str = "reference"


def plan(feet: Sequence[tuple[str, FootTrack]], seen: SeenPath | None = None) -> Figure:
    """Draw the walk from above with its footfalls, metres on equal axes."""
    points = [track.trajectory.position[:, :2] for _, track in feet]
    if seen is not None:
        points.append(seen.position[np.isfinite(seen.position).all(axis=1), :2])
    every = np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    low, high = _with_ends(low, high, [track for _, track in feet])
    span = np.maximum(high - low, 0.3)
    wanted = PANEL_WIDTH * float(span[1] / span[0]) * (1.0 + 2.0 * MARGIN)
    height = min(max(wanted, PLAN_HEIGHT[0]), PLAN_HEIGHT[1])
    rows = 2 if len(feet) > 1 or seen is not None else 1
    above = 12.0 + 18.0 * rows
    figure = new_figure(above + height + 46.0)
    axes = panel(figure, LEFT, 46.0, PANEL_WIDTH, height)
    # The box fills the panel, and the axis that has room to spare shows more.
    scale = max(span[0] / PANEL_WIDTH, span[1] / height) * (1.0 + 2.0 * MARGIN)
    middle, half = (low + high) / 2.0, 0.5 * scale * np.array([PANEL_WIDTH, height])
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    if seen is not None:
        rows_drawn = thinned(len(seen.t))
        axes.plot(
            *seen.position[rows_drawn, :2].T, color=TRUTH, linewidth=2.6, alpha=0.55,
            label=seen.name,
        )  # fmt: skip
    for (name, track), colour in zip(feet, COLOURS, strict=False):
        _draw_plan(axes, track, colour, name if len(feet) > 1 else "")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.locator_params(nbins=8)
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=4 if rows == 1 else 3,
        borderaxespad=0.2, handletextpad=0.4, columnspacing=1.3, borderpad=0.2, handlelength=1.3,
    )  # fmt: skip
    return figure


def _with_ends(
    low: FloatArray, high: FloatArray, tracks: Sequence[FootTrack]
) -> tuple[FloatArray, FloatArray]:
    """Make room for the ellipses of ends, but no more than for as much again as the walk."""
    room = float((high - low).max())
    for track in tracks:
        if track.covariance is not None:
            end = track.trajectory.position[-1, :2]
            half = RADIUS_95 * track.covariance.position_sigma[-1, :2]
            low = np.maximum(np.minimum(low, end - half), low - 0.5 * room)
            high = np.minimum(np.maximum(high, end + half), high + 0.5 * room)
    return low, high


def axes_over_time(track: FootTrack, seen: SeenPath | None = None) -> Figure:
    """Draw x, y and z over time with 95 % bands."""
    figure = new_figure(430.0)
    t, unit = time_axis(track)
    begin = float(track.trajectory.t[0])
    rows = thinned(len(t))
    for axis, letter in enumerate("xyz"):
        axes = panel(figure, LEFT, 46.0 + (2 - axis) * 122.0, PANEL_WIDTH, 108.0)
        if seen is not None:
            chosen = thinned(len(seen.t))
            axes.plot(
                (seen.t[chosen] - begin) / unit.seconds, seen.position[chosen, axis],
                color=TRUTH, linewidth=2.6, alpha=0.55, label=seen.name,
            )  # fmt: skip
        middle = track.trajectory.position[:, axis]
        many = axis == 2 and len(track.footfalls) > MANY_STRIDES
        axes.plot(
            t[rows], middle[rows], color=AFTER, linewidth=0.5 if many else 1.1,
            alpha=0.3 if many else 1.0, label="this recording",
        )  # fmt: skip
        if many:  # swings would hide how high the foot stands
            stood = track.footfalls.quietest
            axes.plot(t[stood], middle[stood], color=INK, linewidth=1.1, label="at footfalls")
        covariance = track.covariance
        if covariance is not None:
            sigma = np.interp(
                np.arange(len(t)), covariance.rows, covariance.position_sigma[:, axis]
            )
            low, high = middle - Z_95 * sigma, middle + Z_95 * sigma
            axes.fill_between(
                t[rows], low[rows], high[rows], color=AFTER, alpha=0.22, linewidth=0,
                label="95 % of its errors",
            )  # fmt: skip
        axes.set_ylabel(f"{letter} [m]")
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
        axes.set_xlim(t[0], t[-1])
        if axis < 2:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel(f"time [{unit.name}]")
        if axis == 0:
            legend(axes, 3)
    align_labels(figure)
    return figure


def heading_over_time(track: FootTrack, heading: FloatArray) -> Figure:
    """Draw which way the standing foot points, and how surely.

    Parameters
    ----------
    track : FootTrack
    heading : shape (k,)
        At each footfall [rad].
    """
    figure = new_figure(250.0)
    axes = panel(figure, LEFT, 46.0, PANEL_WIDTH, 172.0)
    t, unit = time_axis(track)
    falls = track.footfalls.quietest
    degrees = np.unwrap(heading) / DEG
    size = 4.5 if len(falls) <= MANY_STRIDES else 2.4
    axes.plot(t[falls], degrees, "o-", color=AFTER, linewidth=0.9, markersize=size, label="heading")
    if track.covariance is not None:
        sigma = np.interp(falls, track.covariance.rows, track.covariance.heading_sigma / DEG)
        axes.fill_between(
            t[falls], degrees - Z_95 * sigma, degrees + Z_95 * sigma, color=AFTER, alpha=0.22,
            linewidth=0, label="95 % of its errors",
        )  # fmt: skip
    axes.set_xlim(t[0], t[-1])
    axes.yaxis.set_major_locator(MaxNLocator(7, steps=[1, 1.5, 3, 4.5, 9, 10]))
    axes.set_ylabel("heading [deg]")
    axes.set_xlabel(f"time [{unit.name}]")
    align_labels(figure)
    legend(axes, 3)
    return figure


def height_over_way(track: FootTrack) -> Figure:
    """Draw how high the foot stands over how far it has walked, with 95 % bands."""
    figure = new_figure(250.0)
    axes = panel(figure, LEFT, 46.0, PANEL_WIDTH, 172.0)
    falls = track.footfalls.quietest
    places = track.trajectory.position[falls]
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(places[:, :2], axis=0).T))))
    size = 4.5 if len(falls) <= MANY_STRIDES else 2.4
    axes.plot(
        way, places[:, 2], "o-", color=AFTER, linewidth=0.9, markersize=size, label="footfall"
    )
    if track.covariance is not None:
        sigma = np.interp(falls, track.covariance.rows, track.covariance.position_sigma[:, 2])
        axes.fill_between(
            way, places[:, 2] - Z_95 * sigma, places[:, 2] + Z_95 * sigma, color=AFTER, alpha=0.22,
            linewidth=0, label="95 % of its errors",
        )  # fmt: skip
    at_least(axes, LEAST_HEIGHT)
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=STEPS))
    axes.set_ylabel("height [m]")
    axes.set_xlabel("walked [m]")
    align_labels(figure)
    legend(axes, 3)
    return figure


def _draw_plan(axes: Axes, track: FootTrack, colour: str, name: str) -> None:
    position, falls = track.trajectory.position, track.footfalls
    rows = thinned(len(position))
    path = f"{name}: way" if name else "way of the sensor"
    axes.plot(*position[rows, :2].T, color=colour, linewidth=1.0, alpha=0.8, label=path)
    stood = position[falls.quietest, :2]
    size = 5.0 if len(falls) <= 30 else 3.6 if len(falls) <= 4 * MANY_STRIDES else 2.2
    axes.plot(
        *stood.T, "o", color=colour, markersize=size, linestyle="none",
        label=f"{name}: footfall" if name else "footfall",
    )  # fmt: skip
    axes.plot(
        *position[-1:, :2].T, "s", color=INK, markersize=6.0, linestyle="none", zorder=4,
        label="" if name and colour != COLOURS[0] else "end",
    )  # fmt: skip
    if track.covariance is None:
        return
    block = track.covariance.values[-1, 6:8, 6:8]
    squares, ways = np.linalg.eigh(block)
    widths = 2.0 * RADIUS_95 * np.sqrt(np.maximum(squares, 0.0))
    angle = math.degrees(math.atan2(ways[1, 1], ways[0, 1]))
    axes.add_patch(
        Ellipse(
            tuple(position[-1, :2]),
            widths[1],
            widths[0],
            angle=angle,
            facecolor=colour,
            alpha=0.22,
            edgecolor=colour,
            linewidth=0.8,
            label="" if name and colour != COLOURS[0] else "95 % of its end",
        )
    )
