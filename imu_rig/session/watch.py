"""Watching over a running session: samples, health of sensor and controller, disk, the user.

`Watch.look` is what the engine does while it waits for anything. It raises as soon as something
is wrong, and tells progress and notices on the way.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from imu_rig.blocks import ImuBlock
from imu_rig.clock import NS_PER_S, Clock, Deadline
from imu_rig.devices.imu import ImuDevice
from imu_rig.devices.jig import Jig
from imu_rig.errors import DeviceError, DeviceLost, SessionInterrupted, StorageError
from imu_rig.foreign_text import one_line
from imu_rig.recording.writer import TrialWriter
from imu_rig.session import checks
from imu_rig.session.progress import Progress
from imu_rig.session.stillness import StillnessMonitor
from imu_rig.stopping import StopRequest

# Times in seconds.
POLL_S = 0.02  # between looks at the sensor
JIG_CHECK_S = 0.2  # between looks at the controller's errors
FIRST_DATA_S = 4.0  # until the sensor's first packet
SILENCE_S = 0.6  # without a packet: the sensor is lost
MACHINE_SILENCE_S = 0.25  # of the machine's own time at least, for clocks that run faster
SLOW_ANSWER_S = 0.6  # for the questions of one look at the controller
RATE_OFF_S = 2.0  # of another sample rate than the layout's before it is worth a word
LAG_S = 0.3  # of delay of the sensor's data that is worth a word

RATE_TOLERANCE = 0.15
FRESH_SAMPLES = 10  # that tell a sensor is back


class Watch:
    """Looks after one session.

    Parameters
    ----------
    jig, imu, trial : Jig, ImuDevice, TrialWriter
    clock : Clock
    stop : StopRequest
    observe : callable
        Called with the `Progress` of every look.
    notify : callable
        Called with one sentence whenever something happens that a person should know.
    steps : int
        Stops of the session.

    Attributes
    ----------
    progress : Progress
        What was told last.
    notices : list of str
        All sentences so far.
    monitor : StillnessMonitor or None
        Fed with every sample once it is set.
    newest_s : float
        Time of the newest sample [s, host clock].
    """

    def __init__(
        self,
        jig: Jig,
        imu: ImuDevice,
        trial: TrialWriter,
        clock: Clock,
        stop: StopRequest,
        observe: Callable[[Progress], None],
        notify: Callable[[str], None],
        steps: int,
    ) -> None:
        self.progress = Progress(steps=steps)
        self.notices: list[str] = []
        self.monitor: StillnessMonitor | None = None
        self.newest_s = -np.inf
        self._jig, self._imu, self._trial, self._clock = jig, imu, trial, clock
        self._stop, self._observe, self._notify = stop, observe, notify
        self._kept: list[ImuBlock] = []
        self._noticed: set[str] = set()
        self._begin_ns = self._rate_well_ns = clock.now_ns()
        self._jig_looked_ns = 0
        self._fed_machine_s = time.monotonic()
        self._restarts = imu.health.restarts

    def look(self) -> None:
        """Take new samples, look after everything, tell progress, and wait a moment.

        Raises
        ------
        SessionInterrupted
            If the user wants to stop.
        DeviceError, StorageError
            If sensor, controller or disk are not well.
        """
        self.check_stop()
        self.take_samples()
        self._check_imu()
        now = self._clock.now_ns()
        if now - self._jig_looked_ns > JIG_CHECK_S * NS_PER_S:
            self._jig_looked_ns = now
            self._jig.check()
            answered_s = (self._clock.now_ns() - now) / NS_PER_S
            if answered_s > SLOW_ANSWER_S:
                self._notice_once(
                    "slow controller",
                    f"The servo controller is slow to answer ({answered_s:.1f} s); the session "
                    "takes longer.",
                )
        self._check_file()
        self._clock.sleep(POLL_S)

    def look_for(self, seconds: float) -> None:
        """Look for a while."""
        deadline = Deadline(self._clock, seconds)
        while not deadline.expired:
            self.look()

    def await_data(self) -> None:
        """Wait for the sensor's first packet."""
        deadline = Deadline(self._clock, FIRST_DATA_S)
        while self._imu.health.good == 0:
            self._wait_for_data(deadline)

    def await_fresh_data(self) -> None:
        """Wait until a sensor that was lost sends again; what it sent before is no sign of life."""
        self._imu.poll()
        deadline = Deadline(self._clock, SILENCE_S)
        self._fed_machine_s = time.monotonic()
        fresh = 0
        while fresh < FRESH_SAMPLES:
            fresh += self._wait_for_data(deadline)

    def check_stop(self) -> None:
        """Raise `SessionInterrupted` if the user wants to stop."""
        if self._stop.cause is not None:
            raise SessionInterrupted(self._stop.cause)

    def take_samples(self) -> int:
        """Take what the sensor sent, tell progress, and return the number of new samples."""
        block = self._imu.poll()
        if len(block):
            self._fed_machine_s = time.monotonic()
            self._kept.append(block)
            self.newest_s = float(block.t[-1])
            if self.monitor is not None:
                self.monitor.update(block)
        health = self._imu.health
        self.tell(
            rate_hz=health.rate_hz,
            lost=health.lost,
            corrupt=health.corrupt,
            elapsed_s=self.elapsed_s,
        )
        return len(block)

    def samples(self, start_s: float, stop_s: float) -> ImuBlock:
        """Return the samples kept between two times [s, host clock]."""
        block = ImuBlock.concatenate(self._kept)
        return block[(block.t >= start_s) & (block.t <= stop_s)]

    def keep_only(self, block: ImuBlock) -> None:
        """Forget all samples but these."""
        self._kept = [block]

    def forget(self) -> None:
        """Forget all samples, while nothing is measured."""
        self._kept = []

    @property
    def elapsed_s(self) -> float:
        """Time since the watch began [s]."""
        return (self._clock.now_ns() - self._begin_ns) / NS_PER_S

    @property
    def now_s(self) -> float:
        """Host clock [s], as in the samples' times."""
        return self._clock.now_ns() / NS_PER_S

    def trial_s(self, host_s: float) -> float:
        """Trial time [s] of a time on the host clock [s]."""
        return round(self._trial.t_s(int(host_s * NS_PER_S)), 6)

    def tell(self, **changes: Any) -> None:
        """Change fields of the progress and show it."""
        self.progress = replace(self.progress, **changes)
        self._observe(self.progress)

    def event(self, name: str, /, **fields: object) -> None:
        """Write an event into the trial file."""
        self._trial.event(name, **fields)

    def notice(self, sentence: str) -> None:
        """Say a sentence to the person and to the trial file."""
        self.notices.append(sentence)
        self.event("notice", text=sentence)
        self._notify(sentence)

    def _notice_once(self, kind: str, sentence: str) -> None:
        """Notice a lasting condition when it is first seen."""
        if kind not in self._noticed:
            self._noticed.add(kind)
            self.notice(sentence)

    def _wait_for_data(self, deadline: Deadline) -> int:
        self.check_stop()
        new = self.take_samples()
        hungry_s = time.monotonic() - self._fed_machine_s
        if deadline.expired and hungry_s > MACHINE_SILENCE_S:
            raise DeviceLost(checks.silence(self._imu))
        self._clock.sleep(POLL_S)
        return new

    def _check_file(self) -> None:
        if self._trial.error is not None:
            raise self._trial.error
        if not self._trial.path.exists():
            raise StorageError(
                f"{self._trial.path} was deleted or moved away while the session wrote to it, so "
                "what it measured is lost."
            )

    def _check_imu(self) -> None:
        health = self._imu.health
        if health.error is not None:
            raise DeviceLost(health.error)
        hungry_s = time.monotonic() - self._fed_machine_s
        if health.last_packet_age_s > SILENCE_S and hungry_s > MACHINE_SILENCE_S:
            raise DeviceLost(checks.silence(self._imu))
        if health.stuck:
            raise DeviceError(
                f"{self._imu.name} repeats the same sample over and over: its sensor hangs; "
                "switch it off and on again."
            )
        if health.restarts > self._restarts:
            self._restarts = health.restarts
            self.notice(f"{self._imu.name} restarted itself (its counter or clock began anew).")
        for fault in self._imu.port_health.faults:
            self._notice_once(f"fault {fault}", f"{self._imu.name} says: {one_line(fault)}.")
        if health.lag_s > LAG_S:
            self._notice_once("lag", f"{self._imu.name}'s data arrive {health.lag_s:.1f} s late.")
        self._check_rate(health.rate_hz, self._imu.layout.rate_hz)

    def _check_rate(self, rate_hz: float, nominal_hz: float | None) -> None:
        now = self._clock.now_ns()
        if not rate_hz or not nominal_hz or abs(rate_hz / nominal_hz - 1) <= RATE_TOLERANCE:
            self._rate_well_ns = now
        elif now - self._rate_well_ns > RATE_OFF_S * NS_PER_S:
            self._notice_once(
                "rate",
                f"{self._imu.name} sends about {rate_hz:.0f} samples/s where its layout says "
                f"{nominal_hz:g}; going on by its own clock.",
            )
