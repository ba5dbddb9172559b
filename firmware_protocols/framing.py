"""Finding the packets in a stretch of bytes, greedily from its beginning.

The rule, the same however the stream was cut into chunks: at position p, if the header stands
there and the packet is good, it is a packet and p moves past it; otherwise p moves on by one.
A packet with a checksum is good if that is right. A packet without one is good if the packet
before it ended at p ("in sync") or if another header follows right behind it.

A position is decided once a whole packet's bytes follow it. Only a header that waits for the next
header (no checksum, not in sync) needs as many bytes more as the header has. What is undecided at
the end of a stretch is left for the next one.

What that costs is bounded by the length of a packet, not by that of the stream: at worst every
byte looks like a header, as "A5" does in a run of A5, and takes a checksum over a whole packet.
With packets of 4096 bytes and a header of one byte that is about 60 kB/s. This is accepted, since
no device sends it and whoever reads a port takes few bytes at a time; a header of two different
bytes makes it half as bad, and short packets make it harmless.

:func:`find_short` is that rule in plain Python, quickest for the few packets of a live chunk;
:func:`find_many` says the same of a long stretch with arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from firmware_protocols.checksums import checksum_rows, fast_checksum, rows_per_block
from firmware_protocols.layout import PacketLayout

Bytes = npt.NDArray[np.uint8]
Positions = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


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
    run = _unbroken_run(layout, data) if in_sync or layout.checksum else 0
    first = np.arange(run, dtype=np.int64) * layout.length
    skipped = run * layout.length
    rest = data[skipped:]
    if len(rest) < layout.length:
        return Found(first, skipped, 0)
    found = _find_checked(layout, rest) if layout.checksum else _find_unchecked(layout, rest)
    starts = np.concatenate([first, found.starts + skipped])
    return Found(starts, found.decided + skipped, found.corrupt)


def _unbroken_run(layout: PacketLayout, data: Bytes) -> int:
    """Return how many packets stand one right behind the other from the beginning on."""
    number = len(data) // layout.length
    rows = data[: number * layout.length].reshape(number, layout.length)
    run = 0
    per_block = rows_per_block(layout.length)
    while run < number:
        block = rows[run : run + per_block]
        match = np.ones(len(block), dtype=bool)
        for place, byte in enumerate(layout.header):
            match &= block[:, place] == byte
        good = _leading(match)
        if layout.checksum:
            good = _leading(_checksum_holds(layout, block[:good]))
        run += good
        if good < len(block):
            break
    return run


def _leading(flags: Flags) -> int:
    """Return how many flags are set before the first that is not."""
    return len(flags) if bool(flags.all()) else int(flags.argmin())


def _find_checked(layout: PacketLayout, data: Bytes) -> Found:
    last = len(data) - layout.length
    headers = _headers(data, layout.header)
    headers = headers[: np.searchsorted(headers, last, side="right")]
    good = np.empty(len(headers), dtype=bool)
    per_block = rows_per_block(layout.length)
    for block in range(0, len(headers), per_block):
        rows = _gather(data, headers[block : block + per_block], layout.length)
        good[block : block + per_block] = _checksum_holds(layout, rows)
    starts = _without_overlap(headers[good], layout.length)
    rejected = headers[~good]
    if not len(starts):
        return Found(starts, last + 1, len(rejected))
    corrupt = len(rejected) - _covered(rejected, starts, layout.length)
    return Found(starts, max(int(starts[-1]) + layout.length, last + 1), corrupt)


def _checksum_holds(layout: PacketLayout, rows: Bytes) -> Flags:
    """Return for each packet, shape (n, length), whether its checksum is right."""
    check = layout.checksum
    assert check is not None
    sent = rows.view(layout.dtype)["checksum"][:, 0]
    covered = rows[:, check.start : layout.length - check.size]
    holds: Flags = checksum_rows(check.kind, covered) == sent
    return holds


def rows_at(data: Bytes, starts: Positions, length: int) -> Bytes:
    """Return a copy of the ``length`` bytes from each start, shape (n, length)."""
    number = len(starts)
    if number and int(starts[-1]) - int(starts[0]) == (number - 1) * length:
        first = int(starts[0])  # starts never lie closer together, so these are one run
        return data[first : first + number * length].reshape(number, length).copy()
    return _gather(data, starts, length)


def _gather(data: Bytes, starts: Positions, length: int) -> Bytes:
    count = max(0, len(data) - length + 1)
    windows = np.ndarray((count,), dtype=f"V{length}", buffer=data, strides=(1,))
    return windows[starts].view(np.uint8).reshape(len(starts), length)


def _headers(data: Bytes, header: bytes) -> Positions:
    count = len(data) - len(header) + 1
    match = data[:count] == header[0]
    for place in range(1, len(header)):
        match &= data[place : place + count] == header[place]
    return np.flatnonzero(match)


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


def _find_unchecked(layout: PacketLayout, data: Bytes) -> Found:
    """Find packets by their headers alone, where none begins in sync."""
    length = layout.length
    last = len(data) - length
    headers = _headers(data, layout.header)
    is_header = np.zeros(last + 2 * length + 1, dtype=bool)
    is_header[headers] = True
    headers = headers[: np.searchsorted(headers, last, side="right")]
    waits_from = last - len(layout.header) + 1  # the bytes of a following header are not all there
    confirmed = is_header[headers + length] & (headers < waits_from)
    follows = (headers >= length) & is_header[headers - length]
    if len(headers) and _is_plain(headers, confirmed | follows, length):
        return Found(headers, max(int(headers[-1]) + length, last + 1), 0)
    starts: list[int] = []
    corrupt = 0
    free = 0
    packet_end = -1
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


def _is_plain(headers: Positions, taken: Flags, length: int) -> bool:
    """Return whether every header is a packet and none of them overlap."""
    return bool(taken.all()) and bool((np.diff(headers) >= length).all())
