"""Positions by an optical system: text tables, C3D, and MATLAB files that have them beside the IMU.

A table has a time column or a rate, and x, y and z of a marker in metres or millimetres; where the
marker was lost stands nothing or NaN. Names like ``heel_x [mm]``, ``pos_z_m``, or a row of markers
above a row of axes say which columns and units; else options do.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line
from imu_rig.importing import c3d_points, pyshoe
from imu_rig.importing.column_map import (
    ColumnRef,
    Triad,
    locate,
    locate_triad,
    recognize_time,
    split_unit,
)
from imu_rig.importing.matlab_file import is_matlab_file, open_matlab
from imu_rig.importing.text_table import Form, detect_form, read_numbers
from imu_rig.importing.time_column import refuse_going_back
from imu_rig.importing.unit_text import find_unit, known_units, parse_unit
from imu_rig.reference.reference import Reference

Y_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From axes with y up to such with z up, keeping x and the hand."""
FARTHEST_M = 1e6
RATES_HZ = (1.0, 20_000.0)
MOST_SHOWN = 12
_POSITION = re.compile(
    r"^(?P<owner>.*?)[_ .:]*(?:pos(?:ition)?[_ .]*)?(?P<axis>[xyz])(?:[_ .](?P<unit>[a-z]+))?$",
    re.IGNORECASE,
)
_NO_POSITION = re.compile(
    r"(?:^|[_ .:])(?:q|quat\w*|rot\w*|euler|v|vel\w*|a|acc\w*|w|omega|gyr\w*|g|f|force|m|mag\w*"
    r"|mean|sigma)$",
    re.IGNORECASE,
)


def read_reference(
    path: Path | str,
    *,
    marker: str | None = None,
    columns: tuple[ColumnRef, ColumnRef, ColumnRef] | None = None,
    time: ColumnRef | None = None,
    unit: str | None = None,
    time_unit: str | None = None,
    rate_hz: float | None = None,
    y_up: bool | None = None,
) -> Reference:
    """Read where a marker was.

    Parameters
    ----------
    path : Path or str
        C3D, a MATLAB file of pyshoe, or a text table.
    marker : str, optional
        Which marker; needed where there are several.
    columns : three of str or int, optional
        Columns of x, y and z of a table by name or number from 1; a leading minus turns the sign.
    time, time_unit : optional
        Time column of a table and its unit; recognized where not given.
    unit : str, optional
        ``m``, ``cm`` or ``mm``; what the file states where not given.
    rate_hz : float, optional
        Of a table without time column.
    y_up : bool, optional
        Whether y points up; what a C3D file says where not given, else z points up.

    Returns
    -------
    Reference
        Positions [m], z up, in the hand of the file; NaN where the marker was lost.

    Raises
    ------
    InputError
        One sentence that names file, line and column, and what to do.
    """
    source = Path(path)
    if not source.is_file():
        problem = "is not a file" if source.exists() else "does not exist"
        raise InputError(f"{source} {problem}")
    if is_matlab_file(source):
        return _from_matlab(source)
    if c3d_points.is_c3d(source):
        return _from_c3d(source, marker, unit, y_up)
    form = _with_owners(detect_form(source, fewest=1))  # where it was lost, time stands alone
    names = form.names
    try:
        triad = _position_columns(source, form, marker, columns)
        index, stated = _time_column(form, time)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    places = read_numbers(source, form, triad.indices, gaps=True) * np.array(triad.signs)
    t = _times(source, form, index, time_unit or stated, rate_hz, len(places))
    factor = _length_factor(source, unit or triad.unit, places)
    places = places * factor
    shown = ", ".join(names[i] for i in triad.indices) if names else str(triad.indices)
    return _made(source, t, places, bool(y_up), f"columns {one_line(shown)} of a table")


def _from_matlab(source: Path) -> Reference:
    file = open_matlab(source)
    if pyshoe.matches(file):
        reference = pyshoe.load(file).reference
        if reference is not None:
            return reference
    raise InputError(
        f"{source} is a MATLAB file without optical positions that are known: pyshoe's have imu, "
        "ts and gt; save others as CSV with time, x, y and z"
    )


def _from_c3d(source: Path, marker: str | None, unit: str | None, y_up: bool | None) -> Reference:
    file = c3d_points.open_c3d(source)
    index = c3d_points.find_marker(file, marker)
    stated = unit or file.unit
    places = c3d_points.read_marker(file, index)
    factor = _length_factor(source, stated, places)
    up = file.up.lstrip("+") == "Y" if y_up is None else y_up
    about = f"marker {one_line(file.labels[index])} of a C3D file"
    return _made(source, file.times, places * factor, up, about)


def _made(source: Path, t: FloatArray, places: FloatArray, y_up: bool, about: str) -> Reference:
    places = np.where(np.all(np.isfinite(places), axis=1, keepdims=True), places, np.nan)
    if not np.any(np.isfinite(places)):
        raise InputError(f"{source}: the marker was never seen; choose another")
    far = np.flatnonzero(np.any(np.abs(places) > FARTHEST_M, axis=1))
    if len(far):
        raise InputError(
            f"{source}: at {t[far[0]]:.3f} s the marker is farther away than anybody walks; check "
            "columns and unit"
        )
    if y_up:
        places, about = places @ Y_TO_Z_UP.T, f"{about}, turned from y up to z up"
    return Reference(t, position=places, frame=about)


