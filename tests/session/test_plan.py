"""The dry run: limits, one-sided approach, single-axis stages, predicted time."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imu_rig.devices.jig import JigConfig, load_jig
from imu_rig.errors import InputError
from imu_rig.session.plan import SessionPlan, plan_session
from imu_rig.session.protocol import (
    AXIS_NAMES,
    JigProtocol,
    Mounting,
    Step,
    builtin_protocols,
    load_protocol,
)

JIG = load_jig("paper-jig")


def inside(jig: JigConfig, pose: object) -> bool:
    limits = {axis: getattr(jig, axis).limits_deg for axis in AXIS_NAMES}
    return all(low <= getattr(pose, axis) <= high for axis, (low, high) in limits.items())


def waypoints(plan: SessionPlan) -> list[object]:
    return [point for step in plan.steps for stage in step.stages for point in stage.waypoints]


@pytest.mark.parametrize("name", builtin_protocols())
def test_every_builtin_protocol_fits_the_default_jig(name: str) -> None:
    plan = plan_session(load_protocol(name), JIG)
    assert all(inside(JIG, point) for point in waypoints(plan))


def test_the_full_session_takes_about_the_studied_82_seconds_and_its_checks_20_more() -> None:
    plan = plan_session(load_protocol("full"), JIG)
    checks = sum(step.duration_s for step in plan.steps if step.kind == "check")
    assert 65 < plan.duration_s - checks < 110
    assert checks < 20


def test_all_poses_outside_the_limits_are_named_at_once() -> None:
    protocol = JigProtocol(name="far", steps=(Step(tilt=120), Step(tilt=0, roll=500)))
    with pytest.raises(InputError) as caught:
        plan_session(protocol, JIG)
    assert "step 1 tilt 120" in str(caught.value)
    assert "step 2 roll 500" in str(caught.value)


angles = st.fixed_dictionaries(
    {},
    optional={
        "pan": st.floats(-180, 180),
        "tilt": st.floats(-96, 96),
        "roll": st.floats(-190, 190),
    },
)


@given(st.lists(angles, min_size=1, max_size=12))
def test_plans_stay_inside_arrive_where_told_and_come_from_below(steps: list[dict]) -> None:
    protocol = JigProtocol(name="any", steps=tuple(Step(**step) for step in steps))
    plan = plan_session(protocol, JIG)
    position = plan.start
    for step in plan.steps:
        for stage in step.stages:
            assert stage.start == position
            legs = zip((stage.start, *stage.waypoints), stage.waypoints, strict=False)
            for axis in stage.axes:
                last = [getattr(stage.start, axis), *(getattr(p, axis) for p in stage.waypoints)]
                moves = [b - a for a, b in itertools.pairwise(last) if a != b]
                assert (moves[-1] > 0) == (step.approach[axis] > 0)
                if step.approach[axis] < 0:  # only where there is no room below
                    room = getattr(stage.end, axis) - getattr(JIG, axis).limits_deg[0]
                    assert room < JIG.overshoot_deg
            for before, after in legs:
                still = [a for a in AXIS_NAMES if a not in stage.axes]
                assert all(getattr(before, a) == getattr(after, a) for a in still)
            position = stage.end
        assert position == step.pose
    assert all(inside(JIG, point) for point in waypoints(plan))


def test_roll_turns_alone_so_that_its_turns_have_one_fixed_axis() -> None:
    plan = plan_session(load_protocol("full"), JIG)
    fitted = [step for step in plan.steps if step.kind == "pose"]
    turning = [stage.single_axis for step in fitted for stage in step.stages]
    assert turning.count("roll") == 8
    assert turning.count("tilt") >= 16


def test_the_way_into_another_mounting_begins_parked_and_the_mounting_stays() -> None:
    over = Mounting(name="over", axis=(0, 1, 0), angle_deg=90)
    steps = (Step(tilt=40), Step(roll=30, mounting=2), Step(tilt=10), Step(tilt=0, mounting=1))
    plan = plan_session(JigProtocol(name="x", steps=steps, mountings=(over, over)), JIG)
    assert [step.mounting for step in plan.steps] == [0, 1, 1, 0]
    assert plan.steps[1].stages[0].start == plan.start
    assert plan.steps[2].stages[0].start == plan.steps[1].pose
    assert plan.steps[3].stages[0].start == plan.start
