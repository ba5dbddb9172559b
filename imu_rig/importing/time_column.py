"""Time stamps of foreign recordings: brought to increase, or refused by the line they are in."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.errors import InputError
from imu_rig.importing.text_table import Form, line_of_row


def refuse_going_back(source: Path, form: Form, column: FloatArray) -> None:
    """Refuse times that go back.

    Raises
    ------
    InputError
        Naming the line.
    """
    if np.any(np.diff(column) < 0):
        row = int(np.argmax(np.diff(column) < 0)) + 1
        raise InputError(
            f"{source}, line {line_of_row(source, form, row)}: time goes back "
            f"({column[row]:.10g} after {column[row - 1]:.10g}); sort the rows or cut the file "
            "there"
        )


def spread_repeated(source: Path, column: FloatArray) -> FloatArray:
    """Spread samples that share a time stamp evenly over the time since the one before.

    Devices that send in bursts stamp some samples alike, all with the time of the last.
    """
    fresh = np.flatnonzero(np.diff(column) > 0)
    if len(fresh) == len(column) - 1:
        return column
    if not len(fresh):
        raise InputError(f"{source}: its time column is {column[0]:g} in every row")
    # The last row of every run keeps its stamp; time between them is straight.
    last = np.append(fresh, len(column) - 1)
    spread = np.interp(np.arange(len(column)), last, column[last])
    first = int(last[0])
    step = (column[last[-1]] - column[last[0]]) / (last[-1] - last[0])
    spread[:first] = column[first] - step * np.arange(first, 0, -1)
    return np.asarray(spread)


def repeated_rows(rows: FloatArray) -> BoolArray:
    """Return which rows, shape (n,), say the same as the one before, time and all."""
    same = np.zeros(len(rows), dtype=bool)
    same[1:] = np.all(rows[1:] == rows[:-1], axis=1)
    return same
