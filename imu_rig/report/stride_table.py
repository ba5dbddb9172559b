"""Strides as people and other programs read them: units, headings, digits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import AnyArray, FloatArray
from imu_rig.gait.strides import Strides, Summary, summary_of
from imu_rig.report.numbers import MISSING, fixed
from imu_rig.report.page import Html, element, folded, table
from imu_rig.units import DEG

SHOWN_UNITS = {"rad": ("deg", DEG)}
"""Units of columns that people read in others, and their size."""
SUFFIXES = {"m": "_m", "s": "_s", "deg": "_deg", "m/s": "_ms", "1/min": "_per_min", "": ""}
"""Of the names of columns in files."""
DECIMALS = {"m": 3, "s": 3, "deg": 1, "m/s": 3, "1/min": 1, "": 3}
FILE_DECIMALS = {"m": 5, "s": 5, "deg": 3, "m/s": 4, "1/min": 2, "": 4}

MOST_ROWS = 1000
"""Of strides in a page."""

SHORT = (
    ("start", "begins"),
    ("length", "length"),
    ("length_sigma", "± length"),
    ("height", "height"),
    ("duration", "duration"),
    ("velocity", "velocity"),
    ("stance_share", "stance"),
    ("clearance", "clearance"),
    ("contact_pitch", "pitch at contact"),
    ("toe_off_pitch", "pitch at toe-off"),
    ("turn", "turn"),
)
"""Columns of the table in a report, and their headings."""

SUMMARIZED = (
    ("length", "Stride length"),
    ("duration", "Stride time"),
    ("velocity", "Velocity"),
    ("cadence", "Cadence, steps of both feet"),
    ("stance_time", "Stance time"),
    ("swing_time", "Swing time"),
    ("stance_share", "Stance share of the stride"),
    ("clearance", "Clearance of the sensor"),
    ("height", "Height change"),
    ("sideways", "Sideways, left positive"),
    ("swing_width", "Swing width, left positive"),
    ("contact_pitch", "Pitch at contact, toe up positive"),
    ("toe_off_pitch", "Pitch at toe-off"),
    ("highest_pitch", "Highest pitch"),
    ("lowest_pitch", "Lowest pitch"),
    ("turn", "Turn, left positive"),
)
"""Columns of which mean and deviation are shown, and their names."""


@dataclass(frozen=True, eq=False)
class Column:
    """One column in the unit that is shown.

    Attributes
    ----------
    name : str
        As files call it, with its unit.
    unit : str
    values : shape (m,)
    """

    name: str
    unit: str
    values: AnyArray


def stride_columns(strides: Strides) -> dict[str, Column]:
    """Return every column of numbers in the units of files and reports."""
    found = {}
    for name, about in strides.columns().items():
        values = getattr(strides, name)
        if name == "kind":
            continue
        shown, size = SHOWN_UNITS.get(about.unit, (about.unit, 1.0))
        found[name] = Column(name + SUFFIXES[shown], shown, values / size)
    return found


def stride_head(strides: Strides) -> list[str]:
    """Return the names of the columns of a file of strides."""
    return ["foot", "stride", "kind", *(c.name for c in stride_columns(strides).values())]


def stride_rows(foot: str, strides: Strides) -> list[list[object]]:
    """Return the rows of a file of strides; what is not known is NaN."""
    columns = list(stride_columns(strides).values())
    return [
        [
            foot,
            row + 1,
            str(strides.kind[row]),
            *(round(float(c.values[row]), FILE_DECIMALS[c.unit]) for c in columns),
        ]
        for row in range(len(strides))
    ]


def shown_summary(strides: Strides, name: str) -> tuple[str, Summary]:
    """Return the unit and the statistics of one column over the strides of walking."""
    unit = strides.columns()[name].unit
    found = summary_of(getattr(strides, name)[strides.walking])
    shown, size = SHOWN_UNITS.get(unit, (unit, 1.0))
    return shown, Summary(found.mean / size, found.sd / size, found.cv, found.count)


def summary_table(feet: Sequence[tuple[str, Strides]]) -> Html:
    """Return mean ± standard deviation of gait parameters, a column for each foot."""
    many = len(feet) > 1
    head = ["", *(f"{name}: mean ± sd" if many else "mean ± sd" for name, _ in feet)]
    head += [f"{name}: variation" if many else "variation" for name, _ in feet]
    rows = []
    for name, label in SUMMARIZED:
        found = [shown_summary(strides, name) for _, strides in feet]
        if not any(s.count for _, s in found):
            continue
        unit = found[0][0]
        named = f"{label} [{unit}]" if unit else label
        means = [_mean(s, DECIMALS[unit]) for _, s in found]
        varied = [_variation(s) if label in _POSITIVE else MISSING for _, s in found]
        rows.append([named, *means, *varied])
    return table(head, rows)


_POSITIVE = ("Stride length", "Stride time", "Velocity", "Stance time", "Swing time")
"""Of others, which may be near zero, a variation in parts of the mean says nothing."""


def _mean(found: Summary, decimals: int) -> str:
    if not found.count:
        return MISSING
    text = fixed(found.mean, decimals)
    return f"{text} ± {fixed(found.sd, decimals)}" if math.isfinite(found.sd) else text


def _variation(found: Summary) -> str:
    return f"{fixed(100.0 * found.cv, 1)} %"


def stride_table(title: str, strides: Strides) -> Html:
    """Return every stride with what describes it best, folded."""
    columns = stride_columns(strides)
    shown = [(columns[name], heading) for name, heading in SHORT]
    shown = [(c, heading) for c, heading in shown if np.isfinite(c.values).any()]
    head = ["stride", "kind", *(f"{h} [{c.unit}]" if c.unit else h for c, h in shown)]
    body = [
        [
            str(row + 1),
            str(strides.kind[row]),
            *(_cell(c.values, row, DECIMALS[c.unit], c.unit) for c, _ in shown),
        ]
        for row in range(min(len(strides), MOST_ROWS))
    ]
    more = len(strides) - MOST_ROWS
    rest = [element("p", f"{more} more are in strides.csv.", class_="note")] if more > 0 else []
    return folded(title, table(head, body), *rest)


def _cell(values: FloatArray, row: int, decimals: int, unit: str) -> str:
    return fixed(float(values[row]), 2 if unit == "" else decimals)


def kinds_note(strides: Strides) -> Html | None:
    """Tell which strides are not of walking, if any."""
    from imu_rig.gait.stride_kinds import GAIT, KINDS

    names, counts = np.unique(strides.kind, return_counts=True)
    others = [(n, c) for n, c in zip(names.tolist(), counts.tolist(), strict=True) if n not in GAIT]
    if not others:
        return None
    told = "; ".join(f"{count} “{name}” ({KINDS[name]})" for name, count in others)
    return element(
        "p", f"Means are of steady walking and running. Not among them: {told}.", class_="note"
    )
