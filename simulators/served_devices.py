"""Many sending devices on ports of this machine, cheaply: what a recorder is tried with.

Each speaks its protocol at its own rate and by its own clock, and can be unplugged, silenced or
made to send garbage at any moment; what it sent is known by counter, for each of its streams. For
a jig with its sensor and the physics between them there is `simulators.rig`.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import numpy as np

from firmware_protocols.known import load_protocol
from firmware_protocols.protocol import DeviceProtocol
from imu_rig.clock import NS_PER_S, Clock, SystemClock
from simulators.device_voices import Voice, voices_of
from simulators.maestro_board import MaestroBoard
from simulators.maestro_motion import TICK_S
from simulators.models import MaestroModel
from simulators.ports import SimulatedPort, Transport, port_maker

PUMP_S = 0.004
"""Time on the clock between two looks at what is due."""

SHORTEST_WAIT_S = 0.001
"""Shortest wait of the machine's time."""

LISTEN_PUMPS = 8
"""What clients write is read, and new ones let in, every so many looks."""

GARBAGE_BYTES = 28
"""So many random bytes stand for a packet."""


class ServedDevices:
    """Simulated devices that any program can open, served by one thread.

    Use it as a context manager; devices are added inside.

    Parameters
    ----------
    clock : Clock
        Runs by itself: a `SystemClock` or a `ScaledClock`.
    transport : str
        "pty" for pseudo-terminals, "tcp" for sockets on this machine.
    """

    def __init__(self, clock: Clock | None = None, transport: Transport = "pty") -> None:
        self.clock: Clock = SystemClock() if clock is None else clock
        self._devices: dict[str, _Device] = {}
        self._servos: dict[str, _Servos] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._pump, name="served-devices", daemon=True)
        self._resources = ExitStack()
        self._transport: Transport = transport
        self._make_port: Callable[[str], SimulatedPort]

    def __enter__(self) -> Self:
        """Begin to serve."""
        self._make_port = port_maker(self._transport, self._resources)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """End, and take every port away."""
        self._stopping.set()
        self._thread.join()
        self._resources.close()

    def add(
        self,
        name: str,
        protocol: DeviceProtocol | str,
        rate_hz: float | None = None,
        *,
        seed: int = 0,
        skew_ppm: float = 0.0,
        burst_s: float = 0.0,
    ) -> str:
        """Switch a device on and return the address of its port.

        Parameters
        ----------
        name : str
            For the methods below.
        protocol : DeviceProtocol or str
            What it speaks, or the name of it.
        rate_hz : float, optional
            Packets per second by the device's clock; otherwise that of its layout.
        seed : int
            Of its signals and bursts.
        skew_ppm : float
            How much too fast its clock runs [1e-6].
        burst_s : float
            Longest time that a radio holds packets back before it sends them at once; 0 for a
            cable.

        Raises
        ------
        ValueError
            If nothing here speaks that protocol, or its rate is not known.
        """
        spoken = load_protocol(protocol) if isinstance(protocol, str) else protocol
        voices = voices_of(spoken, rate_hz, seed)
        with self._lock:
            port = self._new_port(name)
            self._devices[name] = _Device(
                port, voices, self.clock.now_ns(), seed, skew_ppm, burst_s
            )
            return port.url

    def add_servos(self, name: str = "jig", model: MaestroModel | None = None) -> str:
        """Switch a servo controller on and return the address of its command port."""
        with self._lock:
            port = self._new_port(name)
            self._servos[name] = _Servos(port, model or MaestroModel(), self.clock.now_ns())
            return port.url

    def unplug(self, name: str) -> None:
        """Take the port away, also under the feet of a client. The device runs and counts on."""
        with self._lock:
            (self._devices.get(name) or self._servos[name]).unplug()

    def plug(self, name: str) -> None:
        """Bring the port back under the same address."""
        with self._lock:
            (self._devices.get(name) or self._servos[name]).port.plug()

    def silence(self, name: str, on: bool = True, *, stream: str | None = None) -> None:
        """Send nothing, or send again; the port stays and the device counts on.

        With a stream, as that of a unit whose radio is out of reach, the others go on.
        """
        with self._lock:
            for lane in self._devices[name].lanes.values():
                if stream in (None, lane.voice.stream):
                    lane.silent = on

    def garbage(self, name: str, on: bool = True) -> None:
        """Send random bytes in place of packets, or packets again."""
        with self._lock:
            self._devices[name].garbled = on

    def restart(self, name: str) -> None:
        """Let the device start anew, with counter and clock at zero."""
        with self._lock:
            self._devices[name].restart(self.clock.now_ns())

    def sent(self, name: str) -> int:
        """Return how many samples were handed to a client that had the port open."""
        with self._lock:
            return sum(lane.sent for lane in self._devices[name].lanes.values())

    def counters(self, name: str) -> list[tuple[int, int]]:
        """Return first and last number of every unbroken run of samples that were handed out.

        Samples are numbered from 0 at the device's start; what goes over the wire is that number
        modulo the counter's type. Of several streams it is the first.
        """
        return next(iter(self.counters_of(name).values()))

    def counters_of(self, name: str) -> dict[str, list[tuple[int, int]]]:
        """Return the same of every stream by its name.

        A device that can be spoken to makes all its streams at once, under the name "".
        """
        with self._lock:
            return {s: list(lane.runs) for s, lane in self._devices[name].lanes.items()}

    def dropped(self, name: str) -> int:
        """Return bytes of those handed out that were lost because the client did not read."""
        with self._lock:
            return self._devices[name].port.dropped

    def _new_port(self, name: str) -> SimulatedPort:
        """Make the port of a device and plug it; the caller holds the lock."""
        if name in self._devices or name in self._servos:
            raise ValueError(f"there is a device {name!r} already")
        return self._make_port(name)

    def _pump(self) -> None:
        wait_s = max(PUMP_S / self.clock.speed, SHORTEST_WAIT_S)
        looks = 0
        try:
            while not self._stopping.wait(wait_s):
                with self._lock:
                    listen = looks % LISTEN_PUMPS == 0
                    looks += 1
                    for device in self._devices.values():
                        device.serve(self.clock.now_ns(), listen=listen)
                    for servos in self._servos.values():
                        servos.serve(self.clock.now_ns())
        finally:  # clients must see that nobody serves them any more
            with self._lock:
                for device in self._devices.values():
                    device.unplug()
                for servos in self._servos.values():
                    servos.unplug()


