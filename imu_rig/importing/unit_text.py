"""Units as people and other programs write them, and raw counts per unit."""

from __future__ import annotations

import math
import re
from typing import Literal

from imu_rig.errors import InputError
from imu_rig.units import (
    ACCELERATION_UNITS,
    FIELD_UNITS,
    LENGTH_UNITS,
    RATE_UNITS,
    TIME_UNITS,
)

Kind = Literal["accel", "gyro", "mag", "time", "length"]

_TABLES: dict[str, dict[str, float]] = {
    "accel": ACCELERATION_UNITS,
    "gyro": RATE_UNITS | {"mdps": RATE_UNITS["dps"] * 1e-3},
    "mag": FIELD_UNITS,
    "time": TIME_UNITS,
    "length": LENGTH_UNITS,
}
_ALIASES: dict[str, dict[str, str]] = {
    "accel": dict.fromkeys(
        ("m/s/s", "ms-2", "ms^-2", "m*s^-2", "m.s-2", "m/sec2", "m/sec^2", "mps2", "mss", "ms2"),
        "m/s2",
    )
    | {"gn": "g", "gravity": "g", "g0": "g"},
    "gyro": dict.fromkeys(("degs", "deg/sec", "degree/s", "degrees/s", "deg_s"), "deg/s")
    | dict.fromkeys(("rads", "rad/sec", "radian/s", "radians/s", "radps", "rad_s"), "rad/s"),
    "mag": {"microtesla": "uT", "Gs": "G", "milligauss": "mG", "nanotesla": "nT"},
    "time": dict.fromkeys(("sec", "secs", "second", "seconds"), "s")
    | dict.fromkeys(("msec", "millis", "millisecond", "milliseconds"), "ms")
    | dict.fromkeys(("usec", "micros", "microsecond", "microseconds"), "us")
    | dict.fromkeys(("nsec", "nanos", "nanosecond", "nanoseconds"), "ns"),
    "length": dict.fromkeys(("meter", "meters", "metre", "metres"), "m")
    | dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), "mm")
    | dict.fromkeys(("centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
}
_COUNTS = re.compile(r"^([0-9.]+(?:e[+-]?[0-9]+)?)\s*(?:lsb|counts?)\s*/\s*(.+)$", re.IGNORECASE)
_NAMES = {
    "accel": "acceleration",
    "gyro": "rate",
    "mag": "field",
    "time": "time",
    "length": "length",
}
_EXAMPLES = {"accel": ", or counts as '16384 LSB/g'", "gyro": ", or counts as '131 LSB/(deg/s)'"}


def parse_unit(text: str, kind: Kind) -> float:
    """Return the factor from a unit to SI (microtesla for a field).

    Parameters
    ----------
    text : str
        Such as ``m/s^2``, ``deg/s``, ``16384 LSB/g``, ``131 LSB/(deg/s)``.
    kind : {"accel", "gyro", "mag", "time", "length"}
        What it is a unit of.

    Raises
    ------
    InputError
        A unit that is not known, with those that are.
    """
    factor = find_unit(text, kind)
    if factor is None:
        raise InputError(
            f"{text!r} is no unit of {_NAMES[kind]} that is known; write {known_units(kind)}"
        )
    return factor


def known_units(kind: Kind) -> str:
    """``m/s2, g, mg, or counts as '16384 LSB/g'``, as far as there are."""
    return ", ".join(_TABLES[kind]) + _EXAMPLES.get(kind, "")


def find_unit(text: str, kind: Kind) -> float | None:
    """Return the factor from a unit to SI, None where the text is no unit of this kind."""
    plain = text.strip()
    for sign, letters in (("µ", "u"), ("μ", "u"), ("²", "2"), ("°", "deg"), ("⁻²", "-2")):
        plain = plain.replace(sign, letters)
    counts = _COUNTS.match(plain)
    if counts:
        per_unit = find_unit(counts.group(2).strip(" ()"), kind)
        try:
            number = float(counts.group(1))
        except ValueError:
            return None
        usable = per_unit is not None and math.isfinite(number) and number > 0
        return per_unit / number if usable and per_unit is not None else None
    plain = plain.strip("()[] ").replace(" ", "")
    table, aliases = _TABLES[kind], _ALIASES[kind]
    for known in (table, aliases):
        if plain in known:
            return table[aliases.get(plain, plain)]
    # mG and MG differ, G and g do not where only one of them is in the table.
    folded = {name for name in (*table, *aliases) if name.lower() == plain.lower()}
    meanings = {table[aliases.get(name, name)] for name in folded}
    return meanings.pop() if len(meanings) == 1 else None
