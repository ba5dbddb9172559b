"""Parameters of flight controllers, whose whole numbers travel in the bytes of a float.

PARAM_VALUE has one float for every type. PX4 puts the bytes of a whole number where the float is
("bytewise"), ArduPilot converts it to a float ("cast"). Neither says so in the message: the
capabilities of AUTOPILOT_VERSION do, and the kind of autopilot in its heartbeat. Read the wrong way
the number of a sensor, 1310988, is 1.84e-39, and -1 is no number.

Values are kept as the four bytes of the wire: floats of Python change some patterns that are no
number, and with them whole numbers.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Literal

from imu_rig.foreign_text import one_line

Encoding = Literal["bytewise", "cast"]

PX4, ARDUPILOT = 12, 3
"""Numbers of the autopilots in heartbeats (MAV_AUTOPILOT)."""

CAPABILITY_BYTEWISE, CAPABILITY_CAST = 16, 131_072
"""Bits of AUTOPILOT_VERSION.capabilities."""

REAL32 = 9
_WHOLE = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}
"""Types of whole numbers that fit (MAV_PARAM_TYPE) and how their bytes are laid out."""

_SMALLEST_NORMAL = 2.0**-126
_WORDS = {
    "bytewise": "by its bytes (PX4's way)",
    "cast": "as a float (ArduPilot's way)",
}


@dataclass(frozen=True)
class Parameter:
    """One parameter as it was received.

    Attributes
    ----------
    name : str
    wire : bytes
        The four bytes of param_value.
    type : int
        MAV_PARAM_TYPE.
    """

    name: str
    wire: bytes
    type: int

    @property
    def is_whole(self) -> bool:
        """Whether it is a whole number."""
        return self.type in _WHOLE

    def value(self, encoding: Encoding) -> float | int:
        """Return its value; NaN for a whole number that its float cannot be."""
        return decode(self.wire, self.type, encoding)

    def contradiction(self, encoding: Encoding) -> str | None:
        """Say in a sentence that it must be in the other encoding; None where it may be this.

        Cast, no whole number is a fraction below any that is normal, or not a number. Bytewise,
        whole numbers that are sound floats are above a thousand million: no sensor's number, no
        count and no choice is.
        """
        if not self.is_whole:
            return None
        (as_float,) = struct.unpack("<f", self.wire)
        if encoding == "cast":
            wrong = math.isnan(as_float) or 0.0 < abs(as_float) < _SMALLEST_NORMAL
        else:
            wrong = 1.0 <= abs(as_float) < 2.0**31 and as_float == math.floor(as_float)
        if not wrong:
            return None
        whole = math.isfinite(as_float) and as_float == math.floor(as_float)
        as_text = f"{as_float:.0f}" if whole else f"{as_float:.3g}"
        read = {"cast": as_text, "bytewise": str(self.value("bytewise"))}
        other = "bytewise" if encoding == "cast" else "cast"
        return (
            f"{one_line(self.name)} reads {read[encoding]} {_WORDS[encoding]} and "
            f"{read[other]} {_WORDS[other]}: it must be the latter."
        )


def decode(wire: bytes, kind: int, encoding: Encoding) -> float | int:
    """Return the value of a parameter.

    Parameters
    ----------
    wire : bytes
        The four bytes of param_value.
    kind : int
        MAV_PARAM_TYPE.
    encoding : str
        "bytewise" or "cast"; alike for REAL32.
    """
    layout = _WHOLE.get(kind)
    if layout is not None and encoding == "bytewise":
        whole: int = struct.unpack_from(layout, wire)[0]
        return whole
    as_float: float = struct.unpack("<f", wire)[0]
    if layout is None or not math.isfinite(as_float):
        return as_float
    return round(as_float)


def encode(value: float, kind: int, encoding: Encoding) -> bytes:
    """Return the four bytes of param_value for a value.

    Raises
    ------
    ValueError
        If the type does not fit, or the value not the type; cast, whole numbers beyond 2**24 that a
        float has not are such.
    """
    layout = _WHOLE.get(kind)
    if layout is None:
        if kind != REAL32:
            raise ValueError(f"a parameter of type {kind} does not fit into four bytes.")
        try:
            return struct.pack("<f", value)
        except (OverflowError, struct.error):
            raise ValueError(f"{value} is beyond the range of a float of four bytes.") from None
    if value % 1 != 0:  # nor is what is infinite or no number
        raise ValueError(f"{value} is no whole number.")
    try:
        as_bytes = struct.pack(layout, int(value)).ljust(4, b"\0")
    except struct.error:
        raise ValueError(f"{value} is beyond the range of the parameter's type.") from None
    if encoding == "bytewise":
        return as_bytes
    wire = struct.pack("<f", value)
    if struct.unpack("<f", wire)[0] != value:
        raise ValueError(f"{value} is a whole number that a float of four bytes has not.")
    return wire


def encoding_of(autopilot: int | None, capabilities: int | None = None) -> Encoding | None:
    """Return how an autopilot encodes parameters; None where nothing tells.

    Parameters
    ----------
    autopilot : int or None
        From its heartbeat.
    capabilities : int or None
        From its AUTOPILOT_VERSION; they decide where they say one of the two.
    """
    if capabilities is not None:
        bytewise, cast = capabilities & CAPABILITY_BYTEWISE, capabilities & CAPABILITY_CAST
        if bool(bytewise) != bool(cast):
            return "bytewise" if bytewise else "cast"
    return {PX4: "bytewise", ARDUPILOT: "cast"}.get(autopilot or 0)  # type: ignore[return-value]
