"""What the published method is expected to reach: as good as the angles that it takes for true."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.accuracy import sphere_error, turn_error
from imu_rig.calibration.expected import Design, ExpectedUncertainty
from imu_rig.calibration.model import PARAMETERS, Affine, physical_figures
from imu_rig.calibration.paper import Model, paper_accelerometer, paper_gyroscope
from imu_rig.errors import DataError
from imu_rig.units import DEG, STANDARD_GRAVITY

ANGLE_SIGMA = 1.0 * DEG
"""Error of a commanded angle on a hobby servo [rad]."""
SERVO_GAIN_SIGMA = 0.01
"""Error common to all turns of a servo, over the angle turned."""


def expected_of_paper(design: Design, model: Model) -> tuple[ExpectedUncertainty, str | None]:
    """Predict a session solved by equations (5) and (6), and say what its turns leave open.

    Raises
    ------
    DataError
        If the poses do not determine the accelerometer.
    """
    up = design.directions()
    force = STANDARD_GRAVITY * up
    paper_accelerometer(force, force, model)
    accel = _fitted(force, np.ones(len(force)), model, STANDARD_GRAVITY * ANGLE_SIGMA)
    figures = physical_figures(accel)
    reading = sphere_error(accel).rms
    turns, durations = design.turns()
    try:
        paper_gyroscope(turns, durations, turns, model)
    except DataError as error:
        return ExpectedUncertainty(figures, None, None, reading, None), str(error)
    gyro = _fitted(turns, durations, model, np.sqrt(2.0) * ANGLE_SIGMA)
    C = gyro.covariance.copy()
    C[[0, 4, 8], [0, 4, 8]] += SERVO_GAIN_SIGMA**2
    gyro = Affine(gyro.K, gyro.b, C)
    return (
        ExpectedUncertainty(
            figures, physical_figures(gyro, accel), None, reading, turn_error(gyro).rms
        ),
        None,
    )


def _fitted(u: FloatArray, duration: FloatArray, model: Model, sigma: float) -> Affine:
    """Linear fit of known vectors, each component of which errs by ``sigma``."""
    C = np.zeros((PARAMETERS, PARAMETERS))
    for axis in range(3):
        used = [axis] if model == "diagonal" else [0, 1, 2]
        A = np.column_stack((u[:, used], -duration))
        places = [3 * axis + j for j in used] + [9 + axis]
        C[np.ix_(places, places)] = sigma**2 * np.linalg.inv(A.T @ A)
    return Affine(np.eye(3), np.zeros(3), C)
