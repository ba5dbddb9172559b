"""The parts of a packet layout: its fields, its checksum, and the error for what cannot be used."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from firmware_protocols.checksums import SIZES

MAX_PACKET_BYTES = 4096

TYPE_SIZES = {
    "pad": 1,
    "u8": 1,
    "i8": 1,
    "u16": 2,
    "i16": 2,
    "u24": 3,
    "i24": 3,
    "u32": 4,
    "i32": 4,
    "f32": 4,
    "f64": 8,
}
"""Bytes that each type of field takes."""

BYTE_ORDERS = {"little": "<", "big": ">"}

_AXIS = re.compile(r"[+-][xyz]")
_FIELD_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")
_RESERVED = ("header", "checksum")


class LayoutError(ValueError):
    """A packet layout that cannot be used; one sentence that names file and field."""


@dataclass(frozen=True)
class Field:
    """One field of a packet: ``count`` numbers of one type.

    Attributes
    ----------
    name : str
        Lower-case word. Drivers know seq, status, time, accel, gyro, mag and temperature.
    type : str
        u8, i8, u16, i16, u24, i24, u32, i32, f32, f64, or pad for bytes without meaning.
    count : int
        How many numbers; more than one gives a value of shape (n, count).
    byte_order : str or None
        "little" or "big"; None takes the layout's.
    unit : str
        Unit of the value, for example "g", "deg/s", "uT", "degC"; empty for plain counts.
    counts_per_unit, zero : float
        ``value = (counts - zero) / counts_per_unit`` in ``unit``.
    axes : tuple of str or None
        For three numbers on rotated axes: which raw axis the x, y and z values are, with sign.
        ("+y", "+x", "-z") says x = raw y, y = raw x, z = -raw z.
    """

    name: str
    type: str
    count: int = 1
    byte_order: str | None = None
    unit: str = ""
    counts_per_unit: float = 1.0
    zero: float = 0.0
    axes: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not _FIELD_NAME.fullmatch(self.name) or self.name in _RESERVED:
            raise LayoutError(
                f"field name {quote(self.name)} cannot be used: take a lower-case word of up to "
                f"40 letters, digits and underscores other than {' and '.join(_RESERVED)}."
            )
        where = f"field {self.name!r}"
        if self.type not in TYPE_SIZES:
            raise LayoutError(
                f"{where}: type {quote(self.type)} is not known, take one of "
                f"{', '.join(TYPE_SIZES)}."
            )
        if not 1 <= self.count <= MAX_PACKET_BYTES:
            raise LayoutError(f"{where}: count must be 1 to {MAX_PACKET_BYTES}.")
        if self.byte_order is not None:
            check_byte_order(where, self.byte_order)
        if len(self.unit) > 32:
            raise LayoutError(f"{where}: unit is longer than 32 letters.")
        if not (math.isfinite(self.counts_per_unit) and self.counts_per_unit != 0):
            raise LayoutError(f"{where}: counts_per_unit must be a finite number other than 0.")
        if not math.isfinite(self.zero):
            raise LayoutError(f"{where}: zero must be a finite number.")
        if self.axes is not None:
            self._check_axes(where, self.axes)

    def _check_axes(self, where: str, axes: tuple[str, ...]) -> None:
        permuted = sorted(a[1:] for a in axes if _AXIS.fullmatch(a)) == ["x", "y", "z"]
        if not permuted or self.count != 3 or len(axes) != 3:
            raise LayoutError(
                f"{where}: axes must name x, y and z once each with a sign, such as "
                '["+y", "+x", "-z"], for a field with count 3.'
            )

    @property
    def size(self) -> int:
        """Bytes of the whole field."""
        return TYPE_SIZES[self.type] * self.count

    @property
    def is_integer(self) -> bool:
        """Whether the field holds integers (all types but f32, f64 and pad)."""
        return self.type[0] in "ui"

    @property
    def bits(self) -> int:
        """Bits of one number."""
        return 8 * TYPE_SIZES[self.type]

    @property
    def limits(self) -> tuple[int, int]:
        """Least and greatest count of an integer field."""
        if not self.is_integer:
            raise LayoutError(f"field {self.name!r}: type {self.type} has no integer limits.")
        if self.type[0] == "u":
            return 0, 2**self.bits - 1
        return -(2 ** (self.bits - 1)), 2 ** (self.bits - 1) - 1


@dataclass(frozen=True)
class Checksum:
    """The checksum that ends a packet; it covers everything from byte ``start`` up to itself."""

    kind: str
    start: int = 0
    byte_order: str | None = None

    def __post_init__(self) -> None:
        if self.kind not in SIZES:
            raise LayoutError(
                f"checksum: kind {quote(self.kind)} is not known, take none or one of "
                f"{', '.join(SIZES)}."
            )
        if self.byte_order is not None:
            check_byte_order("checksum", self.byte_order)

    @property
    def size(self) -> int:
        """Bytes of the checksum."""
        return SIZES[self.kind]


def check_byte_order(where: str, order: str) -> None:
    """Raise :class:`LayoutError` for anything but "little" and "big"."""
    if order not in BYTE_ORDERS:
        raise LayoutError(f'{where}: byte order {quote(order)} must be "little" or "big".')


def quote(text: object) -> str:
    """Return a text in quotes for an error sentence, cut short where it is long."""
    shown = repr(text)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
