"""The one place where the bytes of a device become packets with times, live or recorded.

Decode, put in order, map to the host's clock: a live stream and a recording go through the same
steps. They differ in one thing only: live, a packet's time comes from the clock fit as known when
it arrived; in a recording, from the fit to the whole of it.

Times are seconds of the host's monotonic clock (``Clock.now_ns() / 1e9``), with the origin that
the caller's arrival times have; a float holds them to about a nanosecond for months of uptime.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from firmware_protocols.packets import counts
from firmware_protocols.protocol import Decoder, DeviceProtocol, NoticesFaults, Packets
from firmware_protocols.rows import RowLayout
from imu_rig.arrays import AnyArray, BoolArray, FloatArray, IntArray, StructArray
from imu_rig.blocks import in_a_line
from imu_rig.clock import NS_PER_S
from imu_rig.errors import InputError
from imu_rig.imu_scaling import watched_fields
from imu_rig.row_faults import faults_of
from imu_rig.timing.clock_fit import MAX_SKEW, MIN_SPAN_S, ClockFit, fit_clock
from imu_rig.timing.counters import differences
from imu_rig.timing.host_time import HostTime
from imu_rig.timing.live_clock_fit import LiveClockFit
from imu_rig.timing.sample_order import COUNTED_SKEW, Ordered, OrderStats, SampleOrder, TimeSource

# The real rate of samples that carry no clock is measured.
COUNTED_SPAN_S = 2.0  # after which the real rate of samples without a clock is fitted
UNRATED_SPAN_S = 0.3  # the same where the layout states no rate
UNRATED_SKEW = 99.0

PAUSE_S = 1.0  # without a byte: no packet goes on after it that has no checksum to prove it


@dataclass(frozen=True)
class StreamStats(OrderStats):
    """What has become of everything received so far.

    Attributes
    ----------
    good : int
        Packets with a correct header and checksum, duplicates and late ones included.
    corrupt, skipped_bytes : int
        Packets with a wrong checksum; bytes that belong to no good packet. Nobody knows of which
        stream they were: they are those of the whole port.
    """

    good: int = 0
    corrupt: int = 0
    skipped_bytes: int = 0


@dataclass(frozen=True)
class PacketBlock:
    """``n`` consecutive packets of one device, in the order in which it made them.

    Attributes
    ----------
    rows : shape (n,), structured
        The packets, of the layout's ``dtype``.
    t : shape (n,)
        Time of each on the host's monotonic clock [s]: the device clock mapped by a fit, strictly
        increasing. The time that algorithms use.
    host_s : shape (n,)
        Arrival of the bytes that completed each, host monotonic clock [s]. Bursty and late.
    device_s : shape (n,) or None
        Unwrapped device clock [s]; None where the device sends none.
    counter : shape (n,) or None
        Unwrapped packet counter; a difference above 1 is a loss. None where there is none.
    """

    rows: StructArray
    t: FloatArray
    host_s: FloatArray
    device_s: FloatArray | None = None
    counter: IntArray | None = None

    def __len__(self) -> int:
        """Return the number of packets."""
        return len(self.t)

    def __repr__(self) -> str:
        """Return one line; the numbers are in the columns."""
        own = [n for n in ("t", "host_s", "device_s", "counter") if getattr(self, n) is not None]
        return in_a_line("PacketBlock", self.t, [*own, *(self.rows.dtype.names or ())])

    @staticmethod
    def empty(layout: RowLayout) -> PacketBlock:
        """Return a block without packets."""
        return PacketBlock(np.empty(0, layout.dtype), np.empty(0), np.empty(0))

    @staticmethod
    def concatenate(layout: RowLayout, blocks: Sequence[PacketBlock]) -> PacketBlock:
        """Join blocks of one device in order."""
        full = [block for block in blocks if len(block)]
        if not full:
            return PacketBlock.empty(layout)
        devices = [b.device_s for b in full if b.device_s is not None]
        counters = [b.counter for b in full if b.counter is not None]
        return PacketBlock(
            np.concatenate([b.rows for b in full], dtype=layout.dtype),
            np.concatenate([b.t for b in full]),
            np.concatenate([b.host_s for b in full]),
            np.concatenate(devices) if len(devices) == len(full) else None,
            np.concatenate(counters) if len(counters) == len(full) else None,
        )


@dataclass(frozen=True)
class AssembledPackets:
    """One stream of a whole recording, decoded.

    Attributes
    ----------
    block : PacketBlock
    stats : StreamStats
    time_source : str
        What the packets' times rest on: "device clock", "packet counter" or "arrival".
    fits : tuple of ClockFit
        One for each stretch between restarts.
    segment : shape (n,)
        Number of the stretch that each packet belongs to, not decreasing.
    """

    block: PacketBlock
    stats: StreamStats
    time_source: TimeSource
    fits: tuple[ClockFit, ...]
    segment: IntArray

    @property
    def sigma_s(self) -> float:
        """Standard uncertainty of the times where it is worst [s], apart from a constant delay.

        Infinite where there are no packets, or where their times cannot be right.
        """
        if not self.fits or self.time_problem is not None:
            return math.inf
        return max(fit.sigma_s for fit in self.fits)

    @property
    def time_problem(self) -> str | None:
        """Why the times cannot be right, as a sentence without its stop; None where they can."""
        asked = [fit.impossible_skew for fit in self.fits if fit.impossible_skew is not None]
        if not asked:
            return None
        clock, cure = "count of samples", "rate"
        if self.time_source == "device clock":
            clock, cure = "clock", "clock tick"
        return (
            f"the sensor's {clock} and the computer's clock disagree by "
            f"{100.0 * max(asked, key=abs):+.3g} %, more than any clock errs, so the times of the "
            "samples are wrong: the computer was too busy to read the sensor, or the "
            f"{cure} in the layout is wrong; put that right and record anew"
        )


class PacketStreams:
    """Turns the bytes of one port into blocks of packets as they arrive, for each of its streams.

    Parameters
    ----------
    protocol : DeviceProtocol
    """

    def __init__(self, protocol: DeviceProtocol) -> None:
        self.protocol = protocol
        self._decoder = protocol.decoder()
        self._lanes = {name: _Lane(layout) for name, layout in protocol.streams.items()}
        self._chunks: deque[tuple[int, float]] = deque()
        self._received = 0
        self._last_ns = 0
        self._faults: dict[str, float] = {}  # noticed by the decoder, and when

    def stats(self, stream: str) -> StreamStats:
        """Return the counts of a stream so far."""
        lane = self._lanes[stream]
        return _stats(self._decoder, lane.order, lane.good)

    def time_source(self, stream: str) -> TimeSource:
        """Return what a stream's times rest on."""
        return self._lanes[stream].order.time_source

    def clock_fit(self, stream: str) -> ClockFit | None:
        """Return the device clock on the host's, as known now; None before the first packet."""
        return self._lanes[stream].live.fit

    def identical(self, stream: str) -> int:
        """Return how many of the last packets in a row have the same inertial counts.

        0 where a stream has neither accelerometer nor gyroscope.
        """
        return self._lanes[stream].identical

    def faults(self, stream: str, since_s: float) -> tuple[str, ...]:
        """Return the faults that packets told of which arrived since then, host clock [s].

        Those that the decoder noticed are faults of every stream.
        """
        told = {**self._lanes[stream].faults, **self._faults}
        return tuple(fault for fault, last_s in told.items() if last_s >= since_s)

    def feed_many(self, chunks: list[tuple[int, bytes]]) -> dict[str, PacketBlock]:
        """Take in pieces in order of arrival.

        Parameters
        ----------
        chunks : list of (int, bytes)
            When each arrived (host monotonic clock [ns], not decreasing) and what it was.

        Returns
        -------
        dict
            Of each stream the packets that are complete now, after all returned before; streams
            without any are left out.
        """
        for t_ns, data in chunks:
            self._received += len(data)
            self._chunks.append((self._received, t_ns / NS_PER_S))
        decoded = self._decode(chunks)
        noticed = self._decoder.take_faults() if isinstance(self._decoder, NoticesFaults) else {}
        blocks: dict[str, PacketBlock] = {}
        if decoded or noticed:
            stops, arrival = np.array(self._chunks).T
            for fault, end in noticed.items():
                self._faults[fault] = float(arrival[np.searchsorted(stops, end)])
            for stream, packets in decoded.items():
                block = self._lanes[stream].take(
                    packets.rows, arrival[np.searchsorted(stops, packets.end)]
                )
                if len(block):
                    blocks[stream] = block
        undecided = self._received - self._decoder.pending
        while self._chunks and self._chunks[0][0] <= undecided:
            self._chunks.popleft()
        return blocks

    def cut(self) -> None:
        """Let no packet lie on both sides of here: the port was opened anew, bytes are missing."""
        self._decoder.cut()

    def _decode(self, chunks: list[tuple[int, bytes]]) -> dict[str, Packets]:
        """Feed the decoder as `_decode_recording` does."""
        parts: list[Mapping[str, Packets]] = []
        joined: list[bytes] = []
        for t_ns, data in chunks:
            if not self.protocol.proves_packets and t_ns - self._last_ns > PAUSE_S * NS_PER_S:
                parts.append(self._decoder.feed(b"".join(joined)))
                self._decoder.cut()
                joined = []
            joined.append(data)
            self._last_ns = t_ns
        parts.append(self._decoder.feed(b"".join(joined)))
        return _joined(parts)


