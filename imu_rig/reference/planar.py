"""The best turn about the vertical and shift between two paths, in closed form."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.rotation import about_z


def fit_plane(path: FloatArray, places: FloatArray) -> tuple[float, FloatArray]:
    """Return yaw [rad] and shift (3,) [m] that bring ``path`` (n, 3) nearest to ``places`` (n, 3).

    Least squares: with both centred and seen as complex numbers of the plan, the best turn is the
    angle of ``sum conj(path) places``.
    """
    a, b = path.mean(axis=0), places.mean(axis=0)
    p, q = path[:, :2] - a[:2], places[:, :2] - b[:2]
    sine = np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    cosine = np.sum(p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1])
    yaw = float(np.arctan2(sine, cosine))
    return yaw, np.asarray(b - about_z(yaw) @ a)


def turned(path: FloatArray, yaw: float) -> FloatArray:
    """Return a path (n, 3) turned about z by ``yaw`` [rad]."""
    return np.asarray(path @ about_z(yaw).T)


def residual(path: FloatArray, places: FloatArray) -> FloatArray:
    """Return ``path - places``, shape (n, 3) [m], after the best turn and shift."""
    yaw, shift = fit_plane(path, places)
    return np.asarray(turned(path, yaw) + shift - places)


def root_mean_square(vectors: FloatArray) -> float:
    """Return the root of the mean squared length of vectors, shape (n, k)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
