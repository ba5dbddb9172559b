"""Finding packets of several fixed lengths in one stretch of bytes, greedily from its beginning.

The rule is that of :mod:`firmware_protocols.framing` with more than one header: at position p,
if a header stands there and its packet is good, it is a packet and p moves past it; otherwise p
moves on by one. No header is the beginning of another, so at most one stands at a position. A
packet with a checksum is good if that is right. A packet without one is good if a packet, of
whichever kind, ended at p ("in sync") or if any header follows right behind it.

A position where a header stands, or what may yet become one, is decided once the whole packet is
there; of a packet that waits for the next header, once that can be told. Any other position is
decided at once.

:func:`find_short` is that rule in plain Python, quickest for the few packets of a live chunk;
:func:`find_many` says the same of a long stretch with arrays.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from firmware_protocols.checksums import checksum_rows, fast_checksum, rows_per_block
from firmware_protocols.layout import PacketLayout
from firmware_protocols.variable_framing import gather

Bytes = npt.NDArray[np.uint8]
Positions = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Kinds:
    """The kinds of packets that may stand in one stretch of bytes."""

    layouts: tuple[PacketLayout, ...]

    @cached_property
    def by_header(self) -> dict[bytes, int]:
        """Index of the layout that each header begins."""
        return {layout.header: kind for kind, layout in enumerate(self.layouts)}

    @cached_property
    def begins(self) -> re.Pattern[bytes]:
        """Matches a header, and the first bytes of one at the end of a stretch."""
        return re.compile(b"|".join(_beginning(layout.header) for layout in self.layouts))

    @cached_property
    def lengths(self) -> Positions:
        """Bytes of a packet of each kind."""
        return np.array([layout.length for layout in self.layouts], dtype=np.int64)

    @cached_property
    def reach(self) -> int:
        """So many bytes from a position on always decide it."""
        longest_header = max(len(layout.header) for layout in self.layouts)
        return int(self.lengths.max()) + longest_header

    @cached_property
    def unchecked(self) -> Flags:
        """Which kinds have no checksum."""
        return np.array([layout.checksum is None for layout in self.layouts])


@dataclass(frozen=True)
class FoundKinds:
    """What a stretch of bytes holds.

    Attributes
    ----------
    starts : shape (n,), increasing
        Where the packets begin.
    kinds : shape (n,)
        Index of the layout of each.
    decided : int
        The first undecided position; the length of the stretch if there is none.
    corrupt : int
        Decided positions with a header but no good packet.
    """

    starts: Positions
    kinds: Positions
    decided: int
    corrupt: int


def find_short(of: Kinds, data: bytes, *, in_sync: bool) -> FoundKinds:
    """Find the packets of a short stretch; ``in_sync`` if a packet ended right before it."""
    starts: list[int] = []
    kinds: list[int] = []
    position = corrupt = 0
    packet_end = 0 if in_sync else -1
    while True:
        match = of.begins.search(data, position)
        if match is None:
            position = len(data)
            break
        position = match.start()
        kind = of.by_header.get(match.group())
        if kind is None:
            break
        end = position + of.layouts[kind].length
        if end > len(data):
            break
        good = _is_good(of, kind, data[position:end])
        if good is None:
            good = position == packet_end or _header_follows(of, data, end)
            if good is None:
                break
        if good:
            starts.append(position)
            kinds.append(kind)
            position = packet_end = end
        else:
            corrupt += 1
            position += 1
    return _found(starts, kinds, position, corrupt)


def find_many(of: Kinds, data: bytes, *, in_sync: bool) -> FoundKinds:
    """Find the packets of a long stretch; same result as :func:`find_short`.

    Only positions that the stretch is sure to decide are worked out with arrays.
    """
    last = len(data) - of.reach
    found, free = _find_decidable(of, np.frombuffer(data, dtype=np.uint8), last, in_sync=in_sync)
    position = max(free, last + 1, 0)
    ended_here = position == free if len(found.starts) else in_sync and position == 0
    rest = find_short(of, data[position:], in_sync=ended_here)
    return FoundKinds(
        np.concatenate([found.starts, rest.starts + position]),
        np.concatenate([found.kinds, rest.kinds]),
        position + rest.decided,
        found.corrupt + rest.corrupt,
    )


def _find_decidable(of: Kinds, data: Bytes, last: int, *, in_sync: bool) -> tuple[FoundKinds, int]:
    """Find the packets that begin up to ``last``, and where the last of them ends (0 for none)."""
    everywhere, every_kind = _headers(of.layouts, data)
    number = int(np.searchsorted(everywhere, last, side="right"))
    at, kinds = everywhere[:number], every_kind[:number]
    ends = at + of.lengths[kinds]
    good = np.zeros(number, dtype=np.bool_)
    for kind, layout in enumerate(of.layouts):
        which = np.flatnonzero(kinds == kind)
        if layout.checksum is None:
            good[which] = np.isin(ends[which], everywhere)
        else:
            good[which] = _checksums_hold(layout, data, at[which])
    apart = bool((at[1:] >= ends[:-1]).all())
    taken = good
    if of.unchecked.any():
        taken = _in_sync_too(at, ends, good, of.unchecked[kinds], in_sync=in_sync)
    elif not apart:
        taken = _without_overlap(at, ends, good)
    starts, taken_kinds, taken_ends = at[taken], kinds[taken], ends[taken]
    rejected = at[~taken]
    corrupt = len(rejected) - (0 if apart else _covered(rejected, starts, taken_ends))
    free = int(taken_ends[-1]) if len(starts) else 0
    return FoundKinds(starts, taken_kinds, last + 1, corrupt), free


def _headers(layouts: Sequence[PacketLayout], data: Bytes) -> tuple[Positions, Positions]:
    """Return where whole headers stand, in order, and whose they are."""
    of_first: dict[int, Positions] = {}
    places: list[Positions] = []
    kinds: list[Positions] = []
    for kind, layout in enumerate(layouts):
        first = layout.header[0]
        if first not in of_first:
            of_first[first] = np.flatnonzero(data == first)
        at = of_first[first]
        at = at[: np.searchsorted(at, len(data) - len(layout.header), side="right")]
        for place in range(1, len(layout.header)):
            at = at[data[at + place] == layout.header[place]]
        places.append(at)
        kinds.append(np.full(len(at), kind, dtype=np.int64))
    joined, joined_kinds = np.concatenate(places), np.concatenate(kinds)
    order = np.argsort(joined, kind="stable")
    return joined[order], joined_kinds[order]


def _checksums_hold(layout: PacketLayout, data: Bytes, at: Positions) -> Flags:
    """Return for each packet of one kind that begins there whether its checksum is right."""
    check = layout.checksum
    assert check is not None
    holds = np.empty(len(at), dtype=np.bool_)
    per_block = rows_per_block(layout.length)
    for block in range(0, len(at), per_block):
        rows = gather(data, at[block : block + per_block], layout.length)
        covered = rows[:, check.start : layout.length - check.size]
        sent = rows.view(layout.dtype)["checksum"][:, 0]
        holds[block : block + per_block] = checksum_rows(check.kind, covered) == sent
    return holds


def _without_overlap(at: Positions, ends: Positions, good: Flags) -> Flags:
    """Return which good packets are left when each takes its bytes, first come first."""
    which = np.flatnonzero(good)
    if bool((at[which[1:]] >= ends[which[:-1]]).all()):
        return good
    taken = np.zeros_like(good)
    free = 0
    for index, start, end in zip(
        which.tolist(), at[which].tolist(), ends[which].tolist(), strict=True
    ):
        if start >= free:
            taken[index] = True
            free = end
    return taken


def _in_sync_too(
    at: Positions, ends: Positions, good: Flags, unchecked: Flags, *, in_sync: bool
) -> Flags:
    """Return which packets are taken where some need no proof if they begin in sync."""
    follows = np.zeros_like(good)
    follows[1:] = at[1:] == ends[:-1]
    if bool((good | follows & unchecked).all()) and bool((at[1:] >= ends[:-1]).all()):
        return np.ones_like(good)
    taken = np.zeros_like(good)
    free, packet_end = 0, 0 if in_sync else -1
    columns = (at.tolist(), ends.tolist(), good.tolist(), unchecked.tolist())
    for index, (start, end, is_good, is_unchecked) in enumerate(zip(*columns, strict=True)):
        if start >= free and (is_good or (is_unchecked and start == packet_end)):
            taken[index] = True
            free = packet_end = end
    return taken


def _covered(at: Positions, starts: Positions, ends: Positions) -> int:
    """Return how many positions lie inside the packets from ``starts`` to ``ends``."""
    if not len(starts):
        return 0
    before = np.searchsorted(starts, at, side="right") - 1
    return int(np.count_nonzero((before >= 0) & (at < ends[before])))


def _is_good(of: Kinds, kind: int, packet: bytes) -> bool | None:
    """Return whether the checksum is right; None if there is none."""
    layout = of.layouts[kind]
    check = layout.checksum
    if check is None:
        return None
    sent = int.from_bytes(packet[-check.size :], layout.checksum_order)
    return fast_checksum(check.kind)(packet[check.start : -check.size]) == sent


def _header_follows(of: Kinds, data: bytes, end: int) -> bool | None:
    """Return whether a header begins at ``end``; None if more bytes must tell."""
    if end == len(data):
        return None
    match = of.begins.match(data, end)
    if match is None:
        return False
    return True if match.group() in of.by_header else None


def _beginning(header: bytes) -> bytes:
    """Return a pattern of a header that may be cut off by the end of the stretch."""
    pattern = b""
    for byte in reversed(header[1:]):
        pattern = b"(?:" + re.escape(bytes([byte])) + pattern + rb"|\Z)"
    return re.escape(header[:1]) + pattern


def _found(starts: list[int], kinds: list[int], decided: int, corrupt: int) -> FoundKinds:
    return FoundKinds(np.array(starts, np.int64), np.array(kinds, np.int64), decided, corrupt)
