"""A magnetometer beside a solved accelerometer, or alone: never in the way of the others."""

from __future__ import annotations

import numpy as np

from imu_rig.blocks import ImuBlock
from imu_rig.calibration.advice import SHEET_SIGMA
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.mag_result import MagResult
from imu_rig.calibration.magnetic import calibrate_from_samples, calibrate_from_stills, varies
from imu_rig.calibration.magnetometer import FEWEST
from imu_rig.calibration.magnitude import full_covariance
from imu_rig.calibration.model import Affine
from imu_rig.calibration.prepare import temperature_range
from imu_rig.calibration.result import CalibrationResult, DeviceInfo, ErrorStages
from imu_rig.calibration.session import Outcome, Session
from imu_rig.calibration.stills import sample_rate
from imu_rig.errors import DataError

MAGNETOMETER = "magnetometer"
"""Name of the method that calibrates nothing else."""


def magnetometer_beside(
    session: Session, outcome: Outcome, field_ut: float | None
) -> tuple[MagResult | None, tuple[str, ...]]:
    """Calibrate the magnetometer of a session whose accelerometer is solved.

    Returns
    -------
    result : MagResult or None
        None where there is no magnetometer, or the data do not determine it.
    warnings : tuple of str
        What to heed, or why it was not calibrated.
    """
    if not varies(session.block):
        if session.block.mag is None:
            return None, ()
        return None, (
            "The magnetometer was not calibrated: its readings never change, so it is switched off "
            "or dead.",
        )
    accel, on_jig = outcome.accel.affine, session.commanded is not None
    try:
        if on_jig or len(session.stills) >= FEWEST:
            result = calibrate_from_stills(
                session.block,
                session.stills,
                session.names,
                accel,
                field_ut=field_ut,
                attitudes=outcome.attitudes,
                on_jig=on_jig,
            )
        else:
            result = calibrate_from_samples(session.block, accel, field_ut=field_ut)
    except DataError as error:
        return None, (f"The magnetometer was not calibrated: {error}.",)
    return result, result.warnings


def magnetometer_alone(
    block: ImuBlock,
    gravity: Gravity,
    device: DeviceInfo,
    field_ut: float | None,
) -> CalibrationResult:
    """Calibrate a magnetometer from a recording in which the sensor may never have rested.

    The accelerometer only tells which way is up. It stays as it is, with the uncertainty that a
    data sheet leaves.

    Raises
    ------
    DataError
        No magnetometer, or data that cannot determine it.
    """
    if not (np.all(np.isfinite(block.accel)) and len(block)):
        raise DataError("the recording holds values that are not numbers")
    rate = sample_rate(block.t)
    try:
        mag = calibrate_from_samples(block, field_ut=field_ut)
    except DataError as error:
        raise DataError(f"the magnetometer cannot be calibrated: {error}") from error
    sheet = full_covariance(np.diag(SHEET_SIGMA**2))
    return CalibrationResult(
        method=MAGNETOMETER,
        device=device,
        gravity=gravity,
        frame="sensor",
        accel=Affine(np.eye(3), np.zeros(3), sheet),
        gyro=None,
        poses=(),
        moves=(),
        accel_errors=ErrorStages(),
        gyro_errors=ErrorStages(),
        rate_hz=rate,
        duration_s=float(block.t[-1] - block.t[0]),
        temperature_c=temperature_range(block),
        warnings=(
            "Only the magnetometer was calibrated: the accelerometer is left as it is, with the "
            "uncertainty of a data sheet.",
            *mag.warnings,
        ),
        mag=mag,
    )
