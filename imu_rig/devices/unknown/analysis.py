"""Packets of one length among unknown bytes, and everything that can be told of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, ByteArray, IntArray
from imu_rig.devices.unknown.checksum import FoundChecksum, find_checksum
from imu_rig.devices.unknown.counting import Going, find_clock, find_counter
from imu_rig.devices.unknown.fields import Gravity, Part, divide, find_gravity, unread
from imu_rig.devices.unknown.period import Aligned, align, constant_places

MOST_BEGINNINGS = 24  # that are tried
LONGEST_HEADER = 3  # of what stays the same: more of it may be measurements that rest
HEADER_WITH_CHECKSUM = 2
PLAIN_BYTES = (0x00, 0xFF)
"""High bytes of small numbers and rests: seldom what a header begins with."""

USUAL_MARKS = (0xA5, 0x5A, 0x55, 0xAA, 0x7E, 0xFA, 0xFE, 0xFD, 0xEB, 0x90, 0xB5, 0x24)
AGREED = 0.6
MOST_PARTS = 200
"""More than that are no measurements."""


@dataclass(frozen=True)
class UnknownPackets:
    """Packets of one length, and what their bytes seem to mean.

    Attributes
    ----------
    rows : shape (n, length), uint8
        Packets from their likely beginning on.
    share : float
        Of the bytes, those in packets.
    beginning_sure : bool
        Whether a checksum or pauses on the line tell where a packet begins.
    constant : shape (length,), bool
    header : bytes
    checksum : FoundChecksum or None
    counter, clock : Going or None
    parts : list of Part
        The rest, in the order of the packet.
    gravity : Gravity or None
        Which of the parts look like an accelerometer.
    rate_hz : float or None
        Packets per second; None where it is not known how long was listened.
    """

    rows: ByteArray
    share: float
    beginning_sure: bool
    constant: BoolArray
    header: bytes
    checksum: FoundChecksum | None
    counter: Going | None
    clock: Going | None
    parts: list[Part]
    gravity: Gravity | None
    rate_hz: float | None

    @property
    def length(self) -> int:
        """Bytes of a packet."""
        return int(self.rows.shape[1])


@dataclass(frozen=True)
class Framed:
    """Packets of one length from their likely beginning on.

    Attributes
    ----------
    aligned : Aligned
    checksum : FoundChecksum or None
    sure : bool
        Whether a checksum or pauses tell where a packet begins.
    share : float
        Of the bytes, those in packets.
    """

    aligned: Aligned
    checksum: FoundChecksum | None
    sure: bool
    share: float

    @property
    def length(self) -> int:
        """Bytes of a packet."""
        return self.aligned.period


def frame(data: bytes, period: int, pauses: tuple[int, ...] = ()) -> Framed | None:
    """Cut a stream into packets of a known length; None where that cannot be done."""
    aligned = align(data, period)
    if aligned is None:
        return None
    constant = constant_places(aligned.rows)
    if constant.all():
        return None
    share = _share(aligned.starts, period)
    for candidate in _beginnings(constant):
        turned = aligned.turned(candidate)
        checksum = find_checksum(turned.rows)
        if checksum is not None:
            return Framed(turned, checksum, True, share)
    hinted = _hinted(aligned.starts, period, pauses)
    sure = hinted is not None and bool(constant[hinted])
    beginning = hinted if sure and hinted is not None else _likeliest(aligned.rows, constant)
    return Framed(aligned.turned(beginning), None, sure, share)


def describe(framed: Framed, rate_hz: float | None, header_bytes: int = 0) -> UnknownPackets:
    """Say what the bytes of packets seem to mean.

    Parameters
    ----------
    framed : Framed
    rate_hz : float or None
        Packets per second.
    header_bytes : int
        How many bytes belong to the header at least.
    """
    aligned, checksum = framed.aligned, framed.checksum
    constant = constant_places(aligned.rows)
    header = _header(aligned.rows, constant, checksum is not None, header_bytes)
    end = framed.length - (checksum.size if checksum is not None else 0)
    free = set(range(len(header), end))
    counter = find_counter(aligned, free)
    free -= set(counter.places) if counter else set()
    clock = find_clock(aligned, free, rate_hz)
    free -= set(clock.places) if clock else set()
    parts = divide(aligned, free)
    if len(parts) > MOST_PARTS:
        parts = unread(free)
    return UnknownPackets(
        aligned.rows,
        framed.share,
        framed.sure,
        constant,
        header,
        checksum,
        counter,
        clock,
        parts,
        find_gravity(aligned, parts),
        rate_hz,
    )


def _share(starts: IntArray, period: int) -> float:
    """Return how much of the stretch from first to last packet is packets."""
    gaps = np.diff(starts)
    lost = float(np.sum(gaps[gaps != period] - period))  # a row beside a gap may not be seen
    between = np.count_nonzero(gaps != period) * period
    whole = float(starts[-1] - starts[0] + period)
    return min(1.0, 1.0 - max(0.0, lost - between) / whole)


def _beginnings(constant: BoolArray) -> list[int]:
    """Return where constant bytes follow a changing one: a checksum may end there."""
    first = np.flatnonzero(constant & ~np.roll(constant, 1))
    return [int(place) for place in first[:MOST_BEGINNINGS]]


def _hinted(starts: IntArray, period: int, pauses: tuple[int, ...]) -> int | None:
    """Return at which place of the rows most pauses were; None if they do not agree."""
    places = []
    for pause in pauses:
        before = int(np.searchsorted(starts, pause, side="right")) - 1
        if before >= 0 and pause - int(starts[before]) < period:
            places.append(pause - int(starts[before]))
    if len(places) < LONGEST_HEADER:
        return None
    counts = np.bincount(places)
    usual = int(counts.argmax())
    return usual if counts[usual] >= AGREED * len(places) else None


def _likeliest(rows: ByteArray, constant: BoolArray) -> int:
    """Return where the constant bytes begin that look most like a header."""
    period = len(constant)
    best, merit = 0, -1.0
    for at in _beginnings(constant):
        run: list[int] = []
        while len(run) < period and constant[(at + len(run)) % period]:
            run.append(int(rows[0, (at + len(run)) % period]))
        plain = 0
        while plain < len(run) and run[plain] in PLAIN_BYTES:
            plain += 1
        marks = run[plain : plain + LONGEST_HEADER]
        own = sum(byte not in PLAIN_BYTES for byte in marks)
        worth = own + 0.5 * sum(byte in USUAL_MARKS for byte in marks)
        if worth > merit:
            best, merit = ((at + plain) % period if own else at), worth
    return best


def _header(rows: ByteArray, constant: BoolArray, checked: bool, least: int) -> bytes:
    """Return the first bytes that stay the same, but no zeros that may be a number at rest."""
    longest = max(least, HEADER_WITH_CHECKSUM if checked else LONGEST_HEADER)
    usual = bytes(int(np.bincount(column).argmax()) for column in rows[:, :longest].T)
    taken = max(1, least)
    while taken < min(longest, len(usual)) and constant[taken]:
        if usual[taken] == 0 and taken > 1:
            break
        taken += 1
    return usual[:taken]
