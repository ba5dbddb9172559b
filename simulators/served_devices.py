"""Many sending devices on ports of this machine, cheaply: what a recorder is tried with.

Each sends packets of its layout at its own rate and by its own clock, and can be unplugged,
silenced or made to send garbage at any moment; what it sent is known by counter. For a jig with
its sensor and the physics between them there is `simulators.rig`.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import numpy as np

from firmware_protocols.layout import PacketLayout, load_layout
from imu_rig.clock import NS_PER_S, Clock, SystemClock
from simulators.device_packets import DevicePackets
from simulators.maestro_board import MaestroBoard
from simulators.maestro_motion import TICK_S
from simulators.models import MaestroModel
from simulators.ports import SimulatedPort, Transport, port_maker

PUMP_S = 0.004
"""Time on the clock between two looks at what is due."""

SHORTEST_WAIT_S = 0.001
"""Shortest wait of the machine's time."""

LISTEN_PUMPS = 8
"""What clients write is thrown away, and new ones let in, every so many looks."""

AHEAD_S = 0.5
"""So much is made at once, of at most ``MOST_AHEAD`` packets."""

MOST_AHEAD = 2000


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
        layout: PacketLayout | str,
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
        layout : PacketLayout or str
            What it sends, or the name of it.
        rate_hz : float, optional
            Packets per second by the device's clock; otherwise that of the layout.
        seed : int
            Of its signals and bursts.
        skew_ppm : float
            How much too fast its clock runs [1e-6].
        burst_s : float
            Longest time that a radio holds packets back before it sends them at once; 0 for a
            cable.
        """
        made_of = load_layout(layout) if isinstance(layout, str) else layout
        rate = rate_hz or made_of.rate_hz
        if rate is None:
            raise ValueError(f"layout {made_of.name} states no rate; give one")
        with self._lock:
            port = self._new_port(name)
            self._devices[name] = _Device(
                port, made_of, rate, self.clock.now_ns(), seed, skew_ppm, burst_s
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

    def silence(self, name: str, on: bool = True) -> None:
        """Send nothing, or send again; the port stays and the device counts on."""
        with self._lock:
            self._devices[name].silent = on

    def garbage(self, name: str, on: bool = True) -> None:
        """Send random bytes in place of packets, or packets again."""
        with self._lock:
            self._devices[name].garbled = on

    def restart(self, name: str) -> None:
        """Let the device start anew, with counter and clock at zero."""
        with self._lock:
            self._devices[name].restart(self.clock.now_ns())

    def sent(self, name: str) -> int:
        """Return how many packets were handed to a client that had the port open."""
        with self._lock:
            return self._devices[name].sent

    def counters(self, name: str) -> list[tuple[int, int]]:
        """Return first and last number of every unbroken run of packets that were handed out.

        Packets are numbered from 0 at the device's start; what goes over the wire is that number
        modulo the counter's type.
        """
        with self._lock:
            return list(self._devices[name].runs)

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
                        if listen:
                            device.port.read()
                        device.serve(self.clock.now_ns())
                    for servos in self._servos.values():
                        servos.serve(self.clock.now_ns())
        finally:  # clients must see that nobody serves them any more
            with self._lock:
                for device in self._devices.values():
                    device.unplug()
                for servos in self._servos.values():
                    servos.unplug()


class _Device:
    """One device: what it made up to a moment, and what became of it."""

    def __init__(
        self,
        port: SimulatedPort,
        layout: PacketLayout,
        rate_hz: float,
        start_ns: int,
        seed: int,
        skew_ppm: float,
        burst_s: float,
    ) -> None:
        self.port = port
        self.silent = self.garbled = False
        self.sent = 0
        self.runs: list[tuple[int, int]] = []
        self._packets = DevicePackets(layout, rate_hz, seed)
        self._length = layout.length
        self._own_rate_hz = rate_hz
        self._rate_hz = rate_hz * (1.0 + skew_ppm * 1e-6)
        self._start_ns = start_ns
        self._rng = np.random.default_rng((seed, 1))
        self._burst_s = burst_s
        self._burst_ns = start_ns
        self._next = 0  # number of the packet to be sent next
        self._ahead = memoryview(b"")
        self._ahead_from = 0  # number of the packet that it begins with
        self._unbroken = False

    def restart(self, now_ns: int) -> None:
        self._start_ns = now_ns
        self._next = 0
        self._ahead, self._ahead_from = memoryview(b""), 0
        self._packets.reset_clock()
        self._unbroken = False

    def unplug(self) -> None:
        self.port.unplug()
        self._unbroken = False

    def serve(self, now_ns: int) -> None:
        """Send what is due."""
        if self._burst_s > 0:
            if now_ns < self._burst_ns:
                return
            wait_s = float(self._rng.uniform(0.1, 1.0)) * self._burst_s
            self._burst_ns = now_ns + round(wait_s * NS_PER_S)
        due = math.floor((now_ns - self._start_ns) / NS_PER_S * self._rate_hz)
        if due <= self._next:
            return
        if self.silent or not self.port.plugged or not self.port.connected:
            self._next = due
            self._unbroken = False
            return
        if self.garbled:
            self.port.write(self._rng.bytes((due - self._next) * self._length))
            self._unbroken = False
        else:
            self._send(due)
        self._next = due

    def _send(self, due: int) -> None:
        first = self._next
        while self._next < due:
            taken = min(due, self._made_until()) - self._next
            if taken <= 0:
                self._make()
                continue
            start = (self._next - self._ahead_from) * self._length
            self.port.write(self._ahead[start : start + taken * self._length])
            self._next += taken
        self.sent += due - first
        if self._unbroken:
            self.runs[-1] = (self.runs[-1][0], due - 1)
        else:
            self.runs.append((first, due - 1))
        self._unbroken = True

    def _made_until(self) -> int:
        return self._ahead_from + len(self._ahead) // self._length

    def _make(self) -> None:
        number = min(MOST_AHEAD, max(1, round(AHEAD_S * self._own_rate_hz)))
        self._ahead = memoryview(self._packets.make(self._next, number))
        self._ahead_from = self._next


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
