"""Calibrate from a trial file: as a session where it holds one, as a hand-held recording else."""

from __future__ import annotations

import numpy as np

from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.result import CalibrationResult, DeviceInfo
from imu_rig.calibration.session import CommandedPoses
from imu_rig.calibration.solve import DEFAULT_METHOD, solve
from imu_rig.errors import DataError
from imu_rig.recording.reader import Trial
from imu_rig.session.history import IMU_SOURCE, Visit, read_session

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
            np.array([(p.pan, p.tilt, p.roll) for p in (v.commanded_deg for v in visits)]),
            tuple(f"{v.index + 1}: {v.name}" for v in visits),
        ),
        device=DeviceInfo(session.device, session.serial, session.layout.name),
    )


def _inside(visit: Visit, t: np.ndarray) -> bool:
    begin, end = visit.still_s
    return bool(len(t) and t[0] <= begin + EDGE_S and end - EDGE_S <= t[-1] and end - begin > 0.2)
