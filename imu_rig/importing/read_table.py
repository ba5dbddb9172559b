"""A text table of a foreign logger, read into a block of samples in SI units."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import InputError
from imu_rig.importing.column_map import (
    SAMPLES,
    ColumnMap,
    Triad,
    locate,
    locate_triad,
    recognize,
    recognize_time,
    split_unit,
)
from imu_rig.importing.guess import guess_units, refuse_contradiction
from imu_rig.importing.text_table import Form, detect_form, line_of_row, read_numbers
from imu_rig.importing.time_column import refuse_going_back, spread_repeated
from imu_rig.importing.unit_text import Kind, parse_unit

RATE_AGREES = 0.1
"""How far a stated rate may be from that of the time column."""
_RATE_WORD = re.compile(r"\b(?:fs|odr|\w*rate|freq\w*)\b[^0-9]{0,20}[0-9]", re.IGNORECASE)
LARGEST = 1e12
"""No sensor's number is larger, be it counts or any unit."""
USUAL_RATES_HZ = (2.0, 20_000.0)


@dataclass(frozen=True)
class _Plan:
    """Which columns of a table are read as what."""

    form: Form
    accel: Triad
    gyro: Triad | None
    mag: Triad | None
    temperature: int | None
    time: int | None
    time_unit: str | None

    @property
    def wanted(self) -> list[int]:
        """Indices of the columns to read, in ascending order."""
        triads = [t.indices for t in (self.accel, self.gyro, self.mag) if t]
        single = [i for i in (self.temperature, self.time) if i is not None]
        return sorted({*single, *(i for indices in triads for i in indices)})


def read_table(
    path: Path | str, columns: ColumnMap | None = None, *, rows: IntArray | None = None
) -> ImuBlock:
    """Read a CSV or white-space text table.

    Preamble and comment lines, header, delimiter and decimal sign are recognized; what the
    columns mean comes from the map, else from their names. Counts and units become SI; a
    recording without a time column needs ``rate_hz`` and begins at 0 s. Samples that share a time
    stamp are spread over the time since the one before. A table without gyroscope has zeros there.

    Parameters
    ----------
    path : Path or str
        The file.
    columns : ColumnMap, optional
        What is known about the columns.
    rows : shape (n,), optional
        Order in which to take the rows of data.

    Raises
    ------
    InputError
        One sentence that names file, line and column, and what to do; where a unit is not
        stated, the guess and the option that states it.
    """
    source, stated = Path(path), columns or ColumnMap()
    form = detect_form(
        source,
        delimiter=stated.delimiter,
        decimal=stated.decimal,
        skip_rows=stated.skip_rows,
    )
    plan = _plan(source, form, stated)
    numbers = read_numbers(source, form, plan.wanted)
    _refuse_enormous(source, plan, numbers)
    if rows is not None:
        numbers = numbers[rows]
    place = {index: i for i, index in enumerate(plan.wanted)}

    def triad(found: Triad | None) -> FloatArray | None:
        if found is None:
            return None
        return _signed(numbers, place, found)

    accel = _signed(numbers, place, plan.accel)
    gyro, mag = triad(plan.gyro), triad(plan.mag)
    for found, values in ((plan.accel, accel), (plan.gyro, gyro), (plan.mag, mag)):
        if found is not None and values is not None:
            _refuse_constant(source, form, found, values)
    time = None if plan.time is None else numbers[:, place[plan.time]]
    t = _times(source, plan, stated, time, len(numbers))
    units = _units(source, plan, stated)
    if None in units.values():
        raise InputError(
            guess_units(str(source), t, {"accel": accel, "gyro": gyro, "mag": mag}, units)
        )
    factors = {kind: parse_unit(unit, kind) for kind, unit in units.items() if unit is not None}
    block = ImuBlock(
        t=t,
        accel=accel * factors["accel"],
        gyro=np.zeros_like(accel) if gyro is None else gyro * factors["gyro"],
        host_s=t,
        device_s=None if plan.time is None else t,
        mag=None if mag is None else mag * factors["mag"],
        temperature=None if plan.temperature is None else numbers[:, place[plan.temperature]],
    )
    refuse_contradiction(str(source), block, units)
    return block


