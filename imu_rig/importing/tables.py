"""Text tables of any logger as recordings, also with several sensors side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imu_rig.errors import InputError
from imu_rig.importing.column_map import (
    ColumnMap,
    SensorColumns,
    recognize_sets,
)
from imu_rig.importing.foreign import ForeignRecording, block_samples
from imu_rig.importing.read_table import read_table
from imu_rig.importing.text_table import Form, detect_form
from imu_rig.importing.unit_text import Kind

NAME = "table"
KINDS: tuple[Kind, ...] = ("accel", "gyro", "mag")


def load(path: Path, columns: ColumnMap) -> ForeignRecording:
    """Read a table; several sensors are stated by the map, or told apart by their names.

    Names tell them apart by a first header row that names the sensor of every column, or by what
    they begin with: ``left_acc_x``, ``right_acc_x``.
    """
    found = columns
    if not columns.sensors and columns.accel is None:
        sensors = find_sensors(path, columns)
        if len(sensors) > 1:
            found = columns.model_copy(update={"sensors": sensors})
    if not found.sensors:
        maps = {path.stem: found}
    else:
        maps = {name: found.of_sensor(name) for name in found.sensors}
    streams = {}
    notes = []
    for name, one in maps.items():
        try:
            block = read_table(path, one)
        except InputError as error:
            raise (InputError(f"{name}: {error}") if len(maps) > 1 else error) from error
        without = not np.any(block.gyro)
        streams[name] = block_samples(block, without_gyro=without)
        if without:
            notes.append(f"{name} has no gyroscope")
    return ForeignRecording(NAME, (path,), streams, notes=tuple(notes))


def find_sensors(path: Path, columns: ColumnMap) -> dict[str, SensorColumns]:
    """Tell several sensors apart by the names of their columns; empty where there is one or none.

    Raises
    ------
    InputError
        If it is no table.
    """
    form = detect_form(
        path, delimiter=columns.delimiter, decimal=columns.decimal, skip_rows=columns.skip_rows
    )
    names = columns.columns or form.names
    if names is None:
        return {}
    found = _by_first_row(form, names) or _by_prefix(names)
    return found if len(found) > 1 else {}


def _by_first_row(form: Form, names: tuple[str, ...]) -> dict[str, SensorColumns]:
    """Sensors that the row above the names tells, one name for each column."""
    if not form.preamble:
        return {}
    owners = form.split(form.preamble[-1])
    if len(owners) != len(names) or len(set(names)) == len(names):
        return {}
    found = {}
    for owner in dict.fromkeys(owners):
        mine = [i for i, other in enumerate(owners) if other == owner]
        triads = {}
        for kind in KINDS:
            sets = recognize_sets([names[i] for i in mine], kind)
            if len(sets) == 1:
                triads[kind] = [mine[i] + 1 for i in next(iter(sets.values())).indices]
        if owner and "accel" in triads:
            found[owner] = _sensor(triads)
    return found


def _by_prefix(names: tuple[str, ...]) -> dict[str, SensorColumns]:
    """Sensors whose columns begin alike."""
    triads: dict[str, dict[Kind, list[int]]] = {}
    for kind in KINDS:
        for (prefix, twin), triad in recognize_sets(names, kind).items():
            if twin or not prefix.strip("_"):
                return {}
            triads.setdefault(prefix.strip("_"), {})[kind] = [i + 1 for i in triad.indices]
    if any("accel" not in kinds for kinds in triads.values()):
        return {}
    return {prefix: _sensor(kinds) for prefix, kinds in triads.items()}


def _sensor(triads: dict[Kind, list[int]]) -> SensorColumns:
    return SensorColumns.model_validate(triads)
