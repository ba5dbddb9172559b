"""Several kinds of packets on one port, told apart by their headers.

A receiver of two sensor units sends packets of both as they come; a waist unit sends its
accelerometer a hundred times and its barometer ten times a second. Each kind is a stream with a
name, a counter and a clock of its own, so what one unit loses does not touch the other.

A description is a TOML file with ``kind = "interleaved"`` and a table ``[[streams]]`` for each
stream, which holds what a layout of fixed-length packets holds. What stands above the tables is
true of every stream that does not say otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations
from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_protocols.counting import SequenceCounter
from firmware_protocols.decoder import SHORT_BYTES
from firmware_protocols.descriptions import take
from firmware_protocols.fields import LayoutError, quote
from firmware_protocols.framing import rows_at
from firmware_protocols.interleaved_framing import Kinds, find_many, find_short
from firmware_protocols.layout import PacketLayout, toml_lines
from firmware_protocols.packets import counts
from firmware_protocols.protocol import DecodeStats, DeviceProtocol, Packets
from firmware_protocols.rows import RowLayout, check_names
from firmware_protocols.undecided import Undecided, pieces

MAX_STREAMS = 16

_STREAM_NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")
_OWN_KEYS = ("kind", "name", "title", "streams")


@dataclass(frozen=True)
class InterleavedProtocol(DeviceProtocol):
    """Packets of several fixed layouts on one port.

    Attributes
    ----------
    name, title : str
    layouts : tuple of (str, PacketLayout)
        Name and layout of each stream, the most important first. Their headers differ, and none
        is the beginning of another.
    """

    name: str
    title: str
    layouts: tuple[tuple[str, PacketLayout], ...]

    def __post_init__(self) -> None:
        check_names(self.name, self.title)
        if not 1 <= len(self.layouts) <= MAX_STREAMS:
            raise LayoutError(f"streams must list 1 to {MAX_STREAMS} streams.")
        names = [name for name, _ in self.layouts]
        for name in names:
            _check_stream_name(name)
            if names.count(name) > 1:
                raise LayoutError(f"stream {name!r} is there twice; rename one of the two.")
        for (name, layout), (other, longer) in permutations(self.layouts, 2):
            if longer.header.startswith(layout.header):
                same = "is that" if longer.header == layout.header else "begins with that"
                raise LayoutError(
                    f"stream {other!r}: its header {same} of stream {name!r}, so nothing tells "
                    "their packets apart; give each a header of its own."
                )

    @cached_property
    def streams(self) -> Mapping[str, RowLayout]:
        """Layout of each stream by its name."""
        return dict(self.layouts)

    @property
    def longest(self) -> int:
        """Bytes of the longest packet."""
        return max(layout.length for _, layout in self.layouts)

    @property
    def proves_packets(self) -> bool:
        """Whether every stream has a checksum."""
        return all(layout.proves_packets for _, layout in self.layouts)

    @property
    def bytes_per_s(self) -> float | None:
        """Nominal bytes per second; None where a stream does not say."""
        rates = [layout.bytes_per_s for _, layout in self.layouts]
        return None if None in rates else sum(rate for rate in rates if rate is not None)

    def decoder(self) -> InterleavedDecoder:
        """Return a new decoder of what a port delivers."""
        return InterleavedDecoder(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the protocol as plain data, every stream in full."""
        streams = [{**layout.to_dict(), "name": name} for name, layout in self.layouts]
        return {"kind": "interleaved", "name": self.name, "title": self.title, "streams": streams}

    def to_toml(self) -> str:
        """Return the protocol as the text of a file that can be read back."""
        values = self.to_dict()
        streams = values.pop("streams")
        lines = toml_lines(values)
        for stream in streams:
            fields = stream.pop("fields")
            single = {key: stream.pop(key, None) for key in ("barometer", "checksum")}
            lines += ["", "[[streams]]", *toml_lines(stream)]
            for field in fields:
                lines += ["", "[[streams.fields]]", *toml_lines(field)]
            for key, table in single.items():
                if table is not None:
                    lines += ["", f"[streams.{key}]", *toml_lines(table)]
        return "\n".join(lines) + "\n"


def from_dict(data: Mapping[str, Any]) -> InterleavedProtocol:
    """Build a protocol from plain data, checking every key and type.

    Raises
    ------
    LayoutError
        For anything that is not a usable description; names the stream.
    """
    name = take("the layout", data, "name", str)
    title = take("the layout", data, "title", str, "")
    check_names(name, title)
    entries = take("the layout", data, "streams", list)
    if len(entries) > MAX_STREAMS:
        raise LayoutError(f"streams must list 1 to {MAX_STREAMS} streams.")
    shared = {key: value for key, value in data.items() if key not in _OWN_KEYS}
    layouts = tuple(
        _stream_from(number, entry, shared, name) for number, entry in enumerate(entries, start=1)
    )
    return InterleavedProtocol(name, title, layouts)


