"""Which part of a recording is which: a column of names, or a list in a file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.known import FACES, TURNS, Part
from imu_rig.errors import InputError
from imu_rig.files import read_small
from imu_rig.foreign_text import one_line
from imu_rig.importing.column_map import ColumnMap
from imu_rig.importing.read_table import read_table, time_order
from imu_rig.importing.text_table import Form, detect_form, read_words

PART_COLUMN = "part"
MAXIMUM_LIST_BYTES = 100_000
APART_S = 10.0
"""Parts that were cut out and put together are set this far apart again."""
_FORMAT = '{"x_p": {"start": 540, "end": 1271}, ...}'


def has_parts(path: Path, columns: ColumnMap) -> bool:
    """Whether the table names the part of every row."""
    names = columns.columns or _form(path, columns).names
    return bool(names) and PART_COLUMN in (names or ())


def has_known_parts(path: Path, columns: ColumnMap) -> bool:
    """Whether it names a face or a turn among them; other columns may be called so too."""
    if not has_parts(path, columns):
        return False
    form = _form(path, columns)
    names = columns.columns or form.names or ()
    words = read_words(path, form, names.index(PART_COLUMN))
    return not {*FACES, *TURNS}.isdisjoint(words)


def read_annotated(path: Path, columns: ColumnMap) -> tuple[ImuBlock, tuple[Part, ...]]:
    """Read a table whose column `PART_COLUMN` names the part that every row belongs to.

    The parts may stand in any order; time, where there is any, puts them right. Rows of other
    parts count as the rest of the recording.

    Raises
    ------
    InputError
        What `read_table` refuses, or no part of a known name.
    """
    form = _form(path, columns)
    names = columns.columns or form.names or ()
    words = np.array(read_words(path, form, names.index(PART_COLUMN)))
    order = time_order(path, form, columns)
    block = read_table(path, columns, rows=order)
    words = words if order is None else words[order]
    edge = np.flatnonzero(words[1:] != words[:-1]) + 1
    # Parts that follow each other without a row between were cut out and put together.
    named = np.isin(words, (*FACES, *TURNS))
    cut = edge[named[edge] & named[edge - 1]]
    late = APART_S * np.searchsorted(cut, np.arange(len(words)), side="right")
    block = replace(block, t=block.t + late, host_s=block.host_s + late)
    starts = np.concatenate(([0], edge)).astype(int)
    stops = np.concatenate((edge, [len(words)])).astype(int)
    known = [
        Part(str(words[a]), float(block.t[a]), float(block.t[b - 1]))
        for a, b in zip(starts, stops, strict=True)
        if words[a] in (*FACES, *TURNS) and b - a > 1
    ]
    if not known:
        raise InputError(
            f"{path}: its column {PART_COLUMN} names none of {', '.join((*FACES, *TURNS))}"
        )
    return block, tuple(known)


def read_part_list(path: Path, t: FloatArray) -> tuple[Part, ...]:
    """Read a JSON list of parts by their first sample and one past their last.

    Parameters
    ----------
    path : Path
        ``{"x_p": {"start": 540, "end": 1271}, ...}``.
    t : shape (n,)
        Time of the recording [s].

    Raises
    ------
    InputError
        Naming the part that is wrong.
    """
    data = read_small(path, MAXIMUM_LIST_BYTES, what="a list of parts")
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no JSON: {error}") from error
    if not isinstance(content, dict) or not content:
        raise InputError(f"{path} holds no list of parts such as {_FORMAT}")
    return tuple(_part(path, name, span, t) for name, span in content.items())


def _part(path: Path, name: str, span: Any, t: FloatArray) -> Part:
    given = span if isinstance(span, dict) else {}
    shown = one_line(name, 30)
    start, stop = given.get("start"), given.get("end")
    if type(start) is not int or type(stop) is not int:
        raise InputError(f"{path}: the part {shown} needs a start and an end, as in {_FORMAT}")
    if 0 <= start < len(t) and stop == start + 1:
        raise InputError(
            f"{path}: the part {shown} is a single sample; its end is the number of the first "
            "sample after it"
        )
    if not 0 <= start < stop <= len(t):
        raise InputError(
            f"{path}: the part {shown} goes from sample {start} to {stop}, but the recording "
            f"has samples 0 to {len(t)}"
        )
    try:
        return Part(name, float(t[start]), float(t[stop - 1]))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _form(path: Path, columns: ColumnMap) -> Form:
    return detect_form(
        path, delimiter=columns.delimiter, decimal=columns.decimal, skip_rows=columns.skip_rows
    )
