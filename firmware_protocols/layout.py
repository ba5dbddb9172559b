"""Packet layouts as data: which bytes of a fixed-length packet mean what.

A layout is a header, fields in the order of the wire and perhaps a checksum at the end. It is
written as a small TOML file; files are not trusted, and every mistake in one is a
:class:`LayoutError` that names the file and the field.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from firmware_protocols.fields import (
    BYTE_ORDERS,
    MAX_PACKET_BYTES,
    TYPE_SIZES,
    Checksum,
    Field,
    LayoutError,
    check_byte_order,
    quote,
)

__all__ = [
    "DEFAULT_LAYOUT_NAME",
    "MAX_PACKET_BYTES",
    "TYPE_SIZES",
    "Checksum",
    "Field",
    "LayoutError",
    "PacketLayout",
    "builtin_layouts",
    "load_layout",
]

DEFAULT_LAYOUT_NAME = "mpu9150-28"
MAX_HEADER_BYTES = 64
MAX_FIELDS = 256
MAX_FILE_BYTES = 1 << 16
MAX_DOTS = 32  # in one line; a key of thousands of parts keeps its reader busy for ever

_LAYOUT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")

_T = TypeVar("_T")


@dataclass(frozen=True)
class PacketLayout:
    """A whole packet of fixed length: header, fields in wire order, checksum.

    Attributes
    ----------
    name, title : str
        Short name for options and files, and one line for people.
    byte_order : str
        "little" or "big", for every field that does not say otherwise.
    header : bytes
        What every packet begins with.
    fields : tuple of Field
    checksum : Checksum or None
    counter : str or None
        Name of the field that counts packets, modulo its type.
    clock : str or None
        Name of the field with the device's clock, modulo its type.
    clock_tick_s : float
        One count of the clock [s].
    rate_hz : float or None
        Nominal packets per second.
    """

    name: str
    title: str
    byte_order: str
    header: bytes
    fields: tuple[Field, ...]
    checksum: Checksum | None = None
    counter: str | None = None
    clock: str | None = None
    clock_tick_s: float = 1e-6
    rate_hz: float | None = None

    def __post_init__(self) -> None:
        if not _LAYOUT_NAME.fullmatch(self.name):
            raise LayoutError(
                f"name {quote(self.name)} cannot be used: take up to 64 letters, digits, dots, "
                "hyphens and underscores."
            )
        if len(self.title) > 200:
            raise LayoutError("title is longer than 200 letters.")
        check_byte_order("byte_order", self.byte_order)
        if not 1 <= len(self.header) <= MAX_HEADER_BYTES:
            raise LayoutError(
                f"header must have 1 to {MAX_HEADER_BYTES} bytes: without one nothing tells where "
                "a packet begins."
            )
        self._check_fields()
        if self.checksum is not None and not 0 <= self.checksum.start < self._checksum_offset:
            raise LayoutError(
                f"checksum: start must be 0 to {self._checksum_offset - 1}, inside the packet and "
                "before the checksum."
            )
        self._check_counting_field("counter", self.counter)
        self._check_counting_field("clock", self.clock)
        if not (math.isfinite(self.clock_tick_s) and self.clock_tick_s > 0):
            raise LayoutError("clock_tick_s must be a finite number of seconds above 0.")
        if self.rate_hz is not None and not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise LayoutError("rate_hz must be a finite number above 0.")

    def _check_fields(self) -> None:
        if not 1 <= len(self.fields) <= MAX_FIELDS:
            raise LayoutError(f"fields must list 1 to {MAX_FIELDS} fields.")
        seen: set[str] = set()
        for field in self.fields:
            if field.name in seen:
                raise LayoutError(f"field {field.name!r} is there twice; rename one of the two.")
            seen.add(field.name)
        if self.length > MAX_PACKET_BYTES:
            raise LayoutError(
                f"the packet has {self.length} bytes, more than the {MAX_PACKET_BYTES} that a "
                "layout may have."
            )

    def _check_counting_field(self, key: str, name: str | None) -> None:
        if name is None:
            return
        found = [f for f in self.fields if f.name == name]
        if not found:
            raise LayoutError(
                f"{key} names the field {quote(name)}, which is not among the fields "
                f"({', '.join(f.name for f in self.fields)})."
            )
        if found[0].type not in ("u8", "u16", "u24", "u32") or found[0].count != 1:
            raise LayoutError(
                f"{key} names the field {name!r}, which must be one unsigned integer (u8, u16, "
                "u24 or u32)."
            )

    @cached_property
    def _checksum_offset(self) -> int:
        return len(self.header) + sum(f.size for f in self.fields)

    @cached_property
    def length(self) -> int:
        """Bytes of a packet, header and checksum included."""
        return self._checksum_offset + (self.checksum.size if self.checksum else 0)

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Structured type of one packet, without gaps: ``itemsize == length``.

        The header is under "header" and a checksum under "checksum". 24-bit numbers and pads are
        bytes here; :func:`firmware_protocols.packets.counts` makes integers of them.
        """
        members: list[tuple[Any, ...]] = [("header", "u1", (len(self.header),))]
        for field in self.fields:
            shape = (field.count,) if field.count > 1 else ()
            if field.type == "pad":
                members.append((field.name, "u1", (field.count,)))
            elif field.bits == 24:
                members.append((field.name, "u1", (*shape, 3)))
            else:
                members.append((field.name, self._code(field.type, field.byte_order), shape))
        if self.checksum is not None:
            code = self._code(f"u{8 * self.checksum.size}", self.checksum.byte_order)
            members.append(("checksum", code))
        return np.dtype(members)

    def _code(self, type_name: str, byte_order: str | None) -> str:
        return (
            f"{BYTE_ORDERS[byte_order or self.byte_order]}{type_name[0]}{int(type_name[1:]) // 8}"
        )

    def field(self, name: str) -> Field:
        """Return the field of this name, or raise :class:`LayoutError`."""
        for field in self.fields:
            if field.name == name:
                return field
        raise LayoutError(
            f"layout {self.name}: there is no field {quote(name)} "
            f"(fields: {', '.join(f.name for f in self.fields)})."
        )

    @property
    def checksum_order(self) -> Literal["little", "big"]:
        """Byte order of the checksum: its own, or the layout's."""
        own = self.checksum.byte_order if self.checksum else None
        return "big" if (own or self.byte_order) == "big" else "little"

    def order(self, field: Field) -> str:
        """Return the byte order of a field: its own, or the layout's."""
        return field.byte_order or self.byte_order

    def has(self, name: str) -> bool:
        """Return whether there is a field of this name."""
        return any(f.name == name for f in self.fields)

    def to_dict(self) -> dict[str, Any]:
        """Return the layout as plain data, in the form of the TOML files."""
        result: dict[str, Any] = {
            "name": self.name,
            "title": self.title,
            "byte_order": self.byte_order,
            "header": self.header.hex(" ").upper(),
            "counter": self.counter,
            "clock": self.clock,
            "clock_tick_s": self.clock_tick_s,
            "rate_hz": self.rate_hz,
            "fields": [_without_defaults(f) for f in self.fields],
            "checksum": _without_defaults(self.checksum) if self.checksum else None,
        }
        return {key: value for key, value in result.items() if value is not None}

    def to_toml(self) -> str:
        """Return the layout as the text of a file that :func:`load_layout` reads back."""
        values = self.to_dict()
        tables = {"[[fields]]": values.pop("fields"), "[checksum]": [values.pop("checksum", None)]}
        lines = _toml_lines(values)
        for head, entries in tables.items():
            for entry in entries:
                lines += ["", head, *_toml_lines(entry)] if entry is not None else []
        return "\n".join(lines) + "\n"

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], *, source: str = "packet layout") -> PacketLayout:
        """Build a layout from plain data, checking every key and type.

        Parameters
        ----------
        data : mapping
            As :meth:`to_dict` gives it or a TOML file holds it.
        source : str
            Where the data come from; every error begins with it.

        Raises
        ------
        LayoutError
            For anything that is not a usable layout.
        """
        try:
            return _layout_from(data)
        except LayoutError as error:
            raise LayoutError(f"{source}: {error}") from None


