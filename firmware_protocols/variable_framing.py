"""Finding checksummed frames of variable length in a stream of bytes.

The rule is that of :mod:`firmware_protocols.framing`, the same however the stream was cut into
chunks: at position p, if a header stands there and the frame is good, it is a frame and p moves
past it; otherwise p moves on by one. A position is decided as soon as the whole frame that its
header announces is there. A header that announces more than the format's longest frame is none,
so that a length that lies holds back no more bytes than that.

What a header looks like, how long its frame is and whether that is good is up to a
:class:`FrameFormat`. The rule is here twice: in plain Python, quickest for the few frames of a
live chunk, and with arrays for long stretches.

:class:`FrameDecoder` applies it to a stream, whatever the frames say.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from firmware_protocols.checksums import rows_per_block
from firmware_protocols.decoder import SHORT_BYTES, DecodeStats, Packets
from firmware_protocols.undecided import Undecided, pieces

Bytes = npt.NDArray[np.uint8]
Positions = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

FEW_FRAMES = 6
"""Up to so many frames of one length are checked one by one: quicker than arrays."""

SEARCHES = 4
"""So many times at most the checksums are worked out; the last time those of all headers."""

_UNKNOWN, _GOOD, _BAD = 0, 1, 2


class FrameFormat(Protocol):
    """What the frames of a protocol look like."""

    @property
    def longest(self) -> int:
        """Bytes of the longest frame."""

    @property
    def head(self) -> int:
        """So many bytes from its beginning tell the length of any frame."""

    @property
    def header(self) -> re.Pattern[bytes]:
        """Matches where a frame may begin, also where the stretch ends within the header."""

    def length(self, data: bytes, at: int) -> int | None:
        """Return the bytes of the frame that begins at ``at``, where the header matches.

        0 if no frame can begin like this, for example one longer than the longest; None if the
        stretch ends before that can be told.
        """

    def is_good(self, frame: bytes) -> bool:
        """Return whether a frame that has all its bytes is good."""

    def candidates(self, data: Bytes) -> Positions:
        """Return where in a stretch the header matches and ``head`` bytes are there, in order."""

    def lengths(self, data: Bytes, at: Positions) -> Positions:
        """Return what :meth:`length` says of each candidate."""

    def good(self, rows: Bytes) -> Flags:
        """Return which frames of one length are good; ``rows`` of shape (n, length)."""


@dataclass(frozen=True)
class Frames:
    """What a stretch of bytes holds.

    Attributes
    ----------
    starts, lengths : shape (n,)
        Where the frames begin, in order, and how many bytes each has.
    decided : int
        The first undecided position; the length of the stretch if there is none.
    corrupt : int
        Decided positions with a header but no good frame.
    """

    starts: Positions
    lengths: Positions
    decided: int
    corrupt: int


def find_frames(form: FrameFormat, data: bytes) -> Frames:
    """Find the frames of a stretch of bytes that begins at an undecided position."""
    if len(data) <= SHORT_BYTES:
        return find_short(form, data)
    return find_many(form, data)


def find_short(form: FrameFormat, data: bytes) -> Frames:
    """Find the frames of a short stretch, one after the other."""
    starts, lengths = [], []
    position = corrupt = 0
    while True:
        match = form.header.search(data, position)
        if match is None:
            position = len(data)
            break
        position = match.start()
        length = form.length(data, position)
        if length is None or position + length > len(data):
            break
        if length and form.is_good(data[position : position + length]):
            starts.append(position)
            lengths.append(length)
            position += length
        else:
            corrupt += 1
            position += 1
    return Frames(np.array(starts, np.int64), np.array(lengths, np.int64), position, corrupt)


def find_many(form: FrameFormat, data: bytes) -> Frames:
    """Find the frames of a long stretch; same result as :func:`find_short`.

    Headers inside frames need no checksum: first every frame is believed whose header stands where
    the search arrives. Then the checksums of those are worked out, all of one length together, and
    the search begins anew with what is known by then.
    """
    array = np.frombuffer(data, dtype=np.uint8)
    at = form.candidates(array)
    lengths = form.lengths(array, at)
    ends = at + lengths
    whole = ends <= len(data)
    following = np.searchsorted(at, ends)
    known = np.where(lengths == 0, _BAD, _UNKNOWN)
    visited, stopped = _search(following, whole, known)
    for search in range(1, SEARCHES + 1):
        unknown = visited[known[visited] == _UNKNOWN]
        if search == SEARCHES:
            unknown = np.flatnonzero(whole & (known == _UNKNOWN))
        _check(form, array, at, lengths, unknown, known)
        if bool((known[unknown] == _GOOD).all()):
            break
        visited, stopped = _search(following, whole, known)
    good = known[visited] == _GOOD
    taken = visited[good]
    found = Frames(at[taken], lengths[taken], 0, int(np.count_nonzero(~good)))
    if stopped < len(at):
        return replace(found, decided=int(at[stopped]))
    if not len(visited):
        position = 0
    else:
        position = int(ends[visited[-1]]) if good[-1] else int(at[visited[-1]]) + 1
    return _append(found, position, find_short(form, data[position:]))


def _search(following: Positions, whole: Flags, known: Positions) -> tuple[Positions, int]:
    """Return the headers at which the rule arrives, and the one at which it must wait.

    Whatever is not known to be bad is taken for good. All in indices of the candidates.
    """
    after, is_whole, is_bad = following.tolist(), whole.tolist(), (known == _BAD).tolist()
    visited = []
    at = 0
    while at < len(after) and is_whole[at]:
        visited.append(at)
        at = at + 1 if is_bad[at] else after[at]
    return np.array(visited, dtype=np.int64), at


def _check(
    form: FrameFormat,
    data: Bytes,
    at: Positions,
    lengths: Positions,
    which: Positions,
    known: Positions,
) -> None:
    """Find out which of these frames are good and enter that in ``known``."""
    for length, group in _by_length(lengths, which):
        if len(group) <= FEW_FRAMES:
            for index in group.tolist():
                start = int(at[index])
                good = form.is_good(data[start : start + length].tobytes())
                known[index] = _GOOD if good else _BAD
            continue
        per_block = rows_per_block(length)
        for block in range(0, len(group), per_block):
            some = group[block : block + per_block]
            rows = gather(data, at[some], length)
            known[some] = np.where(form.good(rows), _GOOD, _BAD)


def _by_length(lengths: Positions, which: Positions) -> Iterator[tuple[int, Positions]]:
    """Yield every length that is there and the indices that have it, each in order."""
    if not len(which):
        return
    if len(which) == 1:
        yield int(lengths[which[0]]), which
        return
    order = which[np.argsort(lengths[which], kind="stable")]
    found, first = np.unique(lengths[order], return_index=True)
    yield from zip(found.tolist(), np.split(order, first[1:]), strict=True)


def gather(data: Bytes, starts: Positions, length: int) -> Bytes:
    """Return a copy of the ``length`` bytes from each start, shape (n, length)."""
    windows = np.ndarray((len(data) - length + 1,), f"V{length}", data, strides=(1,))
    return windows[starts].view(np.uint8).reshape(len(starts), length)


def _append(found: Frames, position: int, rest: Frames) -> Frames:
    return Frames(
        np.concatenate([found.starts, rest.starts + position]),
        np.concatenate([found.lengths, rest.lengths]),
        rest.decided + position,
        found.corrupt + rest.corrupt,
    )


@dataclass(frozen=True)
class FramedBytes:
    """A stretch of bytes and the frames in it.

    Attributes
    ----------
    data : shape (m,), uint8
        The stretch.
    starts, lengths : shape (n,)
        Where in the stretch the frames begin, in order, and how many bytes each has.
    offset : int
        Bytes of the stream before the stretch.
    """

    data: Bytes
    starts: Positions
    lengths: Positions
    offset: int

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.starts)

    @property
    def end(self) -> Positions:
        """Bytes of the stream up to and including each frame, shape (n,)."""
        return self.starts + self.lengths + self.offset

    def by_length(self) -> Iterator[tuple[Positions, Bytes]]:
        """Yield the frames of each length: their indices, in order, and rows of their bytes."""
        for length, group in _by_length(self.lengths, np.arange(len(self), dtype=np.int64)):
            yield group, gather(self.data, self.starts[group], length)


class FrameDecoder(ABC):
    """Decoder of a byte stream of variable frames; how it is cut into chunks never matters.

    What the frames say is up to the protocol: see :meth:`_read`.

    Parameters
    ----------
    form : FrameFormat
    """

    def __init__(self, form: FrameFormat) -> None:
        self._form = form
        self._undecided = Undecided()

    @abstractmethod
    def _read(self, frames: FramedBytes) -> dict[str, Packets]:
        """Return the packets of every stream that these next frames hold, in order."""

    @property
    def pending(self) -> int:
        """Bytes received but not decided yet: fewer than the longest frame has."""
        return len(self._undecided.tail)

    @property
    def stats(self) -> DecodeStats:
        """Statistics of the frames decided so far; ``good`` counts frames of every kind."""
        return self._undecided.stats

    def feed(self, data: bytes | bytearray | memoryview) -> dict[str, Packets]:
        """Return the packets of each stream that these next bytes complete."""
        parts = [self._feed_piece(piece) for piece in list(pieces(data)) or [memoryview(b"")]]
        if len(parts) == 1:
            return parts[0]
        return {name: Packets.concatenate([part[name] for part in parts]) for name in parts[0]}

    def cut(self) -> None:
        """Let no frame lie on both sides of here: something may be missing before what comes."""
        self._undecided.cut()

    def _feed_piece(self, piece: memoryview) -> dict[str, Packets]:
        joined = self._undecided.joined(piece)
        found = find_frames(self._form, joined)
        data = np.frombuffer(joined, dtype=np.uint8)
        frames = FramedBytes(data, found.starts, found.lengths, self._undecided.offset)
        self._undecided.decide(
            joined,
            found.decided,
            good=len(found.starts),
            taken=int(found.lengths.sum()),
            corrupt=found.corrupt,
        )
        return self._read(frames)
