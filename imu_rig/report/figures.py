"""The figures of a calibration report."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from imu_rig.arrays import FloatArray
from imu_rig.calibration.result import CalibrationResult, MoveRow, PoseRow
from imu_rig.report.numbers import decimals_for, fixed, significant
from imu_rig.report.parameters import ParameterGroup, Sensor
from imu_rig.report.sphere import hemispheres
from imu_rig.report.svg import AFTER, BEFORE, INK, LEFT_OUT, TRUTH, new_figure, panel
from imu_rig.units import DEG, MILLI_G

LEFT, PANEL_WIDTH = 66.0, 442.0
MANY = 60
"""Above so many points a figure draws bands instead of bars, and smaller marks."""
RAYLEIGH_95 = math.sqrt(-2.0 * math.log(0.05))
"""95 % of the lengths of a two-component normal error are below this many of its sigmas."""
LONG_SESSION_S = 300.0
COMPONENTS = (("x", "#b3261e", "o"), ("y", "#2e7d32", "^"), ("z", "#1a5fb4", "D"))


def pose_numbers(poses: Sequence[PoseRow]) -> list[int]:
    """Numbers by which figures and tables name the poses.

    Those in the names (``"pose 7"``) where every pose has one of its own, in rising order;
    otherwise they are counted.
    """
    matches = [re.fullmatch(r"pose ([1-9]\d{0,4})", pose.name) for pose in poses]
    named = [int(match[1]) for match in matches if match]
    if len(named) == len(poses) and all(a < b for a, b in pairwise(named)):
        return named
    return list(range(1, len(poses) + 1))


def sphere_errors(poses: Sequence[PoseRow]) -> tuple[FloatArray, bool]:
    """Errors that colour the poses [m/s^2], and whether they are left-out errors."""
    left_out = _column([pose.left_out for pose in poses])
    if len(poses) and np.all(np.isfinite(left_out)):
        return left_out, True
    return _column([pose.after for pose in poses]), False


def sphere(result: CalibrationResult) -> Figure | None:
    """Where up was in the sensor, coloured by the size of the error."""
    errors, are_left_out = sphere_errors(result.poses)
    directions = np.array([pose.direction for pose in result.poses]).reshape(-1, 3)
    seen = np.isfinite(errors) & np.all(np.isfinite(directions), axis=1)
    if not np.any(seen):
        return None
    kind = "left-out error" if are_left_out else "residual"
    numbers = np.array(pose_numbers(result.poses))
    return hemispheres(
        directions[seen],
        np.abs(errors[seen]) / MILLI_G,
        numbers[seen].tolist(),
        f"{kind} of the gravity magnitude, absolute [mg]",
    )


def pose_errors(result: CalibrationResult) -> Figure:
    """Error of the gravity magnitude per pose before, after, and left out of the fit."""
    figure = new_figure(370.0)
    x = np.array(pose_numbers(result.poses), dtype=float)
    above = panel(figure, LEFT, 258.0, PANEL_WIDTH, 84.0)
    below = panel(figure, LEFT, 46.0, PANEL_WIDTH, 164.0)
    size = _mark(len(x))
    before = _column([pose.before for pose in result.poses]) / MILLI_G
    above.vlines(x, 0.0, before, color=BEFORE, linewidth=1.2 if len(x) <= MANY else 0.6)
    above.plot(x, before, "s", color=BEFORE, markersize=size, label="before calibration")
    shift = 0.16 if len(x) <= MANY else 0.0
    after = _column([pose.after for pose in result.poses]) / MILLI_G
    sigma = _column([pose.sigma for pose in result.poses]) / MILLI_G
    left_out = _column([pose.left_out for pose in result.poses]) / MILLI_G
    left_out_sigma = _column([pose.left_out_sigma for pose in result.poses]) / MILLI_G
    if np.any(np.isfinite(left_out)):
        _uncertain(below, x - shift, after, sigma, AFTER, "o", "after, in the fit")
        _uncertain(below, x + shift, left_out, left_out_sigma, LEFT_OUT, "D", "left out of the fit")
    else:
        _uncertain(below, x, after, sigma, AFTER, "o", "after calibration, in the fit")
    for axes in (above, below):
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set_ylabel("error [mg]")
        count_axis(axes, x)
        _legend(axes)
    above.set_xticks([])
    above.locator_params(axis="y", nbins=5)
    below.set_xlabel("pose number")
    return figure


def gravity_magnitude(result: CalibrationResult) -> Figure:
    """Magnitude of the mean specific force of each pose over the time of the session."""
    figure = new_figure(330.0)
    axes = panel(figure, LEFT + 8.0, 46.0, PANEL_WIDTH - 8.0, 252.0)
    g = result.gravity.value
    begin = np.array([pose.t0 for pose in result.poses])
    time = (begin + np.array([pose.t1 for pose in result.poses])) / 2.0
    time = time - (np.min(begin) if len(begin) else 0.0)
    is_long = len(time) > 0 and float(np.max(time)) > LONG_SESSION_S
    time = time / 60.0 if is_long else time
    size = _mark(len(time))
    before = g + _column([pose.before for pose in result.poses])
    after = g + _column([pose.after for pose in result.poses])
    axes.axhline(g, color=INK, linewidth=0.9, zorder=1)
    axes.plot(time, before, "s", color=BEFORE, markersize=size, label="before calibration")
    axes.plot(time, after, "o", color=AFTER, markersize=size, label="after calibration")
    axes.plot([], [], color=INK, linewidth=0.9, label="gravity")
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.set_ylabel("specific force [m/s²]")
    axes.set_xlabel(f"time from the first pose [{'min' if is_long else 's'}]")
    _legend(axes)
    return figure


def move_errors(result: CalibrationResult) -> Figure:
    """Gravity-direction error per move before, after, and left out of the fit."""
    figure = new_figure(330.0)
    axes = panel(figure, LEFT, 46.0, PANEL_WIDTH, 218.0)
    moves = result.moves
    x = np.arange(1.0, len(moves) + 1.0)
    size = _mark(len(x))
    before = _column([move.before_rad for move in moves]) / DEG
    after = _column([move.after_rad for move in moves]) / DEG
    held_out = _column([move.held_out_rad for move in moves]) / DEG
    expected = RAYLEIGH_95 * _column([move.sigma_rad for move in moves]) / DEG
    every = np.concatenate((before, after, held_out, expected))
    positive = every[np.isfinite(every) & (every > 0.0)]
    axes.set_yscale("log")
    low, high = (0.01, 1.0) if not positive.size else (np.min(positive), np.max(positive))
    low, high = max(low, high * 1e-5) / 1.5, high * 1.5
    axes.set_ylim(low, high)

    def shown(values: FloatArray) -> FloatArray:
        kept: FloatArray = np.where(np.isfinite(values), np.maximum(values, low), np.nan)
        return kept

    axes.plot(x, shown(before), "s", color=BEFORE, markersize=size, label="before")
    if np.any(np.isfinite(held_out)):
        axes.plot(
            x, shown(held_out), "D", markersize=size + 1.0, markerfacecolor="none",
            markeredgecolor=LEFT_OUT, markeredgewidth=1.2, label="left out of the fit",
        )  # fmt: skip
    axes.plot(x, shown(after), "o", color=AFTER, markersize=size - 0.8, label="after, in the fit")
    if np.any(np.isfinite(expected)):
        axes.hlines(
            shown(expected), x - 0.4, x + 0.4, color=INK, linewidth=1.0, label="95 % expected below"
        )
    _plain_log_ticks(axes, low, high)
    axes.set_ylabel("direction error [deg]")
    axes.set_xlabel("move number")
    count_axis(axes, x)
    _legend(axes, columns=2 if len(axes.get_legend_handles_labels()[0]) > 3 else 3)
    return figure


def parameter_intervals(sensor: Sensor) -> Figure:
    """95 % intervals of a sensor's parameters about their estimates, and the truth if known."""
    row, gap, top, bottom = 22.0, 50.0, 30.0, 46.0
    counts = [len(group.parameters) for group in sensor.groups]
    height = top + row * sum(counts) + gap * (len(counts) - 1) + bottom
    figure = new_figure(height)
    upper = height - top
    for group, count in zip(sensor.groups, counts, strict=True):
        axes = panel(figure, 170.0, upper - row * count, 328.0, row * count)
        _draw_intervals(axes, group)
        upper -= row * count + gap
    axes = figure.axes[0]
    axes.errorbar([], [], xerr=[], fmt="o", color=AFTER, capsize=4, label="estimate ± 95 %")
    if any(p.truth is not None for p in sensor.parameters):
        axes.plot([], [], "D", color=TRUTH, markersize=7.0, label="true value")
    _legend(axes)
    return figure


