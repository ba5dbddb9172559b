"""How good a certificate says a sensor on a foot is."""

from __future__ import annotations

import math

import numpy as np

from imu_rig.calibration.certificate import Certificate
from imu_rig.calibration.noise_model import SensorNoise
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.options import FootOptions
from imu_rig.units import DEG

GYRO_MATRIX_LATER = 1e-3
"""By which a gyroscope's gains differ on another day and at another temperature [1]."""
ACCEL_MATRIX_LATER = 5e-4
"""By which an accelerometer's do [1]."""
GYRO_BIAS_LATER = 0.02 * DEG
"""By which a gyroscope's bias differs when it is switched on again [rad/s]."""
ACCEL_BIAS_LATER = 0.03
"""By which an accelerometer's differs on another day [m/s^2]: 3 mg."""
LATE_S = 0.001
"""By which filters of gyroscope and accelerometer differ in sensors whose settings are known [s];
certificates do not tell."""
ODDS_OF_ANOTHER_BIAS = 0.05
"""How often it is not that small: it was colder, or the sensor had just been switched on."""


def grade_of(certificate: Certificate | None) -> SensorGrade:
    """Return what a certificate, or its lack, says of a sensor's errors in a walk.

    What it says of a sensor holds on its day; what sensors of this class do later is added.
    """
    usual = SensorGrade()
    if certificate is None or certificate.gyro is None:
        return usual
    accel, gyro = certificate.accel.affine(), certificate.gyro.affine()
    noise, options = certificate.noise, FootOptions()
    return SensorGrade(
        gyro_bias=math.hypot(float(gyro.b_uncertainty.max()), GYRO_BIAS_LATER),
        gyro_bias_raw=usual.gyro_bias_raw,
        raw_odds=ODDS_OF_ANOTHER_BIAS,
        gyro_matrix=math.hypot(float(gyro.K_uncertainty.max()), GYRO_MATRIX_LATER),
        accel_matrix=math.hypot(float(accel.K_uncertainty.max()), ACCEL_MATRIX_LATER)
        if certificate.has_accel
        else usual.accel_matrix,
        accel_bias=math.hypot(float(accel.b_uncertainty.max()), ACCEL_BIAS_LATER)
        if certificate.has_accel
        else usual.accel_bias,
        late_s=LATE_S,
        gyro_noise=None if noise is None else _above(noise.gyro, options.gyro_noise),
        accel_noise=None if noise is None else _above(noise.accel, options.accel_noise),
    )


def _above(noise: SensorNoise | None, usual: float) -> float | None:
    """Return the white noise of the worst axis where it is above what is assumed anyway.

    A sensor is never less noisy on a foot than at rest, so less noise at rest changes nothing.
    """
    if noise is None:
        return None
    white = noise.values("white")
    worst = float(np.max(white[np.isfinite(white)], initial=0.0))
    return worst if worst > usual else None
