"""The gyroscope's bias, from all that is known of it before the last pass of the smoother.

Zero-velocity updates alone misread errors of the swing as a bias, most of all about the vertical;
a still is only as good as the foot stood still; and a sensor may have been calibrated, or not. The
three are weighed once, outside of the filter, and the filter then runs with the result fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.stills import Stills

WALKING_FACTOR = 2.0
"""By which the filter's own uncertainty of the bias is too small: errors that repeat from stride
to stride are no noise."""


@dataclass(frozen=True, eq=False)
class GyroBias:
    """A bias to subtract.

    Attributes
    ----------
    value : shape (3,)
        Sensor axes [rad/s].
    covariance : shape (3, 3)
        [rad^2/s^2]
    raw_probability : float
        That the sensor's bias had not been taken off before.
    """

    value: FloatArray
    covariance: FloatArray
    raw_probability: float


def fuse_gyro_bias(
    removed: FloatArray,
    walking: FloatArray,
    covariance: FloatArray,
    stills: Stills,
    grade: SensorGrade,
) -> GyroBias:
    """Weigh what the strides, the stills and the grade of the sensor say of the bias.

    The prior is a mixture of two normal distributions, with one switch for the three axes that the
    marginal likelihood of the measurements decides.

    Parameters
    ----------
    removed : shape (3,)
        Taken off the readings before the filter [rad/s].
    walking : shape (3,)
        Estimated by a filter with zero-velocity updates and a wide prior, after that [rad/s].
    covariance : shape (3, 3)
        Of it [rad^2/s^2].
    stills : Stills
        Of the readings as they were.
    grade : SensorGrade
    """
    information = np.linalg.inv(WALKING_FACTOR**2 * covariance)
    pointed = information @ (removed + walking)
    for rate, sigma in zip(stills.rate, stills.sigma, strict=True):
        information = information + np.eye(3) / sigma**2
        pointed = pointed + rate / sigma**2
    measured = np.linalg.solve(information, pointed)
    spread = np.linalg.inv(information)

    components = [(1.0 - grade.raw_odds, grade.gyro_bias), (grade.raw_odds, grade.gyro_bias_raw)]
    logs, means, covariances = [], [], []
    for odds, sigma in components:
        prior = sigma**2 * np.eye(3)
        total = prior + spread
        gain = prior @ np.linalg.inv(total)
        distance = measured @ np.linalg.solve(total, measured)
        logs.append(np.log(max(odds, 1e-300)) - 0.5 * (np.linalg.slogdet(total)[1] + distance))
        means.append(gain @ measured)
        covariances.append(prior - gain @ prior)
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    value = weights @ np.array(means)
    mixed = np.zeros((3, 3))
    for weight, mean, part in zip(weights, means, covariances, strict=True):
        mixed += weight * (part + np.outer(mean - value, mean - value))
    return GyroBias(value, 0.5 * (mixed + mixed.T), float(weights[1]))
