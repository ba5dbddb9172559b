"""A walk on real ports: a person stands until somebody listens to every device, then walks."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from imu_rig.clock import NS_PER_S, Clock, SystemClock
from simulators.ports import SimulatedPort, Transport, port_maker
from simulators.walker.device import Carried, CarriedDevice
from simulators.walker.record import Collector, UnitRecord, check_names
from simulators.walker.scenarios import Scenario
from simulators.walker.walker import Walker

PUMP_S = 0.01
"""Time on the clock between two looks at what is due and at what was written."""

LEAD_S = 0.5
"""From the moment when somebody listens to all devices to the begin of the walk."""

SHORTEST_WAIT_S = 0.002
"""Shortest wait of the machine's time."""


class SimulatedWalk:
    """Devices that a person carries, on ports that any program can open, served by one thread.

    Until the walk begins the devices feel a person who stands. Use it as a context manager.

    Parameters
    ----------
    scenario : Scenario, str or Walker
    devices : mapping of name to kind, or Carried
        The place follows from the name, as in {"left foot": "mpu9150", "waist": "waist-unit"}.
    seed : int
        Of walk and devices.
    clock : Clock, optional
        Runs by itself: a `SystemClock` or a `ScaledClock`.
    transport : str
        "pty" for pseudo-terminals, "tcp" for sockets on this machine.
    waits : bool
        Whether the walk begins only when every port is open; otherwise at once.

    Raises
    ------
    ValueError
        For a scenario, kind or place that there is not.
    """

    def __init__(
        self,
        scenario: Scenario | str | Walker,
        devices: dict[str, str] | Iterable[Carried],
        *,
        seed: int = 1,
        clock: Clock | None = None,
        transport: Transport = "pty",
        waits: bool = True,
    ) -> None:
        self.walker = scenario if isinstance(scenario, Walker) else Walker(scenario, seed)
        if isinstance(devices, dict):
            devices = [Carried(name, kind) for name, kind in devices.items()]
        carried = list(devices)
        check_names(carried)
        self.clock: Clock = SystemClock() if clock is None else clock
        begin_s = math.inf if waits else 0.0
        self._devices = {
            one.name: CarriedDevice(one, self.walker, seed, begin_s=begin_s) for one in carried
        }
        self._collectors = {name: Collector(device) for name, device in self._devices.items()}
        self._transport: Transport = transport
        self._ports: dict[str, SimulatedPort] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._pump, name="simulated-walk", daemon=True)
        self._resources = ExitStack()
        self._origin_ns = 0
        self._begin_s = begin_s

    def __enter__(self) -> Self:
        """Open the ports and switch the devices on."""
        with ExitStack() as resources:
            make = port_maker(self._transport, resources)
            self._ports = {name: make(name) for name in self._devices}
            self._resources = resources.pop_all()
        self._origin_ns = self.clock.now_ns()
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

    def ports(self) -> dict[str, str]:
        """Return the address of every device's port."""
        return {name: port.url for name, port in self._ports.items()}

    @property
    def t_s(self) -> float | None:
        """Time since the begin of the walk [s]; None before it."""
        with self._lock:
            since_s = self._now_s() - self._begin_s
        return since_s if since_s >= 0.0 else None

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait, by the machine's time, until the walk is over; return whether it is."""
        return self._over.wait(timeout_s)

    def units(self) -> list[UnitRecord]:
        """Return what the devices have measured during the walk, with its truth."""
        with self._lock:
            return [unit for one in self._collectors.values() for unit in one.units()]

    def protocols(self) -> dict[str, str]:
        """Return the name of the built-in protocol that every device speaks."""
        return {name: device.kind.protocol for name, device in self._devices.items()}

    def dropped(self) -> dict[str, int]:
        """Return bytes of each device that were lost because its client did not read."""
        with self._lock:
            return {name: port.dropped for name, port in self._ports.items()}

    def _now_s(self) -> float:
        return (self.clock.now_ns() - self._origin_ns) / NS_PER_S

    def _pump(self) -> None:
        wait_s = max(PUMP_S / self.clock.speed, SHORTEST_WAIT_S)
        try:
            while not self._stopping.wait(wait_s):
                with self._lock:
                    self._serve(self._now_s())
        finally:  # clients must see that nobody serves them any more
            for port in self._ports.values():
                port.unplug()

    def _serve(self, now_s: float) -> None:
        if math.isinf(self._begin_s) and all(port.connected for port in self._ports.values()):
            self._begin_s = now_s + LEAD_S
            for device in self._devices.values():
                device.begin(self._begin_s)
        for name, device in self._devices.items():
            port, collector = self._ports[name], self._collectors[name]
            if heard := port.read():
                collector.add(device.receive(heard, now_s))
            collector.add(device.advance(now_s))
            for _, data in device.take(now_s):
                port.write(data)
        if now_s - self._begin_s > self.walker.end_s:
            self._over.set()
