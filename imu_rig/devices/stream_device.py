"""A device on a port: its packets in order, and the figures that tell how well it does."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from firmware_protocols.protocol import DeviceProtocol
from firmware_protocols.rows import RowLayout
from imu_rig.arrays import FloatArray
from imu_rig.clock import NS_PER_S, Clock
from imu_rig.devices.conversation import Conversation, Remembers, conversation_for
from imu_rig.devices.ports import DEFAULT_BAUD, open_port, usb_address
from imu_rig.devices.reader import PortReader
from imu_rig.devices.recognize import explain
from imu_rig.errors import DeviceError, DeviceLost, PortError
from imu_rig.packet_stream import PacketBlock, PacketStreams, StreamStats
from imu_rig.timing.sample_order import TimeSource

# Constants of time.
RECENT_S = 2.0  # over which the rate and the kind of bytes are judged
DECODE_S = 0.2  # of work at a time, after which the rest waits for the next poll
LAG_S = 1.0  # over which the least lag is taken, longer than the bursts of a healthy link
FAULT_S = 1.0  # for which a fault is named after a packet told of it

STUCK_SAMPLES = 25
"""So many samples in a row with the same counts in all axes are no measurement any more."""

RECENT_SAMPLES = 1000
RECENT_BYTES = 4096
MAX_UNREAD_BYTES = 16_000_000
MAX_BEHIND_BYTES = 500_000  # of a device that sends more than can be decoded: what is new counts
DECODED_BYTES = 1 << 17  # between looks at how long decoding takes
CHECKED_BYTES = 1 << 25  # by checksums in that time, where at every byte a packet may begin
MAX_UNREAD_SAMPLES = 1_000_000


@dataclass(frozen=True)
class StreamHealth(StreamStats):
    """How a port or one of its streams does: its counts since the start, leaps among the restarts.

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
    faults : tuple of str
        What the device itself told to be wrong within the last second, in words.
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
    faults: tuple[str, ...] = ()


class _Lane:
    """What has come of one stream: packets that nobody polled for, the times of the last ones."""

    def __init__(self, layout: RowLayout) -> None:
        self.layout = layout
        self.ready: deque[PacketBlock] = deque()
        self.ready_samples = 0
        self.recent = np.empty((2, 0))  # times and arrivals of the last samples [s]
        self.packet_ns: int | None = None
        self.counter: int | None = None

    def keep(self, block: PacketBlock) -> int:
        """Take packets in and return how many older ones were dropped for them."""
        unread = 0
        self.packet_ns = int(block.host_s.max() * NS_PER_S)
        self.ready.append(block)
        self.ready_samples += len(block)
        if block.counter is not None:
            self.counter = int(block.counter[-1])
        while self.ready_samples > MAX_UNREAD_SAMPLES and len(self.ready) > 1:
            dropped = len(self.ready.popleft())
            self.ready_samples -= dropped
            unread += dropped
        fresh = np.stack((block.t, block.host_s))
        self.recent = np.concatenate((self.recent, fresh), axis=1)[:, -RECENT_SAMPLES:]
        return unread

    def take(self) -> PacketBlock:
        """Return what is ready, once."""
        block = PacketBlock.concatenate(self.layout, self.ready)
        self.ready.clear()
        self.ready_samples = 0
        return block


