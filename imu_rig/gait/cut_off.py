"""What readings that are cut off do to strides: the same to each, so that nothing averages out.

What is missing above the end of a range has the same sign in every strike and every swing. How much
it is can only be guessed from the slopes beside it; the guess is as wrong for all of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.gait.trajectory import Footfalls, Trajectory, TrajectoryCovariance
from imu_rig.gait.unseen import Clipping, Holes

GUESSED = 2.0
"""By how much a guess of what is missing may be too small: a peak that is cut off is higher than
the parabola through its flanks where these steepen towards it."""

APART_S = 3.0
"""Cut readings so far apart are of different stretches of a recording."""
NAMED = 3


def cut_strides(holes: Holes, falls: Footfalls) -> BoolArray:
    """Tell which strides, shape (k - 1,), hold readings at the end of their range."""
    rows = falls.quietest
    if len(rows) < 2:
        return np.zeros(0, dtype=bool)
    cut = (holes.gyro.cut | holes.accel.cut).any(axis=1)
    before = np.concatenate(([0], np.cumsum(cut)))
    return np.asarray(before[rows[1:]] > before[rows[:-1]])


def with_cut_off(
    covariance: TrajectoryCovariance, holes: Holes, trajectory: Trajectory, falls: Footfalls
) -> TrajectoryCovariance:
    """Return the covariance with what cut strides have of their own made common to them.

    Lengths err together, and heights do.
    """
    cut = cut_strides(holes, falls)
    common = covariance.common
    if common is None or not cut.any():
        return covariance
    rows = falls.quietest
    moved = np.diff(trajectory.position[rows], axis=0)
    moved[:, 2] = 0.0
    along = moved / np.maximum(np.linalg.norm(moved, axis=1), 1e-9)[:, np.newaxis]
    up = np.broadcast_to((0.0, 0.0, 1.0), along.shape)
    own = covariance.strides - common.transpose(0, 2, 1) @ common
    shared = np.stack([_spread(own, way) for way in (along, up)], axis=1)
    shared *= cut[:, np.newaxis, np.newaxis]
    grown = (GUESSED**2 - 1.0) * shared.transpose(0, 2, 1) @ shared
    shared *= GUESSED
    at_falls = np.concatenate((np.zeros((1, 2, 3)), np.cumsum(shared, axis=0)))
    # Where a row lies between two footfalls, as far as the time between them has gone.
    t = trajectory.t
    off = np.stack(
        [
            [np.interp(t[covariance.rows], t[rows], at_falls[:, j, i]) for i in range(3)]
            for j in range(2)
        ],
        axis=0,
    )
    values = covariance.values.copy()
    values[:, 6:9, 6:9] += np.einsum("jin,jkn->nik", off, off)
    return replace(
        covariance,
        values=values,
        strides=covariance.strides + grown,
        common=np.concatenate((common, shared), axis=1),
    )


def cut_spans(t: FloatArray, clipping: Clipping) -> str:
    """Return when readings were at the end of their range, for people.

    Parameters
    ----------
    t : shape (n,)
        Times [s].
    clipping : Clipping
        Some readings of which are cut off.
    """
    when = t[clipping.cut.any(axis=1)]
    apart = np.flatnonzero(np.diff(when) > APART_S)
    begins = when[np.concatenate(([0], apart + 1))]
    ends = when[np.concatenate((apart, [len(when) - 1]))]
    longest = np.sort(np.argsort(begins - ends, kind="stable")[:NAMED])
    told = [f"{begins[k]:.0f} to {ends[k]:.0f} s" for k in longest]
    more = " and at other times" if len(begins) > NAMED else ""
    return f"{', '.join(told)}{more}"


def _spread(covariance: FloatArray, way: FloatArray) -> FloatArray:
    """Return one standard deviation along a way (m, 3) of covariances (m, 3, 3), shape (m, 3)."""
    variance = np.maximum(np.einsum("ni,nij,nj->n", way, covariance, way), 0.0)
    return np.asarray(way * np.sqrt(variance)[:, np.newaxis])
