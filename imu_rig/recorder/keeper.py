"""Keeps one device of a recording alive: opens it, watches it, opens it again, records each gap."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

from firmware_protocols.packets import values
from firmware_protocols.rows import RowLayout
from imu_rig.clock import NS_PER_S, Clock
from imu_rig.devices.stream_device import PacketDevice, StreamHealth
from imu_rig.errors import DeviceLost, ImuRigError, PortError, PortMissing
from imu_rig.packet_stream import PacketBlock
from imu_rig.recorder.setup import DeviceSetup
from imu_rig.recorder.status import DeviceState, DeviceStatus
from imu_rig.recording.format import SILENT, UNPLUGGED, UNREADABLE
from imu_rig.recording.writer import TrialWriter

# Constants of time.
WATCH_S = 0.1  # between looks at a port
DECODE_S = 0.2  # between looks at what it sent
STATISTICS_S = 1.0  # between records of how it does
SILENT_S = 0.6  # without a byte, or five periods of a slow device: something is wrong
UNREADABLE_S = 0.7  # of bytes without a packet, likewise
PERIODS = 5
RETRY_S = 0.25  # between attempts to open a port that has gone
REVIVE_S = 2.0  # of silence before an open port is opened again, then twice as long each time ...
LONGEST_REVIVE_S = 30.0  # ... up to this: opening resets some boards
ASK_S = 1.0  # between looks at why nothing comes that can be read

SUPPLY_WORDS = ("battery", "supply", "voltage")

REASONS: dict[DeviceState, str] = {
    "lost": UNPLUGGED,
    "silent": SILENT,
    "garbled": UNREADABLE,
}

STATISTICS = (
    "state",
    "rate_hz",
    "packets",
    "lost",
    "corrupt",
    "duplicates",
    "restarts",
    "reconnects",
    "gaps",
)
"""What of a device's status is recorded."""


@dataclass
class _Gap:
    """A stretch without packets: when its first is missing, and the counter before it."""

    start_ns: int
    reason: str
    counter: int | None
    restarts: int


