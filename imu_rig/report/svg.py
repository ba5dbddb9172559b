"""Matplotlib figures as small inline SVG that is the same for the same data.

The text of a figure stays text in the fonts of the page. Figures hold no text from the data,
so nothing in them has to be trusted.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imu_rig.report.page import Html, element, text

WIDTH = 520.0
"""Width of every figure in user units; at full size one unit is one CSS pixel."""
UNITS_PER_INCH = 72.0

BEFORE = "#7a828e"
AFTER = "#1a5fb4"
LEFT_OUT = "#d4650a"
TRUTH = "#b5179e"
INK = "#22262c"
FAINT = "#d9dce1"


@contextmanager
def report_style() -> Iterator[None]:
    """Draw in the report's own style, whatever the user's matplotlib settings are."""
    ticks = {"color": "#8b929c", "labelcolor": INK, "labelsize": 12.0}
    hidden = {"spines.right": False, "spines.top": False}
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rc("axes", edgecolor="#8b929c", labelcolor=INK, labelsize=13.0, linewidth=0.8, **hidden)
        mpl.rc("font", size=12.5)
        mpl.rc("grid", color=FAINT, linewidth=0.7)
        mpl.rc("legend", fontsize=12.5, frameon=False)
        mpl.rc("svg", fonttype="none", hashsalt="imu-rig")
        mpl.rc("text", color=INK)
        mpl.rc("xtick", **ticks)
        mpl.rc("ytick", **ticks)
        yield


def new_figure(height: float) -> Figure:
    """Return an empty figure of the standard width, in user units."""
    return Figure(figsize=(WIDTH / UNITS_PER_INCH, height / UNITS_PER_INCH), dpi=UNITS_PER_INCH)


def panel(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a place in user units, with a grid behind the data."""
    full = figure.get_size_inches() * UNITS_PER_INCH
    axes = figure.add_axes((left / full[0], bottom / full[1], width / full[0], height / full[1]))
    axes.grid(visible=True)
    axes.set_axisbelow(True)
    return axes


def inline(figure: Figure, name: str, description: str) -> Html:
    """Return a figure as an SVG element.

    Parameters
    ----------
    figure : Figure
        Drawn within `report_style`.
    name : str
        Letters only; makes the identifiers inside unique in the page.
    description : str
        For those who cannot see the figure.
    """
    buffer = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(buffer, format="svg", metadata=nothing)
    drawing = buffer.getvalue()
    drawing = drawing[drawing.index("<svg") :]
    drawing = re.sub(r"<!--.*?-->|<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
    drawing = re.sub(r"<style.*?</style>", "", drawing, count=1, flags=re.DOTALL)
    drawing = re.sub(r"font-family: [^;\"]*;? ?", "", drawing)
    drawing = re.sub(r'<g id="[^"]*">', "<g>", drawing)
    drawing = re.sub(r'\bid="', f'id="{name}-', drawing)
    drawing = re.sub(r'(?:xlink:)?href="#', f'href="#{name}-', drawing)
    drawing = re.sub(r"url\(#", f"url(#{name}-", drawing)
    drawing = re.sub(r' (?:d|x|y|width|height|transform)="[^"]*"', _shortened, drawing)
    drawing = re.sub(r"\s*\n\s*", " ", drawing).replace("> <", "><")
    height = figure.get_size_inches()[1] * UNITS_PER_INCH
    opening = (
        f'<svg viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{text(description)}">'
    )
    return Html(opening + drawing[drawing.index(">") + 1 :].strip())


class Figures:
    """Figures with their captions, numbered in order from those ``before`` on."""

    def __init__(self, before: int = 0) -> None:
        self.parts: list[Html] = []
        self._before = before

    @property
    def last(self) -> int:
        """Number of the last figure so far."""
        return self._before + len(self.parts)

    def add(self, name: str, figure: Figure, title: str, caption: str) -> None:
        """Draw one more; ``name`` as for `inline`."""
        heading = f"Figure {self.last + 1}. {title}."
        self.parts.append(
            element(
                "figure",
                inline(figure, name, title),
                element("figcaption", element("b", heading), " ", caption),
            )
        )


def _shortened(attribute: re.Match[str]) -> str:
    """Hundredths of a pixel are enough."""
    return re.sub(r"(\.\d\d)\d+", r"\1", attribute[0])