def vector_residuals(result: CalibrationResult) -> Figure | None:
    """Residual vectors of a method that trusts the commanded angles."""
    kinds: list[tuple[Sequence[PoseRow | MoveRow], list[int], float, str, str]] = [
        (result.poses, pose_numbers(result.poses), MILLI_G, "residual [mg]", "pose number"),
        (
            result.moves,
            list(range(1, len(result.moves) + 1)),
            DEG,
            "residual [deg]",
            "move number",
        ),
    ]
    drawn = [kind for kind in kinds if any(row.vector_error is not None for row in kind[0])]
    if not drawn:
        return None
    height = 190.0 * len(drawn) + 24.0
    figure = new_figure(height)
    for i, (rows, numbers, unit, ylabel, xlabel) in enumerate(drawn):
        axes = panel(figure, LEFT + 4.0, height - 170.0 - i * 190.0, PANEL_WIDTH - 4.0, 140.0)
        x = np.array(numbers, dtype=float)
        missing = np.full(3, np.nan)
        errors = np.array([missing if r.vector_error is None else r.vector_error for r in rows])
        errors = np.where(np.isfinite(errors), errors, np.nan) / unit
        for k, (name, colour, mark) in enumerate(COMPONENTS):
            shift = (k - 1) * 0.2 if len(x) <= MANY else 0.0
            axes.plot(
                x + shift, errors[:, k], mark, color=colour, markersize=_mark(len(x)) - 0.5,
                label=name,
            )  # fmt: skip
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set_ylabel(ylabel)
        axes.set_xlabel(xlabel)
        count_axis(axes, x)
        if i == 0:
            _legend(axes)
    return figure