def _stream_from(
    number: int, entry: Any, shared: Mapping[str, Any], protocol: str
) -> tuple[str, PacketLayout]:
    name = entry.get("name") if isinstance(entry, Mapping) else None
    if not isinstance(name, str):
        raise LayoutError(f"stream {number} must be a table with a name and a header.")
    _check_stream_name(name)
    merged = {"title": name, **shared, **entry, "name": f"{protocol}.{name}"[:64]}
    return name, PacketLayout.from_dict(merged, source=f"stream {quote(name)}")


def _check_stream_name(name: str) -> None:
    if not _STREAM_NAME.fullmatch(name):
        raise LayoutError(
            f"stream name {quote(name)} cannot be used: take a lower-case word of up to 32 "
            "letters, digits, hyphens and underscores."
        )


class InterleavedDecoder:
    """Decoder of the bytes of one port; how they are cut into chunks never matters.

    The rule by which packets are found is in :mod:`firmware_protocols.interleaved_framing`.

    Parameters
    ----------
    protocol : InterleavedProtocol
    """

    def __init__(self, protocol: InterleavedProtocol) -> None:
        self._names = [name for name, _ in protocol.layouts]
        self._kinds = Kinds(tuple(layout for _, layout in protocol.layouts))
        self._sequences = [_sequence(layout) for layout in self._kinds.layouts]
        self._undecided = Undecided()
        self._packet_end = -1  # where the last packet ended in the stream

    @property
    def pending(self) -> int:
        """Bytes received but not decided yet: fewer than a packet and a header."""
        return len(self._undecided.tail)

    @property
    def stats(self) -> DecodeStats:
        """What everything decided so far has held, all streams together."""
        counted = [counter.stats for counter in self._sequences if counter is not None]
        return sum(counted, start=self._undecided.stats)

    def feed(self, data: bytes | bytearray | memoryview) -> dict[str, Packets]:
        """Return the packets of each stream that these next bytes complete."""
        parts = [self._feed_piece(piece) for piece in pieces(data)]
        if len(parts) == 1:
            return parts[0]
        by_name: dict[str, list[Packets]] = {}
        for part in parts:
            for name, packets in part.items():
                by_name.setdefault(name, []).append(packets)
        return {name: Packets.concatenate(found) for name, found in by_name.items()}

    def cut(self) -> None:
        """Let no packet lie on both sides of here: something may be missing before what comes.

        Whole packets stay, also one that waits for the rest of the header behind it.
        """
        tail, kinds = self._undecided.tail, self._kinds
        waiting = [kind for header, kind in kinds.by_header.items() if tail.startswith(header)]
        self._undecided.cut(kinds.layouts[waiting[0]].length if waiting else None)

    def _feed_piece(self, piece: memoryview) -> dict[str, Packets]:
        joined = self._undecided.joined(piece)
        offset = self._undecided.offset
        find = find_short if len(joined) <= SHORT_BYTES else find_many
        found = find(self._kinds, joined, in_sync=self._packet_end == offset)
        data = np.frombuffer(joined, dtype=np.uint8)
        packets: dict[str, Packets] = {}
        taken_bytes = 0
        for kind, layout in enumerate(self._kinds.layouts):
            starts = found.starts[found.kinds == kind]
            if not len(starts):
                continue
            rows = rows_at(data, starts, layout.length)
            ends = starts + (offset + layout.length)
            structured = rows.view(layout.dtype).reshape(-1)
            packets[self._names[kind]] = Packets(structured, ends)
            self._packet_end = max(self._packet_end, int(ends[-1]))
            self._count(kind, structured, rows)
            taken_bytes += rows.size
        self._undecided.decide(
            joined,
            found.decided,
            good=len(found.starts),
            taken=taken_bytes,
            corrupt=found.corrupt,
        )
        return packets

    def _count(self, kind: int, rows: npt.NDArray[np.void], table: npt.NDArray[np.uint8]) -> None:
        counter, layout = self._sequences[kind], self._kinds.layouts[kind]
        if counter is not None and layout.counter is not None:
            counter.add(counts(layout, rows, layout.counter), table)


def _sequence(layout: PacketLayout) -> SequenceCounter | None:
    if layout.counter is None:
        return None
    return SequenceCounter(1 << layout.field(layout.counter).number_bits)
