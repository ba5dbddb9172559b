"""The MPU-9150: what its counts mean, and where they end."""

from __future__ import annotations

import numpy as np

from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.inertial_sensor import (
    InertialSensor,
    Readings,
    SensorRange,
    SensorRanges,
    Vibration,
)
from simulators.models import SensorModel

__all__ = ["MPU9150_RANGES", "Mpu9150", "Readings", "Vibration"]

ACCEL_COUNT = STANDARD_GRAVITY / 4096.0
"""One count of the accelerometer at +-8 g [m/s^2]."""

GYRO_COUNT = DEG / 32.8
"""One count of the gyroscope at +-1000 deg/s [rad/s], by the published 32.8 per deg/s."""

MAG_COUNT = 0.3
"""One count of the AK8975 [uT], a number of 13 bits."""

MPU9150_RANGES = SensorRanges(
    accel=SensorRange.of_bits(ACCEL_COUNT, 16),
    gyro=SensorRange.of_bits(GYRO_COUNT, 16),
    mag=SensorRange(MAG_COUNT, -4096, 4095, axes=("+y", "+x", "-z")),
)
"""The AK8975's axes differ from those of accelerometer and gyroscope."""


class Mpu9150(InertialSensor):
    """One MPU-9150 with its noise and drift.

    Parameters
    ----------
    model : SensorModel
    rng : numpy Generator
    """

    def __init__(self, model: SensorModel, rng: np.random.Generator) -> None:
        super().__init__(model, MPU9150_RANGES, rng)