class _Lane:
    """One stream of a port while it comes: its order, its clock fit, what it said last."""

    def __init__(self, layout: RowLayout) -> None:
        self.layout = layout
        self.order = _order(layout)
        self.live = LiveClockFit(**_fit_options(layout, self.order.time_source))
        self.good = 0
        self.identical = 0
        self.faults: dict[str, float] = {}
        self._watched = watched_fields(layout)
        self._mapping = HostTime(self._fit)
        self._held: tuple[StructArray, FloatArray] | None = None
        self._segment: int | None = None
        self._last_counts: AnyArray | None = None

    def take(self, rows: StructArray, host_s: FloatArray) -> PacketBlock:
        """Return the packets that are in order now, with times."""
        self.good += len(rows)
        for fault, where in faults_of(self.layout, rows).items():
            self.faults[fault] = float(host_s[where])
        if self._held is not None:
            rows = np.concatenate((self._held[0], rows), dtype=rows.dtype)
            host_s = np.concatenate((self._held[1], host_s))
        ordered = _feed_order(self.order, self.layout, rows, host_s)
        self._held = (rows[-1:], host_s[-1:]) if ordered.held else None
        taken, host_s = _taken(rows, ordered.rows), host_s[ordered.rows]
        self._watch(taken)
        t = self._mapping.times(ordered, host_s)
        return _block(taken, t, host_s, ordered, self.order.time_source)

    def _fit(self, segment: int, device_s: FloatArray, host_s: FloatArray) -> ClockFit:
        if self._segment is not None and segment != self._segment:
            self.live.restart()
        self._segment = segment
        return self.live.update(device_s, host_s)

    def _watch(self, rows: StructArray) -> None:
        """Count how long the counts of the watched fields have not changed."""
        if len(rows) == 0 or not self._watched:
            return
        table = np.concatenate(
            [counts(self.layout, rows, n).reshape(len(rows), -1) for n in self._watched], axis=1
        )
        before = table[0] if self._last_counts is None else self._last_counts
        changed = np.any(differences(table, before) != 0, axis=1)
        where = np.flatnonzero(changed)
        if len(where):
            self.identical = len(rows) - int(where[-1])
        else:
            self.identical += len(rows)
        self._last_counts = table[-1]


