"""Sensors of good, middle and poor grade at a foot: other errors for the same exact motion.

A walk is simulated once; its means are exact, and every sensor that is drawn here reads them in its
own wrong way, in milliseconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.budget import Budget, draw_sensor
from simulators.inertial_sensor import InertialSensor, Readings, SensorRange, SensorRanges
from simulators.models import SensorModel
from simulators.sampling import Means

_LIMIT = math.sqrt(3.0)
"""Limits of a uniform distribution over its standard deviation."""

RANGES = SensorRanges(
    accel=SensorRange.of_bits(STANDARD_GRAVITY / 1024.0, 16),
    gyro=SensorRange.of_bits(DEG / 16.4, 16),
    mag=None,
)
"""+-32 g and +-2000 deg/s: a foot that sprints feels 26 g and 1300 deg/s."""


@dataclass(frozen=True)
class Grade:
    """How wrong a sensor is after whatever calibration it had, as standard deviations.

    Attributes
    ----------
    gyro_bias_dps : float
        deg/s.
    matrix : float
        Of each of the nine elements of the gyroscope's and the accelerometer's gain.
    accel_bias_mg : float
    gyro_noise_dps, accel_noise_ug : float
        White noise as data sheets state it, one-sided [deg/s, ug per root hertz].
    gyro_walk_dps, accel_walk_mg : float
        Random walk of the bias after 600 s.
    """

    gyro_bias_dps: float
    matrix: float
    accel_bias_mg: float
    gyro_noise_dps: float
    accel_noise_ug: float
    gyro_walk_dps: float
    accel_walk_mg: float

    def draw(self, rng: np.random.Generator) -> SensorModel:
        """Draw the gains and offsets of one sensor, warm, read in whole counts."""
        noise = SensorModel(
            accel_noise_ug=self.accel_noise_ug,
            gyro_noise_dps=self.gyro_noise_dps,
            accel_walk_mg=self.accel_walk_mg,
            gyro_walk_dps=self.gyro_walk_dps,
            warm_up_c=0.0,
        )
        matrix, accel = _LIMIT * self.matrix, _LIMIT * self.accel_bias_mg
        budget = Budget(
            scale=matrix,
            cross_axis=matrix,
            accel_bias_mg=(accel, accel, accel),
            gyro_bias_dps=_LIMIT * self.gyro_bias_dps,
        )
        return draw_sensor(rng, budget, noise)


GRADES = {
    "good": Grade(0.01, 0.001, 1.0, 0.004, 60.0, 0.002, 0.02),
    "middle": Grade(0.1, 0.003, 4.0, 0.008, 150.0, 0.02, 0.1),
    "poor": Grade(1.0, 0.01, 15.0, 0.02, 400.0, 0.1, 0.5),
}
"""A tactical or freshly calibrated unit, an industrial one, and a consumer chip as delivered."""


def read_as(grade: Grade | str, means: Means, seed: int) -> Readings:
    """Return what one sensor of a grade reads of exact means.

    Parameters
    ----------
    grade : Grade or str
        Or the name of one of `GRADES`.
    means : Means
        Of a foot, as of `simulators.walker.sensor.IdealSensor.means`.
    seed : int
        Of the sensor's errors and its noise.
    """
    if isinstance(grade, str):
        grade = GRADES[grade]
    errors, noise = (
        np.random.default_rng(child) for child in np.random.SeedSequence([seed, 11]).spawn(2)
    )
    return InertialSensor(grade.draw(errors), RANGES, noise).read(means, None)
