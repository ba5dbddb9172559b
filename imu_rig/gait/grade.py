"""How good a sensor is: what is known of its errors before it walked."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.units import DEG


@dataclass(frozen=True)
class SensorGrade:
    """Standard uncertainties of a sensor's errors that last through a recording.

    The defaults are those of a MEMS sensor of which nothing is known.

    Attributes
    ----------
    gyro_bias : float
        Of each axis of a gyroscope whose bias was taken off [rad/s].
    gyro_bias_raw : float
        Of one whose bias was not [rad/s].
    raw_odds : float
        How probable it is that it was not. 0: the bias is known to `gyro_bias`, as after a
        calibration; the recording decides otherwise, one answer for the three axes.
    gyro_matrix, accel_matrix : float
        Of each element of gain and alignment [1].
    accel_bias : float
        [m/s^2]
    late_s : float
        By which the gyroscope comes late or early against the accelerometer [s]. Their filters, and
        the moments at which they are read, differ by a part of a sample period; of a walk, each
        millisecond takes two to three thousandths.
    gyro_noise, accel_noise : float or None
        Noise densities [rad/s/sqrt(Hz), m/s^2/sqrt(Hz)]; None: those of the options.
    """

    gyro_bias: float = 0.02 * DEG
    gyro_bias_raw: float = 0.5 * DEG
    raw_odds: float = 0.2
    gyro_matrix: float = 0.005
    accel_matrix: float = 0.003
    accel_bias: float = 0.03
    late_s: float = 0.003
    gyro_noise: float | None = None
    accel_noise: float | None = None
