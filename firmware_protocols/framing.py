"""Finding the packets in a stretch of bytes, greedily from its beginning.

The rule, the same however the stream was cut into chunks: at position p, if the header stands
there and the packet is good, it is a packet and p moves past it; otherwise p moves on by one.
A packet with a checksum is good if that is right. A packet without one is good if the packet
before it ended at p ("in sync") or if another header follows right behind it.

A position is decided once a whole packet's bytes follow it. Only a header that waits for the next
header (no checksum, not in sync) needs as many bytes more as the header has. What is undecided at
the end of a stretch is left for the next one.

:func:`find_short` is that rule in plain Python, quickest for the few packets of a live chunk;
:func:`find_many` says the same of a long stretch with arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from firmware_protocols.checksums import BLOCK_BYTES, checksum_rows, fast_checksum
from firmware_protocols.layout import PacketLayout

Bytes = npt.NDArray[np.uint8]
Positions = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Found:
    """What a stretch of bytes holds.

    Attributes
    ----------
    starts : shape (n,), increasing
        Where the packets begin.
    decided : int
        The first undecided position.
    corrupt : int
        Decided positions with a header but no good packet.
    """

    starts: Positions
    decided: int
    corrupt: int


def find_short(layout: PacketLayout, data: bytes, *, in_sync: bool) -> Found:
    """Find the packets of a short stretch; ``in_sync`` if a packet ended right before it."""
    header, length, check = layout.header, layout.length, layout.checksum
    last = len(data) - length
    starts: list[int] = []
    corrupt = 0
    position = 0
    packet_end = 0 if in_sync else -1
    while position <= last:
        at = data.find(header, position, last + len(header))
        if at < 0:
            position = last + 1
            break
        position = at
        end = position + length
        if check is not None:
            body = data[position + check.start : end - check.size]
            sent = int.from_bytes(data[end - check.size : end], layout.checksum_order)
            good = fast_checksum(check.kind)(body) == sent
        elif position == packet_end:
            good = True
        elif len(data) < end + len(header):
            break
        else:
            good = data.startswith(header, end)
        if good:
            starts.append(position)
            position = packet_end = end
        else:
            corrupt += 1
            position += 1
    return Found(np.array(starts, dtype=np.int64), position, corrupt)


def find_many(layout: PacketLayout, data: Bytes, *, in_sync: bool) -> Found:
    """Find the packets of a long stretch; same result as :func:`find_short`."""
    last = len(data) - layout.length
    if last < 0:
        return Found(np.empty(0, dtype=np.int64), 0, 0)
    headers = _headers(data, layout.header)
    if layout.checksum is None:
        return _find_unchecked(layout, headers, last, in_sync=in_sync)
    headers = headers[: np.searchsorted(headers, last, side="right")]
    good = _checksum_holds(layout, data, headers)
    starts = _without_overlap(headers[good], layout.length)
    rejected = headers[~good]
    if not len(starts):
        return Found(starts, last + 1, len(rejected))
    corrupt = len(rejected) - _covered(rejected, starts, layout.length)
    return Found(starts, max(int(starts[-1]) + layout.length, last + 1), corrupt)


def rows_at(data: Bytes, starts: Positions, length: int) -> Bytes:
    """Return a copy of the ``length`` bytes from each start, shape (n, length)."""
    number = len(starts)
    if number and int(starts[-1]) - int(starts[0]) == (number - 1) * length:
        first = int(starts[0])
        if number == 1 or bool((np.diff(starts) == length).all()):
            return data[first : first + number * length].reshape(number, length).copy()
    return _windows(data, length)[starts].view(np.uint8).reshape(number, length)


def _windows(data: Bytes, length: int) -> npt.NDArray[np.void]:
    """Return every packet-long window of the data as one opaque item, without copying."""
    count = max(0, len(data) - length + 1)
    return np.ndarray((count,), dtype=f"V{length}", buffer=data, strides=(1,))


def _headers(data: Bytes, header: bytes) -> Positions:
    count = len(data) - len(header) + 1
    match = data[:count] == header[0]
    for place in range(1, len(header)):
        match &= data[place : place + count] == header[place]
    return np.flatnonzero(match)


def _checksum_holds(layout: PacketLayout, data: Bytes, at: Positions) -> npt.NDArray[np.bool_]:
    check = layout.checksum
    assert check is not None
    good = np.empty(len(at), dtype=bool)
    per_block = max(1, BLOCK_BYTES // layout.length)
    for start in range(0, len(at), per_block):
        rows = rows_at(data, at[start : start + per_block], layout.length)
        sent = rows.view(layout.dtype)["checksum"][:, 0]
        covered = rows[:, check.start : layout.length - check.size]
        good[start : start + per_block] = checksum_rows(check.kind, covered) == sent
    return good


def _without_overlap(at: Positions, length: int) -> Positions:
    """Return the positions that are left when each takes ``length`` bytes, first come first."""
    if len(at) < 2 or bool((np.diff(at) >= length).all()):
        return at
    kept = []
    free = 0
    for position in at.tolist():
        if position >= free:
            kept.append(position)
            free = position + length
    return np.array(kept, dtype=np.int64)


def _covered(at: Positions, starts: Positions, length: int) -> int:
    """Return how many positions lie inside the packets that begin at ``starts``."""
    before = np.searchsorted(starts, at, side="right") - 1
    inside = (before >= 0) & (at < starts[before] + length)
    return int(np.count_nonzero(inside))


def _find_unchecked(layout: PacketLayout, headers: Positions, last: int, *, in_sync: bool) -> Found:
    length = layout.length
    is_header = np.zeros(last + 2 * length + 1, dtype=bool)
    is_header[headers] = True
    headers = headers[: np.searchsorted(headers, last, side="right")]
    waits_from = last - len(layout.header) + 1  # the bytes of a following header are not all there
    confirmed = is_header[headers + length] & (headers < waits_from)
    follows = (headers >= length) & is_header[headers - length]
    if in_sync:
        follows |= headers == 0
    return _walk(layout, headers, confirmed, follows, last, waits_from, in_sync=in_sync)


def _walk(
    layout: PacketLayout,
    headers: Positions,
    confirmed: npt.NDArray[np.bool_],
    follows: npt.NDArray[np.bool_],
    last: int,
    waits_from: int,
    *,
    in_sync: bool,
) -> Found:
    """Take headers in order: those confirmed, and those that a taken packet leads to."""
    length = layout.length
    if len(headers) and _is_plain(headers, confirmed | follows, length):
        return Found(headers, max(int(headers[-1]) + length, last + 1), 0)
    starts: list[int] = []
    corrupt = 0
    free = 0
    packet_end = 0 if in_sync else -1
    for position, sure in zip(headers.tolist(), confirmed.tolist(), strict=True):
        if position < free:
            continue
        if sure or position == packet_end:
            starts.append(position)
            free = packet_end = position + length
        elif position >= waits_from:
            return Found(np.array(starts, dtype=np.int64), position, corrupt)
        else:
            corrupt += 1
    return Found(np.array(starts, dtype=np.int64), max(free, last + 1), corrupt)


def _is_plain(headers: Positions, taken: npt.NDArray[np.bool_], length: int) -> bool:
    """Return whether every header is a packet and none of them overlap."""
    return bool(taken.all()) and bool((np.diff(headers) >= length).all())