class StreamDevice:
    """Reads one port in a thread of its own and keeps what comes until it is polled for.

    Safe to use from several threads. Every byte goes to ``tap`` before it is interpreted.

    Parameters
    ----------
    name : str
        What people call it; used in every message.
    url : str
        Port; see `imu_rig.devices.ports.open_port`.
    protocol : DeviceProtocol
        What it speaks.
    clock : Clock
        Host clock that stamps arrivals.
    tap : callable, optional
        Called in the reader's thread with the stamp [ns] and the bytes of each read.
    sent : callable, optional
        The same with what is written to the device.
    baud : int
    """

    def __init__(
        self,
        name: str,
        url: str,
        protocol: DeviceProtocol,
        clock: Clock,
        *,
        tap: Callable[[int, bytes], None] | None = None,
        sent: Callable[[int, bytes], None] | None = None,
        baud: int = DEFAULT_BAUD,
    ) -> None:
        self.name, self.url, self.protocol, self.baud = name, url, protocol, baud
        self._clock, self._tap, self._sent = clock, tap, sent
        self._streams = PacketStreams(protocol)
        self._lanes = {stream: _Lane(layout) for stream, layout in protocol.streams.items()}
        self._conversation: Conversation | None = None
        self._reader: PortReader | None = None
        self._lock = threading.Lock()  # of what polling and health share
        self._arrived = threading.Lock()  # of what the reader's thread adds
        self._chunks: deque[tuple[int, bytes]] = deque()
        self._chunk_bytes = 0
        self._raw: deque[tuple[int, bytes]] = deque()
        self._raw_bytes = 0
        self._reconnects = self._unread = 0
        self._opened_ns = self._byte_ns = self._packet_ns = clock.now_ns()
        self._raised = False
        self._address: str | None = None  # that stays when the device file changes

    def time_source(self, stream: str) -> TimeSource:
        """Return what the times of a stream rest on."""
        return self._streams.time_source(stream)

    def start(self) -> None:
        """Open the port, set the device up where it must be, and begin to read.

        Raises
        ------
        PortError
            If the port cannot be opened.
        DeviceError
            If the device cannot be set up, or if it is stopped meanwhile.
        """
        before = self._reader
        if before is not None and before.alive:
            return
        address = self._address or self.url
        conversation = conversation_for(self.protocol)
        if self._conversation is not None and isinstance(conversation, Remembers):
            conversation.remember(self._conversation)
        reader = PortReader(
            lambda: open_port(address, baud=self.baud),
            self._clock,
            self._take,
            self.name,
            conversation=conversation,
            on_sent=self._sent or (lambda t_ns, data: None),
        )
        self._conversation = conversation
        self._reader = reader  # from now on it can be stopped
        try:
            reader.start()
        except DeviceError as error:
            self._reader = before
            sentence = f"{self.name} on {self.url}: {error}"
            raise (DeviceLost if isinstance(error, DeviceLost) else DeviceError)(
                sentence
            ) from error
        except BaseException:
            self._reader = before
            raise
        self._address = self._address or usb_address(self.url)
        self._raised = False
        with self._lock:
            ever_heard = self._good > 0
        with self._arrived:
            self._opened_ns = self._byte_ns = self._clock.now_ns()
            if not ever_heard:
                self._packet_ns = self._opened_ns
            if self._conversation is None:
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
            self._streams.cut()
        try:
            self.start()
        except (PortError, DeviceError) as error:
            raise DeviceLost(f"{self.name} is not back: {error}") from error
        self._reconnects += 1

    def poll_streams(self) -> dict[str, PacketBlock]:
        """Return all packets since the last poll: ordered, each once, time strictly increasing.

        Of more than can be decoded in a moment, the rest comes with the next poll.

        A lost device raises nothing here: what it sent before is worth having, and the health
        tells.

        Returns
        -------
        dict
            Every stream of the protocol by its name, also those of which nothing came.

        Raises
        ------
        Exception
            What the tap raised.
        """
        with self._lock:
            self._decode()
            blocks = {stream: lane.take() for stream, lane in self._lanes.items()}
        self._raise_fault_of_tap()
        return blocks

    @property
    def port_health(self) -> StreamHealth:
        """Figures of all streams together as of now; rate, lag and counter are the first's."""
        return self._health(tuple(self._lanes))

    def stream_health(self, stream: str) -> StreamHealth:
        """Return the figures of one stream as of now."""
        return self._health((stream,))

    def _health(self, names: Sequence[str]) -> StreamHealth:
        with self._lock:
            self._decode()
            stats = _sum([self._streams.stats(name) for name in names])
            lanes = [self._lanes[name] for name in names]
            recent, counter = lanes[0].recent, lanes[0].counter
            stuck = any(self._streams.identical(name) >= STUCK_SAMPLES for name in names)
            now = self._clock.now_ns()
            since_s = now / NS_PER_S - FAULT_S
            told = [fault for name in names for fault in self._streams.faults(name, since_s)]
        with self._arrived:
            byte_age, packet_ns = now - self._byte_ns, self._packet_ns
        if len(self._lanes) > 1:  # where there is one, duplicates too show that it is alive
            heard = [lane.packet_ns for lane in lanes if lane.packet_ns is not None]
            packet_ns = max(heard, default=self._opened_ns)
        packet_age_s = max(0, now - packet_ns) / NS_PER_S
        # either way its time begins anew
        counts = {**vars(stats), "restarts": stats.restarts + stats.leaps}
        return StreamHealth(
            **counts,
            reconnects=self._reconnects,
            rate_hz=_rate(recent) if packet_age_s < RECENT_S else 0.0,
            last_packet_age_s=packet_age_s,
            last_byte_age_s=max(0, byte_age) / NS_PER_S,
            lag_s=_lag(recent),
            stuck=stuck,
            unread=self._unread,
            counter=counter,
            error=self._error(),
            faults=tuple(dict.fromkeys(told)),
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
        health = self.port_health
        if health.error is not None:
            return health.error
        if health.good and health.last_packet_age_s < LAG_S:
            return None
        if self._conversation is not None and self._conversation.problem is not None:
            return f"{self.name} on {self.url} {self._conversation.problem}."
        with self._arrived:
            since = self._clock.now_ns() - int(RECENT_S * NS_PER_S)
            data = b"".join(piece for t_ns, piece in self._raw if t_ns >= since)
        if not data:
            return (
                f"{self.name} on {self.url} sends nothing: check its power, its cable or Bluetooth "
                "link, and that this is its port."
            )
        return f"{self.name} on {self.url} {explain(data, self.protocol, self.baud)}."

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
        """Take some of what is not decoded, one chunk at least.

        Of long packets it is less: bytes that all look like the beginning of one cost a checksum
        of its length each.
        """
        most = min(DECODED_BYTES, CHECKED_BYTES // self.protocol.longest)
        chunks: list[tuple[int, bytes]] = []
        with self._arrived:
            size = 0
            while self._chunks:
                size += len(self._chunks[0][1])
                if chunks and size > most:
                    break
                chunks.append(self._chunks.popleft())
                self._chunk_bytes -= len(chunks[-1][1])
        return chunks

    @property
    def _good(self) -> int:
        return sum(self._streams.stats(stream).good for stream in self._lanes)

    def _decode_chunks(self, chunks: list[tuple[int, bytes]]) -> None:
        good = self._good
        blocks = self._streams.feed_many(chunks)
        if self._good > good:
            came_s = max(
                (float(block.host_s.max()) for block in blocks.values()),
                default=chunks[-1][0] / NS_PER_S,
            )
            with self._arrived:
                self._packet_ns = max(self._packet_ns, int(came_s * NS_PER_S))
        for stream, block in blocks.items():
            self._unread += self._lanes[stream].keep(block)

    def _drop_oldest(self, limit: int) -> None:
        """Drop what waits to be decoded beyond a limit [bytes]; the caller holds the lock."""
        while self._chunk_bytes > limit and (len(self._chunks) > 1 or not limit):
            dropped = len(self._chunks.popleft()[1])
            self._chunk_bytes -= dropped
            self._unread += dropped // self._packet_bytes

    @property
    def _packet_bytes(self) -> int:
        """About how long a packet is."""
        size, rate = self.protocol.bytes_per_s, self.protocol.packets_per_s
        return max(1, round(size / rate)) if size and rate else self.protocol.longest

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


def _sum(stats: Sequence[StreamStats]) -> StreamStats:
    """Add what each stream counts; what only the port knows is the same in all."""
    ports = ("corrupt", "skipped_bytes")
    return StreamStats(
        **{
            f.name: (max if f.name in ports else sum)(getattr(s, f.name) for s in stats)
            for f in fields(StreamStats)
        }
    )


class PacketDevice(StreamDevice):
    """Any device on a port; hands out the packets of all its streams as they are."""

    def poll(self) -> dict[str, PacketBlock]:
        """Return all packets since the last poll, as `poll_streams`."""
        return self.poll_streams()

    @property
    def health(self) -> StreamHealth:
        """Figures of all streams together as of now, as `port_health`."""
        return self.port_health
