"""How far errors reach with 95 % probability: of a reading at rest, and of a turn."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.calibration.accuracy import sphere_error, turn_error
from imu_rig.calibration.result import CalibrationResult


@dataclass(frozen=True)
class Reach:
    """Size of errors over all directions: root mean square and largest."""

    rms: float
    maximum: float


def reading_reach(result: CalibrationResult) -> Reach | None:
    """Return how far 95 % of the errors of a reading at rest reach [m/s^2].

    None without a calibrated accelerometer.
    """
    if not result.has_accel:
        return None
    error = sphere_error(result.accel, result.gravity.value)
    factor = result.accel.coverage_factor
    return Reach(factor * error.rms, factor * error.maximum)


def turn_reach(result: CalibrationResult) -> Reach | None:
    """Return how far 95 % of the errors of a turn of 90 deg reach [rad].

    None without a calibrated gyroscope.
    """
    if result.gyro is None:
        return None
    error = turn_error(result.gyro)
    factor = result.gyro.coverage_factor
    return Reach(factor * error.rms, factor * error.maximum)
