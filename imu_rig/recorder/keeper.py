"""Keeps one port of a recording alive: opens it, watches it, opens it again, records each gap."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping

from imu_rig.clock import NS_PER_S, Clock
from imu_rig.devices.conversation import conversation_for
from imu_rig.devices.stream_device import PacketDevice
from imu_rig.errors import DeviceError, ImuRigError, PortError, PortMissing
from imu_rig.packet_stream import PacketBlock
from imu_rig.recorder.setup import DeviceSetup
from imu_rig.recorder.status import DeviceState, DeviceStatus
from imu_rig.recorder.stream_watch import REASONS, KeptLog, StreamWatch, statistics_of, together

# Constants of time.
WATCH_S = 0.1  # between looks at a port
DECODE_S = 0.2  # between looks at what it sent
STATISTICS_S = 1.0  # between records of how it does
RETRY_S = 0.25  # between attempts to open a port that has gone
TALK_RETRY_S = 1.0  # likewise, of a device that is there and does not do as it is told
REVIVE_S = 2.0  # of silence before an open port is opened again, then twice as long each time ...
LONGEST_REVIVE_S = 30.0  # ... up to this: opening resets some boards
ASK_S = 1.0  # between looks at why nothing comes that can be read

Blocks = Mapping[str, PacketBlock]


class DeviceKeeper:
    """One port of a recording with all its streams, kept by a thread of its own.

    Parameters
    ----------
    setup : DeviceSetup
    device : PacketDevice
        Its bytes must go to ``log`` by its tap, where they are to be kept.
    log : KeptLog
        Takes gaps and statistics; a `TrialWriter`.
    source : int
        Number of the device in the trial.
    clock : Clock
    notify : callable
        Takes a sentence for people; called from the keeper's thread.
    take : callable, optional
        Takes what came since the last look, by stream; in the keeper's thread.
    look_s : float
        Between looks at what came.
    """

    def __init__(
        self,
        setup: DeviceSetup,
        device: PacketDevice,
        log: KeptLog,
        source: int,
        clock: Clock,
        notify: Callable[[str], None],
        *,
        take: Callable[[Blocks], None] = lambda blocks: None,
        look_s: float = DECODE_S,
    ) -> None:
        self.setup = setup
        self.device = device
        self._log, self._source, self._clock, self._take = log, source, clock, take
        self._look_s = look_s
        self._notify, self._told = notify, ""
        self._watches = {
            name: StreamWatch(
                name,
                setup.name,
                setup.port,
                layout,
                required=setup.required and name not in setup.optional_streams,
                log=log,
                source=source,
                notify=self._notify_once,
            )
            for name, layout in device.protocol.streams.items()
        }
        self._talks = conversation_for(device.protocol) is not None
        self._show_port()
        self._problem: str | None = None  # of the port as a whole
        self._revive_s = REVIVE_S
        self._asked_ns = clock.now_ns()
        self._stopping = threading.Event()
        self.tried = threading.Event()
        """Set once the first attempt to open the port has succeeded or failed."""
        self.fault: Exception | None = None
        """What ended the keeper: a port that will never open, or a mistake of our own."""
        self._thread = threading.Thread(target=self._run, name=f"keep {setup.name}", daemon=True)
        self._silent_s = min(watch.silent_s for watch in self._watches.values())
        self._unreadable_s = min(watch.unreadable_s for watch in self._watches.values())

    @property
    def status(self) -> DeviceStatus:
        """How the device does, as of the last look."""
        return self._status

    @property
    def heard(self) -> bool:
        """Whether a good packet of every required stream ever came; of any where none is."""
        watches = self._watches.values()
        needed = [watch for watch in watches if watch.status.required]
        return all(w.heard for w in needed) if needed else any(w.heard for w in watches)

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
                if now - decoded_ns >= self._look_s * NS_PER_S:
                    decoded_ns = now
                    self._look(now)
                if now - told_ns >= STATISTICS_S * NS_PER_S:
                    told_ns += int(STATISTICS_S * NS_PER_S)
                    self._tell()
                self._wait(min(WATCH_S, self._look_s))
        except Exception as error:  # the recorder raises it in its own thread
            self.fault = error
        finally:
            self.tried.set()
            try:
                self.device.stop()
                self._take_packets()
                self._show_all()
                self._tell()
            except Exception as error:
                self.fault = self.fault or error

    def _wait(self, seconds: float) -> None:
        self._stopping.wait(seconds / self._clock.speed)

    def _open_first(self) -> None:
        """Open the port, waiting for one that is not there or a device that is not ready.

        A port that is refused is final only for a required device, at the first attempt: nobody
        walks yet. Later it may be busy for a moment, as when another program looks at what was
        plugged in, and must not cost the others anything.
        """
        while not self._stopping.is_set():
            begin_ns = self._clock.now_ns()
            try:
                self.device.start()
            except (PortError, DeviceError) as error:
                first = not self.tried.is_set()
                refused = isinstance(error, PortError) and not isinstance(error, PortMissing)
                if first and self.setup.required and refused:
                    raise
                self._take_packets()
                self._complain(str(error))
                for watch in self._watches.values():
                    self._show_refused(watch)
                self._show_port()
                self.tried.set()
                self._wait(RETRY_S if isinstance(error, PortError) else TALK_RETRY_S)
            else:
                self._complain(None)
                self._note_talk(begin_ns)
                self.tried.set()
                return

    def _show_refused(self, watch: StreamWatch) -> None:
        """Take note of a stream whose port was closed again; its device may have been heard."""
        if not watch.heard:
            watch.show("waiting")
        elif not watch.in_gap:
            watch.begin_gap("lost", self._clock.now_ns())
        else:
            watch.show("lost")

    def _watch_port(self, now: int) -> None:
        """Notice a port that has gone and open it again."""
        watches = self._watches.values()
        if not self.device.running:
            if any(watch.gap_reason != REASONS["lost"] for watch in watches):
                self._take_packets()
                self._complain(self.device.health.error)
                for watch in watches:
                    if watch.gap_reason != REASONS["lost"]:
                        watch.begin_gap("lost", now)
                self._show_port()
            self._reopen()
        elif (
            all(watch.in_gap and watch.status.state == "silent" for watch in watches)
            and now - self.device.last_byte_ns > self._revive_s * NS_PER_S
        ):
            self._reopen()
            self._revive_s = min(2 * self._revive_s, LONGEST_REVIVE_S)

    def _note_talk(self, begin_ns: int) -> None:
        """Tell when the device was set up, if it is a kind that one talks to."""
        if self._talks:
            for watch in self._watches.values():
                watch.talked(begin_ns / NS_PER_S, self.device.opened_ns / NS_PER_S)

    def _reopen(self) -> None:
        begin_ns = self._clock.now_ns()
        try:
            self.device.reopen()
        except DeviceError as error:
            self._complain(str(error))
            self._wait(RETRY_S)
        else:
            self._note_talk(begin_ns)

    def _look(self, now: int) -> None:
        """Decode what came and judge the state of every stream by it."""
        self._take_packets()
        byte_age_s = (now - self.device.last_byte_ns) / NS_PER_S
        open_s = (now - self.device.opened_ns) / NS_PER_S
        watches = self._watches.values()
        others_come = any(watch.going_on for watch in watches)
        for watch in watches:
            age_s = watch.health.last_packet_age_s
            if not self.device.running:
                watch.show("lost" if watch.heard else "waiting")
            elif watch.fresh:
                watch.show("live")
            elif byte_age_s > self._silent_s:
                self._doubt(watch, "silent", now)
            elif others_come:
                if min(age_s, open_s) > watch.silent_s:
                    self._miss(watch, now)
                else:
                    watch.show(watch.status.state)
            elif min(age_s, open_s) > self._unreadable_s:
                self._doubt(watch, "garbled", now)
            else:  # opened a moment ago, or the first half second of trouble
                watch.show(watch.status.state)
        self._show_port()

    def _doubt(self, watch: StreamWatch, state: DeviceState, now: int) -> None:
        """Take note of a port that sends nothing that can be read."""
        if now - self._asked_ns > ASK_S * NS_PER_S:
            self._asked_ns = now
            problem = self.device.identify_problem()
            if problem is not None:
                self._complain(problem)
        if watch.heard and not watch.in_gap:
            what = "nothing" if state == "silent" else "nothing that can be read"
            watch.problem = watch.problem or (
                f"{self.setup.name} on {self.setup.port} sends {what} any more: check its power, "
                "its cable or Bluetooth link."
            )
            watch.begin_gap(state, now)
        watch.show(state if watch.heard or state == "garbled" else "waiting")

    def _miss(self, watch: StreamWatch, now: int) -> None:
        """Take note of a stream that is missing while others of its port go on."""
        going = [w.stream for w in self._watches.values() if w.going_on]
        others = ", ".join(going)
        go_on = "goes on" if len(going) == 1 else "go on"
        if watch.heard:
            watch.problem = (
                f"{watch.name} sends nothing any more while {others} of the same port {go_on}: "
                f"check the power and the radio of {watch.stream}."
            )
        else:
            watch.problem = (
                f"{watch.name} has sent nothing while {others} of the same port {go_on}: see that "
                f"it is switched on, or write optional={watch.stream} behind its port."
            )
        if watch.heard and not watch.in_gap:
            watch.begin_gap("silent", now)
        watch.show("silent" if watch.heard else "waiting")

    def _notify_once(self, sentence: str) -> None:
        """Tell what each of several streams has to say of their port only once."""
        if sentence != self._told:
            self._notify(sentence)
        self._told = sentence

    def _complain(self, problem: str | None) -> None:
        """Tell of the port as a whole, for every stream that does not come."""
        self._problem = problem
        for watch in self._watches.values():
            watch.problem = problem

    def _take_packets(self) -> None:
        blocks = self.device.poll()
        came = False
        for name, watch in self._watches.items():
            came |= watch.take(blocks.get(name), self.device.stream_health(name))
        if came:
            self._revive_s = REVIVE_S
            self._take(blocks)

    def _show_all(self) -> None:
        for watch in self._watches.values():
            watch.show(watch.status.state)
        self._show_port()

    def _show_port(self) -> None:
        """Make the status that others see."""
        rows = tuple(watch.status for watch in self._watches.values())
        self._status = together(self.setup.name, rows, required=self.setup.required)

    def _tell(self) -> None:
        self._log.device_statistics(self._source, statistics_of(self._status))


def final_fault(keeper: DeviceKeeper) -> ImuRigError | None:
    """Return why a keeper can never do its work; a mistake of our own is raised as it is."""
    if keeper.fault is None or isinstance(keeper.fault, ImuRigError):
        return keeper.fault
    raise keeper.fault
