"""Packet layouts as data: which bytes of a fixed-length packet mean what.

A layout is a header, fields in the order of the wire and perhaps a checksum at the end. It is
written as a small TOML file; files are not trusted, and every mistake in one is a
:class:`LayoutError` that names the file and the field.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np

from firmware_protocols.descriptions import check_keys, number, take
from firmware_protocols.fields import (
    BYTE_ORDERS,
    MAX_PACKET_BYTES,
    MAX_SCALES,
    TYPE_SIZES,
    Checksum,
    Field,
    LayoutError,
    quote,
)
from firmware_protocols.protocol import Decoder, DeviceProtocol
from firmware_protocols.rows import MAX_FIELDS, MAX_NAME, Barometer, RowLayout

__all__ = [
    "DEFAULT_LAYOUT_NAME",
    "MAX_PACKET_BYTES",
    "TYPE_SIZES",
    "Checksum",
    "Field",
    "LayoutError",
    "PacketLayout",
    "load_layout",
]

DEFAULT_LAYOUT_NAME = "mpu9150-28"
MAX_HEADER_BYTES = 64
MAX_FILE_BYTES = 1 << 16
MAX_DOTS = 32  # in one line; a key of thousands of parts keeps its reader busy for ever

_WHOLE_NUMBER = re.compile(r"-?[0-9]{1,11}")


@dataclass(frozen=True, kw_only=True)
class PacketLayout(RowLayout, DeviceProtocol):
    """A whole packet of fixed length: header, fields in wire order, checksum.

    The simplest protocol: a device that sends nothing else has one stream, without a name.

    Attributes
    ----------
    header : bytes
        What every packet begins with.
    checksum : Checksum or None
    """

    header: bytes
    checksum: Checksum | None = None

    def __post_init__(self) -> None:
        if not 1 <= len(self.header) <= MAX_HEADER_BYTES:
            raise LayoutError(
                f"header must have 1 to {MAX_HEADER_BYTES} bytes: without one nothing tells where "
                "a packet begins."
            )
        super().__post_init__()
        if self.length > MAX_PACKET_BYTES:
            raise LayoutError(
                f"the packet has {self.length} bytes, more than the {MAX_PACKET_BYTES} that a "
                "layout may have."
            )
        if self.checksum is not None and not 0 <= self.checksum.start < self._checksum_offset:
            raise LayoutError(
                f"checksum: start must be 0 to {self._checksum_offset - 1}, inside the packet and "
                "before the checksum."
            )

    @cached_property
    def _checksum_offset(self) -> int:
        return len(self.header) + self.row_bytes

    @cached_property
    def length(self) -> int:
        """Bytes of a packet, header and checksum included."""
        return self._checksum_offset + (self.checksum.size if self.checksum else 0)

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Structured type of one packet, without gaps: ``itemsize == length``.

        As of a `RowLayout`, with the header under "header" and a checksum under "checksum".
        """
        members: list[tuple[Any, ...]] = [("header", "u1", (len(self.header),)), *self.members()]
        if self.checksum is not None:
            members.append(("checksum", f"{BYTE_ORDERS[self.checksum_order]}u{self.checksum.size}"))
        return np.dtype(members)

    @property
    def checksum_order(self) -> Literal["little", "big"]:
        """Byte order of the checksum: its own, or the layout's."""
        own = self.checksum.byte_order if self.checksum else None
        return "big" if (own or self.byte_order) == "big" else "little"

    @property
    def streams(self) -> Mapping[str, RowLayout]:
        """The packets themselves, without a name."""
        return {"": self}

    @property
    def bytes_per_s(self) -> float | None:
        """Nominal bytes per second."""
        return None if self.rate_hz is None else self.rate_hz * self.length

    @property
    def packets_per_s(self) -> float | None:
        """Nominal packets per second."""
        return self.rate_hz

    @property
    def longest(self) -> int:
        """Bytes of a packet."""
        return self.length

    @property
    def proves_packets(self) -> bool:
        """Whether there is a checksum."""
        return self.checksum is not None

    def decoder(self) -> Decoder:
        """Return a new decoder of a stream of these packets."""
        from firmware_protocols.decoder import SingleDecoder  # which is built upon layouts

        return SingleDecoder(self)

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
            "barometer": _without_defaults(self.barometer) if self.barometer else None,
            "checksum": _without_defaults(self.checksum) if self.checksum else None,
        }
        return {key: value for key, value in result.items() if value is not None}

    def to_toml(self) -> str:
        """Return the layout as the text of a file that :func:`load_layout` reads back."""
        values = self.to_dict()
        tables = {
            "[[fields]]": values.pop("fields"),
            "[barometer]": [values.pop("barometer", None)],
            "[checksum]": [values.pop("checksum", None)],
        }
        lines = toml_lines(values)
        for head, entries in tables.items():
            for entry in entries:
                lines += ["", head, *toml_lines(entry)] if entry is not None else []
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
    """Load a layout of fixed-length packets from a TOML file, or the built-in one of that name.

    For whatever a device may speak see :func:`firmware_protocols.known.load_protocol`.

    Raises
    ------
    LayoutError
        For a file that is missing, too large or not a usable layout.
    """
    data, source = read_description(path_or_name)
    return PacketLayout.from_dict(data, source=source)