def _draw_intervals(axes: Axes, group: ParameterGroup) -> None:
    rows = np.arange(float(len(group.parameters)))
    fixed_here = np.array([parameter.is_fixed for parameter in group.parameters])
    half = np.array([parameter.half_width for parameter in group.parameters])
    off = _column([None if p.truth is None else p.truth - p.value for p in group.parameters])
    for chosen, colour in ((fixed_here, BEFORE), (~fixed_here, AFTER)):
        if np.any(chosen):
            axes.errorbar(
                np.zeros(np.count_nonzero(chosen)), rows[chosen], xerr=half[chosen], fmt="o",
                color=colour, markersize=5.0, capsize=4.0 if colour == AFTER else 0.0,
                linewidth=1.8,
            )  # fmt: skip
    if np.any(np.isfinite(off)):
        axes.plot(off, rows, "D", color=TRUTH, markersize=7.0, zorder=4)
    sizes = np.concatenate((half, np.abs(off[np.isfinite(off)])))
    reach = float(np.max(sizes)) or 1.0
    labels = [
        f"{p.name}\N{EN SPACE}{fixed(p.value, decimals_for(p.uncertainty), sign=True)} {group.unit}"
        for p in group.parameters
    ]
    axes.axvline(0.0, color=INK, linewidth=0.8, zorder=1)
    # Ticks cost several times what plain text does, and there is one for every parameter.
    axes.set_yticks([])
    beside = axes.get_yaxis_transform()
    for row, label in zip(rows, labels, strict=True):
        axes.text(-0.015, row, label, transform=beside, ha="right", va="center_baseline", size=12.0)
    axes.set_ylim(len(labels) - 0.45, -0.55)
    axes.spines["left"].set_visible(False)
    axes.set_xlim(-1.15 * reach, 1.15 * reach)
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10], symmetric=True))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _tick(value)))
    axes.set_xlabel(f"{group.name.lower()}, off the estimate [{group.unit}]")


def _uncertain(
    axes: Axes, x: FloatArray, y: FloatArray, sigma: FloatArray, colour: str, mark: str, label: str
) -> None:
    """Points with one standard uncertainty: as bars, or as a band about zero where many."""
    size = _mark(len(x))
    known = np.isfinite(y) & np.isfinite(sigma)
    if np.any(known) and len(x) <= MANY:
        axes.errorbar(
            x[known], y[known], yerr=sigma[known], fmt="none", ecolor=colour, elinewidth=1.1,
            alpha=0.75,
        )  # fmt: skip
    elif np.any(known):
        axes.fill_between(
            x[known], -sigma[known], sigma[known], step="mid", color=colour, alpha=0.22, linewidth=0
        )
    suffix = (" ± σ" if len(x) <= MANY else ", band ± σ") if np.any(known) else ""
    hollow = mark == "D"
    axes.plot(
        x, y, mark, color=colour, markersize=size, label=label + suffix,
        markerfacecolor="white" if hollow else colour, markeredgewidth=1.2 if hollow else 0.0,
    )  # fmt: skip


def _legend(axes: Axes, columns: int = 3) -> None:
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=columns, borderaxespad=0.2,
        handletextpad=0.4, columnspacing=1.6, borderpad=0.2, handlelength=1.4,
    )  # fmt: skip


def count_axis(axes: Axes, x: FloatArray) -> None:
    """Let an axis run over the numbers (n,) of poses or moves."""
    low, high = (float(x[0]), float(x[-1])) if len(x) else (1.0, 1.0)
    margin = max(0.6, 0.01 * (high - low))
    axes.set_xlim(low - margin, high + margin)
    axes.xaxis.set_major_locator(MaxNLocator(12, integer=True, steps=[1, 2, 5, 10]))


def _plain_log_ticks(axes: Axes, low: float, high: float) -> None:
    subs = (1.0,) if high / low > 5000.0 else (1.0, 2.0, 5.0)
    axes.yaxis.set_major_locator(LogLocator(subs=subs))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _tick(value)))
    axes.yaxis.set_minor_locator(NullLocator())


def _tick(value: float) -> str:
    if abs(value) < 1e-12:
        return "0"
    text = significant(value, 3)
    return text.rstrip("0").rstrip(".") if "." in text else text


def _mark(count: int) -> float:
    return 6.0 if count <= 30 else 5.0 if count <= MANY else 3.6


def _column(values: Sequence[float | None]) -> FloatArray:
    column = np.array([math.nan if value is None else value for value in values], dtype=float)
    finite: FloatArray = np.where(np.isfinite(column), column, math.nan)
    return finite
