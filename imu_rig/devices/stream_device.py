"""A device on a port: its packets in order, and the figures that tell how well it does."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from firmware_protocols.layout import PacketLayout
from imu_rig.arrays import FloatArray, IntArray
from imu_rig.clock import NS_PER_S, Clock
from imu_rig.devices.ports import DEFAULT_BAUD, open_port, usb_address
from imu_rig.devices.reader import PortReader
from imu_rig.devices.recognize import explain
from imu_rig.errors import DeviceLost, PortError
from imu_rig.imu_scaling import watched_fields
from imu_rig.packet_stream import PacketBlock, PacketStream, StreamStats
from imu_rig.timing.sample_order import TimeSource

# Constants of time.
RECENT_S = 2.0  # over which the rate and the kind of bytes are judged
DECODE_S = 0.2  # of work at a time, after which the rest waits for the next poll
LAG_S = 1.0  # over which the least lag is taken, longer than the bursts of a healthy link

STUCK_SAMPLES = 25
"""So many samples in a row with the same counts in all axes are no measurement any more."""

RECENT_SAMPLES = 1000
RECENT_BYTES = 4096
MAX_UNREAD_BYTES = 16_000_000
MAX_BEHIND_BYTES = 500_000  # of a device that sends more than can be decoded: what is new counts
DECODED_BYTES = 1 << 17  # between looks at how long decoding takes
MAX_UNREAD_SAMPLES = 1_000_000


@dataclass(frozen=True)
class StreamHealth(StreamStats):
    """How a device does: its counts since the start, leaps among the restarts, and more.

    Attributes
    ----------
    reconnects : int
        How many times the port was opened again.
    rate_hz : float
        Samples per second that the device makes, by its own clock, over the last two seconds;
        0 until there are enough and after two seconds without.
    last_packet_age_s : float
        Since the last good packet, however often the port was opened after it; before the first
        since the port was opened.
    last_byte_age_s : float
        Since the last byte, or since the port was opened.
    lag_s : float
        How much later than usual the freshest data of the last second arrived.
    stuck : bool
        Whether the last samples all have the same accelerometer and gyroscope counts.
    unread : int
        Samples dropped because nobody polled for too long.
    counter : int or None
        Unwrapped counter of the last packet; None before it and where there is none.
    error : str or None
        Why the port is not being read; None while it is.
    """

    reconnects: int = 0
    rate_hz: float = 0.0
    last_packet_age_s: float = 0.0
    last_byte_age_s: float = 0.0
    lag_s: float = 0.0
    stuck: bool = False
    unread: int = 0
    counter: int | None = None
    error: str | None = None


class TimedBlock(Protocol):
    """Samples with their times; see `imu_rig.packet_stream.PacketBlock`."""

    @property
    def t(self) -> FloatArray:
        """Time of each sample [s]."""

    @property
    def host_s(self) -> FloatArray:
        """Arrival of each sample [s]."""

    @property
    def counter(self) -> IntArray | None:
        """Unwrapped counter."""

    def __len__(self) -> int:
        """Return the number of samples."""


Block = TypeVar("Block", bound=TimedBlock)
BlockOut = TypeVar("BlockOut", bound=TimedBlock, covariant=True)


class Stream(Protocol[BlockOut]):
    """What makes samples of bytes; see `imu_rig.packet_stream.PacketStream`."""

    time_source: TimeSource

    @property
    def stats(self) -> StreamStats:
        """Counts so far."""

    @property
    def identical(self) -> int:
        """How many of the last samples in a row are the same."""

    def feed_many(self, chunks: list[tuple[int, bytes]]) -> BlockOut:
        """Take in bytes and return the samples that are complete."""

    def cut(self) -> None:
        """Let no packet lie on both sides of here."""


class StreamDevice(Generic[Block]):
    """Reads one device in a thread of its own and hands out samples when polled.

    Safe to use from several threads. Every byte goes to ``tap`` before it is interpreted.

    Parameters
    ----------
    name : str
        What people call it; used in every message.
    url : str
        Port; see `imu_rig.devices.ports.open_port`.
    layout : PacketLayout
        What it sends.
    stream : Stream
        Makes blocks of what it sends.
    join : callable
        Makes one block of several.
    clock : Clock
        Host clock that stamps arrivals.
    tap : callable, optional
        Called in the reader's thread with the stamp [ns] and the bytes of each read.
    baud : int
    """

    def __init__(
        self,
        name: str,
        url: str,
        layout: PacketLayout,
        stream: Stream[Block],
        join: Callable[[Sequence[Block]], Block],
        clock: Clock,
        *,
        tap: Callable[[int, bytes], None] | None = None,
        baud: int = DEFAULT_BAUD,
    ) -> None:
        self.name, self.url, self.layout, self.baud = name, url, layout, baud
        self._clock, self._tap = clock, tap
        self._stream, self._join = stream, join
        self._reader: PortReader | None = None
        self._lock = threading.Lock()  # of what poll() and health share
        self._arrived = threading.Lock()  # of what the reader's thread adds
        self._chunks: deque[tuple[int, bytes]] = deque()
        self._chunk_bytes = 0
        self._raw: deque[tuple[int, bytes]] = deque()
        self._raw_bytes = 0
        self._ready: deque[Block] = deque()
        self._ready_samples = 0
        self._recent = np.empty((2, 0))  # times and arrivals of the last samples [s]
        self._reconnects = self._unread = 0
        self._opened_ns = self._byte_ns = self._packet_ns = clock.now_ns()
        self._raised = False
        self._counter: int | None = None
        self._address: str | None = None  # that stays when the device file changes

    @property
    def time_source(self) -> str:
        """What the samples' times rest on; see `imu_rig.packet_stream.PacketStream`."""
        return self._stream.time_source

    def start(self) -> None:
        """Open the port and begin to read.

        Raises
        ------
        PortError
            If the port cannot be opened.
        """
        if self._reader is not None and self._reader.alive:
            return
        address = self._address or self.url
        reader = PortReader(
            lambda: open_port(address, baud=self.baud), self._clock, self._take, self.name
        )
        reader.start()
        self._reader = reader
        self._address = self._address or usb_address(self.url)
        self._raised = False
        with self._lock:
            ever_heard = self._stream.stats.good > 0
        with self._arrived:
            self._opened_ns = self._byte_ns = self._clock.now_ns()
            if not ever_heard:
                self._packet_ns = self._opened_ns
            self._raw.clear()
            self._raw_bytes = 0

    def stop(self) -> None:
        """Stop reading and close the port; what was received can still be polled.

        Raises
        ------
        Exception
            What the tap raised, if no poll raised it before.
        """
        if self._reader is not None:
            self._reader.stop()
            self._raise_fault_of_tap(once=True)

    def reopen(self) -> None:
        """Drop the port, dead or not, and open it again.

        A USB device with a serial number is found again wherever it is plugged in.

        Counters and clock fit go on: a device that kept running meanwhile is continued with a gap,
        one that started anew is recognized as restarted. No packet goes on after the gap.

        Raises
        ------
        DeviceLost
            If the port cannot be opened (yet).
        """
        self.stop()
        with self._lock:
            self._decode()
            with self._arrived:
                self._drop_oldest(0)
            self._stream.cut()
        try:
            self.start()
        except PortError as error:
            raise DeviceLost(f"{self.name} is not back: {error}") from error
        self._reconnects += 1

    def poll(self) -> Block:
        """Return all samples since the last poll: ordered, each once, time strictly increasing.

        Of more than can be decoded in a moment, the rest comes with the next poll.

        A lost device raises nothing here: what it sent before is worth having, and ``health``
        tells.

        Raises
        ------
        Exception
            What the tap raised.
        """
        with self._lock:
            self._decode()
            block = self._join(self._ready)
            self._ready.clear()
            self._ready_samples = 0
        self._raise_fault_of_tap()
        return block

    @property
    def health(self) -> StreamHealth:
        """Figures as of now."""
        with self._lock:
            self._decode()
            stats = self._stream.stats
            recent, counter = self._recent, self._counter
            stuck = self._stream.identical >= STUCK_SAMPLES
        now = self._clock.now_ns()
        with self._arrived:
            byte_age, packet_age = now - self._byte_ns, now - self._packet_ns
        packet_age_s = max(0, packet_age) / NS_PER_S
        # either way its time begins anew
        counts = replace(stats, restarts=stats.restarts + stats.leaps)
        return StreamHealth(
            **vars(counts),
            reconnects=self._reconnects,
            rate_hz=_rate(recent) if packet_age_s < RECENT_S else 0.0,
            last_packet_age_s=packet_age_s,
            last_byte_age_s=max(0, byte_age) / NS_PER_S,
            lag_s=_lag(recent),
            stuck=stuck,
            unread=self._unread,
            counter=counter,
            error=self._error(),
        )

    @property
    def running(self) -> bool:
        """Whether the port is open and being read."""
        return self._reader is not None and self._reader.alive

    @property
    def opened_ns(self) -> int:
        """When the port was opened last, host clock [ns]."""
        with self._arrived:
            return self._opened_ns

    @property
    def last_byte_ns(self) -> int:
        """When the last byte came, or the port was opened, host clock [ns]."""
        with self._arrived:
            return self._byte_ns

    def identify_problem(self) -> str | None:
        """Say in a sentence why no packets come; None while they do.

        Tells apart a lost port, silence, another known layout, a wrong checksum or length, text,
        a dead line and noise.
        """
        health = self.health
        if health.error is not None:
            return health.error
        if health.good and health.last_packet_age_s < LAG_S:
            return None
        with self._arrived:
            since = self._clock.now_ns() - int(RECENT_S * NS_PER_S)
            data = b"".join(piece for t_ns, piece in self._raw if t_ns >= since)
        if not data:
            return (
                f"{self.name} on {self.url} sends nothing: check its power, its cable or Bluetooth "
                "link, and that this is its port."
            )
        return f"{self.name} on {self.url} {explain(data, self.layout, self.baud)}."

    def _take(self, t_ns: int, data: bytes) -> None:
        """Keep what the reader read, in the reader's thread."""
        if self._tap is not None:
            self._tap(t_ns, data)
        with self._arrived:
            self._byte_ns = t_ns
            self._chunks.append((t_ns, data))
            self._chunk_bytes += len(data)
            self._drop_oldest(MAX_UNREAD_BYTES)
            self._raw.append((t_ns, data[-RECENT_BYTES:]))
            self._raw_bytes += min(len(data), RECENT_BYTES)
            while self._raw_bytes > 2 * RECENT_BYTES and len(self._raw) > 1:
                self._raw_bytes -= len(self._raw.popleft()[1])

    def _decode(self) -> None:
        """Turn received bytes into samples, as many as are quickly done; the caller holds the lock.

        A device gone mad sends more than can be decoded: it must not hold up who watches it.
        """
        begin_s = time.monotonic()
        while chunks := self._next_chunks():
            self._decode_chunks(chunks)
            if time.monotonic() - begin_s > DECODE_S:
                with self._arrived:
                    self._drop_oldest(MAX_BEHIND_BYTES)
                return

    def _next_chunks(self) -> list[tuple[int, bytes]]:
        """Take some of what is not decoded, one chunk at least."""
        chunks: list[tuple[int, bytes]] = []
        with self._arrived:
            size = 0
            while self._chunks:
                size += len(self._chunks[0][1])
                if chunks and size > DECODED_BYTES:
                    break
                chunks.append(self._chunks.popleft())
                self._chunk_bytes -= len(chunks[-1][1])
        return chunks

    def _decode_chunks(self, chunks: list[tuple[int, bytes]]) -> None:
        good = self._stream.stats.good
        block = self._stream.feed_many(chunks)
        if self._stream.stats.good > good:
            with self._arrived:
                came_s = block.host_s.max() if len(block) else chunks[-1][0] / NS_PER_S
                self._packet_ns = max(self._packet_ns, int(came_s * NS_PER_S))
        if len(block):
            self._keep(block)

    def _drop_oldest(self, limit: int) -> None:
        """Drop what waits to be decoded beyond a limit [bytes]; the caller holds the lock."""
        while self._chunk_bytes > limit and (len(self._chunks) > 1 or not limit):
            dropped = len(self._chunks.popleft()[1])
            self._chunk_bytes -= dropped
            self._unread += dropped // self.layout.length

    def _keep(self, block: Block) -> None:
        self._ready.append(block)
        self._ready_samples += len(block)
        if block.counter is not None:
            self._counter = int(block.counter[-1])
        while self._ready_samples > MAX_UNREAD_SAMPLES and len(self._ready) > 1:
            dropped = len(self._ready.popleft())
            self._ready_samples -= dropped
            self._unread += dropped
        fresh = np.stack((block.t, block.host_s))
        self._recent = np.concatenate((self._recent, fresh), axis=1)[:, -RECENT_SAMPLES:]

    def _error(self) -> str | None:
        if self._reader is None:
            return f"{self.name} on {self.url} has not been started."
        error = self._reader.error
        if error is None:
            return None if self._reader.alive else f"{self.name} on {self.url} is stopped."
        return f"{self.name}: {error}"

    def _raise_fault_of_tap(self, *, once: bool = False) -> None:
        """Raise what ended the reading, unless it was the device."""
        error = None if self._reader is None else self._reader.error
        if error is None or isinstance(error, DeviceLost) or (once and self._raised):
            return
        self._raised = True
        raise error


