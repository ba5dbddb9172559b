"""The rates that a turntable had, from a small table beside the recording."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imu_rig.calibration.known import RateTable
from imu_rig.errors import InputError
from imu_rig.files import parse_toml, read_small
from imu_rig.units import DEG

MAXIMUM_BYTES = 1_000_000
VECTOR = ("x_dps", "y_dps", "z_dps")
_FORMAT = "t0,t1,axis,rate_dps or t0,t1,x_dps,y_dps,z_dps"


def read_rates(path: Path) -> RateTable:
    """Read segments of known rate.

    A CSV file with the columns ``t0,t1,axis,rate_dps`` (axis x, y, z or -x, -y, -z, seconds on
    the time of the recording, deg/s) or ``t0,t1,x_dps,y_dps,z_dps``, or a TOML file with a
    ``[[segment]]`` of these fields for each.

    Raises
    ------
    InputError
        Naming the file, the segment and the field that is wrong.
    """
    data = read_small(path, MAXIMUM_BYTES, what="a table of rates")
    rows: Sequence[Mapping[str, Any]]
    if path.suffix.lower() == ".toml":
        segments = parse_toml(data, str(path)).get("segment")
        if not isinstance(segments, list) or not all(isinstance(s, dict) for s in segments):
            raise InputError(f"{path} holds no [[segment]] with {_FORMAT}")
        rows = segments
    else:
        text = data.decode("utf-8-sig", errors="replace")
        lines = [line for line in text.splitlines() if line.strip() and line[0] != "#"]
        try:
            rows = [_stripped(row) for row in csv.DictReader(io.StringIO("\n".join(lines)))]
        except csv.Error as error:
            raise InputError(f"{path} is no CSV table: {error}") from error
    if not rows:
        raise InputError(f"{path} holds no rates: give rows of {_FORMAT}")
    parsed = [_segment(f"{path}, segment {i}", row) for i, row in enumerate(rows, start=1)]
    t0, t1, rate = (np.array(column) for column in zip(*parsed, strict=True))
    try:
        return RateTable(t0, t1, rate * DEG)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _stripped(row: Mapping[str | None, Any]) -> dict[str, Any]:
    return {
        str(name).strip(): value.strip() if isinstance(value, str) else value
        for name, value in row.items()
    }


def _segment(where: str, row: Mapping[str, Any]) -> tuple[float, float, tuple[float, ...]]:
    t0, t1 = _number(where, row, "t0"), _number(where, row, "t1")
    if all(name in row for name in VECTOR):
        return t0, t1, tuple(_number(where, row, name) for name in VECTOR)
    rate = _number(where, row, "rate_dps")
    axis = str(row.get("axis", "")).lower()
    if axis.lstrip("+-") not in ("x", "y", "z") or len(axis) > 2:
        raise InputError(f"{where}: the axis is {axis[:20]!r}, not x, y, z, -x, -y or -z")
    rate = -rate if axis[0] == "-" else rate
    return t0, t1, tuple(rate if name == axis[-1] else 0.0 for name in "xyz")


def _number(where: str, row: Mapping[str, Any], name: str) -> float:
    value = row.get(name)
    if value is None:
        raise InputError(f"{where} has no {name}: give {_FORMAT}")
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, bool) or not math.isfinite(number):
        raise InputError(f"{where}: {name} is {str(value)[:20]!r}, which is no number")
    return number
