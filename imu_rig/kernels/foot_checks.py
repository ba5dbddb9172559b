"""What checks of a track need of its samples: one pass each, no tables as long as the track."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.kernels.blocks3 import applied
from imu_rig.kernels.compiled import compiled
from imu_rig.kernels.rolling import SLACK_S
from imu_rig.kernels.strapdown import matrix


@compiled
def stride_changes(
    t: FloatArray,
    accel: FloatArray,
    bias: FloatArray,
    quaternion: FloatArray,
    velocity: FloatArray,
    rows: IntArray,
    gravity: float,
) -> FloatArray:
    """Return what accelerations say of the change of velocity from each row to the next.

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    accel : shape (n, 3)
        Readings [m/s^2].
    bias : shape (3,)
        To take off these.
    quaternion, velocity : shapes (n, 4) and (n, 3)
        As smoothed.
    rows : shape (k,) of int
        Ascending.
    gravity : float
        [m/s^2]

    Returns
    -------
    shape (k - 1, 4)
        Trapezoid of the accelerations, navigation axes [m/s], and the highest speed before the
        next row [m/s].
    """
    told = np.zeros((max(len(rows) - 1, 0), 4))
    for i in range(len(told)):
        x, y, z, fastest = 0.0, 0.0, 0.0, 0.0
        a0, b0, c0 = 0.0, 0.0, 0.0
        for k in range(rows[i], rows[i + 1] + 1):
            w = (quaternion[k, 0], quaternion[k, 1], quaternion[k, 2], quaternion[k, 3])
            f = (accel[k, 0] - bias[0], accel[k, 1] - bias[1], accel[k, 2] - bias[2])
            a, b, c = applied(matrix(w), f)
            if k > rows[i]:
                half = 0.5 * (t[k] - t[k - 1])
                x, y, z = x + half * (a0 + a), y + half * (b0 + b), z + half * (c0 + c)
            a0, b0, c0 = a, b, c
            if k < rows[i + 1]:
                u, v, s = velocity[k, 0], velocity[k, 1], velocity[k, 2]
                fastest = max(fastest, u * u + v * v + s * s)
        told[i, 0], told[i, 1] = x, y
        told[i, 2] = z - gravity * (t[rows[i + 1]] - t[rows[i]])
        told[i, 3] = np.sqrt(fastest)
    return told


@compiled
def means_around(t: FloatArray, values: FloatArray, rows: IntArray, half: float) -> FloatArray:
    """Return what `rolling.moving_mean` of three columns is at some rows, shape (k, 3).

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    values : shape (n, 3)
    rows : shape (k,) of int
    half : float
        Reach of the window to either side [s].
    """
    means = np.empty((len(rows), 3))
    reach = half + SLACK_S
    for i in range(len(rows)):
        row = rows[i]
        begin, end = row, row + 1
        while begin > 0 and t[begin - 1] >= t[row] - reach:
            begin -= 1
        while end < len(t) and t[end] <= t[row] + reach:
            end += 1
        x, y, z = 0.0, 0.0, 0.0
        for k in range(begin, end):
            x, y, z = x + values[k, 0], y + values[k, 1], z + values[k, 2]
        share = 1.0 / (end - begin)
        means[i, 0], means[i, 1], means[i, 2] = share * x, share * y, share * z
    return means


@compiled
def turned_between(t: FloatArray, gyro: FloatArray, begin: IntArray, end: IntArray) -> FloatArray:
    """Return the sums of rate times interval from samples to later ones, shape (k, 3) [rad].

    Parameters
    ----------
    t : shape (n,)
        Times [s].
    gyro : shape (n, 3)
        [rad/s]
    begin, end : shape (k,) of int
        Each sum has the intervals that end after the one, up to the other.
    """
    sums = np.zeros((len(begin), 3))
    for i in range(len(begin)):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(begin[i] + 1, end[i] + 1):
            dt = t[k] - t[k - 1]
            x, y, z = x + dt * gyro[k, 0], y + dt * gyro[k, 1], z + dt * gyro[k, 2]
        sums[i, 0], sums[i, 1], sums[i, 2] = x, y, z
    return sums
