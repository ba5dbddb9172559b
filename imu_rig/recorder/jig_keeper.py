"""Watches a jig during a recording: what its servos are told goes on record, and it is parked."""

from __future__ import annotations

import math
import threading
import time

from imu_rig.clock import Clock
from imu_rig.devices.jig import Jig, JigConfig, load_jig
from imu_rig.devices.maestro import MaestroClient
from imu_rig.errors import DeviceError, ImuRigError, PortError
from imu_rig.recorder.setup import JIG_SOURCE, JigSetup
from imu_rig.recording.writer import TrialWriter

# Constants of time.
LOOK_S = 0.1  # between questions for the servos' pulses
RETRY_S = 0.5  # between attempts to reach a controller that has gone
PARK_S = 1.5  # that parking may take before the file is closed all the same
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
        self._thread.start()

    def park(self, *, wait: bool = True) -> None:
        """End the watch, send the jig to its park pose and close the port.

        Parameters
        ----------
        wait : bool
            Whether to wait until it is there, for a moment at most.
        """
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join(PARK_S)
        try:
            if self._thread.ident is not None:
                self._park(wait)
        except (DeviceError, PortError) as error:
            self.problem = f"The jig could not be parked: {error}"
        finally:
            self._maestro.close()

    def _park(self, wait: bool) -> None:
        """Park the axes that are held; a released servo stays released, it would jump."""
        try:
            self._maestro.open()
            held = [axis for axis, angle in self._jig.reported().items() if not math.isnan(angle)]
            target = self._config.park()
            self._jig.command({axis: target[axis] for axis in held})
        except DeviceError:
            self._jig.park_blind()
        self._trial.event("parking", jig=self._config.name)
        end = time.monotonic() + PARK_S
        while wait and time.monotonic() < end and not self._jig.arrived():
            time.sleep(PARK_LOOK_S)

    def _record(self, t_ns: int, direction: str, data: bytes) -> None:
        if direction == "out":
            self._trial.bytes_out(self._source, t_ns, data)
        else:
            self._trial.bytes_in(self._source, t_ns, data)

    def _run(self) -> None:
        try:
            while not self._stopping.wait(LOOK_S):
                self._look()
        except Exception as error:  # the recorder raises it in its own thread
            self.fault = error

    def _look(self) -> None:
        try:
            if not self._maestro.is_open:
                self._maestro.open()
                self._trial.event("jig_back")
            self._jig.reported()
            self.problem = None
        except ImuRigError as error:
            if self.problem is None:
                self._trial.event("jig_lost", reason=str(error))
                self._trial.gap(self._source, self._clock.now_ns(), "unplugged")
            self.problem = str(error)
            self._stopping.wait(RETRY_S)
