"""A whole recording: open devices and file, keep them going, end cleanly whatever ends it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from firmware_protocols.protocol import DeviceProtocol
from imu_rig import __version__
from imu_rig.calibration.certificate import load_certificate
from imu_rig.clock import NS_PER_S, Clock, Deadline, SystemClock
from imu_rig.devices.stream_device import PacketDevice
from imu_rig.errors import DeviceError, PortError
from imu_rig.recorder.jig_keeper import JigKeeper
from imu_rig.recorder.keeper import DeviceKeeper, final_fault
from imu_rig.recorder.setup import DeviceSetup, TrialSetup
from imu_rig.recorder.status import RecorderState, RecorderStatus
from imu_rig.recording.format import CERTIFICATES, MARKER, RECORD_OVERHEAD, TRIAL_KIND
from imu_rig.recording.latency import Latency
from imu_rig.recording.log import RecordingOptions
from imu_rig.recording.writer import TrialWriter
from imu_rig.stopping import StopRequest

ALL_LIVE = "all_live"

# Constants of time.
TURN_S = 0.05  # of the recorder's own loop
OBSERVE_S = 0.2  # between statuses
DISK_S = 1.0  # between looks at the disk
PACE_S = 5.0  # over which the growth of the file is measured
END_S = 2.4  # for the jig to park and all ports to close, whatever they do
PORTS_S = 0.4  # of that, kept for the ports
UNKNOWN_RATE = 10_000.0  # bytes per second of a device that does not state its rate


Ending = Literal["complete", "interrupted"]
"""How a recording ends that nothing went wrong with; as in the end record."""


@dataclass(frozen=True, kw_only=True)
class RecordingOutcome(RecorderStatus):
    """How a recording ended: its last status, and what is known only then.

    Attributes
    ----------
    reason : str
        "complete", or "interrupted" where it was stopped before its planned end.
    latency : Latency
        How long what arrived took to be in the file.
    """

    reason: Ending
    latency: Latency


class Recorder:
    """Records one trial.

    Parameters
    ----------
    setup : TrialSetup
    path : Path
        The new trial file.
    clock : Clock
    stop : StopRequest, optional
        Ends the recording when made.
    observe : callable, optional
        Takes a `RecorderStatus` a few times a second, in the thread of `run`.
    notify : callable, optional
        Takes sentences for people, from any thread.
    wait_s : float, optional
        How long to wait for a required device to be heard; for ever where it is None.
    options : RecordingOptions, optional
        Of the file.
    """

    def __init__(
        self,
        setup: TrialSetup,
        path: Path,
        clock: Clock,
        *,
        stop: StopRequest | None = None,
        observe: Callable[[RecorderStatus], None] = lambda status: None,
        notify: Callable[[str], None] = lambda sentence: None,
        wait_s: float | None = None,
        options: RecordingOptions | None = None,
    ) -> None:
        self._setup, self._path, self._clock = setup, path, clock
        self._stop = stop or StopRequest()
        self._observe, self._notify, self._wait_s = observe, notify, wait_s
        self._protocols = {device.name: device.protocol() for device in setup.devices}
        self._certificates = {device.name: _certificates(device) for device in setup.devices}
        self._options = options or RecordingOptions(planned_bytes=self._planned_bytes())
        self._trial: TrialWriter | None = None
        self._keepers: list[DeviceKeeper] = []
        self._jig: JigKeeper | None = None
        self._received = False  # whether any device sent anything
        self._markers = 0
        self._marks = threading.Lock()
        self._live_ns: int | None = None
        self._pace: deque[tuple[int, int]] = deque()
        self._disk: tuple[int, int | None] = (0, None)

    def mark(self, label: str = "") -> None:
        """Record a marker at this moment; from any thread, ignored while nothing is recorded."""
        with self._marks:
            if self._trial is not None:
                self._trial.event(MARKER, label=label[:200])
                self._markers += 1

    def run(self) -> RecordingOutcome:
        """Record until the planned duration is over or a stop is asked for.

        Raises
        ------
        InputError
            If the file exists or cannot be made.
        PortError, DeviceError
            If a port cannot be opened, or a required device was not heard in time. No file is
            left in which no device said anything.
        StorageError
            If the disk has too little space or failed meanwhile; what was acknowledged is kept.
        """
        trial = TrialWriter.create(
            self._path, self._config(), clock=self._clock, options=self._options
        )
        with self._marks:
            self._trial = trial
        reason, worthless = "failed: the program ended", False
        with ExitStack() as stack:
            stack.callback(lambda: self._close(trial, reason, discard=worthless))
            try:
                self._open(trial)
                self._wait_for_first_attempts()
                ending = self._record(trial)
                reason = ending
            except KeyboardInterrupt:
                reason = "interrupted"
                raise
            except Exception as error:
                reason = f"stopped: {error}"
                worthless = not self._received and trial.error is None
                raise
            finally:
                self._show(trial, "stopping")
                self._release()
        last = self._status(trial, "ended")
        self._observe(last)
        if trial.error is not None:
            raise trial.error
        return RecordingOutcome(**vars(last), reason=ending, latency=trial.latency())

    # --- start --------------------------------------------------------------------------------

    def _config(self) -> dict[str, Any]:
        setup = self._setup
        return {
            "kind": TRIAL_KIND,
            "subject": setup.subject,
            "session": setup.session,
            "trial": setup.trial,
            "note": setup.note,
            "planned_s": setup.duration_s,
            "imu_rig": __version__,
        }

    def _planned_bytes(self) -> int:
        if self._setup.duration_s is None:
            return 0
        rate = sum(_planned_rate(protocol) for protocol in self._protocols.values())
        return int(rate * self._setup.duration_s)

    def _open(self, trial: TrialWriter) -> None:
        if self._setup.jig is not None:
            # the controller first: its errors concern safety
            self._jig = JigKeeper(self._setup.jig, trial, self._clock)
            self._jig.start()
        for device in self._setup.devices:
            self._keepers.append(self._keeper(device, trial))
        for keeper in self._keepers:
            keeper.start()

    def _keeper(self, device: DeviceSetup, trial: TrialWriter) -> DeviceKeeper:
        protocol = self._protocols[device.name]
        descriptor: dict[str, Any] = {
            "layout": protocol.to_dict(),
            "url": device.port,
            "baud": device.baud,
            "required": device.required,
            **self._certificates[device.name],
        }
        kind = "imu" if protocol.inertial_streams else "sensor"
        source = trial.add_source(device.name, kind, descriptor)

        def keep(t_ns: int, data: bytes) -> None:
            self._received = True
            trial.bytes_in(source, t_ns, data)

        def keep_sent(t_ns: int, data: bytes) -> None:
            trial.bytes_out(source, t_ns, data)

        reader = PacketDevice(
            device.name,
            device.port,
            protocol,
            self._clock,
            tap=keep,
            sent=keep_sent,
            baud=device.baud,
        )
        return DeviceKeeper(device, reader, trial, source, self._clock, self._notify)

    def _wait_for_first_attempts(self) -> None:
        """See that no port is refused for good, before anybody walks."""
        for keeper in self._keepers:
            while not keeper.tried.wait(TURN_S) and self._stop.cause is None:
                self._raise_faults()
        self._raise_faults()

    # --- the recording ------------------------------------------------------------------------

    def _record(self, trial: TrialWriter) -> Ending:
        """Go on until something ends the recording."""
        shown_s = -OBSERVE_S
        while True:
            self._raise_faults()
            if trial.error is not None:
                raise trial.error
            self._notice_all_live(trial)
            planned = self._setup.duration_s
            if planned is not None and self._recorded_s() >= planned:
                return "complete"
            if self._stop.cause is not None:
                return "complete" if planned is None else "interrupted"
            if time.monotonic() - shown_s >= OBSERVE_S:
                shown_s = time.monotonic()
                self._show(trial, "waiting" if self._live_ns is None else "recording")
            self._clock.sleep(TURN_S)

    def _notice_all_live(self, trial: TrialWriter) -> None:
        if self._live_ns is not None:
            return
        missing = [k for k in self._keepers if k.setup.required and not k.heard]
        if not missing:
            self._live_ns = self._clock.now_ns()
            trial.event(ALL_LIVE)
        elif self._wait_s is not None and trial.t_s(self._clock.now_ns()) > self._wait_s:
            first = missing[0]
            why = first.status.problem or f"{first.setup.name} on {first.setup.port} is silent."
            refused = PortError if not first.device.running else DeviceError
            raise refused(f"Not heard within {self._wait_s:g} s: {why}")

    def _raise_faults(self) -> None:
        for keeper in self._keepers:
            if (error := final_fault(keeper)) is not None:
                raise error
        if self._jig is not None and self._jig.fault is not None:
            raise self._jig.fault

    # --- the end ------------------------------------------------------------------------------

    def _release(self) -> None:
        """Park the jig, then close the ports; what takes too long is not waited for."""
        end = Deadline(SystemClock(), END_S)
        if self._jig is not None:
            self._jig.park(Deadline(SystemClock(), END_S - PORTS_S), lambda: self._stop.hurry)
        for keeper in self._keepers:
            keeper.ask_to_stop()
        for keeper in self._keepers:
            keeper.join(end.remaining)

    def _close(self, trial: TrialWriter, reason: str, *, discard: bool) -> None:
        with self._marks:
            self._trial = None
        trial.close(reason)
        if discard:
            trial.path.unlink(missing_ok=True)

    # --- what is shown ------------------------------------------------------------------------

    def _recorded_s(self) -> float:
        return 0.0 if self._live_ns is None else (self._clock.now_ns() - self._live_ns) / NS_PER_S

    def _show(self, trial: TrialWriter, state: RecorderState) -> None:
        self._observe(self._status(trial, state))

    def _status(self, trial: TrialWriter, state: RecorderState) -> RecorderStatus:
        now = time.monotonic_ns()
        self._pace.append((now, trial.acknowledged_bytes))
        while len(self._pace) > 1 and now - self._pace[0][0] > PACE_S * NS_PER_S:
            self._pace.popleft()
        seconds = (now - self._pace[0][0]) / NS_PER_S
        pace = (trial.acknowledged_bytes - self._pace[0][1]) / seconds if seconds else 0.0
        if self._disk[1] is None or now - self._disk[0] > DISK_S * NS_PER_S:
            self._disk = now, self._free_bytes()
        free = self._disk[1]
        problems = [trial.error, None if self._jig is None else self._jig.problem]
        return RecorderStatus(
            path=self._path,
            state=state,
            elapsed_s=trial.t_s(self._clock.now_ns()),
            recorded_s=self._recorded_s(),
            planned_s=self._setup.duration_s,
            file_bytes=trial.acknowledged_bytes,
            synced_bytes=trial.synced_bytes,
            disk_free_bytes=free,
            disk_left_s=free / pace if free is not None and pace > 0 else None,
            queue=trial.queued_bytes / self._options.queue_bytes,
            queue_s=self._options.queue_bytes / pace if pace > 0 else 0.0,
            unwritten_records=trial.unwritten_records,
            markers=self._markers,
            devices=tuple(keeper.status for keeper in self._keepers),
            problem=next((str(p) for p in problems if p is not None), None),
        )

    def _free_bytes(self) -> int | None:
        try:
            return self._options.file_system.free_bytes(self._path.parent)
        except OSError:
            return None


def _certificates(device: DeviceSetup) -> dict[str, Any]:
    """Return what a device's descriptor holds of certificates."""
    kept: dict[str, Any] = {}
    if device.certificate is not None:
        kept["certificate"] = load_certificate(device.certificate).model_dump(mode="json")
    if device.certificates:
        kept[CERTIFICATES] = {
            stream: load_certificate(file).model_dump(mode="json")
            for stream, file in device.certificates.items()
        }
    return kept


def _planned_rate(protocol: DeviceProtocol) -> float:
    """Bytes per second in the file: of the packets, each in a record of its own at worst."""
    size, rate = protocol.bytes_per_s, protocol.packets_per_s
    return UNKNOWN_RATE if size is None or rate is None else size + rate * RECORD_OVERHEAD
