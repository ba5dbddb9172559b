"""Calibrate from a trial file: as a session where it holds one, as a hand-held recording else."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.result import CalibrationResult, DeviceInfo
from imu_rig.calibration.session import CommandedPoses, CommandedTurn
from imu_rig.calibration.solve import DEFAULT_METHOD, solve
from imu_rig.errors import DataError
from imu_rig.recording.reader import Trial
from imu_rig.session.history import IMU_SOURCE, Visit, read_session
from imu_rig.session.protocol import Pose

EDGE_S = 0.05  # cut off both ends of a hold: live and final clock fit differ by milliseconds


def solve_session(
    trial: Trial, *, method: str = DEFAULT_METHOD, gravity: Gravity | None = None
) -> CalibrationResult:
    """Calibrate from the finished poses of the session in a trial file.

    Raises
    ------
    InputError
        If the trial holds no session that makes sense.
    DataError
        If its poses cannot determine the calibration.
    """
    session = read_session(trial)
    block = trial.imu(IMU_SOURCE)
    visits = [visit for visit in session.visits if _inside(visit, block.t)]
    if not visits:
        raise DataError(
            f"{trial.path} holds no finished pose yet; go on with the session first: "
            f"imu-rig calibrate --resume {trial.path}"
        )
    return solve(
        block,
        np.array([(v.still_s[0] + EDGE_S, v.still_s[1] - EDGE_S) for v in visits]),
        method=method,
        gravity=gravity,
        commanded=CommandedPoses(
            np.array([_degrees(v.commanded_deg) for v in visits]),
            tuple(f"{v.index + 1}: {v.name}" for v in visits),
            tuple(turn for v in visits for turn in _driven_turns(v)),
        ),
        device=DeviceInfo(session.device, session.serial, session.layout.name),
    )


def _driven_turns(visit: Visit) -> list[CommandedTurn]:
    """Return the driven stages of the way to a stop.

    Each lasts until the next begins, and the last until the hold: a servo goes on for a moment
    after its controller reports arrival.
    """
    begins = [turn.t_s[0] for turn in visit.turns]
    ends = [*begins[1:], visit.still_s[0]]
    return [
        CommandedTurn(begin, end, _degrees(turn.from_deg), _degrees(turn.to_deg))
        for begin, end, turn in zip(begins, ends, visit.turns, strict=True)
    ]


def _degrees(pose: Pose) -> tuple[float, float, float]:
    return pose.pan, pose.tilt, pose.roll


def _inside(visit: Visit, t: FloatArray) -> bool:
    begin, end = visit.still_s
    return bool(len(t) and t[0] <= begin + EDGE_S and end - EDGE_S <= t[-1] and end - begin > 0.2)
