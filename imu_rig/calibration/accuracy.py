"""What the uncertainty of a calibration means in use: for a reading, and for a turn.

The covariance of a model ``calibrated = K @ raw - b`` says how uncertain each parameter is. A
person asks instead how wrong a calibrated reading may be. Here the covariance is carried to the
error vector of a reading; its standard uncertainty is the root of the sum of the variances of
its three components. Noise of the reading itself is not in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.model import Affine, differences, sensor_frame
from imu_rig.units import DEG, STANDARD_GRAVITY

DIRECTIONS = 2000
"""Directions that stand for the sphere: neighbours are 4.5 deg apart."""
TURN_ANGLE = 90.0 * DEG
TURN_DURATION_S = 1.5


@dataclass(frozen=True, eq=False)
class DirectionalError:
    """Standard uncertainty as a function of direction, over the sphere.

    Attributes
    ----------
    rms, maximum : float
        Over all directions, in the unit of what is judged.
    worst : shape (3,)
        Unit vector at which the maximum lies.
    """

    rms: float
    maximum: float
    worst: FloatArray

    @staticmethod
    def over(directions: FloatArray, sigma: FloatArray) -> DirectionalError:
        """Summarize standard uncertainties (n,) at directions (n, 3)."""
        index = int(np.argmax(sigma))
        return DirectionalError(
            float(np.sqrt(np.mean(sigma**2))), float(sigma[index]), directions[index]
        )


def sphere_error(accel: Affine, gravity: float = STANDARD_GRAVITY) -> DirectionalError:
    """Uncertainty of a calibrated accelerometer at rest, in every attitude [m/s^2].

    It is counted in the sensor frame, in which K is upper triangular, so that the frame in which
    the calibration happens to be expressed has no part in it.

    Parameters
    ----------
    accel : Affine
        The accelerometer.
    gravity : float
        Size of the specific force [m/s^2].
    """
    directions = sphere()
    return DirectionalError.over(directions, rest_sigma(accel, directions, gravity))


def rest_sigma(
    accel: Affine, directions: FloatArray, gravity: float = STANDARD_GRAVITY
) -> FloatArray:
    """Return the standard uncertainty (n,) [m/s^2] of readings at rest with ``directions`` up.

    Parameters
    ----------
    accel : Affine
        The accelerometer.
    directions : shape (n, 3)
        Unit vectors in the sensor frame.
    gravity : float
        Size of the specific force [m/s^2].
    """
    return _reading_sigma(in_sensor_frame(accel), gravity * directions)


def turn_error(
    gyro: Affine, angle: float = TURN_ANGLE, duration_s: float = TURN_DURATION_S
) -> DirectionalError:
    """Uncertainty of a turn measured by a calibrated gyroscope, about every axis [rad].

    The turn is steady about one axis: the error of the rate, from gain and offset, times the
    duration. It is counted in the frame in which the gyroscope's K is expressed.

    Parameters
    ----------
    gyro : Affine
        The gyroscope.
    angle : float
        Angle of the turn [rad].
    duration_s : float
        How long it takes; an uncertain bias counts in proportion to it.
    """
    directions = sphere()
    sigma = duration_s * _reading_sigma(gyro, angle / duration_s * directions)
    return DirectionalError.over(directions, sigma)


def in_sensor_frame(accel: Affine) -> Affine:
    """Express an accelerometer in its sensor frame, with the covariance it has there.

    The frame is that of the estimated K, so turning into it takes away the uncertainty of how
    the sensor was mounted.
    """

    def turned(p: FloatArray) -> FloatArray:
        Q, T = sensor_frame(p[:9].reshape(3, 3))
        return np.concatenate((np.triu(T).ravel(), Q.T @ p[9:]))

    parameters = np.concatenate((accel.K.ravel(), accel.b))
    J = differences(turned, parameters)
    values = turned(parameters)
    return Affine(values[:9].reshape(3, 3), values[9:], J @ accel.covariance @ J.T, accel.dof)


def sphere(count: int = DIRECTIONS) -> FloatArray:
    """Return unit vectors (count, 3) that cover the sphere evenly: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    radius, turn = np.sqrt(1.0 - z**2), np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.stack((radius * np.cos(turn), radius * np.sin(turn), z), axis=1)


def _reading_sigma(affine: Affine, inputs: FloatArray) -> FloatArray:
    """Root of the summed variances of a calibrated reading's components, at inputs (n, 3)."""
    raw = affine.undo(inputs)
    # Component i is row i of K times the raw reading minus b_i, so that its variance is a
    # quadratic form in (raw, -1); the three forms are summed before they are evaluated.
    rows = [np.array([3 * i, 3 * i + 1, 3 * i + 2, 9 + i]) for i in range(3)]
    form = np.sum([affine.covariance[np.ix_(row, row)] for row in rows], axis=0)
    h = np.concatenate((raw, -np.ones((len(raw), 1))), axis=1)
    sigma: FloatArray = np.sqrt(np.clip(np.einsum("ni,ij,nj->n", h, form, h), 0.0, None))
    return sigma
