"""Figures of the two-filter smoother: what each filter says of a foot, and both together.

After Suh and Chee, "Foot Motion Estimation Smoother using Inertial Sensors", Figures 4 to 9.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.gait.start import level_attitude
from imu_rig.gait.trajectory import Trajectory
from imu_rig.gait.two_filter import StepSmoothing
from imu_rig.report.svg import AFTER, INK, LEFT_OUT, TRUTH, new_figure, panel
from imu_rig.report.walk_panels import (
    LEFT,
    PANEL_WIDTH,
    at_least,
    legend,
    stance_bands,
    thinned,
)
from imu_rig.rotation import conjugate, euler_angles, multiply, rotate
from imu_rig.units import DEG

BACKWARD = "#2e7d32"
PLAN_HEIGHT = (120.0, 430.0)
SPAN_S = 2.0
"""The paper shows two seconds of a walk in detail; here they hold one whole step, if it fits."""
METHODS = (("forward filter", LEFT_OUT, 1.2), ("backward filter", BACKWARD, 1.2))


@dataclass(frozen=True, eq=False)
class MethodFigure:
    """A figure with its name (letters only), title and caption."""

    name: str
    title: str
    caption: str
    figure: Figure


def two_filter_figures(smoothing: StepSmoothing) -> list[MethodFigure]:
    """Return the paper's Figures 4 to 9 of a recording, drawn within `report_style`.

    Where all is one step, the walk over time is the same as the step, and left out.
    """
    step = middle_step(smoothing)
    figures = [
        MethodFigure(
            "filtersplan",
            "Trajectory from above, forward filter and smoother",
            "The forward filter drifts until the foot stands, then jumps to where it must be; the "
            "smoother spreads the correction over the step.",
            plan(smoothing),
        ),
        MethodFigure(
            "filtersstep",
            "One step by each of the filters",
            "The forward filter errs most at the end of a step, the backward filter at its "
            "beginning. Shaded: zero-velocity intervals.",
            methods_over_time(smoothing, step),
        ),
    ]
    if len(smoothing.steps) > 1:
        figures.append(
            MethodFigure(
                "filterswalk",
                "Smoothed position over time",
                "Position at the first zero-velocity interval is zero.",
                smoothed_over_time(smoothing),
            )
        )
    figures.append(
        MethodFigure(
            "filtersangles",
            "Attitude of the foot as Euler angles",
            "Yaw, pitch and roll turn the foot in this order, about z, y and x, which is the "
            "sensor's x axis made level. The foot is flat in the first zero-velocity interval.",
            angles_over_time(smoothing, step),
        )
    )
    return figures


def middle_step(smoothing: StepSmoothing) -> tuple[float, float]:
    """Return begin and end [s] of a part that shows the longest way in a step, near the middle.

    Of a step the zero-velocity intervals are cut so that the part lasts `SPAN_S` where it can.
    """
    path = smoothing.smoothed.trajectory
    steps = smoothing.steps
    way = np.linalg.norm(np.diff(path.position[steps], axis=1)[:, 0], axis=1)
    long = np.flatnonzero(way >= 0.7 * way.max())
    first, last = steps[long[len(long) // 2]]
    moves = first + np.flatnonzero(~smoothing.still[first : last + 1])
    if not len(moves):
        return float(path.t[first]), float(path.t[last])
    begin, end = float(path.t[moves[0]]), float(path.t[moves[-1]])
    aside = 0.5 * max(SPAN_S - (end - begin), 0.6)
    return max(begin - aside, float(path.t[0])), min(end + aside, float(path.t[-1]))


def plan(smoothing: StepSmoothing, truth: FloatArray | None = None) -> Figure:
    """Draw the trajectory from above, metres on equal axes (Figures 4 and 7).

    Parameters
    ----------
    smoothing : StepSmoothing
    truth : shape (m, 2 or 3), optional
        Points of the true way [m], in the axes of the result.
    """
    forward, smoothed = smoothing.forward.trajectory, smoothing.smoothed.trajectory
    points = [forward.position[:, :2], smoothed.position[:, :2]]
    if truth is not None:
        points.append(truth[:, :2])
    every = np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    span = np.maximum(high - low, 0.1) * 1.1
    height = float(np.clip(PANEL_WIDTH * span[1] / span[0], *PLAN_HEIGHT))
    figure = new_figure(height + 78.0)
    axes = panel(figure, LEFT, 46.0, PANEL_WIDTH, height)
    half = 0.5 * max(span[0] / PANEL_WIDTH, span[1] / height) * np.array((PANEL_WIDTH, height))
    middle = 0.5 * (low + high)
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    if truth is not None:
        axes.plot(*truth[:, :2].T, color=TRUTH, linewidth=3.0, alpha=0.5, label="true way")
    for (name, colour, width), path in (
        (METHODS[0], forward),
        (("smoother", AFTER, 1.4), smoothed),
    ):
        axes.plot(*path.position[:, :2].T, color=colour, linewidth=width, label=name)
    axes.plot(*smoothed.position[[0], :2].T, "o", color=INK, markersize=4.0, label="start")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    legend(axes, 4)
    return figure


def methods_over_time(
    smoothing: StepSmoothing,
    span: tuple[float, float] | None = None,
    truth: Trajectory | None = None,
) -> Figure:
    """Draw x, y and z by either filter and the smoother, from where the span begins (5 and 8).

    Parameters
    ----------
    smoothing : StepSmoothing
    span : (begin, end), optional
        What is shown [s]; otherwise all.
    truth : Trajectory, optional
        The true motion, in the axes of the result.
    """
    rows = _rows(smoothing, span)
    figure = new_figure(470.0)
    smoothed = smoothing.smoothed.trajectory
    t = smoothed.t - smoothed.t[0]
    origin = smoothed.position[rows[0]]
    # A step's first sample is the last of the one before: lines end there.
    ends = np.flatnonzero(np.isin(rows, smoothing.steps[:, 1])) + 1
    for axis, letter in enumerate("xyz"):
        axes = panel(figure, LEFT, 46.0 + (2 - axis) * 132.0, PANEL_WIDTH, 116.0)
        stance_bands(axes, t[rows], smoothing.still[rows])
        if truth is not None:
            true = np.interp(smoothed.t[rows], truth.t, truth.position[:, axis]) - origin[axis]
            axes.plot(t[rows], true, color=TRUTH, linewidth=3.0, alpha=0.5, label="true")
        for (name, colour, width), estimate in zip(
            METHODS, (smoothing.forward, smoothing.backward), strict=True
        ):
            line = estimate.trajectory.position[rows, axis] - origin[axis]
            axes.plot(
                np.insert(t[rows], ends, np.nan), np.insert(line, ends, np.nan), color=colour,
                linewidth=width, label=name,
            )  # fmt: skip
        axes.plot(
            t[rows], smoothed.position[rows, axis] - origin[axis], color=AFTER, linewidth=1.6,
            label="smoother",
        )  # fmt: skip
        _time_panel(axes, f"{letter} [m]", t[rows], last=axis == 2)
        if axis == 0:
            legend(axes, 4)
    return figure


def smoothed_over_time(smoothing: StepSmoothing) -> Figure:
    """Draw x, y and z of the smoother over the whole walk (Figure 6)."""
    path = smoothing.smoothed.trajectory
    return _three_panels(smoothing, path.position, [f"{letter} [m]" for letter in "xyz"], None)


def angles_over_time(smoothing: StepSmoothing, span: tuple[float, float] | None = None) -> Figure:
    """Draw the Euler angles of the foot (Figure 9); ``span`` as of `methods_over_time`."""
    q = smoothing.smoothed.trajectory.quaternion
    # However the sensor sits on it, the foot is flat when it first stands.
    up = rotate(conjugate(q[0]), np.array((0.0, 0.0, 1.0)))
    angles = euler_angles(multiply(q, conjugate(level_attitude(up))))[:, ::-1] / DEG
    angles[:, 0] = np.unwrap(angles[:, 0], period=360.0)
    angles[:, 2] = np.unwrap(angles[:, 2], period=360.0)
    names = ["yaw [deg]", "pitch [deg]", "roll [deg]"]
    return _three_panels(smoothing, angles, names, span)


def _three_panels(
    smoothing: StepSmoothing,
    values: FloatArray,
    names: list[str],
    span: tuple[float, float] | None,
) -> Figure:
    rows = _rows(smoothing, span)
    rows = rows[thinned(len(rows))]
    t = smoothing.smoothed.trajectory.t
    t = t[rows] - t[0]
    figure = new_figure(430.0)
    for number, name in enumerate(names):
        axes = panel(figure, LEFT, 46.0 + (2 - number) * 125.0, PANEL_WIDTH, 108.0)
        stance_bands(axes, t, smoothing.still[rows])
        axes.plot(t, values[rows, number], color=AFTER, linewidth=1.2)
        _time_panel(axes, name, t, last=number == 2)
    return figure


def _time_panel(axes: Axes, name: str, t: FloatArray, *, last: bool) -> None:
    axes.set_xlim(t[0], t[-1])
    axes.locator_params(axis="y", nbins=5)
    axes.set_ylabel(name)
    axes.yaxis.set_label_coords(-0.118, 0.5)
    at_least(axes, 0.02)
    if last:
        axes.set_xlabel("time from the first zero-velocity interval [s]")
    else:
        axes.tick_params(labelbottom=False)


def _rows(smoothing: StepSmoothing, span: tuple[float, float] | None) -> IntArray:
    t = smoothing.smoothed.trajectory.t
    begin, end = (t[0], t[-1]) if span is None else span
    return np.arange(*np.searchsorted(t, (begin, np.nextafter(end, np.inf))))
