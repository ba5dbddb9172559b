"""What a calibration is good for: how wrong a calibrated reading, or a turn, may be."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from imu_rig.arrays import FloatArray
from imu_rig.calibration.accuracy import (
    TURN_ANGLE,
    TURN_DURATION_S,
    rest_sigma,
    sphere,
)
from imu_rig.calibration.model import Affine, sensor_frame
from imu_rig.calibration.reach import Reach, reading_reach, turn_reach
from imu_rig.calibration.result import CalibrationResult
from imu_rig.report.facts import Truth
from imu_rig.report.numbers import significant
from imu_rig.report.page import Html, card
from imu_rig.report.sphere import hemisphere_map
from imu_rig.units import DEG, MILLI_G


def accuracy_cards(result: CalibrationResult) -> list[Html]:
    """Return cards for a reading at rest and a turn of 90 deg."""
    rows = (
        ("Error of a calibrated reading", reading_reach(result), MILLI_G, "mg", "attitudes"),
        ("Error of a 90° turn", turn_reach(result), DEG, "deg", "axes of the turn"),
    )
    return [
        card(
            label,
            f"± {significant(reach.rms / unit, 2)}",
            name,
            f"95 %, root mean square over all {over}; in the worst one "
            f"± {significant(reach.maximum / unit, 2)} {name}",
        )
        for label, reach, unit, name, over in rows
        if reach is not None
    ]


def uncertainty_map(result: CalibrationResult) -> Figure:
    """Draw the standard uncertainty of a calibrated reading over the sphere, with the poses."""
    g = result.gravity.value

    def sigma(directions: FloatArray) -> FloatArray:
        return rest_sigma(result.accel, directions, g) / MILLI_G

    up = np.array([pose.direction for pose in result.poses]).reshape(-1, 3)
    up = up[np.all(np.isfinite(up), axis=1)] @ sensor_frame(result.accel.K)[0]
    return hemisphere_map(sigma, up, "standard uncertainty of a reading at rest [mg]")


def true_errors(result: CalibrationResult, truth: Truth) -> tuple[Reach | None, Reach | None]:
    """Return what readings at rest [m/s^2] and turns of 90 deg [rad] really err by.

    Each error is counted in the sensor frame of its own accelerometer, as its uncertainty is.
    """
    directions = sphere()
    to_found, to_true = sensor_frame(result.accel.K)[0].T, sensor_frame(truth.accel.K)[0].T
    reading = turn = None
    if result.has_accel:
        found, true = result.accel.rotated(to_found), truth.accel.rotated(to_true)
        reading = _off(found, true, result.gravity.value * directions)
    if result.gyro is not None and truth.gyro is not None:
        found, true = result.gyro.rotated(to_found), truth.gyro.rotated(to_true)
        rate = _off(found, true, TURN_ANGLE / TURN_DURATION_S * directions)
        turn = Reach(TURN_DURATION_S * rate.rms, TURN_DURATION_S * rate.maximum)
    return reading, turn


def _off(found: Affine, true: Affine, inputs: FloatArray) -> Reach:
    size = np.linalg.norm(found.apply(true.undo(inputs)) - inputs, axis=1)
    return Reach(float(np.sqrt(np.mean(size**2))), float(np.max(size)))
