"""What is done to every sample of a track or its readings: one pass, no tables in between."""

from __future__ import annotations

import math

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.kernels.compiled import compiled
from imu_rig.kernels.strapdown import product


@compiled
def turn_about_z(
    quaternion: FloatArray, velocity: FloatArray, position: FloatArray, yaw: float
) -> None:
    """Turn a motion, shapes (n, 4), (n, 3) and (n, 3), by ``yaw`` [rad] about z, in place."""
    half = (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw))
    c, s = math.cos(yaw), math.sin(yaw)
    for k in range(len(quaternion)):
        q = (quaternion[k, 0], quaternion[k, 1], quaternion[k, 2], quaternion[k, 3])
        quaternion[k, 0], quaternion[k, 1], quaternion[k, 2], quaternion[k, 3] = product(half, q)
        x, y = velocity[k, 0], velocity[k, 1]
        velocity[k, 0], velocity[k, 1] = c * x - s * y, s * x + c * y
        x, y = position[k, 0], position[k, 1]
        position[k, 0], position[k, 1] = c * x - s * y, s * x + c * y


@compiled
def rises(quaternion: FloatArray, rows: IntArray, axis: FloatArray) -> FloatArray:
    """Return how far a sensor axis points down and up at most from each row to the next.

    Parameters
    ----------
    quaternion : shape (n, 4)
    rows : shape (k,) of int
        Ascending.
    axis : shape (3,)
        Unit vector.

    Returns
    -------
    shape (k - 1, 2)
        Least and greatest vertical component; the next row itself does not count.
    """
    told = np.empty((max(len(rows) - 1, 0), 2))
    for i in range(len(told)):
        least, greatest = np.inf, -np.inf
        for k in range(rows[i], rows[i + 1]):
            w, x, y, z = quaternion[k, 0], quaternion[k, 1], quaternion[k, 2], quaternion[k, 3]
            along = (x * z - w * y) * axis[0] + (y * z + w * x) * axis[1]
            along = 2.0 * (along - (x * x + y * y) * axis[2]) + axis[2]
            least, greatest = min(least, along), max(greatest, along)
        told[i, 0], told[i, 1] = least, greatest
    return told


@compiled
def less_interpolated(
    values: FloatArray, t: FloatArray, knots: FloatArray, at_knots: FloatArray
) -> FloatArray:
    """Return three columns less what changes evenly from knot to knot.

    Parameters
    ----------
    values : shape (n, 3)
    t : shape (n,)
        Times [s], never decreasing.
    knots : shape (k,)
        At least one, ascending [s]; before the first and after the last nothing changes.
    at_knots : shape (k, 3)
    """
    out = np.empty((len(values), 3))
    after = 0
    for k in range(len(values)):
        while after < len(knots) and knots[after] <= t[k]:
            after += 1
        last, following = max(after - 1, 0), min(after, len(knots) - 1)
        share = 0.0
        if following > last:
            share = (t[k] - knots[last]) / (knots[following] - knots[last])
        for i in range(3):
            change = at_knots[following, i] - at_knots[last, i]
            out[k, i] = values[k, i] - (at_knots[last, i] + share * change)
    return out