def stated_units(path: Path | str, columns: ColumnMap | None = None) -> dict[Kind, str]:
    """Units of a table's sensors, as the map or its header states them.

    Raises
    ------
    InputError
        What `read_table` refuses before it reads any numbers.
    """
    source, stated = Path(path), columns or ColumnMap()
    form = detect_form(
        source,
        delimiter=stated.delimiter,
        decimal=stated.decimal,
        skip_rows=stated.skip_rows,
    )
    units = _units(source, _plan(source, form, stated), stated)
    return {kind: unit for kind, unit in units.items() if unit is not None}


def time_order(path: Path, form: Form, columns: ColumnMap) -> IntArray | None:
    """Order (n,) of the rows by their time column; None where there is none."""
    names = columns.columns or form.names
    index, _ = _time_column(columns, names, form.columns)
    if index is None:
        return None
    return np.asarray(np.argsort(read_numbers(path, form, [index])[:, 0], kind="stable"))


def _signed(numbers: FloatArray, place: dict[int, int], triad: Triad) -> FloatArray:
    return np.asarray(numbers[:, [place[i] for i in triad.indices]] * np.array(triad.signs))


def _units(source: Path, plan: _Plan, stated: ColumnMap) -> dict[Kind, str | None]:
    """Return the unit of every sensor there is; None where nobody stated one."""
    triads: dict[Kind, tuple[Triad | None, str | None]] = {
        "accel": (plan.accel, stated.accel_unit),
        "gyro": (plan.gyro, stated.gyro_unit),
        "mag": (plan.mag, stated.mag_unit),
    }
    units = {kind: text or t.unit for kind, (t, text) in triads.items() if t is not None}
    for kind, unit in units.items():
        if unit is not None:
            try:
                parse_unit(unit, kind)
            except InputError as error:
                raise InputError(f"{source}: {error} (--{kind}-unit)") from error
    return units


def _plan(source: Path, form: Form, stated: ColumnMap) -> _Plan:
    names = form.names
    if stated.columns is not None:
        if len(stated.columns) != form.columns:
            raise InputError(
                f"{source} has {form.columns} columns, but {len(stated.columns)} names are stated"
            )
        names = stated.columns
    try:
        accel = _triad(stated.accel, "accel", names, form.columns)
        gyro = _triad(stated.gyro, "gyro", names, form.columns)
        mag = _triad(stated.mag, "mag", names, form.columns)
        time, time_unit = _time_column(stated, names, form.columns)
        temperature = None
        if stated.temperature is not None:
            temperature = locate(stated.temperature, names, form.columns)[0]
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    if accel is None:
        raise InputError(_no_accelerometer(source, form, names))
    named = Form(form.delimiter, form.decimal, form.first_line, form.columns, names, form.preamble)
    return _Plan(named, accel, gyro, mag, temperature, time, time_unit)


def _triad(
    refs: tuple[str | int, str | int, str | int] | None,
    kind: Kind,
    names: tuple[str, ...] | None,
    count: int,
) -> Triad | None:
    if refs is not None:
        return locate_triad(refs, names, count)
    return recognize(names, kind) if names else None


def _time_column(
    stated: ColumnMap, names: tuple[str, ...] | None, count: int
) -> tuple[int | None, str | None]:
    if stated.time is not None:
        index, sign = locate(stated.time, names, count)
        if sign < 0:
            raise InputError("time cannot be turned in sign")
        unit = split_unit(names[index])[1] if names else None
        named = recognize_time((names[index],)) if names else None
        return index, stated.time_unit or unit or (named[1] if named else None)
    found = recognize_time(names) if names else None
    # A rate stated for a table whose time column nobody pointed at must agree with it: see _time.
    return (None, None) if found is None else (found[0], stated.time_unit or found[1])