def assemble_packets(
    protocol: DeviceProtocol,
    data: bytes | memoryview,
    stops: IntArray,
    arrival_s: FloatArray,
    breaks: BoolArray | None = None,
) -> dict[str, AssembledPackets]:
    """Decode a whole recording of one port, with one clock fit from restart to restart.

    Parameters
    ----------
    protocol : DeviceProtocol
    data : bytes or memoryview of bytes
        Everything the port delivered.
    stops : shape (m,)
        Offset in ``data`` just past each piece as it was read.
    arrival_s : shape (m,)
        Arrival of each piece, host monotonic clock [s], not decreasing.
    breaks : shape (m,), optional
        Whether something may be missing just before each piece, so that no packet lies on both
        sides of there.

    Returns
    -------
    dict
        Every stream of the protocol by its name, also those of which nothing came.

    Raises
    ------
    InputError
        If the pieces do not cover the data.
    """
    covered = int(stops[-1]) if len(stops) else 0
    if covered != len(data) or len(stops) != len(arrival_s):
        raise InputError(
            f"The pieces of this recording end at byte {covered}, its data at byte {len(data)}: "
            "give one end and one arrival time for every piece read."
        )
    arrival_s = np.asarray(arrival_s, dtype=float)
    decoder = protocol.decoder()
    decoded = _decode_recording(
        decoder, data, stops, arrival_s, breaks, proven=protocol.proves_packets
    )
    streams = {}
    for name, layout in protocol.streams.items():
        packets = decoded.get(name)
        if packets is None:
            packets = Packets(np.empty(0, layout.dtype), np.empty(0, np.int64))
        streams[name] = _assemble(layout, packets, stops, arrival_s, decoder)
    return streams


def _assemble(
    layout: RowLayout, packets: Packets, stops: IntArray, arrival_s: FloatArray, decoder: Decoder
) -> AssembledPackets:
    order = _order(layout)
    host_s = arrival_s[np.searchsorted(stops, packets.end)]
    ordered = _feed_order(order, layout, packets.rows, host_s)
    rows, host_s = _taken(packets.rows, ordered.rows), host_s[ordered.rows]
    fits = _fit_segments(layout, order.time_source, ordered, host_s)
    mapping = HostTime(lambda segment, _device, _host: fits[segment])
    t = mapping.times(ordered, host_s)
    return AssembledPackets(
        _block(rows, t, host_s, ordered, order.time_source),
        _stats(decoder, order, len(packets)),
        order.time_source,
        tuple(fits.values()),
        ordered.segment,
    )


