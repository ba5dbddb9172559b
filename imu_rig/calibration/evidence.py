"""Turns what a method found into a result: every pose and move with its errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imu_rig.calibration.prepare import temperature_range
from imu_rig.calibration.result import (
    CalibrationResult,
    DeviceInfo,
    ErrorStages,
    ErrorSummary,
    MoveRow,
    PoseRow,
)
from imu_rig.calibration.session import Outcome, Session
from imu_rig.calibration.stills import sample_rate


def result_of(
    session: Session,
    outcome: Outcome,
    method: str,
    device: DeviceInfo,
    warnings: list[str],
) -> CalibrationResult:
    """Put poses, moves, errors and warnings together."""
    block, g = session.block, session.gravity.value
    poses, moves = _poses(session, outcome), _moves(session, outcome)
    held_out = np.array([np.nan if p.left_out is None else p.left_out for p in poses])
    gyro_held = np.array([np.nan if m.held_out_rad is None else m.held_out_rad for m in moves])
    return CalibrationResult(
        method=method,
        device=device,
        gravity=session.gravity,
        frame=outcome.frame,
        accel=outcome.accel.affine,
        gyro=None if outcome.gyro is None else outcome.gyro.affine,
        poses=poses,
        moves=moves,
        accel_errors=ErrorStages(
            ErrorSummary.of(np.linalg.norm(session.stills.accel_mean, axis=1) - g),
            ErrorSummary.of(np.array([p.after for p in poses])),
            ErrorSummary.of(held_out),
        ),
        gyro_errors=ErrorStages(
            ErrorSummary.of(np.array([m.before_rad for m in moves])),
            ErrorSummary.of(np.array([m.after_rad for m in moves])),
            ErrorSummary.of(gyro_held),
        ),
        rate_hz=sample_rate(block.t),
        duration_s=float(block.t[-1] - block.t[0]),
        temperature_c=temperature_range(block),
        warnings=(*warnings, *outcome.warnings),
        accel_at_zero=outcome.accel_at_zero,
        straightness=outcome.straightness,
        jig=outcome.jig,
        findings=(
            *session.findings,
            *(
                replace(f, poses=tuple(int(session.order[i]) for i in f.poses))
                for f in outcome.findings
            ),
        ),
    )


def _poses(session: Session, outcome: Outcome) -> tuple[PoseRow, ...]:
    stills, accel, g = session.stills, outcome.accel, session.gravity.value
    calibrated = accel.affine.apply(stills.accel_mean)
    size = np.linalg.norm(calibrated, axis=1)
    raw = np.linalg.norm(stills.accel_mean, axis=1)
    angles = None if session.commanded is None else session.commanded.angles_deg.tolist()
    return tuple(
        PoseRow(
            name=session.names[i],
            t0=float(stills.t0[i]),
            t1=float(stills.t1[i]),
            count=int(stills.count[i]),
            direction=calibrated[i] / size[i],
            before=float(raw[i] - g),
            after=float(size[i] - g),
            sigma=float(accel.sigma[i]),
            left_out=_known(accel.left_out[i]),
            left_out_sigma=_known(accel.left_out_sigma[i]),
            commanded_deg=None if angles is None else tuple(angles[i]),
            vector_error=None if accel.vector_error is None else accel.vector_error[i],
        )
        for i in range(len(stills))
    )


def _moves(session: Session, outcome: Outcome) -> tuple[MoveRow, ...]:
    gyro = outcome.gyro
    if gyro is None:
        return ()
    rows = []
    for i in range(len(gyro.first)):
        vector = None if gyro.vector_error is None else gyro.vector_error[i]
        rows.append(
            MoveRow(
                start=session.names[gyro.first[i]],
                stop=session.names[gyro.last[i]],
                angle_rad=float(gyro.angle[i]),
                before_rad=float(gyro.before[i]),
                after_rad=float(gyro.after[i]),
                held_out_rad=_known(gyro.held_out[i]),
                sigma_rad=_known(gyro.sigma[i]),
                vector_error=None if vector is None or np.isnan(vector).any() else vector,
            )
        )
    return tuple(rows)


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
