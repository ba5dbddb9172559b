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

MAX_SCALES = 16
MAX_UNIT = 32
MAX_FAULT = 80


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
    low_bits : int or None
        How many bits of an integer are the number, from the lowest; those above are flags. None
        for all.
    flags : tuple of (str, int)
        Bits with a meaning, as lower-case word and number of the bit from the lowest: columns of
        the samples, 0 or 1. Of several numbers, the bit of any.
    faults : tuple of (str, int)
        Bits that tell of trouble, in human words: named in the device's health.
    scale_by : str or None
        Another integer field of the packet, by whose count ``counts_per_unit`` is looked up in
        ``scales``: a range setting. A count that is not there makes the value NaN.
    scales : tuple of (int, float)
    """

    name: str
    type: str
    count: int = 1
    byte_order: str | None = None
    unit: str = ""
    counts_per_unit: float = 1.0
    zero: float = 0.0
    axes: tuple[str, ...] | None = None
    low_bits: int | None = None
    flags: tuple[tuple[str, int], ...] = ()
    faults: tuple[tuple[str, int], ...] = ()
    scale_by: str | None = None
    scales: tuple[tuple[int, float], ...] = ()

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
        check_text(f"{where}: unit", self.unit, MAX_UNIT)
        if not (math.isfinite(self.counts_per_unit) and self.counts_per_unit != 0):
            raise LayoutError(f"{where}: counts_per_unit must be a finite number other than 0.")
        if not math.isfinite(self.zero):
            raise LayoutError(f"{where}: zero must be a finite number.")
        if self.axes is not None:
            self._check_axes(where, self.axes)
        self._check_bits(where)
        self._check_scales(where)

    def _check_bits(self, where: str) -> None:
        named = (*self.flags, *self.faults)
        if (self.low_bits is not None or named) and not self.is_integer:
            raise LayoutError(f"{where}: low_bits, flags and faults are for whole numbers only.")
        if self.low_bits is not None and not 1 <= self.low_bits <= self.bits:
            raise LayoutError(f"{where}: low_bits must be 1 to {self.bits}.")
        if len(named) > self.bits:
            raise LayoutError(f"{where}: more flags and faults than the field has bits.")
        for name, bit in named:
            if not 0 <= bit < self.bits:
                raise LayoutError(
                    f"{where}: bit {quote(bit)} of {quote(name)} is not 0 to {self.bits - 1}."
                )
        for name, _ in self.flags:
            if not _FIELD_NAME.fullmatch(name):
                raise LayoutError(
                    f"{where}: the flag {quote(name)} cannot be used: take a lower-case word."
                )
        for name, _ in self.faults:
            if not name:
                raise LayoutError(f"{where}: a fault must have a name.")
            check_text(f"{where}: the fault {quote(name)}", name, MAX_FAULT)

    def _check_scales(self, where: str) -> None:
        if (self.scale_by is None) != (not self.scales) or len(self.scales) > MAX_SCALES:
            raise LayoutError(
                f"{where}: scale_by and scales go together, with up to {MAX_SCALES} scales."
            )
        if not all(math.isfinite(scale) and scale != 0 for _, scale in self.scales):
            raise LayoutError(f"{where}: scales must be finite numbers other than 0.")

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
    def number_bits(self) -> int:
        """Bits of one number, without the flags above it."""
        return self.bits if self.low_bits is None else self.low_bits

    @property
    def limits(self) -> tuple[int, int]:
        """Least and greatest count of an integer field."""
        if not self.is_integer:
            raise LayoutError(f"field {self.name!r}: type {self.type} has no integer limits.")
        bits = self.number_bits
        if self.type[0] == "u":
            return 0, 2**bits - 1
        return -(2 ** (bits - 1)), 2 ** (bits - 1) - 1


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


def check_text(where: str, text: str, greatest: int) -> None:
    """Raise :class:`LayoutError` for a text that is too long, or that a screen would obey."""
    if len(text) > greatest:
        raise LayoutError(f"{where} is longer than {greatest} letters.")
    if not text.isprintable():
        raise LayoutError(
            f"{where} holds letters that cannot be printed; write it without line ends, control "
            "characters and spaces other than the plain one."
        )


def quote(text: object) -> str:
    """Return a value in quotes for an error sentence, cut short where it is long."""
    try:
        shown = repr(text)
    except (ValueError, RecursionError):  # a number of thousands of digits, lists without end
        return f"(a value too long to show, {type(text).__name__})"
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
