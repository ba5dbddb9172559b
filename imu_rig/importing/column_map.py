"""Which columns of a table mean what: stated in a file or by options, else recognized by name."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StrictInt, StrictStr, ValidationError
from pydantic.functional_validators import BeforeValidator

from imu_rig.errors import InputError
from imu_rig.files import parse_toml, read_small
from imu_rig.importing.unit_text import Kind, find_unit
from imu_rig.validation import sentence

SAMPLES = "samples"
"""The time unit of a column that counts samples; it needs the rate."""
MAXIMUM_MAP_BYTES = 100_000
MOST_SENSORS = 100


def _split(value: Any) -> Any:
    return re.split(r"[\s,;]+", value.strip(" ,;")) if isinstance(value, str) else value


ColumnRef = StrictStr | StrictInt
"""A column's name or its number from 1; a leading minus turns its sign."""
Triple = Annotated[tuple[ColumnRef, ColumnRef, ColumnRef], BeforeValidator(_split)]


class SensorColumns(BaseModel):
    """Columns of one of several sensors in a table; fields as of `ColumnMap`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    accel: Triple | None = None
    gyro: Triple | None = None
    mag: Triple | None = None
    temperature: ColumnRef | None = None
    accel_unit: str | None = None
    gyro_unit: str | None = None
    mag_unit: str | None = None


class ColumnMap(BaseModel):
    """What the columns of a text table mean; everything left out is recognized if it can be.

    Attributes
    ----------
    columns : tuple of str, optional
        Names of all columns in order, for tables without a header (or instead of theirs); also
        as one text, ``"ax ay az gx gy gz"``.
    time : str or int, optional
        Time column.
    time_unit : str, optional
        ``s``, ``ms``, ``us``, ``ns``, or ``samples`` (then ``rate_hz`` is needed).
    rate_hz : float, optional
        Sample rate of a table without time column.
    accel, gyro, mag : triples of str or int, optional
        Columns of x, y and z by name or number from 1; ``"-ay"`` or ``-2`` turns the sign.
    temperature : str or int, optional
        Temperature column [degC].
    accel_unit, gyro_unit, mag_unit : str, optional
        Such as ``g``, ``deg/s``, ``16384 LSB/g``.
    delimiter : str, optional
        One character, or ``whitespace``.
    decimal : {".", ","}, optional
        Decimal sign.
    skip_rows : int
        Lines to skip before anything is looked at.
    sensors : dict of SensorColumns
        Where a table holds several sensors: the columns of each by its name. What a sensor does
        not say of units, the fields above say for all.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    columns: Annotated[tuple[StrictStr, ...], BeforeValidator(_split)] | None = None
    time: ColumnRef | None = None
    time_unit: str | None = None
    rate_hz: float | None = Field(default=None, gt=0.1, lt=100_000)
    accel: Triple | None = None
    gyro: Triple | None = None
    mag: Triple | None = None
    temperature: ColumnRef | None = None
    accel_unit: str | None = None
    gyro_unit: str | None = None
    mag_unit: str | None = None
    delimiter: str | None = None
    decimal: Literal[".", ","] | None = None
    skip_rows: int = Field(default=0, ge=0, le=1_000_000)
    sensors: dict[StrictStr, SensorColumns] = Field(default={}, max_length=MOST_SENSORS)

    @property
    def names_columns(self) -> bool:
        """Whether it says how a table is written or what its columns are."""
        return bool(self.sensors or self.skip_rows) or any(
            part is not None
            for part in (
                self.columns,
                self.time,
                self.accel,
                self.gyro,
                self.mag,
                self.temperature,
                self.delimiter,
                self.decimal,
            )
        )

    def of_sensor(self, name: str) -> ColumnMap:
        """Return what it says of one of its sensors."""
        own = self.sensors[name].model_dump(exclude_none=True)
        return ColumnMap.model_validate(self.model_dump(exclude={"sensors"}) | own)

    def updated(self, **options: Any) -> ColumnMap:
        """Return the map with ``options`` that are not None put over it, checked."""
        stated = {name: value for name, value in options.items() if value is not None}
        return make_column_map(self.model_dump() | stated, "the column options")


def make_column_map(content: dict[str, Any], source: str) -> ColumnMap:
    """Check a mapping and make a column map of it.

    Raises
    ------
    InputError
        Naming ``source`` and the first field that is wrong.
    """
    try:
        return ColumnMap.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{source}: {sentence(error, 'a column map')}") from error


def load_column_map(path: Path | str) -> ColumnMap:
    """Read a column map from a TOML file.

    Raises
    ------
    InputError
        No such file, not TOML, an unknown field or a wrong value.
    """
    data = read_small(path, MAXIMUM_MAP_BYTES, what="a column map")
    return make_column_map(parse_toml(data, str(path)), str(path))


@dataclass(frozen=True)
class Triad:
    """Three columns of one sensor: their indices from 0, signs, and the unit a header states."""

    indices: tuple[int, int, int]
    signs: tuple[float, float, float]
    unit: str | None = None