def load_layout(path_or_name: str | Path) -> PacketLayout:
    """Load a layout from a TOML file, or the built-in one of that name.

    Raises
    ------
    LayoutError
        For a file that is missing, too large or not a usable layout.
    """
    if isinstance(path_or_name, str) and path_or_name in _builtin_names():
        source = files(__package__) / "layouts" / f"{path_or_name}.toml"
        return _parse(source.read_bytes(), f"built-in layout {path_or_name}")
    path = Path(path_or_name)
    try:
        if not path.is_file():
            raise LayoutError(
                f"{path}: there is no such layout file, and no built-in layout of that name "
                f"(built in: {', '.join(_builtin_names())})."
            )
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, LayoutError):
            raise
        raise LayoutError(f"{path}: the layout file cannot be read ({error}).") from None
    if len(text) > MAX_FILE_BYTES:
        raise LayoutError(f"{path}: a layout file may have {MAX_FILE_BYTES} bytes; this has more.")
    return _parse(text, str(path))


def builtin_layouts() -> dict[str, PacketLayout]:
    """Return every built-in layout by its name."""
    return {name: load_layout(name) for name in _builtin_names()}


def _builtin_names() -> list[str]:
    entries = (files(__package__) / "layouts").iterdir()
    return sorted(e.name.removesuffix(".toml") for e in entries if e.name.endswith(".toml"))


