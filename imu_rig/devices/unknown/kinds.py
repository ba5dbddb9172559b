"""Several kinds of packets on one port, of which nothing is known.

What packets of the first kind leave over is looked at again. Kinds of one length that take turns
look like one packet of twice that length, until a checksum tells that it is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imu_rig.devices.unknown.analysis import (
    Framed,
    UnknownPackets,
    describe,
    frame,
)
from imu_rig.devices.unknown.counting import find_counter
from imu_rig.devices.unknown.draft import drafted_layout
from imu_rig.devices.unknown.period import (
    ANALYSED_BYTES,
    LEAST_PACKETS,
    Aligned,
    constant_places,
    find_period,
)

MOST_KINDS = 4
MOST_IN_TURN = 4
LEAST_REST = 0.03
"""Share of the bytes that must be left over for another kind to be looked for."""

TOLD_APART_WITHIN = 4
"""Bytes behind a common header among which one tells the kinds apart."""

COVERED = 0.98
LEAST_LENGTH = 6


def analyse_kinds(
    data: bytes, seconds: float | None = None, pauses: tuple[int, ...] = ()
) -> list[UnknownPackets]:
    """Find the kinds of packets in bytes of which nothing is known, the most bytes first.

    Parameters
    ----------
    data : bytes
    seconds : float, optional
        How long they took to come.
    pauses : tuple of int
        Places in ``data`` that came after a pause on the line.

    Returns
    -------
    list of UnknownPackets
        Empty where no packets are found.
    """
    if seconds is not None and data:
        seconds *= min(1.0, ANALYSED_BYTES / len(data))
    data = data[:ANALYSED_BYTES]
    kinds: list[UnknownPackets] = []
    rest = data
    while len(kinds) < MOST_KINDS:
        more = _kinds_of_period(rest, seconds, pauses if rest is data else ())
        if kinds and not all(found.beginning_sure for found in more):
            break  # what is left over may be damage, in which much can be seen
        if not more or _not_told_apart([*kinds, *more]):
            break
        kinds += more
        left = _without(rest, more)
        if len(left) < LEAST_REST * len(data) or len(left) == len(rest):
            break
        rest = left
    return kinds


def _not_told_apart(kinds: list[UnknownPackets]) -> bool:
    headers = [found.header for found in kinds]
    return any(
        one.startswith(other)
        for place, one in enumerate(headers)
        for other in headers[:place] + headers[place + 1 :]
    )


def _timed(framed: Framed, data: bytes, seconds: float | None) -> UnknownPackets:
    """Describe packets by the rate at which a draft of their layout finds them."""
    found = describe(framed, None)
    if not seconds:
        return found
    packets = len(drafted_layout(found).decoder().feed(data)[""])
    if found.clock is None or not packets:
        return replace(found, rate_hz=packets / seconds if packets else None)
    return describe(framed, packets / seconds)


def _without(data: bytes, kinds: list[UnknownPackets]) -> bytes:
    """Return the bytes that belong to none of these packets."""
    free = np.ones(len(data), bool)
    for found in kinds:
        layout = drafted_layout(found)
        for end in layout.decoder().feed(data)[""].end.tolist():
            free[end - layout.length : end] = False
    return np.frombuffer(data, np.uint8)[free].tobytes()


def _kinds_of_period(
    data: bytes, seconds: float | None, pauses: tuple[int, ...]
) -> list[UnknownPackets]:
    """Return the packets that make a stream like itself: one kind, or several in turn."""
    period = find_period(data)
    if period is None:
        return []
    whole = frame(data, period, pauses)
    for turns in range(1, MOST_IN_TURN + 1):
        length = period // turns
        if period % turns or length < LEAST_LENGTH:
            continue
        framed = whole if turns == 1 else frame(data, length)
        if framed is None or framed.checksum is None:
            continue
        kinds = _told_apart(framed, seconds)
        if kinds:
            return kinds
        return [_timed(framed, data, seconds)]
    return [] if whole is None else [_timed(whole, data, seconds)]


def _told_apart(framed: Framed, seconds: float | None) -> list[UnknownPackets]:
    """Divide packets by a byte behind their header that has few values, one for each kind.

    A byte of flags has few values, too; but only among packets of one sender does a counter go up
    by one.
    """
    rows = framed.aligned.rows
    places = set(range(framed.length - (framed.checksum.size if framed.checksum else 0)))
    if find_counter(framed.aligned, places) is not None:
        return []
    constant = constant_places(rows)
    first = int(np.argmin(constant))
    for place in range(first, min(first + TOLD_APART_WITHIN, framed.length)):
        values, counts = np.unique(rows[:, place], return_counts=True)
        usual = values[counts >= LEAST_PACKETS]
        covered = counts[counts >= LEAST_PACKETS].sum() / len(rows)
        if not 2 <= len(usual) <= MOST_KINDS or covered < COVERED:
            continue
        kinds = []
        for value in usual:
            own = np.ascontiguousarray(rows[rows[:, place] == value])
            one = Aligned(own, np.arange(len(own), dtype=np.int64) * framed.length)
            rate_hz = len(own) / seconds if seconds else None
            part = Framed(one, framed.checksum, framed.sure, framed.share)
            kinds.append(describe(part, rate_hz, place + 1))
        if all(found.counter is not None for found in kinds):
            return kinds
    return []
