"""The engine that steps an IMU through a planned session and keeps the jig safe while it does.

One loop watches everything: samples, the controller's errors, the user's wish to stop. Whatever
goes wrong ends the same way: the jig parks at once, the engine waits for the device to come back,
repeats the stop it was at and says so; or it gives up with everything measured so far on disk.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imu_rig.blocks import ImuBlock
from imu_rig.clock import Clock, Deadline
from imu_rig.devices.imu import ImuDevice
from imu_rig.devices.jig import Jig, JigFault
from imu_rig.errors import (
    AnotherSensor,
    DeviceError,
    DeviceLost,
    ImuRigError,
    SessionInterrupted,
    SessionStopped,
    StorageError,
)
from imu_rig.recording.writer import TrialWriter
from imu_rig.session import checks
from imu_rig.session.history import Visit
from imu_rig.session.plan import PlannedStep, SessionPlan, Stage, plan_move
from imu_rig.session.progress import (
    Hands,
    NoHands,
    Progress,
    SessionOutcome,
    ignore,
)
from imu_rig.session.protocol import AxisName, Pose
from imu_rig.session.stillness import WINDOW_S, StillnessMonitor, has_gyro, scatter
from imu_rig.session.watch import POLL_S, Watch
from imu_rig.stopping import StopRequest

# Times in seconds.
REST_S = 1.5  # of rest before the first move, to learn the sensor's own scatter
REST_PATIENCE_S = 8.0
ARRIVAL_PATIENCE_S = 2.0  # beyond the predicted travel
MIN_STILL_S = 0.4  # a hold used to this length at least, whatever its settling takes away
STILL_PATIENCE_S = 12.0  # until a pose has been held still, beyond the hold itself
RECOVERY_S = 10.0  # for a lost device to come back
RECOVERY_RETRY_S = 0.3
PARK_PATIENCE_S = 8.0
STOP_PATIENCE_S = 2.0  # for parking after the user asked to stop

MAX_RECOVERIES_PER_STEP = 2
MAX_WRONG_TURNS = 1  # of a session: once a servo may have been bumped, twice the jig is not right

NOT_PARKED = (
    "The jig could not be parked, because its controller does not answer: switch off the servo "
    "supply before you touch it."
)


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
    before : Visit, optional
        A finished stop of the session that goes on: it is held once more and compared, so that
        another sensor or mounting is not taken for the one the session began with.
    hands : Hands, optional
        Who turns the sensor over where the protocol changes its mounting; without, the session
        stops there.
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
        before: Visit | None = None,
        hands: Hands | None = None,
    ) -> None:
        self.outcome = SessionOutcome()
        self._plan, self._jig, self._imu, self._clock = plan, jig, imu, clock
        self._first_step = first_step
        self._before = before
        self._hands = hands or NoHands()
        self._mounting = 0 if before is None else before.mounting
        self._reference: checks.Reference | None = None
        self._stop = stop or StopRequest()
        self._watch = Watch(
            jig, imu, trial, clock, self._stop, observe, notify, steps=len(plan.steps)
        )
        self.outcome.notices = self._watch.notices
        self._last_still: tuple[Pose, _Still] | None = None
        self._position = plan.start
        self._wrong_turns = 0

    def run(self) -> SessionOutcome:
        """Visit every stop, then park.

        Raises
        ------
        SessionStopped
            If a device was lost or answered wrongly and did not recover.
        SessionInterrupted
            If the stop request was made.
        StorageError
            If the disk failed. In every case the jig has been sent to its park pose where its
            controller answers.
        """
        step: PlannedStep | None = None
        try:
            self._watch.tell(state="connecting", remaining_s=self._remaining_s())
            self._watch.await_data()
            self._warn_of_released_servos()
            self._park(PARK_PATIENCE_S)
            self._measure_rest()
            if self._before is not None and not self._was_remounted(self._before):
                self._compare_with_before(self._before)
            for step in self._plan.steps[self._first_step :]:
                self._visit_persistently(step)
            step = None
            self._watch.event("session-complete", finished=self.outcome.finished)
            self._end_parked()
            self._watch.tell(state="done", remaining_s=0.0)
        except SessionInterrupted as stop:
            raise SessionInterrupted(self._farewell(step, str(stop))) from stop
        except StorageError as fault:
            raise StorageError(self._farewell(step, str(fault))) from fault
        except ImuRigError as fault:
            kind = AnotherSensor if isinstance(fault, AnotherSensor) else SessionStopped
            raise kind(self._farewell(step, str(fault))) from fault
        except BaseException:  # a fault of ours must not leave the jig standing either
            self._park_quietly(STOP_PATIENCE_S)
            raise
        finally:
            self.outcome.elapsed_s = self._watch.elapsed_s
        return self.outcome

    # --- stops ------------------------------------------------------------------------------

    def _visit_persistently(self, step: PlannedStep) -> None:
        for attempt in range(1 + MAX_RECOVERIES_PER_STEP):
            try:
                if step.mounting != self._mounting:
                    self._remount(step)
                self._visit(step)
                return
            except DeviceError as fault:
                if attempt == MAX_RECOVERIES_PER_STEP:
                    raise
                self._recover(fault)

    def _visit(self, step: PlannedStep) -> None:
        watch = self._watch
        watch.tell(
            step=step.index + 1, name=step.name, kind=step.kind, hold_s=step.hold_s, held_s=0.0
        )
        watch.event("step", index=step.index, name=step.name, pose=step.pose.angles())
        stages, approach = self._way_to(step)
        turns = [self._travel(stage, last=stage is stages[-1]) for stage in stages]
        still = self._hold(step, watch.now_s)
        reported = self._jig.reported()
        self._jig.check()
        self._check_turn(step, still)
        rest = scatter(still.block)
        watch.event(
            "pose",
            index=step.index,
            name=step.name,
            kind=step.kind,
            mounting=step.mounting,
            commanded_deg=step.pose.angles(),
            reported_deg={axis: round(angle, 3) for axis, angle in reported.items()},
            approach=approach,
            still_s=[watch.trial_s(still.start), watch.trial_s(still.stop)],
            samples=len(still.block),
            accel_mean=np.mean(still.block.accel, axis=0).round(6).tolist(),
            gyro_mean=rest.gyro_bias.round(8).tolist() if has_gyro(still.block) else None,
            accel_scatter=rest.accel,
            gyro_scatter=rest.gyro,
            turns=turns,
        )
        self._monitor.follow_bias(still.block)
        self._remember(step.pose, still)
        self._position = step.pose
        watch.keep_only(still.block)
        self.outcome.finished.append(step.index)
        watch.tell(remaining_s=self._remaining_s())

    def _compare_with_before(self, before: Visit) -> None:
        """Hold a finished stop once more and see whether sensor and mounting are the same."""
        step = self._plan.steps[before.index]
        self._watch.tell(step=step.index + 1, name=step.name, hold_s=step.hold_s, held_s=0.0)
        stages, _ = self._way_to(step)
        for stage in stages:
            self._travel(stage, last=stage is stages[-1])
        still = self._hold(step, self._watch.now_s)
        problem = checks.another_sensor(self._imu.name, before, still.block)
        if problem is not None:
            raise AnotherSensor(problem)
        self._remember(step.pose, still)
        self._watch.keep_only(still.block)
        self._position = step.pose

    # --- mountings ----------------------------------------------------------------------------

    def _remount(self, step: PlannedStep) -> None:
        """Park, have the sensor turned over, and see that gravity stands where it should."""
        watch, protocol = self._watch, self._plan.protocol
        mounting, turn = protocol.mountings[step.mounting], protocol.mounting_turns[step.mounting]
        self._park(PARK_PATIENCE_S)
        what = mounting.instruction or f"Fix the IMU as mounting '{mounting.name}' asks."
        watch.tell(state="remounting", step=step.index + 1, name=mounting.name, held_s=0.0)
        problem: str | None = None
        while True:
            watch.event("remounting", mounting=step.mounting, name=mounting.name)
            words = what if problem is None else f"{problem} {what}"
            if not self._hands.ask(words, turn):
                raise SessionStopped(
                    f"The sensor must be turned over now: {words} Then go on with the session."
                )
            while not self._hands.ready():
                watch.check_stop()
                watch.take_samples()
                watch.forget()
                self._clock.sleep(POLL_S)
            rest = self._rest_again()
            if self._reference is None:
                break
            problem = checks.wrong_mounting(
                self._imu.name, self._reference, rest.block, self._position, np.array(turn)
            )
            if problem is None:
                break
        watch.event("remounted", mounting=step.mounting, name=mounting.name)
        self._mounting = step.mounting

    def _rest_again(self) -> _Still:
        """Wait for the sensor, whose cable hands may have pulled, and for its rest."""
        self._reconnect()
        self._measure_rest()
        if self._last_still is None:
            raise RuntimeError("the sensor's rest was measured just now")
        return self._last_still[1]

    def _was_remounted(self, before: Visit) -> bool:
        """Whether the sensor was turned over between a stopped session and its resumption."""
        steps = self._plan.steps[self._first_step :]
        if not steps or steps[0].mounting == before.mounting or before.accel_mean is None:
            return False
        turns, rest = self._plan.protocol.mounting_turns, self._last_still
        if rest is None:
            return False
        then = checks.Reference(
            np.array(before.accel_mean), before.commanded_deg, np.array(turns[before.mounting])
        )
        now, wanted = rest[1].block, np.array(turns[steps[0].mounting])
        if checks.wrong_mounting(self._imu.name, then, now, self._position, wanted) is not None:
            return False
        problem = checks.other_readings(self._imu.name, before, now)
        if problem is not None:
            raise AnotherSensor(problem)
        self._mounting = steps[0].mounting
        self._watch.event("remounted", mounting=self._mounting)
        return True

    def _way_to(self, step: PlannedStep) -> tuple[tuple[Stage, ...], dict[AxisName, int]]:
        """Plan the way from where the jig stands, which after a recovery is its park pose."""
        order = self._plan.protocol.order
        parked = self._position is self._plan.start
        return plan_move(self._position, step.pose, self._jig.config, order, parked=parked)

    def _travel(self, stage: Stage, *, last: bool) -> dict[str, object]:
        """Drive one stage and return what the trial file keeps of it."""
        watch = self._watch
        watch.tell(state="moving", motion=float("inf"), held_s=0.0)
        begin = watch.now_s
        position = stage.start
        for waypoint in stage.waypoints:
            self._jig.command({axis: getattr(waypoint, axis) for axis in stage.axes})
            predicted = self._jig.config.travel_time(position.angles(), waypoint.angles())
            self._await_arrival(f"at {waypoint}", predicted + ARRIVAL_PATIENCE_S)
            position = waypoint
        if not last:
            watch.look_for(self._plan.protocol.pause_s)
        return {
            "axes": list(stage.axes),
            "from_deg": stage.start.angles(),
            "to_deg": stage.end.angles(),
            "t_s": [watch.trial_s(begin), watch.trial_s(watch.now_s)],
        }

    def _await_arrival(self, where: str, patience_s: float) -> None:
        deadline = Deadline(self._clock, patience_s)
        while not self._jig.arrived():
            self._watch.look()
            if deadline.expired and not self._jig.arrived():
                self._jig.check()
                reported = checks.angles(self._jig.reported())
                raise DeviceError(
                    f"The jig did not arrive {where} within {patience_s:.1f} s (it reports "
                    f"{reported}): check that nothing blocks it and that the servo supply is on."
                )

    def _hold(self, step: PlannedStep, arrived_s: float) -> _Still:
        """Wait until the sensor has been still for the hold; motion starts it anew."""
        watch, monitor = self._watch, self._monitor
        watch.tell(state="settling")
        monitor.clear()
        since = arrived_s + self._plan.protocol.settle_s
        wanted = max(MIN_STILL_S, step.hold_s - self._plan.protocol.settle_s)
        deadline = Deadline(self._clock, STILL_PATIENCE_S + step.hold_s)
        start: float | None = None
        restarts = 0
        while True:
            watch.look()
            motion = monitor.excess(since)
            watch.tell(motion=motion)
            if motion < float("inf"):
                self._check_gravity(monitor.window(since))
            if motion < 1.0:
                if start is None:
                    start = max(since, watch.newest_s - WINDOW_S)
                watch.tell(state="holding", held_s=watch.newest_s - start)
                if watch.newest_s - start >= wanted:
                    block = watch.samples(start, watch.newest_s)
                    if checks.is_whole(block):
                        return _Still(start, watch.newest_s, block)
                    start, since, restarts = None, watch.newest_s, restarts + 1
                    watch.notice(f"Packets were lost while {step.name} was held; holding it again.")
            elif start is not None:
                start, since, restarts = None, watch.newest_s, restarts + 1
                watch.tell(state="settling", held_s=0.0)
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
        way = self._watch.samples(held.stop, still.start)
        if len(way) < 2 or not checks.is_whole(way) or not has_gyro(way):
            return
        bias = np.mean(held.block.gyro, axis=0)
        problem = checks.wrong_turn(way, bias, before, step.pose)
        if problem is None:
            return
        self._wrong_turns += 1
        if self._wrong_turns > MAX_WRONG_TURNS:
            raise SessionStopped(problem)
        raise DeviceError(problem)

    # --- before and after ---------------------------------------------------------------------

    def _warn_of_released_servos(self) -> None:
        if self._jig.start_errors:
            self._watch.notice(
                f"The servo controller had latched {self._jig.start_errors.describe()}; cleared."
            )
        if any(np.isnan(angle) for angle in self._jig.reported().values()):
            self._watch.notice(
                "The servos were released and take hold at the park pose at full speed now: "
                "keep your hands off the jig."
            )

    def _measure_rest(self) -> None:
        """Learn the sensor's scatter and bias at rest, which stillness is judged by."""
        watch, name = self._watch, self._imu.name
        watch.tell(state="resting")
        deadline = Deadline(self._clock, REST_PATIENCE_S)
        begin = watch.now_s
        problem: str | None = None
        while not deadline.expired:
            watch.look()
            if watch.newest_s - begin < REST_S:
                continue
            block = watch.samples(watch.newest_s - REST_S, watch.newest_s)
            quiet = scatter(block)
            problem = checks.no_rest(name, quiet) or checks.wrong_gravity(name, block)
            if problem is None:
                watch.monitor = StillnessMonitor(quiet)
                watch.keep_only(block)
                rest = _Still(float(block.t[0]), float(block.t[-1]), block)
                self._last_still = (self._plan.start, rest)
                watch.event("rest", accel_scatter=quiet.accel, gyro_scatter=quiet.gyro)
                return
        if problem is None:
            raise DeviceLost(checks.silence(self._imu))
        raise DeviceError(problem)

    def _park(self, patience_s: float) -> None:
        self._watch.tell(state="parking")
        self._jig.park()
        self._watch.event("parking")
        self._await_arrival("at its park pose", patience_s)
        self._position = self._plan.start
        self._watch.event("parked")

    def _end_parked(self) -> None:
        """Park after the last stop; every pose is measured, whatever happens now."""
        self._watch.tell(state="parking")
        if self._park_quietly(PARK_PATIENCE_S) in {"sent", "lost"}:
            self._watch.notice(f"All stops are finished. {NOT_PARKED}")

    def _park_quietly(self, patience_s: float, *, reset: bool = False) -> str:
        """Park whatever the sensor does.

        The park targets are sent before anything is asked, because a controller that does not
        answer may still obey; only one that was ``reset`` must take hold of its servos first.

        Returns "parked"; "parking" where it is still on its way after ``patience_s``; "sent"
        where the controller does not answer; "lost" where nothing can be sent to it.
        """
        sent = False
        try:
            if not reset:
                self._jig.park_blind()
                sent = True
                self._watch.event("parking")
            self._jig.recover()
            self._jig.park()
            if not sent:
                sent = True
                self._watch.event("parking")
            deadline = Deadline(self._clock, patience_s)
            while not self._jig.arrived():
                if deadline.expired or self._stop.hurry:
                    return "parking"
                self._clock.sleep(POLL_S)
        except DeviceError:
            return "sent" if sent else "lost"
        self._watch.event("parked")
        return "parked"

    def _farewell(self, step: PlannedStep | None, cause: str) -> str:
        """Park and put together the sentence that tells the person where everything stands."""
        parked = self._park_quietly(STOP_PATIENCE_S)
        end = {
            "parked": "The jig is parked.",
            "parking": (
                "The jig was sent to its park pose and is not there yet: see that it gets there."
            ),
            "sent": (
                "The jig was told to park, but its controller does not answer: see that it did "
                "before you touch it."
            ),
            "lost": NOT_PARKED,
        }[parked]
        at = None if step is None else step.index
        self._watch.event(
            "session-stopped",
            cause=cause,
            at_step=at,
            finished=self.outcome.finished,
            park=parked,
        )
        self._watch.tell(state="stopped")
        where = "" if at is None else f" at pose {at + 1} of {len(self._plan.steps)}"
        return f"Session stopped{where}: {cause} {end}"

    # --- faults -------------------------------------------------------------------------------

    def _recover(self, fault: DeviceError) -> None:
        """Park at once, wait for the devices to come back, and check that they are well."""
        watch = self._watch
        watch.event("fault", cause=str(fault), kind=type(fault).__name__)
        watch.tell(state="recovering")
        reset = isinstance(fault, JigFault) and fault.kind != "stuck"
        lost = self._park_quietly(0.0, reset=reset) == "lost"
        watch.notice(
            f"{fault} {'The jig cannot be parked now.' if lost else 'The jig is parking.'} "
            f"Waiting up to {RECOVERY_S:.0f} s for all to be well."
        )
        deadline = Deadline(self._clock, RECOVERY_S)
        while True:
            try:
                self._reconnect()
                self._park(PARK_PATIENCE_S)
                self._measure_rest()
                break
            except DeviceError as still_wrong:
                if deadline.expired:
                    raise SessionStopped(str(still_wrong)) from fault
                watch.take_samples()
                self._clock.sleep(RECOVERY_RETRY_S)
        self.outcome.recoveries += 1
        watch.event("recovered")
        watch.notice("All is well again; the session goes on with the pose it was at.")

    def _reconnect(self) -> None:
        self._watch.check_stop()
        if self._imu.health.error is not None:
            self._imu.reopen()
        self._jig.recover()
        self._watch.await_fresh_data()

    def _remember(self, pose: Pose, still: _Still) -> None:
        """Keep a finished still: the next turn begins there, and gravity is known there."""
        turn = self._plan.protocol.mounting_turns[self._mounting]
        self._last_still = (pose, still)
        mean = np.mean(still.block.accel, axis=0)
        self._reference = checks.Reference(mean, pose, np.array(turn))

    # --- small things -------------------------------------------------------------------------

    @property
    def _monitor(self) -> StillnessMonitor:
        if self._watch.monitor is None:
            raise RuntimeError("the sensor's rest is measured before any pose is held")
        return self._watch.monitor

    def _remaining_s(self) -> float:
        done = len(self.outcome.finished) + self._first_step
        return self._plan.remaining_s(done) if done < len(self._plan.steps) else 0.0
