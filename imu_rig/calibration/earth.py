"""What the rotation of the Earth adds to a gyroscope's bias, and how uncertain that makes it."""

from __future__ import annotations

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import FloatArray
from imu_rig.calibration.moves import Moves, integrate

EARTH_RATE = 7.292115e-5
"""Rotation of the Earth [rad/s] (WGS-84), 0.0042 deg/s."""


def earth_covariance(moves: Moves, stills: int, K: FloatArray, bias: FloatArray) -> FloatArray:
    """Covariance (3, 3) of the mean bias in output axes [rad^2/s^2] from the Earth's rotation.

    At rest a gyroscope reads its bias and the Earth's rotation. Neither latitude nor heading is
    known here, so the rotation may point anywhere: covariance ``EARTH_RATE^2 / 3`` per axis in
    navigation axes. Turning the sensor over averages it out of the mean bias as far as the mean
    of the attitudes' matrices says; where a missing move breaks the chain of attitudes, nothing
    is taken to average out.

    Parameters
    ----------
    moves : Moves
        Moves between the stills.
    stills : int
        Number of stills.
    K : shape (3, 3)
        Gyroscope gain.
    bias : shape (m, 3)
        Raw bias at every still [rad/s].
    """
    mean = np.eye(3)
    if np.array_equal(moves.first, np.arange(stills - 1)):
        attitude = np.array([1.0, 0.0, 0.0, 0.0])
        total = np.eye(3)
        for turn in integrate(moves, K, bias):
            attitude = rotation.multiply(attitude, turn)
            total += rotation.to_matrix(attitude).T
        mean = total / stills
    covariance: FloatArray = EARTH_RATE**2 / 3.0 * mean @ mean.T
    return covariance
