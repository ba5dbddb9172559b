"""CSV files of x-io's x-IMU3 and NGIMU: one file for each kind of message, in a folder per device.

Their headers state units, and the first column is time: ``Timestamp (us)`` of the x-IMU3,
``Time (s)`` of the NGIMU. Every file keeps its own rate and becomes a stream of its own.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import Samples
from imu_rig.errors import InputError
from imu_rig.importing.column_map import split_unit
from imu_rig.importing.foreign import ForeignRecording, SharedClock
from imu_rig.importing.read_table import LARGEST
from imu_rig.importing.text_table import detect_form, line_of_row, read_numbers
from imu_rig.importing.time_column import refuse_going_back, repeated_rows, spread_repeated
from imu_rig.importing.unit_text import Kind, find_unit

X_IMU3, NGIMU = "x-imu3", "ngimu"
TIME_COLUMNS = {"Timestamp (us)": X_IMU3, "Time (s)": NGIMU}
MOST_FILES = 200
"""Files of one folder; a trial has room for 255 sources."""
FEWEST_ROWS = 2
LONGEST_HEADER = 65_536
YEARS_NS = (2015, 2100)
EPOCH_S = tuple((year - 1970) * 31_556_952.0 for year in YEARS_NS)
"""Stamps between these [s] count from 1970; others from when the device was switched on."""
_SENSORS: dict[str, tuple[str, Kind]] = {
    "gyroscope": ("gyro", "gyro"),
    "accelerometer": ("accel", "accel"),
    "magnetometer": ("mag", "mag"),
}
_SI = {"gyro": "rad/s", "accel": "m/s2", "mag": "uT"}
_AXIS = re.compile(r"^(?:(.*)\s)?([WXYZ]|[XYZ]{2})(?:\s(?:Axis|Element))?$")
_WHOLE_SETS = ("X Y Z", "W X Y Z", "XX XY XZ YX YY YZ ZX ZY ZZ")


def matches(path: Path) -> bool:
    """Whether it is such a file with inertial readings, or a folder that holds such files."""
    if path.is_dir():
        return any(_time_column(file) for file in files(path))
    return _time_column(path) is not None and _is_inertial(path)


def made_by(path: Path) -> str:
    """Return which of the two devices wrote a file or folder that `matches`."""
    found = [path] if path.is_file() else files(path)
    return next(TIME_COLUMNS[name] for file in found if (name := _time_column(file)))


def load(path: Path) -> ForeignRecording:
    """Read a file, the folder of a device, or a folder with one for each device."""
    found = [path] if path.is_file() else [f for f in files(path) if _time_column(f)]
    several = len({file.parent for file in found}) > 1
    tables: dict[str, _Table] = {}
    notes: list[str] = []
    for file in found:
        try:
            table = _read(file)
        except InputError as error:
            if _is_inertial(file):
                raise
            notes.append(f"left out: {error}")
            continue
        tables[_stream_name(path, file, several=several)] = table
    if not tables:
        raise InputError(f"{path} holds no numbers of an x-IMU3 or NGIMU")
    kinds = {table.time_column for table in tables.values()}
    if len(kinds) > 1:
        raise InputError(f"{path} mixes files of an x-IMU3 and of an NGIMU: import them apart")
    time_column = kinds.pop()
    tick_s = 1.0 if time_column == "Time (s)" else 1e-6
    zero = min(float(table.stamps[0]) for table in tables.values())
    streams = {name: table.samples(zero, tick_s) for name, table in tables.items()}
    notes += [note for table in tables.values() for note in table.notes]
    since_1970 = EPOCH_S[0] < zero * tick_s < EPOCH_S[1]
    if since_1970:
        notes.append("its time stamps count from 1970, by the device's own clock")
    return ForeignRecording(
        format=TIME_COLUMNS[time_column],
        files=tuple(table.file for table in tables.values()),
        streams=streams,
        notes=tuple(notes),
        start_utc_ns=round(zero * tick_s * 1e6) * 1000 if since_1970 else None,
        clock=SharedClock("UTC of x-io devices", zero * tick_s) if since_1970 else None,
    )


@dataclass(frozen=True)
class _Table:
    """One file.

    Attributes
    ----------
    stamps : shape (n,)
        Time as it stands in the file, increasing.
    """

    file: Path
    time_column: str
    stamps: FloatArray
    values: dict[str, FloatArray]
    units: dict[str, str]
    notes: tuple[str, ...]

    def samples(self, zero: float, tick_s: float) -> Samples:
        """Return it with time from ``zero`` on; subtracted first, for stamps are huge."""
        t = (self.stamps - zero) * tick_s
        return Samples(t, t, t, None, self.values, self.units)


def files(folder: Path) -> list[Path]:
    """CSV files of a folder, or of the folders in it; links are not followed."""
    try:
        inside = sorted(p for p in folder.iterdir() if not p.is_symlink())
        found = [p for p in inside if p.suffix.lower() == ".csv" and p.is_file()]
        if not found:
            deeper = [q for p in inside if p.is_dir() for q in sorted(p.iterdir())]
            found = [
                q
                for q in deeper
                if q.suffix.lower() == ".csv" and q.is_file() and not q.is_symlink()
            ]
    except OSError as error:
        raise InputError(f"{folder} could not be read: {error.strerror}") from error
    if len(found) > MOST_FILES:
        raise InputError(f"{folder} holds more than {MOST_FILES} CSV files: name one session")
    return found


def _stream_name(path: Path, file: Path, *, several: bool) -> str:
    if path.is_file():
        return file.stem
    device = file.parent.name
    if _is_inertial(file):
        return device
    return f"{device} {file.stem}" if several else file.stem


def _is_inertial(file: Path) -> bool:
    return any(name.startswith(("Gyroscope X", "Accelerometer X")) for name in _header(file))


def _header(file: Path) -> list[str]:
    """Names of the first line; what is no text has none that are known."""
    try:
        with file.open("rb") as stream:
            first = stream.readline(LONGEST_HEADER)
    except OSError:
        return []
    text = first.decode("utf-8-sig", errors="replace")
    return [name.strip().strip('"') for name in text.split(",")]


def _time_column(file: Path) -> str | None:
    header = _header(file)
    return header[0] if len(header) > 1 and header[0] in TIME_COLUMNS else None


def _read(file: Path) -> _Table:
    form = detect_form(file, delimiter=",", decimal=".", fewest=2)
    names = form.names
    if names is None or names[0] not in TIME_COLUMNS:
        raise InputError(f"{file}: its header does not fit its {form.columns} columns of numbers")
    rows = read_numbers(file, form, range(form.columns))
    refuse_going_back(file, form, rows[:, 0])
    if enormous := np.argwhere(np.abs(rows[:, 1:]) > LARGEST).tolist():
        row, column = enormous[0]
        raise InputError(
            f"{file}, line {line_of_row(file, form, row)}: column {names[column + 1]} is "
            f"{rows[row, column + 1]:.3g}, which no sensor gives; correct or cut out the row"
        )
    notes: list[str] = []
    repeated = repeated_rows(rows)
    if np.any(repeated):
        rows = rows[~repeated]
        notes.append(
            f"{file.name} says {np.count_nonzero(repeated)} rows twice, time stamp and all: each "
            "is read once"
        )
    if len(rows) < FEWEST_ROWS:
        raise InputError(f"{file} holds fewer than {FEWEST_ROWS} rows of data")
    values, units = _fields(file, names, rows)
    stamps = spread_repeated(file, rows[:, 0])
    if len(stamps) != len(np.unique(rows[:, 0])):
        notes.append(f"{file.name} stamps some rows alike: they are spread over the time before")
    return _Table(file, names[0], stamps, values, units, tuple(notes))


def _fields(
    file: Path, names: tuple[str, ...], rows: FloatArray
) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Put the columns x, y and z (or w to z, or xx to zz) of one quantity together."""
    values: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    index = 1
    while index < len(names):
        count, quantity, unit = _quantity(file, names, index)
        numbers = rows[:, index] if count == 1 else rows[:, index : index + count]
        name = _field_name(quantity)
        if quantity.lower() in _SENSORS and count == 3:
            short, kind = _SENSORS[quantity.lower()]
            factor = find_unit(unit, kind)
            if factor is not None:
                name, unit, numbers = short, _SI[short], numbers * factor
        if unit in ("\N{DEGREE SIGN}C", "C"):
            unit = "degC"
        if name in values:
            raise InputError(f"{file} has two columns {names[index]!r}")
        values[name], units[name] = numbers, unit
        index += count
    return values, units


def _quantity(file: Path, names: tuple[str, ...], index: int) -> tuple[int, str, str]:
    """Count the columns from ``index`` on that are axes of one quantity; its name and unit."""
    bare, unit = split_unit(names[index])
    match = _AXIS.match(bare)
    for whole in _WHOLE_SETS if match else ():
        axes = whole.split()
        found = [_AXIS.match(split_unit(name)[0]) for name in names[index : index + len(axes)]]
        if [m[2] for m in found if m] == axes and len({m[1] for m in found if m}) == 1:
            return len(axes), (match[1] if match and match[1] else file.stem), unit or ""
    return 1, bare, unit or ""


def _field_name(quantity: str) -> str:
    """``Gyroscope And Accelerometer`` or ``EulerAngles`` as a word that a layout takes."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", quantity)
    word = re.sub(r"[^a-z0-9]+", "_", spaced.lower()).strip("_")
    return word[:40] if word[:1].isalpha() else f"column_{word}"[:40]
