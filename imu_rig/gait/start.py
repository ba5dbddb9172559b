"""The attitude with which a recording begins, also where its foot already moves."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.kernels.rolling import moving_mean
from imu_rig.rotation import compose, conjugate, from_rotation_vector, multiply, normalize

LOOK_S = 4.0
"""So far into the recording a stance is looked for [s]: two strides of slow gait."""

SETTLE_S = 0.1
"""The tilt is the mean direction over this long [s]."""


def first_attitude(
    t: FloatArray, accel: FloatArray, gyro: FloatArray, statistic: FloatArray
) -> tuple[FloatArray, int]:
    """Return the attitude at the first sample, and the sample whose tilt it was taken from.

    Tilt is read from the accelerometer in the quietest moment of the first seconds and taken back
    to the first sample by the gyroscope. Yaw is 0 at that moment, for which of the sensor's axes
    points where is not known.

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    accel, gyro : shape (n, 3)
        [m/s^2], and [rad/s] without bias.
    statistic : shape (n,)
        How much the foot moves; the least is taken.

    Returns
    -------
    quaternion : shape (4,)
    quietest : int
    """
    rows = int(np.searchsorted(t, t[0] + LOOK_S, side="right"))
    quietest = int(np.argmin(statistic[:rows]))
    near = moving_mean(t[:rows], np.ascontiguousarray(accel[:rows]), 0.5 * SETTLE_S)
    level = level_attitude(near[quietest])
    if quietest == 0:
        return level, 0
    dt = np.diff(t[: quietest + 1])[:, np.newaxis]
    steps = from_rotation_vector(0.5 * (gyro[:quietest] + gyro[1 : quietest + 1]) * dt)
    return normalize(multiply(level, conjugate(compose(steps)))), quietest


def level_attitude(up: FloatArray) -> FloatArray:
    """Return the smallest rotation that brings ``up`` (3,), sensor axes, to the vertical; (4,)."""
    x, y, z = up / np.linalg.norm(up)
    if z < -1.0 + 1e-9:  # upside down: about x, as good as any
        return np.array([0.0, 1.0, 0.0, 0.0])
    return normalize(np.array([1.0 + z, y, -x, 0.0]))
