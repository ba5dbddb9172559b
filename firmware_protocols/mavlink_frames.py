"""Frames of MAVLink 1 and 2, and the content of the messages in them.

MAVLink 1: ``FE`` length sequence system component message, payload, checksum. MAVLink 2: ``FD``
length incompatible-flags compatible-flags sequence system component message (3 bytes), payload
without its trailing zeros, checksum, and 13 bytes of signature if flag 1 says so. A frame with any
other incompatible flag is laid out in a way that nobody here knows, and is none.

The checksum is the CRC of X.25 without the last inversion (6F91 for "123456789") over everything
after the first byte and then CRC_EXTRA, a digest of the message's definition: only frames of known
messages can be checked. An unknown message is passed over byte by byte as garbage is, so that it
can never take a sound frame with it. It is not counted as garbage if it, or a few of them, fill the
space between two sound frames exactly; a known message with a wrong checksum always is.

Signatures are not verified: that takes the key, and whoever can write to the cable can do more.

Sources: mavlink.io, "Packet serialization" and "Message signing"; pymavlink 2.4.50.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from firmware_protocols.checksums import checksum_rows, fast_checksum
from firmware_protocols.mavlink_messages import CHECKS, Message
from firmware_protocols.protocol import DecodeStats, Packets
from firmware_protocols.variable_framing import Bytes, Flags, FramedBytes, FrameDecoder, Positions

VERSION_1, VERSION_2 = 0xFE, 0xFD
SIGNED = 0x01
SIGNATURE_BYTES = 13
CRC_KIND = "crc16-mcrf4xx"

_HEAD_1, _HEAD_2, _CRC = 6, 10, 2
_CRC_OF = fast_checksum(CRC_KIND)

MOST_UNKNOWN_BYTES = 4096
"""So much between two sound frames may be unknown messages; more is garbage."""

FEW_FRAMES = 16
"""Up to here plain Python is quicker than arrays."""

_NUMBERS = np.array(sorted(CHECKS), dtype=np.int64)
_EXTRAS = np.array([CHECKS[number].crc_extra for number in _NUMBERS.tolist()], dtype=np.uint8)
_BASE = np.full(256, 256, dtype=np.int64)
_EXTENDED = np.full(256, -1, dtype=np.int64)
for _number, _check in CHECKS.items():
    if _check.base:
        _BASE[_number], _EXTENDED[_number] = _check.base, _check.extended

Rows = npt.NDArray[np.void]


class MavlinkFormat:
    """What the frames look like, for :mod:`firmware_protocols.variable_framing`."""

    shortest = _HEAD_1 + 1 + _CRC
    longest = _HEAD_2 + 255 + _CRC + SIGNATURE_BYTES
    head = _HEAD_2
    header = re.compile(rb"[\xfd\xfe]")

    def length(self, data: bytes, at: int) -> int | None:
        """Return the bytes of the frame at ``at``; 0 for an unknown message, None if untold."""
        left = len(data) - at
        if data[at] == VERSION_1:
            if left < _HEAD_1:
                return None
            size, check = data[at + 1], CHECKS.get(data[at + 5])
            known = check is not None and check.base and check.base <= size <= check.extended
            return _HEAD_1 + size + _CRC if known else 0
        if left < _HEAD_2:
            return None
        if data[at + 2] & ~SIGNED or _number_2(data, at) not in CHECKS:
            return 0
        return _length_2(data, at)

    def is_good(self, frame: bytes) -> bool:
        """Return whether the checksum holds."""
        if frame[0] == VERSION_1:
            end, number = _HEAD_1 + frame[1], frame[5]
        else:
            end, number = _HEAD_2 + frame[1], _number_2(frame, 0)
        covered = frame[1:end] + bytes([CHECKS[number].crc_extra])
        return _CRC_OF(covered) == frame[end] | frame[end + 1] << 8

    def candidates(self, data: Bytes) -> Positions:
        """Return where a frame may begin and ten bytes are there."""
        found: Positions
        head = data[: max(0, len(data) - self.head + 1)]
        found = np.flatnonzero((head == VERSION_2) | (head == VERSION_1))
        return found

    def lengths(self, data: Bytes, at: Positions) -> Positions:
        """Return the bytes of each frame, 0 for unknown messages."""
        size = data[at + 1].astype(np.int64)
        number_1 = data[at + 5]
        known_1 = (_BASE[number_1] <= size) & (size <= _EXTENDED[number_1])
        length_1 = np.where(known_1, _HEAD_1 + size + _CRC, 0)
        flags = data[at + 2]
        number_2 = (
            data[at + 7].astype(np.int64)
            | data[at + 8].astype(np.int64) << 8
            | data[at + 9].astype(np.int64) << 16
        )
        known_2 = _is_known(number_2) & (flags & ~np.uint8(SIGNED) == 0)
        length_2 = _HEAD_2 + size + _CRC + SIGNATURE_BYTES * (flags & SIGNED).astype(np.int64)
        return np.where(data[at] == VERSION_1, length_1, np.where(known_2, length_2, 0))

    def good(self, rows: Bytes) -> Flags:
        """Return whether each checksum holds; ``rows`` of shape (n, length)."""
        holds = np.zeros(len(rows), dtype=np.bool_)
        for part in _alike(rows):
            covered = rows[part.which, 1 : part.end + 1]  # its last byte, of the CRC, is replaced
            covered[:, -1] = _EXTRAS[np.searchsorted(_NUMBERS, part.number)]
            sent = rows[part.which, part.end : part.end + 2].copy().view("<u2")[:, 0]
            holds[part.which] = checksum_rows(CRC_KIND, covered) == sent
        return holds


MAVLINK_FORMAT = MavlinkFormat()


def _number_2(data: bytes, at: int) -> int:
    return data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16


def _length_2(data: bytes, at: int) -> int:
    signature = SIGNATURE_BYTES if data[at + 2] & SIGNED else 0
    return _HEAD_2 + data[at + 1] + _CRC + signature


def _is_known(number: Positions) -> Flags:
    place = np.minimum(np.searchsorted(_NUMBERS, number), len(_NUMBERS) - 1)
    known: Flags = _NUMBERS[place] == number
    return known


@dataclass(frozen=True)
class _Alike:
    """Frames of one length, one version, and all signed or none: their parts lie alike.

    Attributes
    ----------
    which : shape (n,)
        Rows of the table.
    version : int
    start, end : int
        Where the payload lies.
    number : shape (n,)
        Of each message.
    """

    which: Positions
    version: int
    start: int
    end: int
    number: Positions


def _alike(rows: Bytes) -> Iterable[_Alike]:
    """Yield the frames of a table of one length, those of one kind together."""
    length = rows.shape[1]
    old = rows[:, 0] == VERSION_1
    if bool(old.any()):
        which = np.flatnonzero(old)
        yield _Alike(which, 1, _HEAD_1, length - _CRC, rows[which, 5].astype(np.int64))
    if not bool(old.all()):
        signed = (rows[:, 2] & SIGNED) != 0
        for kind, more in ((~signed, 0), (signed, SIGNATURE_BYTES)):
            which = np.flatnonzero(kind & ~old)
            if len(which):
                number = rows[which, 7:10].astype(np.int64) @ np.array([1, 1 << 8, 1 << 16])
                yield _Alike(which, 2, _HEAD_2, length - _CRC - more, number)


@dataclass(frozen=True)
class Contents:
    """All frames of one message in a stretch, in order.

    Attributes
    ----------
    index : shape (n,)
        Which of the frames of the stretch.
    version : shape (n,)
        Of MAVLink, 1 or 2.
    system, component : shape (n,)
        Who sent each.
    payload : shape (n,), structured
        Of the message's dtype; what was not sent is zero.
    """

    index: Positions
    version: Positions
    system: Positions
    component: Positions
    payload: Rows

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.index)

    def taken(self, which: Flags) -> Contents:
        """Return some of the frames."""
        if bool(which.all()):
            return self
        return Contents(
            self.index[which],
            self.version[which],
            self.system[which],
            self.component[which],
            self.payload[which],
        )


def read_senders(frames: FramedBytes) -> tuple[Positions, Positions, Positions]:
    """Return system, component and sequence number of every frame."""
    data, at = frames.data, frames.starts
    sequence = at + np.where(data[at] == VERSION_1, 2, 4)
    return (
        data[sequence + 1].astype(np.int64),
        data[sequence + 2].astype(np.int64),
        data[sequence].astype(np.int64),
    )


def no_contents(message: Message) -> Contents:
    """Return the content of no frame."""
    none = np.empty(0, dtype=np.int64)
    return Contents(none, none, none, none, np.empty(0, dtype=message.dtype))


def read_contents(frames: FramedBytes, messages: Iterable[Message]) -> dict[str, Contents]:
    """Return the content of some messages by their names; one that does not occur is left out."""
    wanted = {message.number: message for message in messages}
    if len(frames) <= FEW_FRAMES:
        return _read_few(frames, wanted)
    found: dict[int, list[Contents]] = {}
    for index, rows in frames.by_length():
        for part in _alike(rows):
            for number in np.unique(part.number).tolist():
                if number in wanted:
                    which = part.which[part.number == number]
                    contents = _contents(wanted[number], part, rows[which], index[which])
                    found.setdefault(number, []).append(contents)
    return {wanted[number].name: _in_order(parts) for number, parts in found.items()}


def _read_few(frames: FramedBytes, wanted: Mapping[int, Message]) -> dict[str, Contents]:
    """Do the same one frame after the other, quicker for a live chunk."""
    data = frames.data.tobytes()
    heads: dict[int, list[tuple[int, int, int, int]]] = {}
    payloads: dict[int, list[bytes]] = {}
    for index, at in enumerate(frames.starts.tolist()):
        if data[at] == VERSION_1:
            version, start, number, who = 1, at + _HEAD_1, data[at + 5], at + 3
        else:
            version, start, number, who = 2, at + _HEAD_2, _number_2(data, at), at + 5
        if number in wanted:
            size = wanted[number].dtype.itemsize
            sent = data[start : start + min(data[at + 1], size)]
            payloads.setdefault(number, []).append(sent.ljust(size, b"\0"))
            heads.setdefault(number, []).append((index, version, data[who], data[who + 1]))
    found = {}
    for number, message in wanted.items():
        if number in heads:
            payload = np.frombuffer(b"".join(payloads[number]), dtype=message.dtype)
            index, version, system, component = np.array(heads[number], dtype=np.int64).T
            found[message.name] = Contents(index, version, system, component, payload)
    return found


def _contents(message: Message, part: _Alike, rows: Bytes, index: Positions) -> Contents:
    size = message.dtype.itemsize
    sent = rows[:, part.start : min(part.end, part.start + size)]
    payload = np.zeros((len(rows), size), dtype=np.uint8)
    payload[:, : sent.shape[1]] = sent
    place = 3 if part.version == 1 else 5
    return Contents(
        index,
        np.full(len(rows), part.version),
        rows[:, place].astype(np.int64),
        rows[:, place + 1].astype(np.int64),
        payload.view(message.dtype)[:, 0],
    )


def _in_order(parts: list[Contents]) -> Contents:
    if len(parts) == 1:
        return parts[0]
    index = np.concatenate([part.index for part in parts])
    order = np.argsort(index)
    return Contents(
        index[order],
        np.concatenate([part.version for part in parts])[order],
        np.concatenate([part.system for part in parts])[order],
        np.concatenate([part.component for part in parts])[order],
        np.concatenate([part.payload for part in parts])[order],
    )


class MavlinkFrameDecoder(FrameDecoder):
    """Decoder of frames that tells unknown messages from garbage; see the module."""

    def __init__(self) -> None:
        super().__init__(MAVLINK_FORMAT)
        self.unknown = 0  # messages
        self._unknown_bytes = self._unknown_headers = 0
        self._last_end = -1  # of the last sound frame in the stream; -1 where nothing is known
        self._since = b""  # all bytes after it, as far as they may be unknown messages

    @property
    def stats(self) -> DecodeStats:
        """Statistics of the frames decided so far, unknown messages left out."""
        stats = super().stats
        headers, size = self._unknown_headers, self._unknown_bytes
        if self._last_end >= 0:  # what follows the last frame may yet turn out to be unknown
            decided = self._since[: self._undecided.offset - self._last_end]
            if _unknown_messages(decided, cut_short=True) is not None:
                headers += _headers(decided)
                size += len(decided)
        return DecodeStats(stats.good, stats.corrupt - headers, stats.skipped_bytes - size)

    def cut(self) -> None:
        """Let no frame lie on both sides of here: something may be missing before what comes."""
        decided = self._undecided.offset
        super().cut()
        if self._last_end >= 0:
            self._settle(self._since[: decided - self._last_end], cut_short=True)
        self._last_end, self._since = -1, b""

    def _note_gaps(self, frames: FramedBytes) -> None:
        """Look at what lies between the sound frames."""
        starts, ends = frames.starts, frames.starts + frames.lengths
        data = frames.data
        if self._last_end >= 0:
            kept = self._since[: frames.offset - self._last_end]
            first = int(starts[0]) if len(starts) else len(data)
            room = max(0, MOST_UNKNOWN_BYTES + 1 - len(kept))
            self._since = kept + data[: min(first, room)].tobytes()
            if len(starts):
                self._settle(self._since)
        for place in np.flatnonzero(starts[1:] > ends[:-1]).tolist():
            stop = min(int(starts[place + 1]), int(ends[place]) + MOST_UNKNOWN_BYTES + 1)
            self._settle(data[int(ends[place]) : stop].tobytes())
        if len(starts):
            last = int(ends[-1])
            self._last_end = frames.offset + last
            self._since = data[last : last + MOST_UNKNOWN_BYTES + 1].tobytes()
        if len(self._since) > MOST_UNKNOWN_BYTES:
            self._last_end, self._since = -1, b""

    def _settle(self, between: bytes, *, cut_short: bool = False) -> None:
        number = _unknown_messages(between, cut_short=cut_short)
        if number is not None:
            self.unknown += number
            self._unknown_bytes += len(between)
            self._unknown_headers += _headers(between)

    def _read(self, frames: FramedBytes) -> dict[str, Packets]:
        self._note_gaps(frames)
        return {}


def _headers(data: bytes) -> int:
    return data.count(VERSION_1) + data.count(VERSION_2)


def _unknown_messages(data: bytes, *, cut_short: bool = False) -> int | None:
    """Return how many unknown messages fill these bytes exactly; None if they do not.

    Parameters
    ----------
    data : bytes
    cut_short : bool
        Whether the last one may lack its end.
    """
    if len(data) > MOST_UNKNOWN_BYTES:
        return None
    at = number = 0
    while at < len(data):
        left = len(data) - at
        if data[at] == VERSION_1:
            if left < _HEAD_1:
                return number if cut_short else None
            check = CHECKS.get(data[at + 5])
            if check is not None and check.base:
                return None
            at += _HEAD_1 + data[at + 1] + _CRC
        elif data[at] == VERSION_2:
            if left < _HEAD_2:
                return number if cut_short else None
            if data[at + 2] & ~SIGNED or _number_2(data, at) in CHECKS:
                return None
            at += _length_2(data, at)
        else:
            return None
        number += 1
    if at > len(data):
        return number - 1 if cut_short else None
    return number
