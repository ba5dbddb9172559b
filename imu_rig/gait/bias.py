"""The gyroscope's bias, from all that is known of it before the last pass of the smoother.

Zero-velocity updates alone misread errors of the swing as a bias, most of all about the vertical;
a still is only as good as the foot stood still; and a sensor may have been calibrated, or not. The
three are weighed once, outside of the filter, and the filter then runs with the result fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.gait.filter_inputs import WIDE_BIAS
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.stills import Stills, drift_between
from imu_rig.kernels.tracks import less_interpolated

TURN_FACTOR = 2.0
"""By which the filter's own uncertainty of the bias about the vertical is too small: errors of a
swing that repeat from stride to stride, of a gyroscope that is askew or late, look like a bias."""

TILT_FACTOR = 0.5
"""By which that about horizontal axes is too large: gravity shows these at every stance, while the
filter's noise is generous to swings."""

LEAST_TOLD = 1e-3
"""Strides that say less than this part of what the filter's prior does say that much, by rounding.
"""

RAW_SCALES = 9
LARGEST_SHARE = 40.0
"""A bias that was not taken off is of any size between a calibrated one and so many times the
usual one; the axes that gravity shows tell which."""


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
    up: FloatArray,
    stills: Stills,
    grade: SensorGrade,
) -> GyroBias:
    """Weigh what the strides, the stills and the grade of the sensor say of the bias.

    The prior is a mixture of normal distributions of different width, one width for the three axes,
    weighed by the marginal likelihood of the measurements: the two axes whose bias shows, because
    gravity does, tell how large that about the vertical may be.

    Parameters
    ----------
    removed : shape (3,)
        Taken off the readings before the filter [rad/s].
    walking : shape (3,)
        Estimated by a filter with zero-velocity updates and a wide prior, after that [rad/s].
    covariance : shape (3, 3)
        Of it [rad^2/s^2].
    up : shape (3,)
        The vertical in the axes of the standing sensor.
    stills : Stills
        Of the readings as they were.
    grade : SensorGrade
    """
    vertical = np.outer(up, up)
    factor = TILT_FACTOR * (np.eye(3) - vertical) + TURN_FACTOR * vertical
    information, alone = _without_prior(walking, covariance)
    information = np.linalg.solve(factor, np.linalg.solve(factor, information).T)
    pointed = information @ (removed + alone)
    of_stills = stills.information(drift_between(stills))
    information = information + of_stills.sum(axis=0)
    pointed = pointed + np.einsum("kij,kj->i", of_stills, stills.rate)
    measured = np.linalg.solve(information, pointed)
    spread = np.linalg.inv(information)

    logs, means, covariances = [], [], []
    for odds, sigma in _scales(grade):
        prior = sigma**2 * np.eye(3)
        total = prior + spread
        gain = prior @ np.linalg.inv(total)
        distance = measured @ np.linalg.solve(total, measured)
        logs.append(np.log(odds) - 0.5 * (np.linalg.slogdet(total)[1] + distance))
        means.append(gain @ measured)
        covariances.append(prior - gain @ prior)
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    value = weights @ np.array(means)
    mixed = np.zeros((3, 3))
    for weight, mean, part in zip(weights, means, covariances, strict=True):
        mixed += weight * (part + np.outer(mean - value, mean - value))
    return GyroBias(value, 0.5 * (mixed + mixed.T), float(weights[1:].sum()))


def without_bias(gyro: FloatArray, t: FloatArray, stills: Stills, value: FloatArray) -> FloatArray:
    """Return readings less the bias at each sample, which may wander, shape (n, 3) [rad/s].

    As a sensor warms up its bias changes. What a still reads beyond the mean ``value`` (3,) is
    believed as far as the wander between the stills exceeds its own uncertainty; between stills it
    is taken to change evenly, before the first and after the last not at all.

    Parameters
    ----------
    gyro : shape (n, 3)
        As read [rad/s].
    t : shape (n,)
        Times [s], never decreasing.
    stills : Stills
        In order of time.
    value : shape (3,)
        `GyroBias.value`.
    """
    if len(stills) < 2:
        return gyro - value
    variance = drift_between(stills) ** 2
    gain = variance * stills.information(float(np.sqrt(variance)))
    away = np.einsum("kij,kj->ki", gain, stills.rate - value)
    return less_interpolated(gyro, t, stills.t, value + away)


def _without_prior(estimate: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the information (3, 3) and the estimate (3,) of the strides alone.

    The filter's prior would pull large biases towards 0, and count beside that of the grade.
    """
    of_both = np.linalg.inv(covariance)
    sizes, axes = np.linalg.eigh(of_both - np.eye(3) / WIDE_BIAS**2)
    information = (axes * np.maximum(sizes, LEAST_TOLD / WIDE_BIAS**2)) @ axes.T
    return information, np.linalg.solve(information, of_both @ estimate)


def _scales(grade: SensorGrade) -> list[tuple[float, float]]:
    """Return how probable which size of the bias is [rad/s]."""
    scales = [(1.0 - grade.raw_odds, grade.gyro_bias)]
    if grade.raw_odds > 0.0:
        raw = np.geomspace(grade.gyro_bias, LARGEST_SHARE * grade.gyro_bias_raw, RAW_SCALES + 1)[1:]
        scales += [(grade.raw_odds / RAW_SCALES, float(sigma)) for sigma in raw]
    return [scale for scale in scales if scale[0] > 0.0]
