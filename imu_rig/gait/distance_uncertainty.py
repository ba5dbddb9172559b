"""Uncertainty of a walked distance: strides of one foot err alike, so their errors add up.

A gyroscope whose gain is wrong, or a pivot that is not where it is assumed, makes every stride of
a walk longer or shorter by the same share. Adding the variances of strides as if they were
independent would promise too much by the square root of their number.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import AnyArray, BoolArray, FloatArray
from imu_rig.gait.trajectory import TrajectoryCovariance

ALONG = 0.9
"""Cosine between a stride and the way so far above which that way tells how its errors add up."""
FEWEST = 3
"""Strides that must tell it; with fewer, all errors are taken to be the same."""


def distance_sigma(
    covariance: TrajectoryCovariance, rows: AnyArray, position: FloatArray, counted: BoolArray
) -> float:
    """Return the standard uncertainty [m] of the sum of the lengths of some strides.

    Where the covariance tells which errors strides share, those add up and the others add in
    squares. Otherwise it tells the variance of every displacement and that of every place. With
    ``p`` the place before a stride and ``d`` its displacement,
    ``var(p + d) = var(p) + var(d) + 2 cov(p, d)`` gives how a stride's error goes with that of the
    way before it. Where both lie on one line, this is the correlation of lengths; its median over
    such strides is taken for all.

    Parameters
    ----------
    covariance : TrajectoryCovariance
    rows : shape (k,)
        Samples of the footfalls.
    position : shape (n, 3)
        Of the trajectory [m].
    counted : shape (k - 1,)
        Which strides count.
    """
    if len(rows) < 2:
        return 0.0
    places = position[rows]
    moved = np.diff(places, axis=0)[:, :2]
    length = np.linalg.norm(moved, axis=1)
    along = moved / np.maximum(length, 1e-9)[:, None]
    own = _along(along, covariance.strides[:, :2, :2])
    if covariance.common is not None:
        alike = np.einsum("ij,ipj->ip", along, covariance.common[:, :, :2])
        left = np.maximum(own - np.sum(alike**2, axis=1), 0.0)[counted]
        return float(np.sqrt(left.sum() + np.sum(alike[counted].sum(axis=0) ** 2)))
    shared = _correlation(covariance, rows, places[:, :2], along, own)
    total = 0.0
    for variance in own[counted]:
        total += variance + 2.0 * shared * np.sqrt(total * variance)
    return float(np.sqrt(total))


def _correlation(
    covariance: TrajectoryCovariance,
    rows: AnyArray,
    places: FloatArray,
    along: FloatArray,
    own: FloatArray,
) -> float:
    """Correlation of a stride's length with that of the way before it."""
    at = np.searchsorted(covariance.rows, rows)
    spread = covariance.values[at][:, 6:8, 6:8]
    before, after = _along(along, spread[:-1]), _along(along, spread[1:])
    way = places[:-1] - places[0]
    far = np.linalg.norm(way, axis=1)
    cosine = np.abs(np.sum(way * along, axis=1)) / np.maximum(far, 1e-9)
    tells = (cosine > ALONG) & (before > 0.0) & (own > 0.0)
    if np.count_nonzero(tells) < FEWEST:
        return 1.0
    both = 0.5 * (after - before - own)[tells] / np.sqrt(before[tells] * own[tells])
    sign = np.sign(np.sum(way * along, axis=1))[tells]
    return float(np.clip(np.median(both * sign), 0.0, 1.0))


def _along(direction: FloatArray, P: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(np.einsum("ij,ijk,ik->i", direction, P, direction), 0.0))