def read_description(path_or_name: str | Path) -> tuple[dict[str, Any], str]:
    """Read the plain data of a TOML file, or of the built-in one of that name.

    Returns
    -------
    data : dict
    source : str
        Where they come from, for the beginning of an error.

    Raises
    ------
    LayoutError
        For a file that is missing, too large or no TOML.
    """
    if isinstance(path_or_name, str) and path_or_name in builtin_names():
        source = files(__package__) / "layouts" / f"{path_or_name}.toml"
        return _parse(source.read_bytes(), f"built-in layout {path_or_name}")
    path = Path(path_or_name)
    try:
        if not path.is_file():
            raise LayoutError(
                f"{path}: there is no such layout file, and no built-in layout of that name "
                f"({_meant(path.name)}built in: {', '.join(builtin_names())})."
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


def builtin_names() -> list[str]:
    """Return the names of everything built in, in order."""
    entries = (files(__package__) / "layouts").iterdir()
    return sorted(e.name.removesuffix(".toml") for e in entries if e.name.endswith(".toml"))


def _meant(name: str) -> str:
    """Return the question after a built-in name that was perhaps misspelt; nothing for others."""
    from difflib import get_close_matches  # for the one who errs

    close = get_close_matches(name[:MAX_NAME].removesuffix(".toml"), builtin_names(), n=1)
    return f"did you mean {close[0]}? " if close else ""


def _parse(text: bytes, source: str) -> tuple[dict[str, Any], str]:
    if any(line.count(b".") > MAX_DOTS for line in text.split(b"\n")):
        raise LayoutError(f"{source}: a line has more than {MAX_DOTS} dots.")
    try:
        return tomllib.loads(text.decode("utf-8")), source
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, nested without end
        raise LayoutError(f"{source}: this is not a TOML file ({error}).") from None


def _layout_from(data: Mapping[str, Any]) -> PacketLayout:
    known = {f.name for f in fields(PacketLayout)}
    check_keys("the layout", data, known)
    listed = take("the layout", data, "fields", list, [])
    if len(listed) > MAX_FIELDS:
        raise LayoutError(f"fields must list 1 to {MAX_FIELDS} fields.")
    return PacketLayout(
        name=take("the layout", data, "name", str),
        title=take("the layout", data, "title", str, ""),
        byte_order=take("the layout", data, "byte_order", str, "little"),
        header=_header(take("the layout", data, "header", str, "")),
        fields=tuple(_field_from(place, entry) for place, entry in enumerate(listed, start=1)),
        barometer=_barometer_from(take("the layout", data, "barometer", dict, None)),
        checksum=_checksum_from(take("the layout", data, "checksum", dict, None)),
        counter=take("the layout", data, "counter", str, None),
        clock=take("the layout", data, "clock", str, None),
        clock_tick_s=number("the layout", data, "clock_tick_s", 1e-6),
        rate_hz=number("the layout", data, "rate_hz", None),
    )


def _field_from(place: int, entry: Any) -> Field:
    if not isinstance(entry, Mapping):
        raise LayoutError(f"field {place} must be a table with name and type.")
    where = f"field {place}"
    name = take(where, entry, "name", str)
    where = f"field {quote(name)}"
    check_keys(where, entry, {f.name for f in fields(Field)})
    axes = take(where, entry, "axes", list, None)
    if axes is not None and not all(isinstance(a, str) for a in axes):
        raise LayoutError(f"{where}: axes must be a list of texts.")
    return Field(
        name=name,
        type=take(where, entry, "type", str),
        count=take(where, entry, "count", int, 1),
        byte_order=take(where, entry, "byte_order", str, None),
        unit=take(where, entry, "unit", str, ""),
        counts_per_unit=number(where, entry, "counts_per_unit", 1.0),
        zero=number(where, entry, "zero", 0.0),
        axes=None if axes is None else tuple(axes),
        low_bits=take(where, entry, "low_bits", int, None),
        flags=_bits(where, "flags", take(where, entry, "flags", dict, {})),
        faults=_bits(where, "faults", take(where, entry, "faults", dict, {})),
        scale_by=take(where, entry, "scale_by", str, None),
        scales=_scales(where, take(where, entry, "scales", dict, {})),
    )


def _bits(where: str, key: str, table: Mapping[str, Any]) -> tuple[tuple[str, int], ...]:
    if any(not isinstance(bit, int) or isinstance(bit, bool) for bit in table.values()):
        raise LayoutError(f"{where}: {key} must give the number of a bit for each name.")
    return tuple(table.items())


def _scales(where: str, table: Mapping[str, Any]) -> tuple[tuple[int, float], ...]:
    if len(table) > MAX_SCALES:
        raise LayoutError(f"{where}: there may be {MAX_SCALES} scales.")
    scales = []
    for key in table:
        if not _WHOLE_NUMBER.fullmatch(key):
            raise LayoutError(
                f"{where}: scales are looked up by a whole number, not by {quote(key)}."
            )
        scales.append((int(key), number(f"{where}, scales", table, key)))
    return tuple(scales)


def _barometer_from(entry: Mapping[str, Any] | None) -> Barometer | None:
    if entry is None:
        return None
    check_keys("barometer", entry, {f.name for f in fields(Barometer)})
    return Barometer(
        variant=take("barometer", entry, "variant", str),
        prom=take("barometer", entry, "prom", str, "prom"),
        d1=take("barometer", entry, "d1", str, "d1"),
        d2=take("barometer", entry, "d2", str, "d2"),
    )


def _checksum_from(entry: Mapping[str, Any] | None) -> Checksum | None:
    if entry is None:
        return None
    check_keys("checksum", entry, {f.name for f in fields(Checksum)})
    kind = take("checksum", entry, "kind", str)
    start = take("checksum", entry, "start", int, 0)
    order = take("checksum", entry, "byte_order", str, None)
    return None if kind == "none" else Checksum(kind, start, order)


def _header(text: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise LayoutError(
            f'header {quote(text)} is not hexadecimal; write bytes such as "A5 5A".'
        ) from None


def toml_lines(values: Mapping[str, Any]) -> list[str]:
    """Return the lines of a table of numbers, texts, lists of texts and tables of numbers."""
    return [f"{key} = {_toml(value)}" for key, value in values.items()]


def _toml(value: Any) -> str:
    """Write a value as JSON does; every text in a layout is printable."""
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_toml(k)} = {_toml(v)}' for k, v in value.items())} }}"
    if not isinstance(value, str):
        return json.dumps(value)
    text = json.dumps(value, ensure_ascii=False)
    return text.replace(".", "\\u002e") if text.count(".") > MAX_DOTS else text


def _without_defaults(value: Field | Barometer | Checksum) -> dict[str, Any]:
    """Return a part of a layout as a table that leaves out what the default says anyway."""
    result = {}
    for f in fields(value):
        entry = getattr(value, f.name)
        if entry == f.default:
            continue
        if f.name in ("flags", "faults", "scales"):
            entry = {str(key): value for key, value in entry}
        result[f.name] = list(entry) if f.name == "axes" else entry
    return result