def _with_owners(form: Form) -> Form:
    """Put the names of markers in a row above before the names of their axes."""
    if form.names is None or not form.preamble:
        return form
    owners = form.split(form.preamble[-1])
    if len(owners) != len(form.names) or len(set(form.names)) == len(form.names):
        return form
    return replace(
        form,
        names=tuple(f"{a}_{b}".strip("_") for a, b in zip(owners, form.names, strict=True)),
    )


def _position_columns(
    source: Path, form: Form, marker: str | None, columns: Sequence[ColumnRef] | None
) -> Triad:
    if columns is not None:
        return locate_triad(columns, form.names, form.columns)
    if form.names is None:
        if form.columns == 4:
            return Triad((1, 2, 3), (1.0, 1.0, 1.0))
        raise InputError(
            f"it has {form.columns} columns of numbers without names: say which are x, y and z"
        )
    found = _triads(form.names)
    if marker is not None:
        same = [t for owner, t in found.items() if owner.lower() == marker.lower()]
        if len(same) == 1:
            return same[0]
        raise InputError(f"there is no marker {marker!r}; there are {_listed(found)}")
    if len(found) == 1:
        return next(iter(found.values()))
    if "" in found:
        return found[""]
    if found:
        raise InputError(f"there are {len(found)} markers: say which of {_listed(found)}")
    raise InputError(
        f"none of its columns ({one_line(', '.join(form.names), 120)}) is recognized as a "
        "position: say which are x, y and z"
    )


def _triads(names: Sequence[str]) -> dict[str, Triad]:
    """Columns of x, y and z by the marker that owns them."""
    sets: dict[str, dict[str, tuple[int, str | None]]] = {}
    for index, name in enumerate(names):
        bare, unit = split_unit(name)
        match = _POSITION.match(bare)
        if match is None or _NO_POSITION.search(match["owner"]):
            continue
        suffix = match["unit"]
        if suffix is not None:
            if find_unit(suffix, "length") is None:
                continue
            unit = unit or suffix
        if unit is not None and find_unit(unit, "length") is None:
            continue
        sets.setdefault(match["owner"], {}).setdefault(match["axis"].lower(), (index, unit))
    triads = {}
    for owner, axes in sets.items():
        units = {unit for _, unit in axes.values()}
        if len(axes) == 3 and len(units) == 1:
            x, y, z = (axes[axis][0] for axis in "xyz")
            triads[owner] = Triad((x, y, z), (1.0, 1.0, 1.0), units.pop())
    return triads


def _listed(found: dict[str, Triad]) -> str:
    names = [one_line(owner) or "(no name)" for owner in found]
    more = f" and {len(names) - MOST_SHOWN} more" if len(names) > MOST_SHOWN else ""
    return ", ".join(names[:MOST_SHOWN]) + more


def _time_column(form: Form, time: ColumnRef | None) -> tuple[int | None, str | None]:
    if time is not None:
        index, sign = locate(time, form.names, form.columns)
        if sign < 0:
            raise InputError("time cannot be turned in sign")
        named = recognize_time((form.names[index],)) if form.names else None
        return index, named[1] if named else None
    if form.names is None:
        return (0, None) if form.columns == 4 else (None, None)
    found = recognize_time(form.names)
    return (None, None) if found is None else found


def _times(
    source: Path,
    form: Form,
    index: int | None,
    unit: str | None,
    rate_hz: float | None,
    count: int,
) -> FloatArray:
    if index is None:
        if rate_hz is None or not rate_hz > 0.0:
            raise InputError(
                f"{source} has no time column that is recognized: state its rate in Hz, or the "
                "column"
            )
        return np.arange(count) / rate_hz
    column = read_numbers(source, form, [index])[:, 0]
    refuse_going_back(source, form, column)
    step = float(np.median(np.diff(column))) if len(column) > 1 else 0.0
    if unit is not None:
        try:
            factor = parse_unit(unit, "time")
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
    else:
        # ranges of the usual units do not overlap between 1 and 1000 Hz
        fits = [f for f in (1.0, 1e-3, 1e-6, 1e-9) if 1e-3 <= step * f <= 1.0]
        if not fits:
            raise InputError(
                f"{source}: its time column steps by {step:g}, which fits no unit: state s, ms, "
                "us or ns"
            )
        factor = fits[0]
    if not step > 0.0 or not RATES_HZ[0] <= 1.0 / (step * factor) <= RATES_HZ[1]:
        raise InputError(
            f"{source}: its time column steps by {step * factor:.3g} s: state the right unit of "
            "time, or the column"
        )
    return np.asarray(column * factor)


def _length_factor(source: Path, unit: str | None, places: FloatArray) -> float:
    """Return the factor from a unit to metres; a unit that nobody stated is not guessed."""
    if unit:
        try:
            return parse_unit(unit, "length")
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
    known = places[np.all(np.isfinite(places), axis=1)]
    spans = float(np.max(np.ptp(known, axis=0))) if len(known) else 0.0
    guess = "mm" if spans > 200.0 else "m"
    raise InputError(
        f"{source} does not state the unit of its positions, which span {spans:.4g}: state "
        f"{known_units('length')} (it reads like {guess})"
    )
