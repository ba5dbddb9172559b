"""Watches devices until told to stop: opens their ports, reads them, keeps the newest samples.

The same keepers as in a recording, with nothing written down.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

import numpy as np

from firmware_protocols.protocol import DeviceProtocol
from firmware_protocols.rows import RowLayout
from imu_rig.clock import NS_PER_S, Clock, Deadline, SystemClock
from imu_rig.devices.stream_device import PacketDevice
from imu_rig.errors import DeviceError, PortError
from imu_rig.imu_stream import packet_samples
from imu_rig.monitor.figure import StreamPlan
from imu_rig.monitor.quantities import Quantity, quantities_of
from imu_rig.monitor.rings import Ring, ring_size
from imu_rig.monitor.status import MonitorStatus, Reading
from imu_rig.packet_stream import PacketBlock
from imu_rig.recorder.keeper import DeviceKeeper, final_fault
from imu_rig.recorder.setup import DeviceSetup
from imu_rig.stopping import StopRequest

# Constants of time.
TURN_S = 0.05
OBSERVE_S = 0.2  # between statuses
LOOK_S = 0.2  # between looks at what came
SMOOTH_LOOK_S = 0.05  # the same for a window, whose lines are to move smoothly
END_S = 2.0  # for all ports to close

NAMELESS = 0  # source number of everything, as nothing is recorded


class NothingKept:
    """Takes what a keeper would record, and keeps nothing of it."""

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns

    def gap(self, source: int, t_ns: int, reason: str, **fields: Any) -> None:
        """Keep nothing."""

    def device_statistics(self, source: int, values: Mapping[str, Any]) -> None:
        """Keep nothing."""

    def t_s(self, t_ns: int) -> float:
        """Return the time since the start [s]."""
        return (t_ns - self._start_ns) / NS_PER_S


class Monitor:
    """Watches devices.

    Parameters
    ----------
    devices : sequence of DeviceSetup
    clock : Clock
    stop : StopRequest, optional
        Ends it when made.
    seconds : float, optional
        After which it ends by itself.
    observe : callable, optional
        Takes a `MonitorStatus` a few times a second, in the thread of `run`.
    notify : callable, optional
        Takes sentences for people, from any thread.

    Attributes
    ----------
    plans : tuple of StreamPlan
        What every stream measures, in the order of the devices.
    rates_hz : tuple of float or None
        Nominal rate of each.
    shortfall : PortError or DeviceError or None
        Why a planned watch is not what it should be: a required device was not heard, or no
        longer at the end.

    Raises
    ------
    InputError
        If a layout cannot be used.
    """

    def __init__(
        self,
        devices: tuple[DeviceSetup, ...],
        clock: Clock,
        *,
        stop: StopRequest | None = None,
        seconds: float | None = None,
        observe: Callable[[MonitorStatus], None] = lambda status: None,
        notify: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._clock, self._stop, self._seconds = clock, stop or StopRequest(), seconds
        self._observe, self._notify = observe, notify
        self._setups = [(device, device.protocol()) for device in devices]
        self._layouts = {
            stream_name(device.name, name): layout
            for device, protocol in self._setups
            for name, layout in protocol.streams.items()
        }
        self.plans = tuple(StreamPlan(n, measured(layout)) for n, layout in self._layouts.items())
        self.rates_hz = tuple(layout.rate_hz for layout in self._layouts.values())
        self._quantities = {plan.name: plan.quantities for plan in self.plans}
        self._rings: dict[str, Ring] = {}
        self._look_s = LOOK_S
        self._readings: dict[str, tuple[Reading, ...]] = {}
        self._lock = threading.Lock()
        self._keepers: list[DeviceKeeper] = []
        self._start_ns = clock.now_ns()
        self.shortfall: PortError | DeviceError | None = None

    def ring_sizes(self, seconds: float) -> list[int]:
        """Return how many samples of each stream so many seconds are."""
        return [ring_size(rate, seconds) for rate in self.rates_hz]

    def fill(self, rings: list[Ring], *, smoothly: bool = False) -> None:
        """Put samples into these rings, one for each of ``plans``; before `run`.

        ``smoothly`` looks more often at what came, for somebody who watches.
        """
        self._look_s = SMOOTH_LOOK_S if smoothly else LOOK_S
        self._rings = {plan.name: ring for plan, ring in zip(self.plans, rings, strict=True)}

    def run(self) -> MonitorStatus:
        """Watch until the time is over or a stop is asked for, and return how it was at the end.

        Raises
        ------
        PortError, DeviceError
            If a port of a required device is refused.
        """
        self._start_ns = self._clock.now_ns()
        with ExitStack() as stack:
            stack.callback(self._release)
            for device, protocol in self._setups:
                self._keepers.append(self._keeper(device, protocol))
            for keeper in self._keepers:
                keeper.start()
            self._watch()
            self._observe(self._status())
            over = self._stop.cause is None
            last = self._status()
            if over:
                self.shortfall = self._shortfall()
        self._raise_faults()
        return last

    def _keeper(self, setup: DeviceSetup, protocol: DeviceProtocol) -> DeviceKeeper:
        device = PacketDevice(setup.name, setup.port, protocol, self._clock, baud=setup.baud)

        def take(blocks: Mapping[str, PacketBlock]) -> None:
            for name, block in blocks.items():
                if len(block):
                    self._take(stream_name(setup.name, name), block)

        return DeviceKeeper(
            setup,
            device,
            NothingKept(self._start_ns),
            NAMELESS,
            self._clock,
            self._notify,
            take=take,
            look_s=self._look_s,
        )

    def _take(self, name: str, block: PacketBlock) -> None:
        """Keep the newest samples of a stream; in its keeper's thread."""
        samples = packet_samples(self._layouts[name], block)
        quantities = self._quantities[name]
        shown = [quantity.shown(samples.values) for quantity in quantities]
        ring = self._rings.get(name)
        if ring is not None:
            ring.write(samples.t, shown)
        newest = tuple(
            (quantity, tuple(float(number) for number in latest(numbers)))
            for quantity, numbers in zip(quantities, shown, strict=True)
        )
        with self._lock:
            before = dict(self._readings.get(name, ()))
            self._readings[name] = tuple(
                (q, n if np.isfinite(n).any() else before.get(q, n)) for q, n in newest
            )

    def _watch(self) -> None:
        shown_s = -OBSERVE_S
        while self._stop.cause is None:
            self._raise_faults()
            elapsed_s = self._elapsed_s()
            if self._seconds is not None and elapsed_s >= self._seconds:
                return
            if elapsed_s - shown_s >= OBSERVE_S:
                shown_s = elapsed_s
                self._observe(self._status())
            self._clock.sleep(TURN_S)

    def _shortfall(self) -> PortError | DeviceError | None:
        """Return what is wrong with the first required device that does not send now."""
        for keeper in self._keepers:
            setup, rows = keeper.setup, [row for row in keeper.status.rows if row.required]
            off = [row for row in rows if row.state != "live"]
            if not off and (keeper.heard or not setup.required):
                continue
            refused = DeviceError if keeper.device.running or keeper.heard else PortError
            problem = next((row.problem for row in off if row.problem), keeper.status.problem)
            if problem is not None:
                return refused(problem)
            names = ", ".join(row.name for row in off) or setup.name
            heard = "is not heard any more" if keeper.heard else "was not heard"
            return DeviceError(
                f"{names} on {setup.port} {heard} in the {self._elapsed_s():.1f} s of this look: "
                "look longer, and see that it is switched on."
            )
        return None

    def _raise_faults(self) -> None:
        for keeper in self._keepers:
            if (error := final_fault(keeper)) is not None:
                raise error

    def _release(self) -> None:
        end = Deadline(SystemClock(), END_S)
        for keeper in self._keepers:
            keeper.ask_to_stop()
        for keeper in self._keepers:
            keeper.join(end.remaining)

    def _elapsed_s(self) -> float:
        return (self._clock.now_ns() - self._start_ns) / NS_PER_S

    def _status(self) -> MonitorStatus:
        with self._lock:
            readings = dict(self._readings)
        devices = tuple(keeper.status for keeper in self._keepers)
        return MonitorStatus(self._elapsed_s(), self._seconds, devices, readings)


def stream_name(device: str, stream: str) -> str:
    """Return the name of a stream: the device's, and its own where there are several."""
    return f"{device}/{stream}" if stream else device


def measured(layout: RowLayout) -> tuple[Quantity, ...]:
    """Return what rows of a layout measure."""
    samples = packet_samples(layout, PacketBlock.empty(layout))
    flags = [flag for field in layout.fields for flag, _ in field.flags]
    raw = []
    if layout.barometer is not None:
        raw = [layout.barometer.prom, layout.barometer.d1, layout.barometer.d2]
    return quantities_of(samples.values, samples.units, (*flags, *raw))


def latest(numbers: np.ndarray[Any, np.dtype[np.float64]]) -> Any:
    """Return the newest row that holds a number, of which a packet without measurement has none."""
    there = np.flatnonzero(np.isfinite(numbers).any(axis=1))
    return numbers[there[-1] if len(there) else -1]