def _joined(parts: list[Mapping[str, Packets]]) -> dict[str, Packets]:
    """Join what was decoded one after the other; streams without packets are left out."""
    names = [name for part in parts for name in part]
    found = {
        name: Packets.concatenate([part[name] for part in parts if name in part])
        for name in dict.fromkeys(names)
    }
    return {name: packets for name, packets in found.items() if len(packets)}


def _decode_recording(
    decoder: Decoder,
    data: bytes | memoryview,
    stops: IntArray,
    arrival_s: FloatArray,
    breaks: BoolArray | None,
    *,
    proven: bool,
) -> dict[str, Packets]:
    """Decode everything, with a cut at each break.

    A pause cuts packets without a checksum, which would hide that the port was opened anew in it
    and bytes were lost. A checksum proves that a packet is whole, however long it was on its way.
    """
    cuts = np.zeros(len(stops), bool) if breaks is None else breaks.copy()
    if not proven:
        cuts[1:] |= np.diff(arrival_s) > PAUSE_S
    view = memoryview(data)
    parts = []
    edges = [0, *stops[np.flatnonzero(cuts[1:])].tolist(), len(data)]
    for start, stop in pairwise(edges):
        decoder.cut()
        parts.append(decoder.feed(view[start:stop]))
    return _joined(parts)


def _fit_segments(
    layout: RowLayout, source: TimeSource, ordered: Ordered, host_s: FloatArray
) -> dict[int, ClockFit]:
    """Fit every segment; those too short for a skew of their own take that of the longest."""
    numbers, starts = np.unique(ordered.segment, return_index=True)
    edges = pairwise([*starts.tolist(), len(host_s)])
    parts = {n: slice(a, b) for n, (a, b) in zip(numbers.tolist(), edges, strict=True)}
    options = _fit_options(layout, source)
    fits: dict[int, ClockFit] = {}
    skew = 0.0
    for segment in sorted(parts, key=lambda n: parts[n].start - parts[n].stop):
        part = parts[segment]
        fits[segment] = fit_clock(
            ordered.device_s[part], host_s[part], default_skew=skew, **options
        )
        if len(fits) == 1:
            skew = fits[segment].skew
            if np.ptp(ordered.device_s[part]) >= MIN_SPAN_S:  # the rate is known well from now on
                options["min_span_s"] = max(options["min_span_s"], MIN_SPAN_S)
    return {n: fits[n] for n in parts}


def _fit_options(layout: RowLayout, source: TimeSource) -> dict[str, float]:
    if source == "device clock":
        return {"max_skew": MAX_SKEW, "min_span_s": MIN_SPAN_S}
    if layout.rate_hz is not None:
        return {"max_skew": COUNTED_SKEW, "min_span_s": COUNTED_SPAN_S}
    return {"max_skew": UNRATED_SKEW, "min_span_s": UNRATED_SPAN_S}


def _order(layout: RowLayout) -> SampleOrder:
    def modulus(name: str | None) -> int | None:
        return None if name is None else 1 << layout.field(name).number_bits

    return SampleOrder(
        clock_modulus=modulus(layout.clock),
        tick_s=layout.clock_tick_s,
        counter_modulus=modulus(layout.counter),
        period_s=None if layout.rate_hz is None else 1.0 / layout.rate_hz,
    )


def _feed_order(
    order: SampleOrder, layout: RowLayout, rows: StructArray, host_s: FloatArray
) -> Ordered:
    return order.feed(
        None if layout.clock is None else counts(layout, rows, layout.clock),
        None if layout.counter is None else counts(layout, rows, layout.counter),
        host_s,
    )


def _taken(rows: StructArray, places: IntArray) -> StructArray:
    """Return some packets, all of them as they are; whole they are copied ten times as fast."""
    if len(places) == len(rows) and bool(np.all(places[1:] > places[:-1])):
        return rows
    found: StructArray = rows.view(f"V{rows.dtype.itemsize}")[places].view(rows.dtype)
    return found


def _stats(decoder: Decoder, order: SampleOrder, good: int) -> StreamStats:
    decoded = decoder.stats
    return StreamStats(
        **vars(order.stats),
        good=good,
        corrupt=decoded.corrupt,
        skipped_bytes=decoded.skipped_bytes,
    )


def _block(
    rows: StructArray, t: FloatArray, host_s: FloatArray, ordered: Ordered, source: TimeSource
) -> PacketBlock:
    return PacketBlock(
        rows=rows,
        t=t,
        host_s=host_s,
        device_s=ordered.device_s if source == "device clock" else None,
        counter=ordered.counter,
    )