def _rate(recent: FloatArray) -> float:
    """Return samples per second by the samples' own times, gaps left out."""
    if recent.shape[1] < 3:
        return 0.0
    t = recent[0][recent[0] > recent[0, -1] - RECENT_S]
    steps = np.diff(t)
    if len(steps) < 2:
        return 0.0
    steps = steps[steps < 3 * np.median(steps)]
    return float(len(steps) / steps.sum())


def _lag(recent: FloatArray) -> float:
    """Return the least lag among the samples that arrived last [s]."""
    if recent.shape[1] == 0:
        return 0.0
    t, host_s = recent
    late = (host_s - t)[host_s > host_s[-1] - LAG_S]
    return max(0.0, float(late.min()))


class PacketDevice(StreamDevice[PacketBlock]):
    """Any device that sends packets of a layout; hands them out as they are."""

    def __init__(
        self,
        name: str,
        url: str,
        layout: PacketLayout,
        clock: Clock,
        *,
        tap: Callable[[int, bytes], None] | None = None,
        baud: int = DEFAULT_BAUD,
    ) -> None:
        def join(blocks: Sequence[PacketBlock]) -> PacketBlock:
            return PacketBlock.concatenate(layout, blocks)

        stream = PacketStream(layout, watched_fields(layout))
        super().__init__(name, url, layout, stream, join, clock, tap=tap, baud=baud)
