"""A first ellipsoid through points: linear least squares that sets far points aside.

Good enough to start a weighted fit from, and the place where points that lie in a plane, on a
line or in one spot are recognized.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.errors import DataError

FLAT = 0.05
"""Least over largest extent of the points below which they lie in a plane."""
FAR = 6.0
"""Distance from the surface, in robust standard deviations, that sets a point aside."""
LEAST_SCATTER = 1e-4
"""Scatter about the surface, over its radius, below which nothing is set aside."""
LONGEST = 4.0
"""Longest over shortest half axis that a magnetometer's ellipsoid may have; beyond it the sphere
is the better start."""
ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipsoid ``|K (x - centre)| = radius`` with K symmetric and its mean gain 1.

    Attributes
    ----------
    K : shape (3, 3)
    centre : shape (3,)
    radius : float
        Median of ``|K (x - centre)|`` over the kept points.
    kept : shape (n,)
        Points that it rests on.
    """

    K: FloatArray
    centre: FloatArray
    radius: float
    kept: BoolArray


def ellipsoid_through(points: FloatArray) -> Ellipsoid:
    """Fit an ellipsoid to points (n, 3), n at least 9; a sphere where they allow no more.

    Raises
    ------
    DataError
        Points in one spot, on a line, or in a plane.
    """
    middle = np.median(points, axis=0)
    spread = np.linalg.norm(points - middle, axis=1)
    size = float(np.median(spread))
    if not size > 1e-9 * float(np.max(np.abs(points), initial=1e-300)):
        raise DataError("its readings never change: it is dead, or was not turned")
    # A glitch far outside would pull an algebraic fit by the fourth power of its distance.
    kept = spread < FAR * size
    for _ in range(ROUNDS):
        extent = np.linalg.svd(points[kept] - points[kept].mean(axis=0), compute_uv=False)
        if extent[2] < FLAT * extent[0]:
            raise DataError(
                "its readings lie in a plane: turn it about level axes too, until every side has "
                "been up"
            )
        K, centre = _fit((points[kept] - middle) / size)
        centre = middle + size * centre
        reach = np.linalg.norm((points - centre) @ K, axis=1)
        radius = float(np.median(reach[kept]))
        off = np.abs(reach - radius)
        scatter = max(1.4826 * float(np.median(off[kept])), LEAST_SCATTER * radius)
        now = off < FAR * scatter
        if np.array_equal(now, kept) or now.sum() < max(9, 0.5 * len(points)):
            break
        kept = now
    return Ellipsoid(K, centre, radius, kept)


def _fit(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the symmetric K of mean gain 1 and the centre, of points of size about 1."""
    a, b, c = x.T
    squares = np.stack((a * a, b * b, c * c, 2 * a * b, 2 * a * c, 2 * b * c), axis=1)
    D = np.concatenate((squares, -2 * x), axis=1)
    q, _, rank, _ = np.linalg.lstsq(D, np.ones(len(x)), rcond=1e-9)
    A = np.array(((q[0], q[3], q[4]), (q[3], q[1], q[5]), (q[4], q[5], q[2])))
    values, vectors = np.linalg.eigh(A)
    if rank == D.shape[1] and values[0] > 0 and values[2] < LONGEST**2 * values[0]:
        gains = np.sqrt(values)
        gains = gains / float(np.prod(gains)) ** (1 / 3)
        return (vectors * gains) @ vectors.T, np.linalg.solve(A, q[6:])
    linear = np.concatenate((2 * x, np.ones((len(x), 1))), axis=1)
    centre = np.linalg.lstsq(linear, np.sum(x**2, axis=1), rcond=None)[0][:3]
    return np.eye(3), np.asarray(centre)
