"""The straight line that a nonlinear accelerometer looks like to gravity."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from imu_rig.arrays import FloatArray
from simulators.inertial_sensor import bent
from simulators.models import Vector3
from simulators.rig import AffineTruth

DIRECTIONS = 2000
ITERATIONS = 6


def line_over_gravity(
    at_zero: AffineTruth, quadratic: Vector3, cubic: Vector3, gravity: float
) -> AffineTruth:
    """Return the calibration that gives gravity its magnitude best in all directions.

    A calibration from poses at rest can find no other one. It differs from the gain at zero input
    by the cubic terms, and from the offset there by the quadratic ones.

    Parameters
    ----------
    at_zero : AffineTruth
        The calibration for small inputs.
    quadratic, cubic : three numbers
        As in :class:`simulators.models.SensorModel`.
    gravity : float
        m/s^2.
    """
    if not (any(quadratic) or any(cubic)):
        return at_zero
    D, e = _fit(quadratic, cubic, gravity)
    return AffineTruth(D @ at_zero.K, D @ at_zero.b + e)


@lru_cache(maxsize=8)
def _fit(quadratic: Vector3, cubic: Vector3, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Fit a symmetric D and an e with ``|D f' - e| = gravity`` to bent forces f' on the sphere."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, k * math.pi * (1.0 + math.sqrt(5.0))
    ring = np.sqrt(1.0 - z**2)
    sphere = gravity * np.stack((ring * np.cos(turn), ring * np.sin(turn), z), axis=1)
    force = bent(sphere, quadratic, cubic)
    D, e = np.eye(3), np.zeros(3)
    rows, columns = np.triu_indices(3)
    for _ in range(ITERATIONS):
        straight = force @ D - e
        size = np.linalg.norm(straight, axis=1)
        unit = straight / size[:, np.newaxis]
        J = unit[:, rows] * force[:, columns]
        J += np.where(rows != columns, unit[:, columns] * force[:, rows], 0.0)
        step = np.linalg.lstsq(np.hstack((J, -unit)), gravity - size, rcond=None)[0]
        change = np.zeros((3, 3))
        change[rows, columns] = change[columns, rows] = step[:6]
        D, e = D + change, e + step[6:]
    return D, e
