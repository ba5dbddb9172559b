"""Still poses on the sphere: which way was up in the sensor, as two equal-area hemispheres."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from imu_rig.arrays import FloatArray
from imu_rig.report.svg import FAINT, INK, WIDTH, new_figure

HEIGHT = 370.0
RADIUS = 102.0
CENTRES = ((131.0, 216.0), (389.0, 216.0))
AXIS_LABEL_AWAY = 16.0
DOT = 4.6
LABEL_SIZE = 11.5
LETTER = 6.8
JOINED_WITHIN = 4.0
MANY = 60
WORST = 6
AROUND = (
    (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0),
    (0.75, 0.9), (-0.75, 0.9), (0.75, -0.9), (-0.75, -0.9),
)  # fmt: skip
"""Directions in which a label may stand from its point, best first."""
REACHES = (1.0, 2.3, 3.6)
"""How far off, in units of the nearest place; the farther ones get a line to the point."""
COLOURS = "viridis_r"
STEPS = 12
"""Colours of a map."""
SOFT = "#5b626c"
BAR = (134.0, 46.0, 252.0, 10.0)
"""Left, bottom, width and height of the colour bar."""


@dataclass(frozen=True)
class _Spot:
    """One or more poses at one place of the drawing."""

    x: float
    y: float
    label: str
    worst: float


@dataclass(frozen=True)
class _Label:
    """Where the label of a spot stands."""

    spot: _Spot
    x: float
    y: float
    needs_line: bool


def hemispheres(
    directions: FloatArray,
    errors: FloatArray,
    numbers: Sequence[int],
    error_name: str,
    *,
    titles: tuple[str, str] = ("sensor z up", "sensor z down"),
) -> Figure:
    """Draw directions on the upper and lower half of the sphere.

    Lambert's azimuthal equal-area projection, so that the density of points in the drawing is
    their density on the sphere. Both halves are seen from +z, as if the sphere were glass.

    Parameters
    ----------
    directions : shape (n, 3)
        Unit vectors in sensor axes.
    errors : shape (n,)
        Absolute errors that colour the points.
    numbers : sequence of int
        Number of each pose; none for points without labels.
    error_name : str
        Quantity and unit of ``errors``.
    titles : (str, str)
        Names of the halves.
    """
    figure, axes = _empty(titles)
    places = project(directions)
    largest = float(np.max(errors)) or 1.0
    colours = mpl.colormaps[COLOURS]
    order = np.argsort(errors, kind="stable")
    axes.scatter(
        places[order, 0],
        places[order, 1],
        s=(2.0 * DOT) ** 2 if len(order) <= MANY else DOT**2 * 2.0,
        c=colours(errors[order] / largest),
        edgecolors=INK,
        linewidths=0.7,
        zorder=3,
    )
    spots = _spots(places, errors, numbers) if numbers else []
    for label in _labels(spots, many=len(order) > MANY):
        if label.needs_line:
            axes.plot(
                [label.spot.x, label.x],
                [label.spot.y, label.y],
                color=INK,
                linewidth=0.7,
                zorder=3.5,
            )
        axes.text(
            label.x,
            label.y,
            label.spot.label,
            size=LABEL_SIZE,
            ha="center",
            va="center_baseline",
            zorder=4,
            bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0.0, "pad": 0.6},
        )
    _draw_colour_bar(axes, colours, (0.0, largest), error_name)
    return figure


def hemisphere_map(
    values: Callable[[FloatArray], FloatArray],
    directions: FloatArray,
    name: str,
    *,
    titles: tuple[str, str] = ("sensor z up", "sensor z down"),
) -> Figure:
    """Draw a quantity over the whole sphere, with points on it, as `hemispheres` does.

    Parameters
    ----------
    values : function
        From unit vectors (n, 3) in sensor axes to the quantity (n,).
    directions : shape (m, 3)
        Unit vectors to mark.
    name : str
        Quantity and unit of ``values``.
    titles : (str, str)
        Names of the halves.
    """
    figure, axes = _empty(titles, elevations=False)
    radius, turn = np.meshgrid(np.linspace(0.0, 1.0, 21), np.linspace(0.0, 2.0 * math.pi, 73))
    up = 1.0 - radius**2
    flat = np.sqrt(1.0 - up**2)
    grid = [
        np.stack((flat * np.cos(turn), flat * np.sin(turn), side * up), axis=-1).reshape(-1, 3)
        for side in (1.0, -1.0)
    ]
    heights = [values(half).reshape(up.shape) for half in grid]
    low, high = float(np.min(heights)), float(np.max(heights))
    margin = 1e-3 * (high - low) + 1e-9 * abs(high) + 1e-300
    edges = np.linspace(low - margin, high + margin, STEPS + 1)
    colours = mpl.colormaps[COLOURS]
    for centre, height in zip(CENTRES, heights, strict=True):
        x = centre[0] + RADIUS * radius * np.cos(turn)
        y = centre[1] + RADIUS * radius * np.sin(turn)
        filled = axes.contourf(x, y, height, levels=edges, cmap=colours, zorder=0.5)
        # Without it the page shows through between the colours.
        filled.set_edgecolor("face")
    places = project(directions)
    axes.plot(
        places[:, 0], places[:, 1], "o", markersize=2.0 * DOT if len(places) <= MANY else DOT,
        markerfacecolor="white", markeredgecolor=INK, markeredgewidth=0.9, zorder=3,
    )  # fmt: skip
    _draw_colour_bar(axes, colours, (low, high), name)
    return figure


def _empty(titles: tuple[str, str], *, elevations: bool = True) -> tuple[Figure, Axes]:
    figure = new_figure(HEIGHT)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0.0, WIDTH)
    axes.set_ylim(0.0, HEIGHT)
    for centre, title in zip(CENTRES, titles, strict=True):
        _draw_net(axes, centre, title)
        for name, x, y in _elevation_labels(centre) if elevations else []:
            axes.text(
                x, y, name, size=10.0, color=SOFT, ha="center", va="center_baseline", zorder=1
            )
    return figure, axes


def project(directions: FloatArray) -> FloatArray:
    """Place unit vectors (n, 3) in the drawing, shape (n, 2)."""
    x, y, z = directions.T
    radius = RADIUS * np.sqrt(np.clip(1.0 - np.abs(z), 0.0, 1.0))
    flat = np.hypot(x, y)
    flat = np.where(flat > 0.0, flat, 1.0)
    centres = np.array(CENTRES)[np.where(z >= 0.0, 0, 1)]
    places: FloatArray = centres + np.stack((radius * x / flat, radius * y / flat), axis=1)
    return places


def _draw_net(axes: Axes, centre: tuple[float, float], title: str) -> None:
    turn = np.linspace(0.0, 2.0 * math.pi, 91)
    for elevation_deg in (0, 30, 60):
        radius = RADIUS * math.sqrt(1.0 - math.sin(math.radians(elevation_deg)))
        axes.plot(
            centre[0] + radius * np.cos(turn),
            centre[1] + radius * np.sin(turn),
            color="#8b929c" if elevation_deg == 0 else FAINT,
            linewidth=1.0 if elevation_deg == 0 else 0.8,
        )
    for angle_deg in range(0, 180, 45):
        across = RADIUS * np.array([-1.0, 1.0])
        angle = math.radians(angle_deg)
        axes.plot(
            centre[0] + across * math.cos(angle),
            centre[1] + across * math.sin(angle),
            color=FAINT,
            linewidth=0.8,
        )
    for name, x, y in _axis_labels(centre):
        axes.text(x, y, name, color=SOFT, ha="center", va="center_baseline")
    axes.text(centre[0], HEIGHT - 2.0, title, size=13.0, ha="center", va="top")


def _axis_labels(centre: tuple[float, float]) -> list[tuple[str, float, float]]:
    away = RADIUS + AXIS_LABEL_AWAY
    return [
        (name, centre[0] + away * x, centre[1] + away * y)
        for name, x, y in (("+x", 1, 0), ("−x", -1, 0), ("+y", 0, 1), ("−y", 0, -1))
    ]


def _elevation_labels(centre: tuple[float, float]) -> list[tuple[str, float, float]]:
    labels = []
    for elevation_deg in (30, 60):
        along = math.sqrt((1.0 - math.sin(math.radians(elevation_deg))) / 2.0) * RADIUS
        labels.append((f"{elevation_deg}°", centre[0] + along + 8.0, centre[1] - along - 8.0))
    return labels


def _draw_colour_bar(axes: Axes, colours: Colormap, ends: tuple[float, float], name: str) -> None:
    left, bottom, width, thick = BAR
    steps = 36
    edges = left + width * np.arange(steps) / steps
    axes.bar(
        edges,
        thick,
        width=width / steps * 1.05,
        bottom=bottom,
        align="edge",
        color=colours((np.arange(steps) + 0.5) / steps),
    )
    low, high = ends
    for value in MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high):
        share = (value - low) / (high - low) if high > low else 0.0
        if -1e-9 <= share <= 1.0 + 1e-9:
            x = left + width * share
            axes.plot([x, x], [bottom - 4.0, bottom], color=SOFT, linewidth=0.8)
            axes.text(x, bottom - 6.0, f"{value:.6g}", ha="center", va="top", size=12.0)
    axes.text(left + width / 2.0, bottom - 24.0, name, ha="center", va="top", size=13.0)


def _spots(places: FloatArray, errors: FloatArray, numbers: Sequence[int]) -> list[_Spot]:
    """Join poses that would lie on top of each other; the largest error first."""
    groups: list[list[int]] = []
    for i, place in enumerate(places):
        for group in groups:
            if np.hypot(*(place - places[group[0]])) < JOINED_WITHIN:
                group.append(i)
                break
        else:
            groups.append([i])
    spots = []
    for group in groups:
        shown = [str(numbers[i]) for i in group[:3]]
        more = len(group) - len(shown)
        label = ", ".join(shown) + (f" +{more}" if more else "")
        x, y = places[group[0]]
        spots.append(_Spot(float(x), float(y), label, float(np.max(errors[group]))))
    return sorted(spots, key=lambda spot: -spot.worst)


def _labels(spots: Sequence[_Spot], *, many: bool) -> list[_Label]:
    """Place the labels that fit: beside their point, off other points and other labels."""
    taken = [(s.x - DOT, s.y - DOT, s.x + DOT, s.y + DOT) for s in spots]
    for centre in CENTRES:
        net = _axis_labels(centre) + _elevation_labels(centre)
        taken += [(x - 8.0, y - 6.0, x + 8.0, y + 6.0) for _, x, y in net]
    placed = []
    for rank, spot in enumerate(spots):
        if many and rank >= WORST:
            break
        half_width = LETTER * len(spot.label) / 2.0
        half_height = LABEL_SIZE * 0.45
        aside, above = DOT + half_width + 1.0, DOT + half_height + 1.0
        candidates = [
            (spot.x + reach * dx * aside, spot.y + reach * dy * above)
            for reach in REACHES
            for dx, dy in AROUND
        ]
        boxes = [
            (x - half_width, y - half_height, x + half_width, y + half_height)
            for x, y in candidates
        ]
        covered = [sum(_overlap(box, other) for other in taken) for box in boxes]
        best = int(np.argmin(covered))
        if covered[best] > 0.0 and rank >= WORST:
            continue
        taken.append(boxes[best])
        placed.append(_Label(spot, *candidates[best], needs_line=best >= len(AROUND)))
    return placed


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> float:
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    return width * height if width > 0.0 and height > 0.0 else 0.0