def _no_accelerometer(source: Path, form: Form, names: tuple[str, ...] | None) -> str:
    if names is None:
        example = "ax,ay,az,gx,gy,gz" if form.columns == 6 else "t,ax,ay,az,gx,gy,gz"
        return (
            f"{source} has {form.columns} columns of numbers without names: say what they are in "
            f"order, e.g. --columns {example}"
        )
    return (
        f"{source}: none of its columns ({', '.join(names)}) is recognized as an accelerometer: "
        "say which are with --accel X,Y,Z"
    )


def _refuse_constant(source: Path, form: Form, triad: Triad, values: FloatArray) -> None:
    if len(values) < 3:
        raise InputError(f"{source} holds only {len(values)} rows of data")
    for axis in np.flatnonzero(np.ptp(values, axis=0) == 0):
        index = triad.indices[axis]
        name = form.names[index] if form.names else str(index + 1)
        raise InputError(
            f"{source}: column {name} is {values[0, axis]:g} in every row: a dead sensor axis or "
            "the wrong column"
        )


def _refuse_enormous(source: Path, plan: _Plan, numbers: FloatArray) -> None:
    """Refuse what overflows, by the line it is in; ``numbers`` are in the order of the file."""
    single = (plan.temperature, plan.time)
    columns = [i for i, index in enumerate(plan.wanted) if index not in single]
    rows, which = np.nonzero(np.abs(numbers[:, columns]) > LARGEST)
    if not len(rows):
        return
    row, column = int(rows[0]), columns[int(which[0])]
    index, names = plan.wanted[column], plan.form.names
    raise InputError(
        f"{source}, line {line_of_row(source, plan.form, row)}: column "
        f"{names[index] if names else index + 1} is {numbers[row, column]:.3g}, which no sensor "
        "gives in any unit: correct or cut out the row"
    )


def _times(
    source: Path, plan: _Plan, stated: ColumnMap, column: FloatArray | None, count: int
) -> FloatArray:
    """Time stamps [s], shape (n,), strictly increasing."""
    rate = stated.rate_hz
    if column is None:
        if rate is None:
            hint = next(
                (
                    f" (its preamble says {p.strip()!r})"
                    for p in plan.form.preamble
                    if _RATE_WORD.search(p)
                ),
                "",
            )
            raise InputError(
                f"{source} has no time column that is recognized: state its sample rate with "
                f"--rate HZ{hint}, or the column with --time"
            )
        return np.arange(count) / rate
    refuse_going_back(source, plan.form, column)
    column = spread_repeated(source, column)
    t = column * _time_factor(source, plan, rate, float(np.median(np.diff(column))))
    measured = 1.0 / float(np.median(np.diff(t)))
    if not USUAL_RATES_HZ[0] <= measured <= USUAL_RATES_HZ[1]:
        raise InputError(
            f"{source}: by its time column in {plan.time_unit} the rate is {measured:.3g} Hz: "
            "state the right unit with --time-unit"
        )
    if rate is not None and abs(measured / rate - 1.0) > RATE_AGREES:
        raise InputError(
            f"{source}: the rate is stated as {rate:g} Hz, but its time column runs at "
            f"{measured:.4g} Hz: leave out the rate, or state the unit of time with --time-unit"
        )
    return t


def _time_factor(source: Path, plan: _Plan, rate: float | None, step: float) -> float:
    if plan.time_unit is None:
        # Between 2 and 2000 Hz the usual units cannot be confused: their ranges do not overlap.
        for factor in (1.0, 1e-3, 1e-6, 1e-9):
            if 1 / 2000.0 <= step * factor < 1 / 2.0:
                return factor
        raise InputError(
            f"{source}: its time column steps by {step:g}, which fits no unit: state it with "
            "--time-unit s, ms, us, ns or samples"
        )
    if plan.time_unit == SAMPLES:
        if rate is None:
            raise InputError(f"{source}: a column that counts samples needs --rate HZ")
        return 1.0 / rate
    try:
        return parse_unit(plan.time_unit, "time")
    except InputError as error:
        raise InputError(f"{source}: {error}, or samples (--time-unit)") from error
