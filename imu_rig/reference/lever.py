"""Where on the foot an optical marker sits, fitted from how it moves against the sensor."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.reference.planar import fit_plane
from imu_rig.rotation import about_z, normalize, to_matrix

ROUNDS = 60
ENOUGH_M = 1e-7


def fit_lever_arm(path: FloatArray, R: FloatArray, places: FloatArray) -> FloatArray:
    """Return the lever arm (3,) [m] from sensor to marker, sensor axes.

    Least squares in ``places = Rz(yaw) (path + R lever) + shift``, by turns in yaw, which has a
    closed form, and in lever and shift, which are linear.

    Parameters
    ----------
    path : shape (n, 3)
        Of the sensor [m].
    R : shape (n, 3, 3)
        Sensor to the path's axes.
    places : shape (n, 3)
        Of the marker [m], in other axes about the vertical.
    """
    lever = np.zeros(3)
    A = (R - R.mean(axis=0)).reshape(-1, 3)
    for _ in range(ROUNDS):
        yaw, _ = fit_plane(path + R @ lever, places)
        left = places @ about_z(yaw) - path
        b = (left - left.mean(axis=0)).reshape(-1)
        before, lever = lever, np.linalg.lstsq(A, b, rcond=1e-9)[0]
        if np.max(np.abs(lever - before)) < ENOUGH_M:
            break
    return np.asarray(lever)


def attitude_at(t: FloatArray, quaternion: FloatArray, at: FloatArray) -> FloatArray:
    """Return the rotation matrices (m, 3, 3) at times ``at`` (m,) within ``t`` (n,).

    Between neighbours the components are interpolated and scaled to length one: samples of a foot
    differ by some degrees, over which that is exact to millionths.
    """
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    a, b = quaternion[after - 1], quaternion[after]
    b = np.where(np.sum(a * b, axis=1, keepdims=True) < 0.0, -b, b)
    step = t[after] - t[after - 1]
    share = np.where(step > 0.0, (at - t[after - 1]) / np.where(step > 0.0, step, 1.0), 1.0)
    return to_matrix(normalize(a + share[:, None] * (b - a)))
