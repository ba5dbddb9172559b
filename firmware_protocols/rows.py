"""What one row of a device's data says: named fields with types and units, counter and clock.

A row is the content of one packet. Of a packet of fixed length it is cut out of the bytes as they
came (:class:`~firmware_protocols.layout.PacketLayout`); a protocol with packets of variable length
fills rows of its own.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from firmware_protocols.fields import (
    BYTE_ORDERS,
    Field,
    LayoutError,
    check_byte_order,
    check_text,
    quote,
)

MAX_FIELDS = 256

MAX_NAME = 64
PROTOCOL_NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9._-]{{0,{MAX_NAME - 1}}}")
MAX_TITLE = 200

RATES_HZ = (1e-4, 1e6)
TICKS_S = (1e-12, 1e4)
"""Least and greatest rate and clock tick: beyond them times lose their digits or become NaN."""


@dataclass(frozen=True)
class Barometer:
    """That rows hold the raw readings of a barometer of the MS5803 family.

    Attributes
    ----------
    variant : str
        Which one of it; see :mod:`firmware_protocols.ms5803`.
    prom, d1, d2 : str
        Fields with the eight words of its PROM, the raw pressure and the raw temperature.
    """

    variant: str
    prom: str = "prom"
    d1: str = "d1"
    d2: str = "d2"


@dataclass(frozen=True, kw_only=True)
class RowLayout:
    """The fields of a row, in order.

    Attributes
    ----------
    name, title : str
        Short name for options and files, and one line for people.
    byte_order : str
        "little" or "big", for every field that does not say otherwise.
    fields : tuple of Field
    counter : str or None
        Name of the field that counts packets, modulo its type.
    clock : str or None
        Name of the field with the device's clock, modulo its type.
    clock_tick_s : float
        One count of the clock [s].
    rate_hz : float or None
        Nominal rows per second.
    barometer : Barometer or None
        Where pressure and temperature are to be computed from raw readings.
    """

    name: str
    title: str
    byte_order: str
    fields: tuple[Field, ...]
    counter: str | None = None
    clock: str | None = None
    clock_tick_s: float = 1e-6
    rate_hz: float | None = None
    barometer: Barometer | None = None

    def __post_init__(self) -> None:
        check_names(self.name, self.title)
        check_byte_order("byte_order", self.byte_order)
        self._check_fields()
        self._check_counting_field("counter", self.counter)
        self._check_counting_field("clock", self.clock)
        _check_range("clock_tick_s", self.clock_tick_s, TICKS_S)
        if self.rate_hz is not None:
            _check_range("rate_hz", self.rate_hz, RATES_HZ)
        if self.barometer is not None:
            self._check_barometer(self.barometer)

    def _check_fields(self) -> None:
        if not 1 <= len(self.fields) <= MAX_FIELDS:
            raise LayoutError(f"fields must list 1 to {MAX_FIELDS} fields.")
        seen: set[str] = set()
        for field in self.fields:
            for name in (field.name, *(flag for flag, _ in field.flags)):
                if name in seen:
                    raise LayoutError(f"field {name!r} is there twice; rename one of the two.")
                seen.add(name)
        for field in self.fields:
            if field.scale_by is not None:
                self._named("scale_by", field.scale_by, "one integer", lambda f: f.is_integer)

    def _check_counting_field(self, key: str, name: str | None) -> None:
        if name is not None:
            self._named(
                key,
                name,
                "one unsigned integer (u8, u16, u24 or u32)",
                lambda f: f.type in ("u8", "u16", "u24", "u32"),
            )

    def _named(self, key: str, name: str, kind: str, fits: Any, count: int = 1) -> None:
        """Refuse a key that names a field which is not there or of another kind."""
        found = [f for f in self.fields if f.name == name]
        if not found:
            raise LayoutError(
                f"{key} names the field {quote(name)}, which is not among the fields "
                f"({', '.join(f.name for f in self.fields)})."
            )
        if not fits(found[0]) or found[0].count != count:
            raise LayoutError(f"{key} names the field {name!r}, which must be {kind}.")

    def _check_barometer(self, barometer: Barometer) -> None:
        from firmware_protocols.ms5803 import VARIANTS  # whose integers few layouts need

        if barometer.variant not in VARIANTS:
            raise LayoutError(
                f"barometer: variant {quote(barometer.variant)} is not known, take one of "
                f"{', '.join(VARIANTS)}."
            )
        self._named(
            "barometer.prom", barometer.prom, "eight u16", lambda f: f.type == "u16", count=8
        )
        for key in ("d1", "d2"):
            self._named(
                f"barometer.{key}",
                getattr(barometer, key),
                "one u24 or u32",
                lambda f: f.type in ("u24", "u32"),
            )
        for name in ("pressure", "temperature"):
            if self.has(name):
                raise LayoutError(
                    f"field {name!r} is computed by the barometer; rename the field of that name."
                )

    @cached_property
    def row_bytes(self) -> int:
        """Bytes of all fields."""
        return sum(f.size for f in self.fields)

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Structured type of one row, without gaps.

        24-bit numbers and pads are bytes here; :func:`firmware_protocols.packets.counts` makes
        integers of them.
        """
        return np.dtype(self.members())

    def members(self) -> list[tuple[Any, ...]]:
        """Return the fields as members of a structured type."""
        members: list[tuple[Any, ...]] = []
        for field in self.fields:
            shape = (field.count,) if field.count > 1 else ()
            if field.type == "pad":
                members.append((field.name, "u1", (field.count,)))
            elif field.bits == 24:
                members.append((field.name, "u1", (*shape, 3)))
            else:
                code = f"{BYTE_ORDERS[self.order(field)]}{field.type[0]}{field.bits // 8}"
                members.append((field.name, code, shape))
        return members

    def field(self, name: str) -> Field:
        """Return the field of this name, or raise :class:`LayoutError`."""
        for field in self.fields:
            if field.name == name:
                return field
        raise LayoutError(
            f"layout {self.name}: there is no field {quote(name)} "
            f"(fields: {', '.join(f.name for f in self.fields)})."
        )

    def order(self, field: Field) -> str:
        """Return the byte order of a field: its own, or the layout's."""
        return field.byte_order or self.byte_order

    def has(self, name: str) -> bool:
        """Return whether there is a field of this name."""
        return any(f.name == name for f in self.fields)


def check_names(name: str, title: str) -> None:
    """Raise :class:`LayoutError` for a name or title that cannot be used for a protocol."""
    if not PROTOCOL_NAME.fullmatch(name):
        raise LayoutError(
            f"name {quote(name)} cannot be used: take up to 64 letters, digits, dots, "
            "hyphens and underscores."
        )
    check_text("title", title, MAX_TITLE)


def _check_range(key: str, value: float, limits: tuple[float, float]) -> None:
    least, greatest = limits
    if not least <= value <= greatest:  # nor NaN
        raise LayoutError(f"{key} must be a number from {least:g} to {greatest:.12g}.")