_WORDS: dict[Kind, str] = {
    "accel": "accelerometer|acceleration|accel|acc|a",
    "gyro": "gyroscope|angular_velocity|angular_rate|gyro|gyr|omega|g|w",
    "mag": "magnetometer|magnetic_field|magn|mag|m",
}
_NOT_SPECIFIC_FORCE = re.compile(r"linear|user|free|grav|earth|global")
_UNIT = re.compile(r"^(.*?)\s*[\[(](.+)[\])]\s*$")
_TIME = re.compile(r"^(?:.*_)?(?:t|time|timestamp|time_stamp|seconds|elapsed)(?:_([a-z]+))?$")


def split_unit(name: str) -> tuple[str, str | None]:
    """Split ``acc_x [m/s^2]`` into the name and the unit it states, if any."""
    match = _UNIT.match(name.strip())
    return (match.group(1), match.group(2)) if match else (name.strip(), None)


def recognize(names: Sequence[str], kind: Kind) -> Triad | None:
    """Find the x, y and z columns of one kind of sensor by their names.

    Raises
    ------
    InputError
        More than one set fits.
    """
    whole = list(recognize_sets(names, kind).values())
    if len(whole) > 1:
        shown = "; ".join(
            ", ".join(f"{names[i]} ({i + 1})" for i in triad.indices) for triad in whole
        )
        raise InputError(
            f"more than one set of columns could be the {kind}: {shown}; say which with "
            f"--{kind} X,Y,Z, by name or number"
        )
    return whole[0] if whole else None


def recognize_sets(names: Sequence[str], kind: Kind) -> dict[tuple[str, int], Triad]:
    """Find all sets of x, y and z columns of one kind of sensor.

    Returns
    -------
    dict
        By what stands before the sensor's word in the names, and by which of several of the same
        names it is.
    """
    sets: dict[tuple[str, int], dict[str, tuple[int, str | None]]] = {}
    seen: Counter[tuple[str, str]] = Counter()
    pattern = re.compile(
        rf"^(?P<prefix>(?:.*_)?)(?:(?P<kind>{_WORDS[kind]})_?(?:raw_)?(?P<axis>[xyz])"
        rf"|(?P<first>[xyz])_(?:{_WORDS[kind]}))(?:_(?P<unit>[a-z0-9_]+))?$"
    )
    for index, name in enumerate(names):
        bare, unit = split_unit(name)
        match = pattern.match(_plain(bare))
        if match is None or _NOT_SPECIFIC_FORCE.search(match["prefix"]):
            continue
        suffix = match["unit"]
        if suffix is not None and suffix != "raw":
            unit = unit or suffix
            if find_unit(suffix, kind) is None:
                continue
        axis = match["axis"] or match["first"]
        # Columns of the same name belong to different sensors: a set each.
        twin = seen[match["prefix"], axis]
        seen[match["prefix"], axis] += 1
        sets.setdefault((match["prefix"], twin), {})[axis] = (index, unit)
    triads = {}
    for key, found in sets.items():
        if len(found) == 3:
            x, y, z = (found[axis][0] for axis in "xyz")
            unit = _one_unit([found[axis][1] for axis in "xyz"], kind)
            triads[key] = Triad((x, y, z), (1.0, 1.0, 1.0), unit)
    return triads


def recognize_time(names: Sequence[str]) -> tuple[int, str | None] | None:
    """Find the time column by its name: its index from 0 and the unit it states."""
    for index, name in enumerate(names):
        bare, unit = split_unit(name)
        match = _TIME.match(_plain(bare))
        if match is None:
            continue
        if match[1] is not None and find_unit(match[1], "time") is None:
            continue
        return index, unit or match[1]
    return None


def locate(ref: str | int, names: Sequence[str] | None, count: int) -> tuple[int, float]:
    """Return the index from 0 and the sign that a stated column stands for.

    Raises
    ------
    InputError
        No such column.
    """
    if isinstance(ref, int):
        index = abs(ref) - 1
        if not 0 <= index < count:
            raise InputError(f"there is no column {ref}: the table has {count}, counted from 1")
        return index, -1.0 if ref < 0 else 1.0
    sign, wanted = (-1.0, ref[1:]) if ref.startswith("-") else (1.0, ref)
    for candidate in names or ():
        if wanted in (candidate, split_unit(candidate)[0]):
            return list(names or ()).index(candidate), sign
    if wanted.isdecimal():
        return locate(int(sign) * int(wanted), None, count)
    there = ", ".join(names) if names else "none, name them with --columns"
    raise InputError(f"there is no column {wanted!r}; the table's columns are: {there}")


def locate_triad(refs: Sequence[str | int], names: Sequence[str] | None, count: int) -> Triad:
    """Find the three stated columns of one sensor."""
    found = [locate(ref, names, count) for ref in refs]
    units = [split_unit(names[i])[1] if names else None for i, _ in found]
    (x, sx), (y, sy), (z, sz) = found
    if len({x, y, z}) < 3:
        raise InputError(f"x, y and z need three columns; {list(refs)} names one twice")
    return Triad((x, y, z), (sx, sy, sz), units[0] if len(set(units)) == 1 else None)


def _one_unit(units: list[str | None], kind: str) -> str | None:
    if len(set(units)) > 1:
        raise InputError(f"the {kind} columns state different units: {units}")
    return units[0]


def _plain(name: str) -> str:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", "_", name)
    return re.sub(r"[^a-z0-9]+", "_", spaced.lower()).strip("_")
