"""The formats that are read, told apart by what a file holds and never by its name alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from imu_rig.blocks import ImuBlock
from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line
from imu_rig.importing import broad, pyshoe, tables, xio, xsens
from imu_rig.importing.column_map import ColumnMap
from imu_rig.importing.foreign import ForeignRecording
from imu_rig.importing.guess import refuse_contradiction
from imu_rig.importing.matlab_file import (
    MatlabFile,
    begins_with,
    is_matlab_file,
    open_matlab,
)
from imu_rig.importing.read_table import read_table
from imu_rig.importing.read_table import stated_units as read_table_units
from imu_rig.importing.unit_text import Kind
from imu_rig.recording.format import MAGIC as FILE_MAGIC

TABLE = tables.NAME
FORMATS: dict[str, str] = {
    TABLE: "CSV or white-space text, with a column map where its header does not say enough",
    xsens.NAME: "Xsens MT Manager text (MTw, MTi) and DOT CSV",
    xio.X_IMU3: "x-IMU3 CSV: Inertial.csv, the folder of a device, or the folder of a session",
    xio.NGIMU: "NGIMU CSV: sensors.csv, the folder of a device, or the folder of a session",
    broad.NAME: "BROAD trial (.mat) with optical orientation",
    pyshoe.NAME: "pyshoe trial (.mat) with motion capture of the foot",
}
"""Name of each format to what it is."""

_MATLAB: dict[
    str,
    tuple[Callable[[MatlabFile], bool], Callable[[MatlabFile], ForeignRecording]],
] = {
    broad.NAME: (broad.matches, broad.load),
    pyshoe.NAME: (pyshoe.matches, pyshoe.load),
}


def recognize(path: Path | str) -> str:
    """Return the name of a recording's format, by its content.

    Raises
    ------
    InputError
        No such file, or nothing that is read; what a text holds is left to its reader.
    """
    source = Path(path)
    if source.is_dir():
        if xio.matches(source):
            return xio.made_by(source)
        raise InputError(
            f"{source} is a folder without CSV files of an x-IMU3 or NGIMU: name a file"
        )
    if not source.is_file():
        problem = "is not a file" if source.exists() else "does not exist"
        raise InputError(f"{source} {problem}")
    if begins_with(source, FILE_MAGIC):
        raise InputError(f"{source} is a trial file of imu-rig already: nothing is to be imported")
    if is_matlab_file(source):
        file = open_matlab(source)
        for name, (matches, _) in _MATLAB.items():
            if matches(file):
                return name
        raise InputError(
            f"{source} is a MATLAB file, but of no kind that is read: BROAD has imu_acc, imu_gyr "
            f"and sampling_rate, pyshoe imu and ts; this has {_shown(file)}"
        )
    if xsens.matches(source):
        return xsens.NAME
    if xio.matches(source):
        return xio.made_by(source)
    return TABLE


def load_foreign(
    path: Path | str,
    format: str | None = None,  # noqa: A002
    columns: ColumnMap | None = None,
) -> ForeignRecording:
    """Read a recording of another program.

    Parameters
    ----------
    path : Path or str
        A file; for x-IMU3 and NGIMU also the folder of a device or session.
    format : str, optional
        One of `FORMATS`; recognized where not given. A map that names columns makes a text file
        a table.
    columns : ColumnMap, optional
        What is known of a table's columns; of other formats the rate and the units that a file
        does not state.

    Raises
    ------
    InputError
        One sentence that names file, line and column or matrix, and what to do.
    """
    source, stated = Path(path), columns or ColumnMap()
    name = _format_of(source, format, stated)
    if name == TABLE:
        return tables.load(source, stated)
    if name != xsens.NAME and stated != ColumnMap():
        raise InputError(
            f"{source} is read as {name}, which states its columns, units and rate: leave those "
            "options out"
        )
    if name in _MATLAB:
        file = open_matlab(source)
        matches, load = _MATLAB[name]
        if not matches(file):
            raise InputError(f"{source} is no {name} trial: it has {_shown(file)}")
        recording = load(file)
    elif name == xsens.NAME:
        recording = xsens.load(source, stated)
    else:
        recording = xio.load(source)
    units: dict[Kind, str | None] = {"accel": "m/s2", "gyro": "rad/s"}
    for stream, samples in recording.streams.items():
        if samples.is_inertial and "accel" in samples.values:
            shown = str(source) if len(recording.sensors) == 1 else f"{source} ({stream})"
            refuse_contradiction(shown, recording.imu(stream), units)
    return recording


def read_imu(
    path: Path | str, columns: ColumnMap | None = None, sensor: str | None = None
) -> ImuBlock:
    """Read the samples of a recording's only sensor, or of the one that is named.

    Raises
    ------
    InputError
        As of `load_foreign`, or several sensors to choose from.
    """
    if sensor is None and is_table(path, columns):
        return read_table(path, columns)
    return load_foreign(path, columns=columns).imu(sensor)


def stated_units(path: Path | str, columns: ColumnMap | None = None) -> dict[Kind, str]:
    """Return the units that a table or its map states; other formats are read into SI units."""
    if is_table(path, columns):
        return read_table_units(path, columns)
    return {}


def files_of(folder: Path) -> list[Path]:
    """Return the files of a folder that can be a recording."""
    return xio.files(folder)


def is_table(path: Path | str, columns: ColumnMap | None = None) -> bool:
    """Whether a recording is a plain table with the columns of one sensor."""
    stated = columns or ColumnMap()
    return not stated.sensors and _format_of(Path(path), None, stated) == TABLE


def _format_of(source: Path, wanted: str | None, stated: ColumnMap) -> str:
    if wanted is not None:
        if wanted not in FORMATS:
            raise InputError(f"{wanted!r} is no format that is read: {', '.join(FORMATS)}")
        return wanted
    if stated.names_columns:
        return TABLE
    found = recognize(source)
    if found in (xio.X_IMU3, xio.NGIMU) and source.is_file() and stated != ColumnMap():
        return TABLE  # somebody knows better than its header
    return found


def _shown(file: MatlabFile) -> str:
    return one_line(", ".join((*file.shapes, *file.others)), 120) or "nothing"
