"""What numpy takes long for on long tables of three columns: one pass each, no copies."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.kernels.blocks3 import applied
from imu_rig.kernels.compiled import compiled
from imu_rig.kernels.strapdown import matrix


@compiled
def extent(values: FloatArray) -> FloatArray:
    """Return least, greatest, mean and variance of three columns.

    Parameters
    ----------
    values : shape (n, 3), n at least 1
        A NaN anywhere in a column makes its mean and variance NaN.

    Returns
    -------
    shape (4, 3)
    """
    told = np.empty((4, 3))
    x0, y0, z0 = values[0, 0], values[0, 1], values[0, 2]
    lx, ly, lz, hx, hy, hz = x0, y0, z0, x0, y0, z0
    sx, sy, sz, qx, qy, qz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    n = len(values)
    for k in range(n):
        x, y, z = values[k, 0], values[k, 1], values[k, 2]
        lx, ly, lz = min(lx, x), min(ly, y), min(lz, z)
        hx, hy, hz = max(hx, x), max(hy, y), max(hz, z)
        x, y, z = x - x0, y - y0, z - z0  # about the first: no cancellation of large means
        sx, sy, sz = sx + x, sy + y, sz + z
        qx, qy, qz = qx + x * x, qy + y * y, qz + z * z
    told[0, 0], told[0, 1], told[0, 2] = lx, ly, lz
    told[1, 0], told[1, 1], told[1, 2] = hx, hy, hz
    sx, sy, sz = sx / n, sy / n, sz / n
    told[2, 0], told[2, 1], told[2, 2] = x0 + sx, y0 + sy, z0 + sz
    told[3, 0], told[3, 1], told[3, 2] = qx / n - sx * sx, qy / n - sy * sy, qz / n - sz * sz
    return told


@compiled
def repeated(one: FloatArray, other: FloatArray) -> BoolArray:
    """Return which rows of two tables (n, 3) are both the same as the row before, shape (n,)."""
    same = np.zeros(len(one), dtype=np.bool_)
    for k in range(1, len(one)):
        same[k] = (
            one[k, 0] == one[k - 1, 0]
            and one[k, 1] == one[k - 1, 1]
            and one[k, 2] == one[k - 1, 2]
            and other[k, 0] == other[k - 1, 0]
            and other[k, 1] == other[k - 1, 1]
            and other[k, 2] == other[k - 1, 2]
        )
    return same


@compiled
def scatter(values: FloatArray) -> FloatArray:
    """Return how far three columns scatter from row to row, as a variance of each row.

    Fourth differences of what changes smoothly over five rows vanish; those of rows of which none
    tells of the next have 70 times the variance of a row.

    Parameters
    ----------
    values : shape (n, 3)

    Returns
    -------
    shape (n,)
        Mean over the columns; 0 for the two rows at either end.
    """
    out = np.zeros(len(values))
    for k in range(2, len(values) - 2):
        total = 0.0
        for i in range(3):
            beside = values[k - 1, i] + values[k + 1, i]
            off = values[k - 2, i] + values[k + 2, i] - 4.0 * beside + 6.0 * values[k, i]
            total += off * off
        out[k] = total / 210.0
    return out


@compiled
def rotated(quaternion: FloatArray, values: FloatArray) -> FloatArray:
    """Rotate vectors (n, 3) by unit quaternions (n, 4), sensor to navigation axes."""
    out = np.empty((len(values), 3))
    for k in range(len(values)):
        w, x, y, z = quaternion[k, 0], quaternion[k, 1], quaternion[k, 2], quaternion[k, 3]
        a, b, c = applied(matrix((w, x, y, z)), (values[k, 0], values[k, 1], values[k, 2]))
        out[k, 0], out[k, 1], out[k, 2] = a, b, c
    return out