def _parse(text: bytes, source: str) -> PacketLayout:
    if any(line.count(b".") > MAX_DOTS for line in text.split(b"\n")):
        raise LayoutError(f"{source}: a line has more than {MAX_DOTS} dots.")
    try:
        data = tomllib.loads(text.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, nested without end
        raise LayoutError(f"{source}: this is not a TOML file ({error}).") from None
    return PacketLayout.from_dict(data, source=source)


def _layout_from(data: Mapping[str, Any]) -> PacketLayout:
    known = {f.name for f in fields(PacketLayout)}
    _check_keys("the layout", data, known)
    listed = _take("the layout", data, "fields", list, [])
    if len(listed) > MAX_FIELDS:
        raise LayoutError(f"fields must list 1 to {MAX_FIELDS} fields.")
    return PacketLayout(
        name=_take("the layout", data, "name", str),
        title=_take("the layout", data, "title", str, ""),
        byte_order=_take("the layout", data, "byte_order", str, "little"),
        header=_header(_take("the layout", data, "header", str, "")),
        fields=tuple(_field_from(number, entry) for number, entry in enumerate(listed, start=1)),
        checksum=_checksum_from(_take("the layout", data, "checksum", dict, None)),
        counter=_take("the layout", data, "counter", str, None),
        clock=_take("the layout", data, "clock", str, None),
        clock_tick_s=_number("the layout", data, "clock_tick_s", 1e-6),
        rate_hz=_number("the layout", data, "rate_hz", None),
    )


def _field_from(number: int, entry: Any) -> Field:
    if not isinstance(entry, Mapping):
        raise LayoutError(f"field {number} must be a table with name and type.")
    where = f"field {number}"
    name = _take(where, entry, "name", str)
    where = f"field {quote(name)}"
    _check_keys(where, entry, {f.name for f in fields(Field)})
    axes = _take(where, entry, "axes", list, None)
    if axes is not None and not all(isinstance(a, str) for a in axes):
        raise LayoutError(f"{where}: axes must be a list of texts.")
    return Field(
        name=name,
        type=_take(where, entry, "type", str),
        count=_take(where, entry, "count", int, 1),
        byte_order=_take(where, entry, "byte_order", str, None),
        unit=_take(where, entry, "unit", str, ""),
        counts_per_unit=_number(where, entry, "counts_per_unit", 1.0),
        zero=_number(where, entry, "zero", 0.0),
        axes=None if axes is None else tuple(axes),
    )


def _checksum_from(entry: Mapping[str, Any] | None) -> Checksum | None:
    if entry is None:
        return None
    _check_keys("checksum", entry, {f.name for f in fields(Checksum)})
    kind = _take("checksum", entry, "kind", str)
    start = _take("checksum", entry, "start", int, 0)
    order = _take("checksum", entry, "byte_order", str, None)
    return None if kind == "none" else Checksum(kind, start, order)


def _header(text: str) -> bytes:
    try:
        return bytes.fromhex(text[: 4 * MAX_HEADER_BYTES])
    except ValueError:
        raise LayoutError(
            f'header {quote(text)} is not hexadecimal; write bytes such as "A5 5A".'
        ) from None


def _check_keys(where: str, entry: Mapping[str, Any], known: set[str]) -> None:
    for key in entry:
        if key not in known:
            raise LayoutError(
                f"{where}: the key {quote(key)} is not known (known: {', '.join(sorted(known))})."
            )


_REQUIRED: Any = object()
_KIND_NAMES = {str: "text", int: "a whole number", list: "a list", dict: "a table"}


def _take(
    where: str, entry: Mapping[str, Any], key: str, kind: type[_T], default: Any = _REQUIRED
) -> Any:
    value = entry.get(key, default)
    if value is _REQUIRED:
        raise LayoutError(f"{where}: the key {key!r} is missing.")
    if value is default:
        return value
    if not isinstance(value, kind) or isinstance(value, bool):
        raise LayoutError(f"{where}: {key} must be {_KIND_NAMES[kind]}.")
    return value


def _number(where: str, entry: Mapping[str, Any], key: str, default: float | None) -> Any:
    value = entry.get(key, default)
    if value is default:
        return value
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise LayoutError(f"{where}: {key} must be a number.")
    try:
        return float(value)
    except OverflowError:
        raise LayoutError(f"{where}: {key} is too large a number.") from None


def _toml_lines(values: Mapping[str, Any]) -> list[str]:
    """Return the lines of a table of numbers, texts and lists of texts."""
    return [f"{key} = {_toml(value)}" for key, value in values.items()]


def _toml(value: Any) -> str:
    """Write a value as JSON does, but for a few letters: TOML and UTF-8 know fewer of them."""
    if not isinstance(value, str):
        return json.dumps(value)
    text = json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if text.count(".") > MAX_DOTS:
        text = text.replace(".", "\\u002e")
    return text.encode("utf-8", "replace").decode("utf-8")


def _without_defaults(value: Field | Checksum) -> dict[str, Any]:
    """Return a field or checksum as a table that leaves out what the default says anyway."""
    result = {}
    for f in fields(value):
        entry = getattr(value, f.name)
        if entry != f.default:
            result[f.name] = (
                list(entry) if isinstance(entry, Sequence) and f.name == "axes" else entry
            )
    return result
