"""Whole jig sessions with known truth, made at once, and how to solve them."""

from functools import cache

import numpy as np

from imu_rig.calibration.session import CommandedPoses, CommandedTurn
from imu_rig.calibration.solve import solve
from imu_rig.devices.jig import load_jig
from imu_rig.session.plan import plan_session
from imu_rig.session.protocol import load_protocol
from simulators.config import RigConfig
from simulators.quick_session import quick_session

DEG = np.pi / 180.0
MILLI_G = 9.80665e-3


@cache
def full_protocol():
    plan = plan_session(load_protocol("full"), load_jig("paper-jig"))
    steps = [step for step in plan.steps if step.kind != "check"]
    angles = np.array([(s.pose.pan, s.pose.tilt, s.pose.roll) for s in steps])
    return angles, tuple(step.hold_s for step in steps)


def commanded(session):
    return CommandedPoses(
        session.angles_deg,
        turns=tuple(CommandedTurn(t.t0, t.t1, t.start_deg, t.stop_deg) for t in session.turns),
        mounting=session.mounting,
        mounting_turns=tuple(tuple(a * DEG for a in v) for v in session.mountings_deg),
    )


@cache
def session_of(seed, faults=None, **sensor):
    config = RigConfig.random(seed)
    config = config.model_copy(update={"sensor": config.sensor.model_copy(update=sensor)})
    angles, holds = full_protocol()
    return quick_session(config, angles, hold_s=holds, faults=faults)


def solved(session, method="joint", **changes):
    asked = {"gravity": session.truth.gravity, "commanded": commanded(session), **changes}
    return solve(session.block, session.windows, method=method, **asked)