class _Lane:
    """One stream of a device: what it made up to a moment, and what became of it."""

    def __init__(self, voice: Voice) -> None:
        self.voice = voice
        self.silent = False
        self.sent = 0
        self.runs: list[tuple[int, int]] = []
        self._next = 0  # number of the sample to be sent next
        self._since_s, self._since = 0.0, 0  # since when, and from which sample, at this rate
        self._rate_hz = voice.rate_hz
        self._unbroken = False

    def restart(self) -> bytes:
        self._next = self._since = 0
        self._since_s = 0.0
        self._unbroken = False
        said = self.voice.restart()
        self._rate_hz = self.voice.rate_hz
        return said

    def interrupt(self) -> None:
        self._unbroken = False

    def due(self, now_s: float) -> int:
        """Return how many samples there should be by now, by the device's clock."""
        if self.voice.rate_hz != self._rate_hz:  # it was told to
            self._since_s, self._since = now_s, self._next
            self._rate_hz = self.voice.rate_hz
        return self._since + math.floor((now_s - self._since_s) * self._rate_hz)

    def pass_by(self, due: int) -> int:
        """Let samples pass that nobody hears; return how many."""
        first, self._next = self._next, max(self._next, due)
        if self._next > first:
            self.voice.skip(first, self._next)
            self._unbroken = False
        return self._next - first

    def tell(self, due: int) -> bytes:
        """Return what goes out with the samples that are due."""
        first = self._next
        if due <= first:
            return b""
        said = self.voice.say(first, due)
        self._next = due
        for number, packet in enumerate(said, first):
            if not packet:
                self._unbroken = False
                continue
            self.sent += 1
            if self._unbroken:
                self.runs[-1] = (self.runs[-1][0], number)
            else:
                self.runs.append((number, number))
            self._unbroken = True
        return b"".join(said)


class _Device:
    """One device: its streams, its clock, and what is wrong with it."""

    def __init__(
        self,
        port: SimulatedPort,
        voices: list[Voice],
        start_ns: int,
        seed: int,
        skew_ppm: float,
        burst_s: float,
    ) -> None:
        self.port = port
        self.garbled = False
        self.lanes = {voice.stream: _Lane(voice) for voice in voices}
        self._speed = 1.0 + skew_ppm * 1e-6
        self._start_ns = start_ns
        self._rng = np.random.default_rng((seed, 1))
        self._burst_s = burst_s
        self._burst_ns = start_ns

    def restart(self, now_ns: int) -> None:
        self._start_ns = now_ns
        said = b"".join(lane.restart() for lane in self.lanes.values())
        if said and self._heard:
            self.port.write(said)

    def unplug(self) -> None:
        self.port.unplug()
        for lane in self.lanes.values():
            lane.interrupt()

    @property
    def _heard(self) -> bool:
        return self.port.plugged and self.port.connected

    def serve(self, now_ns: int, *, listen: bool) -> None:
        """Send what is due, after an answer to what was said."""
        now_s = (now_ns - self._start_ns) / NS_PER_S * self._speed
        if listen and (data := self.port.read()):
            self._catch_up(now_s)
            for lane in self.lanes.values():
                if answer := lane.voice.hear(data, now_s):
                    self.port.write(answer)
        if self._burst_s > 0:
            if now_ns < self._burst_ns:
                return
            wait_s = float(self._rng.uniform(0.1, 1.0)) * self._burst_s
            self._burst_ns = now_ns + round(wait_s * NS_PER_S)
        self._catch_up(now_s)

    def _catch_up(self, now_s: float) -> None:
        """Send all that is due by now."""
        heard = self._heard
        for lane in self.lanes.values():
            due = lane.due(now_s)
            if lane.silent or not heard or self.garbled:
                passed = lane.pass_by(due)
                if heard and self.garbled and not lane.silent:
                    self.port.write(self._rng.bytes(passed * GARBAGE_BYTES))
            elif said := lane.tell(due):
                self.port.write(said)


class _Servos:
    """A servo controller that does what it is told."""

    def __init__(self, port: SimulatedPort, model: MaestroModel, start_ns: int) -> None:
        self.port = port
        self._board = MaestroBoard(model, "usb-dual-port", np.random.default_rng(0))
        self._start_ns = start_ns
        self._ticks = 0

    def unplug(self) -> None:
        self.port.unplug()

    def serve(self, now_ns: int) -> None:
        """Answer, and move on what is under way."""
        now_s = (now_ns - self._start_ns) / NS_PER_S
        if data := self.port.read():
            self._board.receive(data, now_s)
        ticks = int(now_s / TICK_S)
        for _ in range(ticks - self._ticks):
            self._board.tick(now_s)
        self._ticks = ticks
        if answer := self._board.outbox.take(now_s):
            self.port.write(answer)
