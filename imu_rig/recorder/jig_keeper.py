"""Watches a jig during a recording: what its servos are told goes on record, and it is parked."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping

from imu_rig.clock import Clock, Deadline
from imu_rig.devices.jig import AXES, AxisName, Jig, JigConfig, load_jig
from imu_rig.devices.maestro import MaestroClient
from imu_rig.errors import DeviceError, ImuRigError
from imu_rig.recorder.setup import JIG_SOURCE, JigSetup
from imu_rig.recording.format import SILENT, UNPLUGGED
from imu_rig.recording.writer import TrialWriter

# Constants of time.
LOOK_S = 0.1  # between questions for the servos' pulses
RETRY_S = 0.5  # between attempts to reach a controller that has gone
PARK_LOOK_S = 0.05


class JigKeeper:
    """Asks a jig's controller for its pulses until told to park it.

    The recording commands nothing: a script on the controller may, or nobody.

    Parameters
    ----------
    setup : JigSetup
    trial : TrialWriter
    clock : Clock

    Raises
    ------
    InputError
        If the jig file cannot be used.
    """

    def __init__(self, setup: JigSetup, trial: TrialWriter, clock: Clock) -> None:
        self._config: JigConfig = load_jig(setup.file)
        self._source = trial.add_source(
            JIG_SOURCE,
            "servo",
            {"url": setup.maestro, "jig": self._config.model_dump(mode="json")},
        )
        self._trial, self._clock = trial, clock
        self._maestro = MaestroClient(
            setup.maestro, clock, device=setup.device, crc=setup.crc, tap=self._record
        )
        self._jig = Jig(self._config, self._maestro, clock)
        self._held: tuple[AxisName, ...] = ()  # as of the last answer ...
        self._answered_ns = clock.now_ns()  # ... which came then
        self._gap: tuple[int, str] | None = None  # since when it does not answer, and why
        self._end: Deadline | None = None
        self._hurry: Callable[[], bool] = lambda: True
        self._told = False  # to park
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keep jig", daemon=True)
        self.problem: str | None = None
        """Why the controller cannot be reached, in one sentence; None while it can."""
        self.fault: Exception | None = None

    def start(self) -> None:
        """Reach the controller and begin to watch. Moves nothing.

        Raises
        ------
        PortError, DeviceError
            If it cannot be reached.
        """
        self._jig.start()
        self._answered(self._jig.reported())
        self._thread.start()

    def park(self, end: Deadline, hurry: Callable[[], bool] = lambda: False) -> None:
        """End the watch, send the jig to its park pose and close the port.

        Parameters
        ----------
        end : Deadline
            On the machine's clock. What has not happened by then is not waited for.
        hurry : callable
            Whether not even to wait until the jig is there.
        """
        self._end, self._hurry = end, hurry
        self._stopping.set()
        if self._thread.ident is None:
            self._maestro.close()
            return
        self._thread.join(end.remaining)
        if self._thread.is_alive() and not self._told:
            self.problem = "The jig could not be parked: its controller takes too long to answer."

    def _run(self) -> None:
        try:
            while not self._stopping.wait(LOOK_S):
                self._look()
        except Exception as error:  # the recorder raises it in its own thread
            self.fault = error
        try:
            self._park()
        except Exception as error:  # nothing may keep the recording from its end
            what = "was told to park, but may not have:" if self._told else "could not be parked:"
            self.problem = f"The jig {what} {error}"
        finally:
            self._maestro.close()

    def _look(self) -> None:
        try:
            self._maestro.open()
            angles: dict[str, float] = {}
            for axis in AXES:
                if self._stopping.is_set():  # parking waits for no more than one answer
                    return
                angles |= self._jig.reported([axis])
            self._answered(angles)
        except ImuRigError as error:
            self._missed(error)
            self._stopping.wait(RETRY_S)

    def _answered(self, angles: Mapping[str, float]) -> None:
        """Take note that the controller answers, and of the axes whose servos it holds."""
        self._held = tuple(axis for axis in AXES if not math.isnan(angles[axis]))
        self._answered_ns = self._clock.now_ns()
        self.problem = None
        if self._gap is not None:
            since_ns, reason = self._gap
            back_s = self._trial.t_s(self._answered_ns)
            self._trial.gap(self._source, since_ns, reason, until_s=back_s)
            self._trial.event("jig_back")
            self._gap = None

    def _missed(self, error: ImuRigError) -> None:
        """Take note that the controller does not answer or has gone."""
        self.problem = str(error)
        reason = SILENT if self._maestro.is_open else UNPLUGGED
        if self._gap is None:
            self._trial.event("jig_lost", reason=self.problem)
        elif self._gap[1] == reason:
            return
        since_ns = self._answered_ns if self._gap is None else self._gap[0]
        self._gap = since_ns, reason
        self._trial.gap(self._source, since_ns, reason)

    def _park(self) -> None:
        """Park the axes that are held; a released servo stays released, it would jump.

        Without a question first, for a slow answer would hold up what matters. Only a controller
        that was away is asked, as it may have started anew.
        """
        if not self._maestro.is_open:
            self._maestro.open()
            try:
                self._answered(self._jig.reported())
            except DeviceError as error:
                self._missed(error)
        self._maestro.stop_script()  # it could drive the jig away again
        self._jig.park_blind(self._held)
        self._told = True
        self._trial.event("parking", jig=self._config.name)
        if self.problem is not None:
            raise DeviceError(self.problem)
        while not (self._end is None or self._end.expired or self._hurry()):
            if self._jig.arrived():
                break
            self._clock.sleep(PARK_LOOK_S)

    def _record(self, t_ns: int, direction: str, data: bytes) -> None:
        if direction == "out":
            self._trial.bytes_out(self._source, t_ns, data)
        else:
            self._trial.bytes_in(self._source, t_ns, data)
