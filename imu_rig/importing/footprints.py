"""Footprints that were measured by hand, from a table or a MATLAB file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import InputError
from imu_rig.importing.column_map import split_unit
from imu_rig.importing.matlab_file import (
    MatlabFile,
    is_matlab_file,
    open_matlab,
    read_matrices,
    require_finite,
)
from imu_rig.importing.text_table import detect_form, read_numbers
from imu_rig.importing.unit_text import find_unit, parse_unit
from imu_rig.reference.footprints import Footprints

MATRIX = "GCP_meters"
LONGEST_STRIDE_M = 5.5
"""The best sprinters' strides measure 5 m: what is longer is in another unit, or lacks a print."""
MOST = 100_000


def read_footprints(path: Path | str, *, unit: str | None = None) -> Footprints:
    """Read where one foot came down.

    A table has a row for each footprint in order, with columns x, y and, if heights were measured,
    z; without names the first two or three columns are taken. The unit is metres where neither a
    header such as ``x [mm]`` nor ``unit`` says otherwise. A MATLAB file has them as the matrix
    ``GCP_meters``, a row each.

    Raises
    ------
    InputError
        One sentence that names what is wrong, also for strides that nobody takes.
    """
    source = Path(path)
    if not source.is_file():
        problem = "is not a file" if source.exists() else "does not exist"
        raise InputError(f"{source} {problem}")
    if is_matlab_file(source):
        places = _from_matlab(open_matlab(source))
    else:
        places = _from_table(source, unit)
    if not 2 <= len(places) <= MOST:
        raise InputError(f"{source} holds {len(places)} footprints; 2 or more are compared")
    prints = Footprints(places)
    longest = int(np.argmax(prints.stride_lengths))
    length = float(prints.stride_lengths[longest])
    if not length <= LONGEST_STRIDE_M:
        raise InputError(
            f"{source}: from footprint {longest + 1} to {longest + 2} it is {length:.4g} m, more "
            "than anybody strides: check the unit, or whether a footprint is missing"
        )
    return prints


def _from_matlab(file: MatlabFile) -> FloatArray:
    if MATRIX not in file.shapes:
        raise InputError(f"{file.path} has no matrix {MATRIX} of footprints")
    columns = file.shapes[MATRIX][-1] if len(file.shapes[MATRIX]) == 2 else 0
    places = read_matrices(file, {MATRIX: 3 if columns == 3 else 2})[MATRIX]
    require_finite(file.path, MATRIX, places)
    return places


def _from_table(source: Path, unit: str | None) -> FloatArray:
    form = detect_form(source, fewest=2)
    indices, stated = list(range(min(form.columns, 3))), None
    if form.names is not None:
        named = [_axis(name) for name in form.names]
        axes = [axis for axis, _ in named]
        if "x" not in axes or "y" not in axes:
            raise InputError(
                f"{source}: none of its columns ({', '.join(form.names)[:120]}) are x and y of "
                "footprints"
            )
        indices = [axes.index(axis) for axis in "xyz" if axis in axes]
        units = {named[i][1] for i in indices}
        if len(units) > 1:
            raise InputError(f"{source}: its columns state different units; state one of them")
        stated = units.pop()
    elif form.columns > 3:
        raise InputError(
            f"{source} has {form.columns} columns without names: name those of x and y in a header"
        )
    try:
        factor = parse_unit(unit or stated or "m", "length")
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    return np.asarray(read_numbers(source, form, indices) * factor)


def _axis(name: str) -> tuple[str, str | None]:
    """Return the axis that a column's name tells, or nothing, and its unit."""
    bare, unit = split_unit(name)
    axis, _, suffix = bare.lower().partition("_")
    if suffix and find_unit(suffix, "length") is None:
        return "", None
    return (axis, unit or suffix or None) if axis in ("x", "y", "z") else ("", None)
