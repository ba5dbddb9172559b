"""The dry run: a protocol turned into moves of one jig, checked against its limits, with times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from imu_rig.devices.jig import JigConfig
from imu_rig.errors import InputError
from imu_rig.session.protocol import AXIS_NAMES, AxisName, JigProtocol, Pose

ARRIVAL_S = 0.15
"""What a stop costs beyond the travel itself: two polls of the controller [s]."""


@dataclass(frozen=True)
class Stage:
    """Part of a move in which ``axes`` turn together from ``start`` to ``end``.

    ``waypoints`` end with ``end``; one before it is the overshoot from which the final approach
    comes, always in the direction of rising angle, so that backlash is taken up the same way.
    """

    axes: tuple[AxisName, ...]
    start: Pose
    end: Pose
    waypoints: tuple[Pose, ...]

    @property
    def single_axis(self) -> AxisName | None:
        """The axis, if only one turns: the move is then a rotation about a fixed axis."""
        return self.axes[0] if len(self.axes) == 1 else None


@dataclass(frozen=True)
class PlannedStep:
    """One stop: where, how to get there from the stop before, and how long to hold.

    In another ``mounting`` (counted from 0) than that of the stop before, the way begins at the
    park pose, where the sensor is turned over.

    ``approach`` gives the direction in which each moving axis arrives: +1 from below, -1 from
    above where the limits leave no room to overshoot.
    """

    index: int
    name: str
    kind: str
    pose: Pose
    hold_s: float
    stages: tuple[Stage, ...]
    approach: Mapping[AxisName, int]
    duration_s: float
    mounting: int = 0


@dataclass(frozen=True)
class SessionPlan:
    """All stops of a session on one jig, with the predicted duration [s]."""

    protocol: JigProtocol
    steps: tuple[PlannedStep, ...]
    start: Pose
    duration_s: float

    def remaining_s(self, index: int) -> float:
        """Predicted time [s] from the beginning of step ``index`` to the end."""
        return sum(step.duration_s for step in self.steps[index:])


def park_pose(jig: JigConfig) -> Pose:
    """Return the pose in which the jig file parks the jig."""
    pan, tilt, roll = jig.park_deg
    return Pose(pan=pan, tilt=tilt, roll=roll)


def plan_session(protocol: JigProtocol, jig: JigConfig) -> SessionPlan:
    """Plan every move of ``protocol`` on ``jig``, starting and ending parked.

    Raises
    ------
    InputError
        If any pose lies outside the jig's limits; all of them are named.
    """
    poses = _absolute_poses(protocol)
    _check_limits(protocol, jig, poses)
    position, mounting = park_pose(jig), 0
    steps = []
    described = zip(protocol.steps, poses, protocol.mounting_of_steps, strict=True)
    for index, (step, pose, mounted) in enumerate(described):
        travel = 0.0
        if mounted != mounting:
            travel = jig.travel_time(position.angles(), park_pose(jig).angles())
            position, mounting = park_pose(jig), mounted
        parked = index == 0 or (mounted != protocol.mounting_of_steps[index - 1])
        stages, approach = plan_move(position, pose, jig, protocol.order, parked=parked)
        travel += sum(travel_time(jig, stage) for stage in stages)
        pauses = max(0, len(stages) - 1) * protocol.pause_s + len(stages) * ARRIVAL_S
        hold = protocol.hold_of(step)
        steps.append(
            PlannedStep(
                index=index,
                name=step.name or str(pose),
                kind=step.kind,
                pose=pose,
                hold_s=hold,
                stages=stages,
                approach=approach,
                duration_s=travel + pauses + hold,
                mounting=mounted,
            )
        )
        position = pose
    return SessionPlan(
        protocol=protocol,
        steps=tuple(steps),
        start=park_pose(jig),
        duration_s=sum(step.duration_s for step in steps),
    )


def plan_move(
    start: Pose,
    end: Pose,
    jig: JigConfig,
    order: tuple[tuple[AxisName, ...], ...],
    *,
    parked: bool = False,
) -> tuple[tuple[Stage, ...], dict[AxisName, int]]:
    """Split the way from ``start`` to ``end`` into stages by ``order``, with one-sided approach.

    From the park pose, which servos may have reached from either side, every axis is approached
    anew, those that stay where they are included: a dead band of some degrees would else part
    the first poses from the rest.
    """
    stages: list[Stage] = []
    approach: dict[AxisName, int] = {}
    position = start
    for group in order:
        turning = tuple(a for a in group if parked or getattr(end, a) != getattr(position, a))
        if not turning:
            continue
        goal: dict[str, float] = {a: getattr(end, a) for a in turning}
        target = position.model_copy(update=goal)
        before: dict[str, float] = {}
        for axis in turning:
            approach[axis] = 1
            if getattr(end, axis) <= getattr(position, axis):
                beyond = getattr(end, axis) - jig.overshoot_deg
                if beyond >= getattr(jig, axis).limits_deg[0]:
                    before[axis] = beyond
                else:
                    approach[axis] = -1
        waypoints = (target.model_copy(update=before), target) if before else (target,)
        stages.append(Stage(axes=turning, start=position, end=target, waypoints=waypoints))
        position = target
    return tuple(stages), approach


def travel_time(jig: JigConfig, stage: Stage) -> float:
    """Predicted duration [s] of a stage: its slowest axis on every leg."""
    legs = zip((stage.start, *stage.waypoints[:-1]), stage.waypoints, strict=True)
    return sum(jig.travel_time(a.angles(), b.angles()) for a, b in legs)


def _absolute_poses(protocol: JigProtocol) -> list[Pose]:
    poses, current = [], Pose()
    for step in protocol.steps:
        stated = {axis: getattr(step, axis) for axis in AXIS_NAMES}
        current = current.model_copy(update={a: v for a, v in stated.items() if v is not None})
        poses.append(current)
    return poses


def _check_limits(protocol: JigProtocol, jig: JigConfig, poses: list[Pose]) -> None:
    outside = []
    for number, pose in enumerate(poses, start=1):
        for axis in AXIS_NAMES:
            low, high = getattr(jig, axis).limits_deg
            angle = getattr(pose, axis)
            if not low <= angle <= high:
                outside.append(f"step {number} {axis} {angle:g} deg (allowed {low:g} to {high:g})")
    if outside:
        raise InputError(
            f"Protocol '{protocol.name}' leaves the limits of jig '{jig.name}': "
            f"{'; '.join(outside[:8])}{' ...' if len(outside) > 8 else ''}; "
            "use a protocol within the jig's reach or correct the limits in the jig file."
        )
