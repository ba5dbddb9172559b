"""Calibrate from a trial file: as a session where it holds one, as a hand-held recording else."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.result import CalibrationResult, DeviceInfo
from imu_rig.calibration.session import CommandedPoses, CommandedTurn
from imu_rig.calibration.solve import DEFAULT_METHOD, solve
from imu_rig.calibration.verification import Limits
from imu_rig.errors import DataError
from imu_rig.recording.reader import Trial
from imu_rig.session.history import IMU_SOURCE, SessionRecord, Visit, read_session
from imu_rig.session.protocol import CheckLimits, JigProtocol, Pose
from imu_rig.units import DEG, MILLI_G

EDGE_S = 0.05  # cut off both ends of a hold: live and final clock fit differ by milliseconds


def solve_session(
    trial: Trial,
    *,
    method: str = DEFAULT_METHOD,
    gravity: Gravity | None = None,
    field_ut: float | None = None,
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
    block = trial.imu_in_time(IMU_SOURCE)
    visits, windows = holds(session, block.t)
    if not visits:
        raise DataError(
            f"{trial.path} holds no finished pose yet; go on with the session first: "
            f"imu-rig calibrate --resume {trial.path}"
        )
    if session.protocol.only_checks:
        raise DataError(
            f"{trial.path} holds a check of a sensor, from which nothing can be calibrated: "
            f"compare it with the sensor's certificate: imu-rig verify CERTIFICATE {trial.path}"
        )
    try:
        return _solve(block, session, visits, windows, method, gravity, field_ut)
    except DataError as error:
        if session.next_step == len(session.protocol.steps):
            raise
        raise DataError(
            f"{error}; the session is not finished ({len(session.finished)} of "
            f"{len(session.protocol.steps)} stops), so go on with it first: imu-rig calibrate "
            f"--resume {trial.path}"
        ) from error


def _solve(
    block: ImuBlock,
    session: SessionRecord,
    visits: list[Visit],
    windows: FloatArray,
    method: str,
    gravity: Gravity | None,
    field_ut: float | None,
) -> CalibrationResult:
    return solve(
        block,
        windows,
        method=method,
        gravity=gravity,
        field_ut=field_ut,
        commanded=CommandedPoses(
            np.array([_degrees(v.commanded_deg) for v in visits]),
            tuple(f"{v.index + 1}: {v.name}" for v in visits),
            tuple(turn for v in visits for turn in _driven_turns(v, session.protocol)),
            mounting=tuple(v.mounting for v in visits),
            mounting_turns=session.protocol.mounting_turns,
            check=tuple(v.kind == "check" for v in visits),
        ),
        limits=limits_of(session.protocol.limits),
        device=DeviceInfo(session.device, session.serial, session.layout.name),
    )


def holds(session: SessionRecord, t: FloatArray) -> tuple[list[Visit], FloatArray]:
    """Return the visits that lie in a recording with times ``t``, and their windows (m, 2) [s]."""
    visits = [visit for visit in session.visits if _inside(visit, t)]
    spans = [(v.still_s[0] + EDGE_S, v.still_s[1] - EDGE_S) for v in visits]
    return visits, np.array(spans).reshape(-1, 2)


def limits_of(stated: CheckLimits) -> Limits:
    """Limits of a protocol file in SI units."""
    return Limits(stated.accel_mg * MILLI_G, stated.turn_deg * DEG, stated.sigma)


def _driven_turns(visit: Visit, protocol: JigProtocol) -> list[CommandedTurn]:
    """Return the driven stages of the way to a stop.

    Each lasts until the next begins, and the last until the hold: a servo goes on for a moment
    after its controller reports arrival.
    """
    mounted = protocol.mounting_turns[visit.mounting]
    begins = [turn.t_s[0] for turn in visit.turns]
    ends = [*begins[1:], visit.still_s[0]][: len(begins)]
    return [
        CommandedTurn(begin, end, _degrees(turn.from_deg), _degrees(turn.to_deg), mounted)
        for begin, end, turn in zip(begins, ends, visit.turns, strict=True)
    ]


def _degrees(pose: Pose) -> tuple[float, float, float]:
    return pose.pan, pose.tilt, pose.roll


def _inside(visit: Visit, t: FloatArray) -> bool:
    begin, end = visit.still_s
    return bool(len(t) and t[0] <= begin + EDGE_S and end - EDGE_S <= t[-1] and end - begin > 0.2)
