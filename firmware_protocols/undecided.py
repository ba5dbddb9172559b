"""What a decoder keeps between two chunks: the bytes that wait for more, and its counts."""

from __future__ import annotations

from collections.abc import Iterator

from firmware_protocols.protocol import DecodeStats

PIECE_BYTES = 1 << 20
"""Longer input is worked through in pieces of this size: temporary memory stays bounded."""


class Undecided:
    """The bytes of a stream that are not decided yet, and what those before them held.

    Attributes
    ----------
    tail : bytes
        What waits for more.
    offset : int
        Where in the stream it begins.
    """

    def __init__(self) -> None:
        self.tail = b""
        self.offset = 0
        self._good = 0
        self._corrupt = 0
        self._skipped = 0

    @property
    def stats(self) -> DecodeStats:
        """Counts of everything decided so far."""
        return DecodeStats(self._good, self._corrupt, self._skipped)

    def joined(self, piece: memoryview) -> bytes:
        """Return the stretch to look at: what waits, and the next piece behind it."""
        return b"".join((self.tail, piece))

    def decide(self, stretch: bytes, decided: int, *, good: int, taken: int, corrupt: int) -> None:
        """Keep what is left of a stretch.

        Parameters
        ----------
        stretch : bytes
            As :meth:`joined` gave it.
        decided : int
            The first position that is not.
        good, taken : int
            Packets found, and how many bytes they have together.
        corrupt : int
            Headers without a good packet.
        """
        self._good += good
        self._corrupt += corrupt
        self._skipped += decided - taken
        self.tail = stretch[decided:]
        self.offset += decided

    def cut(self, length: int | None = None) -> None:
        """Drop what waits: something is missing behind it.

        Parameters
        ----------
        length : int, optional
            Of a whole packet at the beginning of what waits, which stays. It waits for the header
            of the next one, of which bytes may have come: those are dropped, and the packet ends
            where they did.
        """
        whole = self.tail[:length] if length is not None and length <= len(self.tail) else b""
        dropped = len(self.tail) - len(whole)
        self._skipped += dropped
        self.offset += dropped
        self.tail = whole


def pieces(data: bytes | bytearray | memoryview) -> Iterator[memoryview]:
    """Yield bytes in pieces of a bounded size, nothing of none."""
    view = memoryview(data).cast("B")
    for start in range(0, len(view), PIECE_BYTES):
        yield view[start : start + PIECE_BYTES]
