"""Bytes in any chunking to arrays of packets, with statistics of what went wrong on the way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_protocols.counting import SequenceCounter
from firmware_protocols.framing import find_many, find_short, rows_at
from firmware_protocols.layout import PacketLayout
from firmware_protocols.packets import counts
from firmware_protocols.protocol import DecodeStats, Packets
from firmware_protocols.undecided import PIECE_BYTES, Undecided, pieces

__all__ = ["PIECE_BYTES", "DecodeStats", "Packets", "SingleDecoder", "StreamDecoder"]

SHORT_BYTES = 1024
"""Up to here plain Python is quicker than arrays."""


class StreamDecoder:
    """Decoder of one byte stream; how the stream is cut into chunks never matters.

    The rule by which packets are found is in :mod:`firmware_protocols.framing`.

    Parameters
    ----------
    layout : PacketLayout
    """

    def __init__(self, layout: PacketLayout) -> None:
        self.layout = layout
        self._undecided = Undecided()
        self._packet_end = -1  # where the last packet ended in the stream
        self._sequence: SequenceCounter | None = None
        if layout.counter is not None:
            self._sequence = SequenceCounter(1 << layout.field(layout.counter).number_bits)

    @property
    def pending(self) -> int:
        """Bytes received but not decided yet: fewer than a packet and a header."""
        return len(self._undecided.tail)

    @property
    def stats(self) -> DecodeStats:
        """Statistics of everything decided so far."""
        stats = self._undecided.stats
        return stats if self._sequence is None else stats + self._sequence.stats

    def feed(self, data: bytes | bytearray | memoryview) -> Packets:
        """Return the packets that these next bytes of the stream complete."""
        parts = [self._feed_piece(piece) for piece in pieces(data)]
        if len(parts) == 1:
            rows, end = parts[0]
        elif parts:
            rows = np.concatenate([p[0] for p in parts])
            end = np.concatenate([p[1] for p in parts])
        else:
            rows, end = np.empty((0, self.layout.length), np.uint8), np.empty(0, np.int64)
        return Packets(rows.view(self.layout.dtype).reshape(-1), end)

    def cut(self) -> None:
        """Let no packet lie on both sides of here: something may be missing before what comes.

        Whole packets stay, also one that waits for the rest of the header behind it.
        """
        behind = self._undecided.tail[self.layout.length :]
        goes_on = self.layout.header.startswith(behind)
        self._undecided.cut(self.layout.length if goes_on else None)

    def _feed_piece(self, piece: memoryview) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
        joined = self._undecided.joined(piece)
        data = np.frombuffer(joined, dtype=np.uint8)
        offset = self._undecided.offset
        in_sync = self._packet_end == offset
        if len(joined) <= SHORT_BYTES:
            found = find_short(self.layout, joined, in_sync=in_sync)
        else:
            found = find_many(self.layout, data, in_sync=in_sync)
        rows = rows_at(data, found.starts, self.layout.length)
        end = found.starts + (offset + self.layout.length)
        self._undecided.decide(
            joined, found.decided, good=len(rows), taken=rows.size, corrupt=found.corrupt
        )
        if len(end):
            self._packet_end = int(end[-1])
            self._count(rows)
        return rows, end

    def _count(self, rows: npt.NDArray[Any]) -> None:
        if self._sequence is not None and self.layout.counter is not None:
            structured = rows.view(self.layout.dtype)[:, 0]
            self._sequence.add(counts(self.layout, structured, self.layout.counter), rows)


class SingleDecoder:
    """The decoder of a port with one stream, which has no name."""

    def __init__(self, layout: PacketLayout) -> None:
        self._decoder = StreamDecoder(layout)

    @property
    def pending(self) -> int:
        """Bytes received but not decided yet."""
        return self._decoder.pending

    @property
    def stats(self) -> DecodeStats:
        """What everything decided so far has held."""
        return self._decoder.stats

    def feed(self, data: bytes | bytearray | memoryview) -> Mapping[str, Packets]:
        """Return the packets that these next bytes of the stream complete."""
        return {"": self._decoder.feed(data)}

    def cut(self) -> None:
        """Let no packet lie on both sides of here."""
        self._decoder.cut()
