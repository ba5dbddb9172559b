"""The engine that steps an IMU through a planned session and keeps the jig safe while it does.

One loop watches everything: samples, the controller's errors, the user's wish to stop. Whatever
goes wrong ends the same way: the jig parks at once, the engine waits for the device to come back,
repeats the stop it was at and says so; or it gives up with everything measured so far on disk.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from imu_rig.blocks import ImuBlock
from imu_rig.clock import NS_PER_S, Clock, Deadline
from imu_rig.devices.imu import ImuDevice
from imu_rig.devices.jig import Jig
from imu_rig.errors import DeviceError, DeviceLost, ImuRigError, SessionInterrupted, SessionStopped
from imu_rig.recording.writer import TrialWriter
from imu_rig.session import checks
from imu_rig.session.plan import PlannedStep, SessionPlan, Stage, plan_move
from imu_rig.session.progress import Progress, SessionOutcome, StopRequest, ignore
from imu_rig.session.protocol import Pose
from imu_rig.session.stillness import WINDOW_S, StillnessMonitor, scatter

# Every time the engine waits for, in seconds.
POLL_S = 0.02  # between looks at the sensor
JIG_CHECK_S = 0.2  # between looks at the controller's errors
FIRST_DATA_S = 4.0  # until the sensor's first packet
SILENCE_S = 0.6  # without a packet: the sensor is lost
REST_S = 1.5  # of rest before the first move, to learn the sensor's own scatter
REST_PATIENCE_S = 8.0
ARRIVAL_PATIENCE_S = 2.0  # beyond the predicted travel
MIN_STILL_S = 0.4  # a hold used to this length at least, whatever its settling takes away
STILL_PATIENCE_S = 12.0  # until a pose has been held still, beyond the hold itself
RECOVERY_S = 10.0  # for a lost device to come back
RECOVERY_RETRY_S = 0.3
PARK_PATIENCE_S = 8.0
STOP_PATIENCE_S = 2.0  # for parking after the user asked to stop

SLOW_ANSWER_S = 0.6  # for the questions of one look at the controller
RATE_OFF_S = 2.0  # of another sample rate than the layout's before it is worth a word
LAG_WARNING_S = 0.3  # of delay of the sensor's data

MAX_RECOVERIES_PER_STEP = 2
LOST_IN_HOLD = 0.05  # share of packets that a hold may miss
RATE_TOLERANCE = 0.15


@dataclass(frozen=True)
class _Still:
    """A held interval [s, host clock] with its samples."""

    start: float
    stop: float
    block: ImuBlock


class SessionEngine:
    """Runs one planned session on opened devices.

    Parameters
    ----------
    plan : SessionPlan
    jig, imu, trial : Jig, ImuDevice, TrialWriter
        Started devices and an open trial file. The engine closes none of them.
    clock : Clock
    observe : callable
        Called with a `Progress` about fifty times a second and must return quickly.
    notify : callable
        Called with one sentence whenever something happens that a person should know.
    stop : StopRequest
        Made by whoever wants the session to park and end.
    first_step : int
        Index of the first stop to visit, above 0 when a stopped session goes on.
    """

    def __init__(
        self,
        plan: SessionPlan,
        jig: Jig,
        imu: ImuDevice,
        trial: TrialWriter,
        clock: Clock,
        *,
        observe: Callable[[Progress], None] = ignore,
        notify: Callable[[str], None] = lambda sentence: None,
        stop: StopRequest | None = None,
        first_step: int = 0,
    ) -> None:
        self.outcome = SessionOutcome()
        self._plan, self._jig, self._imu, self._trial = plan, jig, imu, trial
        self._clock, self._observe, self._notify = clock, observe, notify
        self._first_step = first_step
        self._stop = stop or StopRequest()
        self._progress = Progress(steps=len(plan.steps))
        self._begin_ns = clock.now_ns()
        self._jig_looked_ns = 0
        self._rate_well_ns = clock.now_ns()
        self._monitor: StillnessMonitor | None = None
        self._since_still: list[ImuBlock] = []
        self._newest_s = -np.inf
        self._last_still: tuple[Pose, _Still] | None = None
        self._restarts = imu.health.restarts
        self._noticed: set[str] = set()

    def run(self) -> SessionOutcome:
        """Visit every stop, then park.

        Raises
        ------
        SessionStopped
            If a device was lost or answered wrongly and did not recover.
        SessionInterrupted
            If the stop request was made. In both cases the jig has been parked where possible.
        """
        step: PlannedStep | None = None
        try:
            self._state("connecting")
            self._await_first_data()
            self._park(PARK_PATIENCE_S)
            self._measure_rest()
            for step in self._plan.steps[self._first_step :]:
                self._visit_persistently(step)
            step = None
            self._park(PARK_PATIENCE_S)
            self._event("session-complete", finished=self.outcome.finished)
            self._state("done", remaining_s=0.0)
        except SessionInterrupted as stop:
            raise SessionInterrupted(self._farewell(step, str(stop), STOP_PATIENCE_S)) from stop
        except ImuRigError as fault:
            raise SessionStopped(self._farewell(step, str(fault), STOP_PATIENCE_S)) from fault
        except BaseException:
            self._park_quietly(STOP_PATIENCE_S)
            raise
        finally:
            self.outcome.elapsed_s = self._elapsed_s()
        return self.outcome

    # --- stops ------------------------------------------------------------------------------

    def _visit_persistently(self, step: PlannedStep) -> None:
        for attempt in range(1 + MAX_RECOVERIES_PER_STEP):
            try:
                self._visit(step, detour=attempt > 0)
                return
            except DeviceError as fault:
                if attempt == MAX_RECOVERIES_PER_STEP:
                    raise
                self._recover(fault)

    def _visit(self, step: PlannedStep, *, detour: bool) -> None:
        self._progress = replace(
            self._progress, step=step.index + 1, name=step.name, hold_s=step.hold_s, held_s=0.0
        )
        self._event("step", index=step.index, name=step.name, pose=step.pose.angles())
        stages = step.stages
        if detour or not self.outcome.finished:
            stages = self._stages_from_park(step)
        begin_s = self._now_s()
        record = [self._travel(stage, last=stage is stages[-1]) for stage in stages]
        still = self._hold(step, self._now_s())
        self._check_turn(step, still)
        reported = self._jig.reported()
        rest = scatter(still.block)
        self._event(
            "pose",
            index=step.index,
            name=step.name,
            kind=step.kind,
            commanded_deg=step.pose.angles(),
            reported_deg={axis: round(angle, 3) for axis, angle in reported.items()},
            approach=dict(step.approach),
            still_s=[self._trial_s(still.start), self._trial_s(still.stop)],
            samples=len(still.block),
            accel_mean=np.mean(still.block.accel, axis=0).round(6).tolist(),
            gyro_mean=np.mean(still.block.gyro, axis=0).round(8).tolist(),
            accel_scatter=rest.accel,
            gyro_scatter=rest.gyro,
            began_s=self._trial_s(begin_s),
            turns=record,
        )
        self._require_monitor().follow_bias(still.block)
        self._last_still = (step.pose, still)
        self._since_still = [still.block]
        self.outcome.finished.append(step.index)

    def _stages_from_park(self, step: PlannedStep) -> tuple[Stage, ...]:
        stages, _ = plan_move(
            self._plan.start, step.pose, self._jig.config, self._plan.protocol.order
        )
        return stages

    def _travel(self, stage: Stage, *, last: bool) -> dict[str, object]:
        """Drive one stage and return what the trial file keeps of it."""
        self._state("moving")
        begin = self._now_s()
        position = stage.start
        for waypoint in stage.waypoints:
            self._jig.command({axis: getattr(waypoint, axis) for axis in stage.axes})
            predicted = self._jig.config.travel_time(position.angles(), waypoint.angles())
            self._await_arrival(waypoint, predicted + ARRIVAL_PATIENCE_S)
            position = waypoint
        if not last:
            self._watch_for(self._plan.protocol.pause_s)
        return {
            "axes": list(stage.axes),
            "from_deg": stage.start.angles(),
            "to_deg": stage.end.angles(),
            "t_s": [self._trial_s(begin), self._trial_s(self._now_s())],
        }

    def _await_arrival(self, target: Pose, patience_s: float) -> None:
        deadline = Deadline(self._clock, patience_s)
        while not self._jig.arrived():
            self._watch()
            if deadline.expired:
                self._jig.check()
                reported = checks.angles(self._jig.reported())
                raise DeviceError(
                    f"The jig did not arrive at {target} within {patience_s:.1f} s (it reports "
                    f"{reported}): check that nothing blocks it and that the servo supply is on."
                )

    def _hold(self, step: PlannedStep, arrived_s: float) -> _Still:
        """Wait until the sensor has been still for the hold; motion starts it anew."""
        self._state("settling")
        monitor = self._require_monitor()
        monitor.clear()
        since = arrived_s + self._plan.protocol.settle_s
        wanted = max(MIN_STILL_S, step.hold_s - self._plan.protocol.settle_s)
        deadline = Deadline(self._clock, STILL_PATIENCE_S + step.hold_s)
        start: float | None = None
        restarts = 0
        while True:
            self._watch()
            motion = monitor.excess(since)
            self._progress = replace(self._progress, motion=motion)
            if motion != float("inf"):
                self._check_gravity(self._samples(self._newest_s - WINDOW_S, self._newest_s))
            if motion < 1.0:
                if start is None:
                    start = max(since, self._newest_s - WINDOW_S)
                held = self._newest_s - start
                self._state("holding", held_s=held)
                if held >= wanted:
                    block = self._samples(start, self._newest_s)
                    if checks.share_lost(block) <= LOST_IN_HOLD:
                        return _Still(start, self._newest_s, block)
                    start, since, restarts = None, self._newest_s, restarts + 1
                    self._notice(f"Packets were lost while {step.name} was held; holding it again.")
            elif start is not None:
                start, since, restarts = None, self._newest_s, restarts + 1
                self._state("settling", held_s=0.0)
            if deadline.expired:
                raise DeviceError(
                    f"Pose {step.index + 1} ({step.name}) was not held still for {step.hold_s:g} s "
                    f"(motion {motion:.1f} times the limit, {restarts} interruptions): "
                    "stand the jig on a firm table, tighten the sensor and its cable, and see "
                    "that no servo hunts."
                )

    def _check_gravity(self, resting: ImuBlock) -> None:
        problem = checks.wrong_gravity(self._imu.name, resting)
        if problem is not None:
            raise DeviceError(problem)

    def _check_turn(self, step: PlannedStep, still: _Still) -> None:
        if self._last_still is None:
            return
        before, held = self._last_still
        way = self._samples(held.stop, still.start)
        if len(way) < 2 or checks.share_lost(way) > LOST_IN_HOLD:
            return
        bias = np.mean(held.block.gyro, axis=0)
        problem = checks.wrong_turn(way, bias, before, step.pose)
        if problem is not None:
            raise DeviceError(problem)

    # --- before and after ---------------------------------------------------------------------

    def _await_first_data(self) -> None:
        deadline = Deadline(self._clock, FIRST_DATA_S)
        while self._imu.health.good == 0:
            self._check_stop()
            if deadline.expired:
                raise DeviceLost(checks.silence(self._imu))
            self._take_samples()
            self._clock.sleep(POLL_S)

    def _measure_rest(self) -> None:
        """Learn the sensor's scatter and bias at rest, which stillness is judged by."""
        self._state("resting")
        deadline = Deadline(self._clock, REST_PATIENCE_S)
        begin = self._now_s()
        while True:
            self._watch()
            if self._newest_s - begin < REST_S:
                if deadline.expired:
                    raise DeviceLost(checks.silence(self._imu))
                continue
            block = self._samples(self._newest_s - REST_S, self._newest_s)
            if len(block) < 10:
                continue
            quiet = scatter(block)
            name = self._imu.name
            problem = checks.no_rest(name, quiet) or checks.wrong_gravity(name, block)
            if problem is None:
                break
            if deadline.expired:
                raise DeviceError(problem)
        self._monitor = StillnessMonitor(quiet)
        self._since_still = [block]
        rest = _Still(float(block.t[0]), float(block.t[-1]), block)
        self._last_still = (self._plan.start, rest)
        self._event("rest", accel_scatter=quiet.accel, gyro_scatter=quiet.gyro)

    def _park(self, patience_s: float) -> None:
        self._state("parking")
        self._jig.park()
        deadline = Deadline(self._clock, patience_s)
        while not self._jig.arrived():
            self._watch()
            if deadline.expired:
                self._jig.check()
                raise DeviceError(
                    "The jig did not reach its park pose "
                    f"(it reports {checks.angles(self._jig.reported())}): check the servo supply."
                )
        self._event("parked")

    def _park_quietly(self, patience_s: float) -> bool:
        """Park without looking at the sensor; return whether the controller took the command."""
        try:
            self._jig.recover()
            self._jig.park()
            deadline = Deadline(self._clock, 0.0 if self._stop.hurry else patience_s)
            while not deadline.expired and not self._jig.arrived():
                self._clock.sleep(POLL_S)
        except DeviceError:
            return False
        self._event("parked")
        return True

    def _farewell(self, step: PlannedStep | None, cause: str, patience_s: float) -> str:
        """Park and put together the sentence that tells the person where everything stands."""
        parked = self._park_quietly(patience_s)
        if not parked:
            cause += (
                " The jig could not be parked, because its controller does not answer: "
                "switch off the servo supply before you touch it."
            )
        self._event(
            "session-stopped",
            cause=cause,
            at_step=None if step is None else step.index,
            finished=self.outcome.finished,
            parked=parked,
        )
        self._state("stopped")
        where = "" if step is None else f" at pose {step.index + 1} of {len(self._plan.steps)}"
        safe = " The jig is parked." if parked else ""
        return f"Session stopped{where}: {cause}{safe}"

    # --- faults -------------------------------------------------------------------------------

    def _recover(self, fault: DeviceError) -> None:
        """Park at once, wait for the devices to come back, and check that they are well."""
        self._event("fault", cause=str(fault), kind=type(fault).__name__)
        self._state("recovering")
        parked = self._park_quietly(0.0)
        self._notice(
            f"{fault} {'The jig is parking.' if parked else 'The jig cannot be parked now.'} "
            f"Waiting up to {RECOVERY_S:.0f} s for it to come back."
        )
        deadline = Deadline(self._clock, RECOVERY_S)
        while True:
            try:
                self._reconnect()
                self._park(PARK_PATIENCE_S)
                self._measure_rest()
            except DeviceError as still_wrong:
                if deadline.expired:
                    raise SessionStopped(str(still_wrong)) from fault
                self._clock.sleep(RECOVERY_RETRY_S)
                continue
            break
        self.outcome.recoveries += 1
        self._event("recovered")
        self._notice("It came back; the session goes on with the pose it was at.")

    def _reconnect(self) -> None:
        self._check_stop()
        if self._imu.health.error is not None:
            self._imu.reopen()
        self._jig.recover()
        # what arrived before must not be taken for life
        self._imu.poll()
        deadline = Deadline(self._clock, SILENCE_S)
        fresh = 0
        while fresh < 10:
            self._check_stop()
            fresh += len(self._take_samples())
            if deadline.expired:
                raise DeviceLost(checks.silence(self._imu))
            self._clock.sleep(POLL_S)

    # --- watching -----------------------------------------------------------------------------

    def _watch(self) -> None:
        """Take new samples, look after sensor and jig, report, and wait a moment."""
        self._check_stop()
        self._take_samples()
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
        self._check_disk()
        self._clock.sleep(POLL_S)

    def _watch_for(self, seconds: float) -> None:
        deadline = Deadline(self._clock, seconds)
        while not deadline.expired:
            self._watch()

    def _check_stop(self) -> None:
        if self._stop.cause is not None:
            raise SessionInterrupted(self._stop.cause)

    def _check_disk(self) -> None:
        if self._trial.error is not None:
            raise self._trial.error

    def _take_samples(self) -> ImuBlock:
        block = self._imu.poll()
        if len(block):
            self._since_still.append(block)
            self._newest_s = float(block.t[-1])
            if self._monitor is not None:
                self._monitor.update(block)
        health = self._imu.health
        elapsed = self._elapsed_s()
        self._progress = replace(
            self._progress,
            rate_hz=health.rate_hz,
            lost=health.lost,
            corrupt=health.corrupt,
            elapsed_s=elapsed,
            remaining_s=self._remaining_s(),
        )
        self._observe(self._progress)
        return block

    def _check_imu(self) -> None:
        health = self._imu.health
        if health.error is not None:
            raise DeviceLost(health.error)
        if health.last_packet_age_s > SILENCE_S:
            raise DeviceLost(checks.silence(self._imu))
        if health.stuck:
            raise DeviceError(
                f"{self._imu.name} repeats the same sample over and over: its sensor hangs; "
                "switch it off and on again."
            )
        if health.restarts > self._restarts:
            self._restarts = health.restarts
            self._notice(f"{self._imu.name} restarted itself (its counter or clock began anew).")
        nominal = self._imu.layout.rate_hz
        if health.lag_s > LAG_WARNING_S:
            self._notice_once("lag", f"{self._imu.name}'s data arrive {health.lag_s:.1f} s late.")
        off = nominal and health.rate_hz and abs(health.rate_hz / nominal - 1) > RATE_TOLERANCE
        if not off:
            self._rate_well_ns = self._clock.now_ns()
        elif self._clock.now_ns() - self._rate_well_ns > RATE_OFF_S * NS_PER_S:
            self._notice_once(
                "rate",
                f"{self._imu.name} sends about {health.rate_hz:.0f} samples/s where its layout "
                f"says {nominal:g}; going on by its own clock.",
            )

    # --- small things -------------------------------------------------------------------------

    def _samples(self, start_s: float, stop_s: float) -> ImuBlock:
        block = ImuBlock.concatenate(self._since_still)
        return block[(block.t >= start_s) & (block.t <= stop_s)]

    def _require_monitor(self) -> StillnessMonitor:
        if self._monitor is None:
            raise RuntimeError("the sensor's rest is measured before any pose is held")
        return self._monitor

    def _now_s(self) -> float:
        return self._clock.now_ns() / NS_PER_S

    def _elapsed_s(self) -> float:
        return (self._clock.now_ns() - self._begin_ns) / NS_PER_S

    def _trial_s(self, host_s: float) -> float:
        return round(self._trial.t_s(int(host_s * NS_PER_S)), 6)

    def _remaining_s(self) -> float:
        done = len(self.outcome.finished) + self._first_step
        return self._plan.remaining_s(done) if done < len(self._plan.steps) else 0.0

    def _state(self, state: str, **changes: float) -> None:
        self._progress = replace(self._progress, state=state, **changes)  # type: ignore[arg-type]  # floats only
        self._observe(self._progress)

    def _event(self, name: str, /, **fields: object) -> None:
        self._trial.event(name, **fields)

    def _notice(self, sentence: str) -> None:
        self.outcome.notices.append(sentence)
        self._event("notice", text=sentence)
        self._notify(sentence)

    def _notice_once(self, kind: str, sentence: str) -> None:
        """Notice a lasting condition when it is first seen."""
        if kind not in self._noticed:
            self._noticed.add(kind)
            self._notice(sentence)
