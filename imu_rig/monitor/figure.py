"""The picture of live streams: a row for each, a panel for each quantity, the newest at the right.

Axes stand still: time runs from minus some seconds to now, and ranges change rarely. So only the
lines have to be drawn anew, over a background that was drawn once.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from imu_rig.arrays import FloatArray
from imu_rig.foreign_text import one_line
from imu_rig.monitor.quantities import FIRST, Quantity
from imu_rig.monitor.scales import LARGEST, Scale

COLOURS = ("#b3261e", "#2e7d32", "#1a5fb4")
"""Of x, y and z, as in the reports."""
ALONE = "#37474f"
INK, FAINT = "#263238", "#cfd8dc"
LEAST_SPANS = {"g": 0.1, "deg/s": 4.0, "uT": 4.0, "hPa": 0.2, "degC": 0.5}
USUAL_LEAST = 1e-3

ROW_IN, ROWS_IN, WIDE_IN = 1.55, 8.4, 11.0  # inches: of one row, of all at most, of one block
HEAD_IN, FOOT_IN, LEFT_IN, RIGHT_IN, TITLE_IN = 0.3, 0.5, 0.85, 0.2, 0.4
BETWEEN_IN = 0.78  # panels, for the ticks and the unit
ROWS_OF_A_BLOCK = 6  # more streams stand in blocks side by side
MOST_PANELS = 5
ENOUGH_PANELS = 2  # of well-known quantities, beside which others are left to the table
LONGEST_NAME = 44
MOST_POINTS = 1500  # of a line: more than a panel has pixels


@dataclass(frozen=True)
class StreamPlan:
    """What of one stream is drawn.

    Attributes
    ----------
    name : str
    quantities : tuple of Quantity
        In the order of the columns of its ring.
    """

    name: str
    quantities: tuple[Quantity, ...]

    @property
    def columns(self) -> int:
        """Numbers in each sample."""
        return sum(quantity.count for quantity in self.quantities)


@dataclass
class _Panel:
    axes: Axes
    lines: list[Line2D]
    first: int  # column of its first number; times are in column 0
    scale: Scale
    absent: Text


class LiveFigure:
    """A figure of streams that is kept up to date.

    Parameters
    ----------
    plans : sequence of StreamPlan
    seconds : float
        How far back it shows.
    figure : Figure, optional
        One that belongs to a window; otherwise a new one.
    """

    def __init__(
        self, plans: Sequence[StreamPlan], seconds: float, figure: Figure | None = None
    ) -> None:
        self.figure = figure or Figure()
        self.figure.set_size_inches(*figure_size(plans))
        self.figure.set_facecolor("white")
        self._seconds = seconds
        self._panels: list[tuple[str, _Panel]] = []
        self._background: Any = None
        self._saving = False
        self.redraws = self.frames = 0
        self._build(plans)
        for _, panel in self._panels:
            for artist in (*panel.lines, panel.absent):
                artist.set_animated(True)
        # also after somebody changed the size of the window
        self.figure.canvas.mpl_connect("draw_event", lambda event: self._drawn())

    # --- drawing ------------------------------------------------------------------------------

    def update(self, samples: Mapping[str, FloatArray], now_s: float) -> bool:
        """Move the lines to where the samples are.

        Parameters
        ----------
        samples : mapping
            By the stream's name, shape (n, 1 + columns), times first [s].
        now_s : float
            The time at the right edge.

        Returns
        -------
        bool
            Whether a range changed, so that everything must be drawn.
        """
        changed = False
        for name, panel in self._panels:
            rows = samples.get(name)
            if rows is None or not len(rows):
                panel.absent.set_visible(True)
                continue
            rows = rows[rows[:, 0] >= now_s - self._seconds]
            since = rows[:, 0] - now_s
            numbers = rows[:, panel.first : panel.first + len(panel.lines)]
            for line, column in zip(panel.lines, numbers.T, strict=True):
                # what comes only with some packets is joined over those without
                there = np.flatnonzero(np.isfinite(column))
                there = there[:: max(1, math.ceil(len(there) / MOST_POINTS))]
                line.set_data(since[there], np.clip(column[there], -LARGEST, LARGEST))
                line.set_marker("." if len(there) == 1 else "")
            whole = numbers[np.isfinite(numbers)]
            panel.absent.set_visible(not len(whole))
            if len(whole) and panel.scale.fit(
                float(whole.min()), float(whole.max()), time.monotonic()
            ):
                panel.axes.set_ylim(*panel.scale.range)
                changed = True
        return changed

    def draw(self) -> None:
        """Draw everything, and remember what lies behind the lines."""
        self.figure.canvas.draw()

    def _drawn(self) -> None:
        """Take what was drawn just now, without lines, as what lies behind them."""
        if self._saving:
            return
        self.redraws += 1
        canvas: Any = self.figure.canvas
        self._background = canvas.copy_from_bbox(self.figure.bbox)
        self.draw_lines()

    def draw_lines(self) -> None:
        """Draw the lines alone, over the background."""
        canvas: Any = self.figure.canvas
        if self._background is None:
            self.draw()
            return
        canvas.restore_region(self._background)
        for _, panel in self._panels:
            for artist in (*panel.lines, panel.absent):
                panel.axes.draw_artist(artist)
        canvas.blit(self.figure.bbox)
        self.frames += 1

    def save(self, file: Any, kind: str) -> None:
        """Write the picture as "png", "svg" or "pdf", lines and all; the figure ends with it."""
        self._saving = True
        for _, panel in self._panels:
            for artist in (*panel.lines, panel.absent):
                artist.set_animated(False)
        self.figure.savefig(file, format=kind, dpi=self.figure.dpi)

    # --- layout -------------------------------------------------------------------------------

    def _build(self, plans: Sequence[StreamPlan]) -> None:
        wide, high = figure_size(plans)
        blocks, rows = _grid(len(plans))
        row_in = (high - HEAD_IN - FOOT_IN) / rows
        block_in = wide / blocks
        for at, plan in enumerate(plans):
            block, row = divmod(at, rows)
            last = row == rows - 1 or at == len(plans) - 1
            shown = drawn(plan)
            room = block_in - LEFT_IN - RIGHT_IN - BETWEEN_IN * (len(shown) - 1)
            width = room / max(1, len(shown))
            top = high - HEAD_IN - row * row_in
            for number, (quantity, first) in enumerate(shown):
                left = block * block_in + LEFT_IN + number * (width + BETWEEN_IN)
                axes = self.figure.add_axes(
                    (
                        left / wide,
                        (top - row_in + 0.12) / high,
                        width / wide,
                        (row_in - TITLE_IN - 0.12) / high,
                    )
                )
                self._panels.append((plan.name, self._panel(axes, quantity, first, last=last)))
            words = Text(
                (block * block_in + 0.14) / wide,
                (top - 0.15) / high,
                _fitted(one_line(plan.name, LONGEST_NAME)),
                fontsize=9,
                fontweight="bold",
                color=INK,
            )
            self.figure.add_artist(words)
        if any(q.count == len(COLOURS) for plan in plans for q, _ in drawn(plan)):
            axes_lines = [Line2D([], [], color=colour, lw=2) for colour in COLOURS]
            self.figure.legend(
                axes_lines,
                ["x", "y", "z"],
                loc="upper right",
                bbox_to_anchor=(1 - RIGHT_IN / wide / 2, 1 - 0.02 / high),
                ncol=3,
                frameon=False,
                fontsize=9,
                handlelength=1.2,
                borderaxespad=0.0,
                columnspacing=1.2,
            )

    def _panel(self, axes: Axes, quantity: Quantity, first: int, *, last: bool) -> _Panel:
        scale = Scale(LEAST_SPANS.get(quantity.unit, USUAL_LEAST))
        axes.set_xlim(-self._seconds, 0.0)
        axes.set_ylim(*scale.range)
        axes.tick_params(labelsize=7, length=2, colors=INK, labelbottom=last)
        axes.grid(color=FAINT, lw=0.5)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        numbers = ScalarFormatter(useOffset=False)
        numbers.set_powerlimits((-7, 7))
        axes.yaxis.get_offset_text().set_fontsize(7)
        axes.yaxis.set_major_formatter(numbers)
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        unit = quantity.spoken_unit
        axes.set_title(
            f"{quantity.title} [{unit}]" if unit else quantity.title,
            fontsize=8,
            color=INK,
            loc="right",
            pad=3,
        )
        if last:
            axes.set_xlabel("time [s], 0 is now", fontsize=8, color=INK, labelpad=2)
        of_axes = quantity.count == len(COLOURS)
        lines = [
            axes.plot([], [], lw=1.0, color=COLOURS[at] if of_axes else _shade(at, quantity))[0]
            for at in range(quantity.count)
        ]
        absent = axes.text(
            0.5, 0.5, "no data", transform=axes.transAxes, ha="center", va="center", color="#90a4ae"
        )
        return _Panel(axes, lines, first, scale, absent)


def drawn(plan: StreamPlan) -> list[tuple[Quantity, int]]:
    """Quantities of a stream that find room, and the column of the ring where each begins."""
    found, first = [], 1  # after the times
    for quantity in plan.quantities:
        found.append((quantity, first))
        first += quantity.count
    known = [(quantity, at) for quantity, at in found if quantity.name in FIRST]
    return (known if len(known) >= ENOUGH_PANELS else found)[:MOST_PANELS]


def figure_size(plans: Sequence[StreamPlan]) -> tuple[float, float]:
    """Width and height in inches."""
    blocks, rows = _grid(len(plans))
    width = WIDE_IN if blocks == 1 else 9.0 * blocks
    return width, HEAD_IN + FOOT_IN + min(ROWS_IN, max(2.0, ROW_IN * rows))


def _grid(streams: int) -> tuple[int, int]:
    blocks = max(1, math.ceil(streams / ROWS_OF_A_BLOCK))
    return blocks, max(1, math.ceil(streams / blocks))


def _shade(at: int, quantity: Quantity) -> Any:
    return ALONE if quantity.count == 1 else f"C{at}"


def _fitted(name: str) -> str:
    """Keep a dollar from being taken for mathematics."""
    return name.replace("$", r"\$")
