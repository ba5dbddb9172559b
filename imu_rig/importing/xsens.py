"""Xsens text: what MT Manager and the DOT app write, one sensor per file.

A preamble of ``//`` lines, a header with names such as ``PacketCounter`` and ``Acc_X``, and a row
for each packet. Packets that the radio lost are missing, or stand there without numbers. Row
number is never time: the counter, or the finer ``SampleTimeFine``, is.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.blocks import Samples
from imu_rig.clock import NS_PER_S
from imu_rig.errors import InputError
from imu_rig.importing.column_map import ColumnMap
from imu_rig.importing.foreign import ForeignRecording, SharedClock
from imu_rig.importing.read_table import LARGEST
from imu_rig.importing.text_table import (
    Form,
    detect_form,
    first_lines,
    line_of_row,
    read_numbers,
)
from imu_rig.importing.unit_text import parse_unit

NAME = "xsens"
COUNTER, CLOCK = "PacketCounter", "SampleTimeFine"
HEAD_LINES = 200
"""Lines among which the header is looked for."""
COUNTER_BITS = (16, 32)
WHERE_COUNTS_END = 1 << 32
FEWEST_PACKETS = 2
MT_TICK_S, DOT_TICK_S = 1e-4, 1e-6
USUAL_RATES_HZ = (2.0, 2_000.0)
RATE_AGREES = 0.1
_RATE = re.compile(
    r"(?:update rate|output ?rate|acquisition frequency|sampl\w* (?:rate|frequency))"
    r"[^0-9]{0,10}([0-9.]+)",
    re.IGNORECASE,
)
_DEVICE = re.compile(r"(?:DeviceId|Device ?Tag)[\s:,]+([\w-]{1,40})", re.IGNORECASE)
_VECTORS: dict[str, tuple[tuple[str, ...], str]] = {
    "accel": (("Acc_X", "Acc_Y", "Acc_Z"), "m/s2"),
    "gyro": (("Gyr_X", "Gyr_Y", "Gyr_Z"), "rad/s"),
    "mag_normalized": (("Mag_X", "Mag_Y", "Mag_Z"), "a.u."),
    "velocity_increment": (("VelInc_X", "VelInc_Y", "VelInc_Z"), "m/s"),
    "orientation_increment": (tuple(f"OriInc_q{i}" for i in range(4)), ""),
    "orientation": (tuple(f"Quat_q{i}" for i in range(4)), ""),
    "rotation_matrix": (tuple(f"Mat[{i}][{j}]" for i in (1, 2, 3) for j in (1, 2, 3)), ""),
    "roll_pitch_yaw": (("Roll", "Pitch", "Yaw"), "deg"),
    "temperature": (("Temperature",), "degC"),
    "pressure": (("Pressure",), "Pa"),
}
"""Fields by their columns and unit; the DOT app writes some under other names."""
_OTHER_NAMES = {
    "Quat_W": "Quat_q0",
    "Quat_X": "Quat_q1",
    "Quat_Y": "Quat_q2",
    "Quat_Z": "Quat_q3",
    "Euler_X": "Roll",
    "Euler_Y": "Pitch",
    "Euler_Z": "Yaw",
}
_MEASURED = ("accel", "gyro", "mag_normalized")
_OWN_FILTER = ("orientation", "rotation_matrix", "roll_pitch_yaw")


def matches(path: Path) -> bool:
    """Whether a text file has the header of such an export."""
    lines = first_lines(path)[:HEAD_LINES]
    rated = any(_RATE.search(line) for line in lines if line.startswith("//"))
    for line in lines:
        fields = set(re.split(r"[\t,; ]+", line.strip()))
        if {"Acc_X", "Gyr_X"} & fields and (rated or {COUNTER, CLOCK} & fields):
            return True
    return False


def load(path: Path, columns: ColumnMap) -> ForeignRecording:
    """Read a file; of ``columns`` the rate and the units count where the file states none."""
    form = detect_form(path)
    if form.names is None:
        raise InputError(
            f"{path}: its rows have {form.columns} columns, its header another number; export it "
            "anew"
        )
    names = [_OTHER_NAMES.get(name, name) for name in form.names]
    head = first_lines(path)[: form.first_line]
    fields = {
        name: ([names.index(c) for c in needed], unit)
        for name, (needed, unit) in _VECTORS.items()
        if all(c in names for c in needed)
    }
    timing = {name: names.index(name) for name in (COUNTER, CLOCK) if name in names}
    wanted = sorted({*timing.values(), *(i for found, _ in fields.values() for i in found)})
    numbers = read_numbers(path, form, wanted, gaps=True)
    place = {index: i for i, index in enumerate(wanted)}
    table = {name: numbers[:, [place[i] for i in found]] for name, (found, _) in fields.items()}
    table = {name: rows for name, rows in table.items() if not np.all(np.isnan(rows))}
    if "accel" not in table and "gyro" not in table:
        raise InputError(
            f"{path} holds no numbers under Acc_X, Acc_Y, Acc_Z or Gyr_X, Gyr_Y, Gyr_Z"
        )
    rows = _rows_with_numbers(path, form, table)
    ticks = {
        name: whole
        for name, index in timing.items()
        if (whole := _whole(path, form, name, numbers[rows, place[index]], rows)) is not None
    }
    timed = _timed(path, form, ticks, _stated_rate(path, head, columns), rows)
    notes: list[str] = []
    if not ticks:
        notes.append("it has no packet counter, so lost packets cannot be seen: time is row number")
    if without := len(numbers) - len(rows):
        notes.append(f"{without} rows without numbers stand for packets that the radio lost")
    units = {name: _VECTORS[name][1] for name in table}
    values = {name: found[rows] for name, found in table.items()}
    _refuse_enormous(path, form, values, rows)
    _scale(values, units, columns, dot=timed.dot, notes=notes)
    for name in ("temperature", "pressure"):
        if name in values:
            values[name] = values[name][:, 0]
    own = [name.replace("_", " ") for name in _OWN_FILTER if name in values]
    if own:
        notes.append(f"the {' and '.join(own)} is by the sensor's own filter: no reference")
    t = timed.t
    samples = Samples(t, t, t if ticks else None, timed.counter, values, units)
    return ForeignRecording(
        format=NAME,
        files=(path,),
        streams={_device(head) or path.stem: samples},
        notes=tuple(notes),
        start_utc_ns=_start_utc(path, form),
        clock=timed.clock,
    )


@dataclass(frozen=True)
class _Timed:
    """When the packets were measured.

    Attributes
    ----------
    t : shape (n,)
        From the first packet on [s].
    counter : shape (n,) or None
        Unwrapped packet counter.
    clock : SharedClock or None
        The packet counter as a clock that the sensors of one station share.
    dot : bool
        Whether the clock is that of a Movella DOT, which has other units.
    """

    t: FloatArray
    counter: IntArray | None
    clock: SharedClock | None
    dot: bool


def _rows_with_numbers(path: Path, form: Form, table: Mapping[str, FloatArray]) -> IntArray:
    """Return the rows that hold a packet; one that holds half of it is refused."""
    measured = np.concatenate([table[name] for name in _MEASURED if name in table], axis=1)
    absent = np.isnan(measured)
    whole = ~np.all(absent, axis=1)
    torn = np.flatnonzero(whole & np.any(absent, axis=1))
    if len(torn):
        raise InputError(
            f"{path}, line {line_of_row(path, form, int(torn[0]))}: some of its readings are "
            "missing; correct or delete the line"
        )
    if np.count_nonzero(whole) < FEWEST_PACKETS:
        raise InputError(f"{path} holds fewer than {FEWEST_PACKETS} packets")
    return np.flatnonzero(whole)


def _refuse_enormous(
    path: Path, form: Form, values: Mapping[str, FloatArray], rows: IntArray
) -> None:
    """Refuse what would overflow, by the line it is in."""
    for name, numbers in values.items():
        wrong = np.flatnonzero(np.any(np.abs(numbers) > LARGEST, axis=1))
        if len(wrong):
            raise InputError(
                f"{path}, line {line_of_row(path, form, int(rows[wrong[0]]))}: its "
                f"{name.replace('_', ' ')} is no sensor's; correct or delete the line"
            )


def _whole(
    path: Path, form: Form, name: str, column: FloatArray, rows: IntArray
) -> IntArray | None:
    """Return a column of counts as integers; None where it stands empty."""
    if np.all(np.isnan(column)):
        return None
    usable = (column == np.rint(column)) & (column >= 0) & (column < WHERE_COUNTS_END)
    wrong = np.flatnonzero(~usable)
    if len(wrong):
        at = int(wrong[0])
        raise InputError(
            f"{path}, line {line_of_row(path, form, int(rows[at]))}: {name} is {column[at]:.10g}, "
            "which is no count; correct or delete the line"
        )
    return column.astype(np.int64)


def _unwrapped(
    path: Path, form: Form, name: str, counts: IntArray, rows: IntArray
) -> tuple[IntArray, int]:
    """Return counts continued where they began at 0 again, and where they do.

    Raises
    ------
    InputError
        Counts that come twice or go back.
    """
    bits = next(b for b in COUNTER_BITS if int(counts.max()) < 1 << b)
    modulus = 1 << (32 if name == CLOCK else bits)
    steps = np.diff(counts)
    wrapped = (steps < 0) & (steps + modulus < modulus // 4)
    steps = steps + modulus * wrapped
    wrong = np.flatnonzero(steps <= 0)
    if len(wrong):
        at = int(wrong[0]) + 1
        how = "comes twice" if counts[at] == counts[at - 1] else f"follows {counts[at - 1]}"
        raise InputError(
            f"{path}, line {line_of_row(path, form, int(rows[at]))}: {name} {counts[at]} {how}; "
            "cut the file there or sort its rows"
        )
    return np.concatenate((counts[:1], counts[0] + np.cumsum(steps))), modulus


def _timed(
    path: Path, form: Form, ticks: Mapping[str, IntArray], rate: float | None, rows: IntArray
) -> _Timed:
    if not ticks:
        if rate is None:
            raise InputError(f"{path} states neither time nor rate: give its rate with --rate HZ")
        return _Timed(np.arange(len(rows)) / rate, None, None, dot=False)
    counter, modulus = None, 0
    if COUNTER in ticks:
        counter, modulus = _unwrapped(path, form, COUNTER, ticks[COUNTER], rows)
    if CLOCK in ticks:
        stamps, _ = _unwrapped(path, form, CLOCK, ticks[CLOCK], rows)
        steps = np.diff(stamps) / (1 if counter is None else np.diff(counter))
        tick_s = _tick_s(path, float(np.median(steps)), rate)
        t = (stamps - stamps[0]) * tick_s
        rate = rate or 1.0 / (float(np.median(steps)) * tick_s)
        dot = tick_s == DOT_TICK_S
    elif rate is not None and counter is not None:
        t, dot = (counter - counter[0]) / rate, False
    else:
        raise InputError(
            f"{path} counts packets, but does not say how many come in a second: give its rate "
            "with --rate HZ"
        )
    clock = None
    if counter is not None:
        clock = SharedClock(f"{COUNTER} at {rate:.4g} Hz", float(counter[0]) / rate, modulus / rate)
    return _Timed(t, counter, clock, dot)


def _tick_s(path: Path, step: float, rate: float | None) -> float:
    """Tick of the clock, by what it advances from packet to packet [s]."""
    for tick_s in (MT_TICK_S, DOT_TICK_S):
        measured = 1.0 / (step * tick_s)
        if rate is None and USUAL_RATES_HZ[0] <= measured <= USUAL_RATES_HZ[1]:
            return tick_s
        if rate is not None and abs(measured / rate - 1.0) < RATE_AGREES:
            return tick_s
    stated = "which is no usual rate" if rate is None else f"not the stated rate of {rate:g} Hz"
    raise InputError(
        f"{path}: {CLOCK} advances by {step:g} from packet to packet, {stated}: correct the rate, "
        "or empty the column to go by the counter"
    )


def _stated_rate(path: Path, head: list[str], columns: ColumnMap) -> float | None:
    found = next((m[1] for line in head if (m := _RATE.search(line))), None)
    try:
        stated = None if found is None else float(found)
    except ValueError:
        stated = None
    if stated is not None and not USUAL_RATES_HZ[0] <= stated <= USUAL_RATES_HZ[1]:
        stated = None
    given = columns.rate_hz
    if given is not None and stated is not None and abs(given / stated - 1.0) > RATE_AGREES:
        raise InputError(
            f"{path} states a rate of {stated:g} Hz, the options {given:g} Hz: leave out the rate"
        )
    return stated or given


def _scale(
    values: dict[str, FloatArray],
    units: dict[str, str],
    columns: ColumnMap,
    *,
    dot: bool,
    notes: list[str],
) -> None:
    """Bring the readings to SI units, by what the format says or the options state."""
    if columns.accel_unit is not None and "accel" in values:
        values["accel"] = values["accel"] * parse_unit(columns.accel_unit, "accel")
    gyro_unit = columns.gyro_unit or ("deg/s" if dot else None)
    if gyro_unit is not None and "gyro" in values:
        values["gyro"] = values["gyro"] * parse_unit(gyro_unit, "gyro")
        if dot and columns.gyro_unit is None:
            notes.append("its clock ticks in microseconds: a DOT, whose rates are in deg/s")
    if "mag_normalized" not in values:
        return
    if columns.mag_unit is not None:
        values["mag"] = values.pop("mag_normalized") * parse_unit(columns.mag_unit, "mag")
        units["mag"] = "uT"
        del units["mag_normalized"]
    else:
        notes.append(
            "its magnetometer reads in units of the field where it was calibrated, kept as "
            'mag_normalized; --mag-unit (such as "0.02 LSB/uT") makes a field of it'
        )


def _device(head: list[str]) -> str | None:
    return next((m[1] for line in head if (m := _DEVICE.search(line))), None)


def _start_utc(path: Path, form: Form) -> int | None:
    """Wall clock of the first packet [ns since 1970 UTC], where the rows tell it."""
    names = list(form.names or ())
    needed = [f"UTC_{part}" for part in ("Year", "Month", "Day", "Hour", "Minute", "Second")]
    lines = first_lines(path)
    if not set(needed) <= set(names) or len(lines) <= form.first_line:
        return None
    fields = form.split(lines[form.first_line])
    try:
        year, month, day, hour, minute, second = (
            int(float(fields[names.index(name)])) for name in needed
        )
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except (ValueError, OverflowError, IndexError):
        return None
    nano = names.index("UTC_Nano") if "UTC_Nano" in names else None
    try:
        part = 0 if nano is None else int(float(fields[nano]))
    except (ValueError, OverflowError):
        part = 0
    return int(start.timestamp()) * NS_PER_S + part