class DeviceKeeper:
    """One device of a recording, kept by a thread of its own.

    Parameters
    ----------
    setup : DeviceSetup
    device : PacketDevice
        Its bytes must go to ``trial`` by its tap.
    trial : TrialWriter
    source : int
        Number of the device in the trial.
    clock : Clock
    notify : callable
        Takes a sentence for people; called from the keeper's thread.
    """

    def __init__(
        self,
        setup: DeviceSetup,
        device: PacketDevice,
        trial: TrialWriter,
        source: int,
        clock: Clock,
        notify: Callable[[str], None],
    ) -> None:
        self.setup = setup
        self.device = device
        self._trial, self._source, self._clock, self._notify = trial, source, clock, notify
        self._status = DeviceStatus(setup.name, setup.port, required=setup.required)
        self._health = StreamHealth()
        self._gap: _Gap | None = None
        self._gaps = 0
        self._supply: tuple[tuple[str, float, str], ...] = ()
        self._heard = False
        self._problem: str | None = None
        self._revive_s = REVIVE_S
        self._asked_ns = clock.now_ns()
        self._stopping = threading.Event()
        self.tried = threading.Event()
        """Set once the first attempt to open the port has succeeded or failed."""
        self.fault: Exception | None = None
        """What ended the keeper: a port that will never open, or a mistake of our own."""
        self._thread = threading.Thread(target=self._run, name=f"keep {setup.name}", daemon=True)
        rate_hz = max((layout.rate_hz or 0.0) for layout in device.protocol.streams.values())
        period = 1.0 / rate_hz if rate_hz else 0.0
        self._silent_s = max(SILENT_S, PERIODS * period)
        self._unreadable_s = max(UNREADABLE_S, PERIODS * period)

    @property
    def status(self) -> DeviceStatus:
        """How the device does, as of the last look."""
        return self._status

    @property
    def heard(self) -> bool:
        """Whether a good packet ever came."""
        return self._heard

    def start(self) -> None:
        """Begin; returns at once."""
        self._thread.start()

    def ask_to_stop(self) -> None:
        """Begin to end; returns at once."""
        self._stopping.set()

    def join(self, timeout_s: float) -> None:
        """Wait until the port is closed and the last statistics are handed in."""
        self._stopping.set()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        try:
            self._open_first()
            decoded_ns = told_ns = self._clock.now_ns()
            while not self._stopping.is_set():
                now = self._clock.now_ns()
                self._watch_port(now)
                if now - decoded_ns >= DECODE_S * NS_PER_S:
                    decoded_ns = now
                    self._look(now)
                if now - told_ns >= STATISTICS_S * NS_PER_S:
                    told_ns += int(STATISTICS_S * NS_PER_S)
                    self._tell()
                self._wait(WATCH_S)
        except Exception as error:  # the recorder raises it in its own thread
            self.fault = error
        finally:
            self.tried.set()
            try:
                self.device.stop()
                self._take_packets()
                self._show(self._status.state)
                self._tell()
            except Exception as error:
                self.fault = self.fault or error

    def _wait(self, seconds: float) -> None:
        self._stopping.wait(seconds / self._clock.speed)

    def _open_first(self) -> None:
        """Open the port, waiting for one that is not there.

        A port that is refused is final only for a required device, at the first attempt: nobody
        walks yet. Later it may be busy for a moment, as when another program looks at what was
        plugged in, and must not cost the others anything.
        """
        while not self._stopping.is_set():
            try:
                self.device.start()
            except PortError as error:
                first = not self.tried.is_set()
                if first and self.setup.required and not isinstance(error, PortMissing):
                    raise
                self._problem = str(error)
                self._show("waiting")
                self.tried.set()
                self._wait(RETRY_S)
            else:
                self._problem = None
                self.tried.set()
                return

    def _watch_port(self, now: int) -> None:
        """Notice a port that has gone and open it again."""
        if not self.device.running:
            if self._gap is None or self._gap.reason != REASONS["lost"]:
                self._take_packets()
                self._problem = self.device.health.error
                self._begin_gap("lost")
            self._reopen()
        elif (
            self._gap is not None
            and self._status.state == "silent"
            and now - self.device.last_byte_ns > self._revive_s * NS_PER_S
        ):
            self._reopen()
            self._revive_s = min(2 * self._revive_s, LONGEST_REVIVE_S)

    def _reopen(self) -> None:
        try:
            self.device.reopen()
        except DeviceLost as error:
            self._problem = str(error)
            self._wait(RETRY_S)

    def _look(self, now: int) -> None:
        """Decode what came and judge the state by it."""
        self._take_packets()
        health = self._health
        byte_age_s = (now - self.device.last_byte_ns) / NS_PER_S
        open_s = (now - self.device.opened_ns) / NS_PER_S
        if not self.device.running:
            self._show("lost" if self._heard else "waiting")
        elif health.good and health.last_packet_age_s <= self._silent_s:
            self._show("live")
        elif byte_age_s > self._silent_s:
            self._doubt("silent", now)
        elif min(health.last_packet_age_s, open_s) > self._unreadable_s:
            self._doubt("garbled", now)
        else:  # opened a moment ago, or the first half second of trouble
            self._show(self._status.state)

    def _doubt(self, state: DeviceState, now: int) -> None:
        """Take note of a device that sends nothing that can be read."""
        if now - self._asked_ns > ASK_S * NS_PER_S:
            self._asked_ns = now
            self._problem = self.device.identify_problem() or self._problem
        if self._heard and self._gap is None:
            what = "nothing" if state == "silent" else "nothing that can be read"
            self._problem = self._problem or (
                f"{self.setup.name} on {self.setup.port} sends {what} any more: check its power, "
                "its cable or Bluetooth link."
            )
            self._begin_gap(state)
        self._show(state if self._heard or state == "garbled" else "waiting")

    def _take_packets(self) -> None:
        stream, block = next(iter(self.device.poll().items()))
        self._health = self.device.health
        if not len(block):
            return
        self._supply = supply_of(self.device.protocol.streams[stream], block)
        if not self._heard:
            self._heard = True
            self._problem = None
        if self._gap is not None and block.host_s[-1] * NS_PER_S > self._gap.start_ns:
            self._end_gap(block)
        self._revive_s = REVIVE_S

    def _begin_gap(self, state: DeviceState) -> None:
        if self._gap is not None:  # was silent, and now its port has gone
            self._gap.reason = REASONS[state]
        else:
            health = self._health
            last_ns = self._clock.now_ns() - int(health.last_packet_age_s * NS_PER_S)
            self._gap = _Gap(last_ns, REASONS[state], health.counter, health.restarts)
            self._gaps += 1
        self._record_gap({})
        if self._heard:
            self._notify(self._problem or f"{self.setup.name} is {state}.")
        self._show(state)

    def _end_gap(self, block: PacketBlock) -> None:
        gap = self._gap
        if gap is None:
            return
        fresh = block.host_s * NS_PER_S > gap.start_ns
        first = int(fresh.argmax())
        host_s = float(block.host_s[first])
        restarted = self._health.restarts > gap.restarts
        after = None if block.counter is None else int(block.counter[first])
        self._record_gap(
            {
                "until_s": self._trial.t_s(int(host_s * NS_PER_S)),
                "counter_after": after,
                "restarted": restarted,
            }
        )
        seconds = host_s - gap.start_ns / NS_PER_S
        told = f"{self.setup.name} is back after {seconds:.1f} s"
        if restarted:
            told += "; it has started anew"
        elif after is not None and gap.counter is not None and after > gap.counter:
            told += f"; {after - gap.counter - 1} packets are missing by its counter"
        self._notify(f"{told}.")
        self._gap, self._problem = None, None

    def _record_gap(self, more: dict[str, object]) -> None:
        """Write the gap as far as it is known; a later record of it completes an earlier one."""
        gap = self._gap
        if gap is not None:
            known = {"counter_before": gap.counter, **more}
            self._trial.gap(self._source, gap.start_ns, gap.reason, **known)

    def _show(self, state: DeviceState) -> None:
        health = self._health
        self._status = replace(
            self._status,
            state=state,
            rate_hz=health.rate_hz,
            packets=health.good,
            lost=health.lost,
            corrupt=health.corrupt,
            duplicates=health.duplicates,
            restarts=health.restarts,
            reconnects=health.reconnects,
            gaps=self._gaps,
            age_s=health.last_packet_age_s,
            supply=self._supply,
            problem=None if state == "live" else self._problem,
        )

    def _tell(self) -> None:
        told = {name: getattr(self._status, name) for name in STATISTICS}
        self._trial.device_statistics(self._source, told)


def supply_of(layout: RowLayout, block: PacketBlock) -> tuple[tuple[str, float, str], ...]:
    """Return what the newest packet of a block says of battery or supply: name, value, unit."""
    return tuple(
        (field.name, float(values(layout, block.rows[-1:], field.name).flat[0]), field.unit)
        for field in layout.fields
        if field.name.startswith(SUPPLY_WORDS) and field.type != "pad"
    )


def final_fault(keeper: DeviceKeeper) -> ImuRigError | None:
    """Return why a keeper can never do its work; a mistake of our own is raised as it is."""
    if keeper.fault is None or isinstance(keeper.fault, ImuRigError):
        return keeper.fault
    raise keeper.fault
