"""The footfalls among intervals of zero velocity: one for each stay of a foot on the ground."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.gait.trajectory import Footfalls
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.rotation import conjugate, multiply, to_rotation_vector
from imu_rig.units import DEG

NO_SWING_S = 0.1
"""A foot that leaves the ground is away for longer than this [s], even in a sprint (0.3 s)."""

LEAST_STRIDE_S = 0.35
"""Of the fastest sprinters (2.6 strides per second) [s]."""

LEAST_SHARE, LIGHT = 0.55, 0.1
"""Strides shorter than this part of the median one are steps of a turn on the spot, if they end in
a stance as good as others; one that has less than this part of its neighbour's weight is none."""

UNMOVED_M, UNTURNED = 0.05, 10.0 * DEG
"""Who lifts a foot puts it down farther off than this, half its width, or turned about the vertical
by more [m, rad]. A foot that rolls from its heel to its sole moves the sensor by less."""

LONGEST_STRIDE_S = 3.0
"""What takes longer than this is standing and does not count for the median [s]."""


def find_footfalls(zero_velocity: ZeroVelocity, t: FloatArray) -> Footfalls:
    """Return the stays of a foot on the ground.

    Intervals with too short a time in between for a swing are one. Of two that are closer than any
    stride the lighter one (by the information of its samples, ``sum(dt / sigma^2)``) is dropped,
    and of two that are closer than half a usual stride of this person if it is far lighter: the
    foot moved evenly there for a moment, but did not stand.

    Parameters
    ----------
    zero_velocity : ZeroVelocity
        Of any detector.
    t : shape (n,)
        Times [s], never decreasing.

    Returns
    -------
    Footfalls
    """
    first, last = runs(zero_velocity.still)
    if len(first) == 0:
        return Footfalls(first, last, first)
    apart = t[first[1:]] - t[last[:-1]] > NO_SWING_S
    first = first[np.concatenate(([True], apart))]
    last = last[np.concatenate((apart, [True]))]
    quietest = _quietest(first, last, zero_velocity)
    weight = _information(first, last, zero_velocity, t)
    kept = _strides_apart(t[quietest], weight)
    return Footfalls(first[kept], last[kept], quietest[kept])


def merge_unmoved(
    footfalls: Footfalls,
    places: FloatArray,
    attitudes: FloatArray,
    statistic: FloatArray,
) -> Footfalls:
    """Return footfalls with those made one between which the foot went nowhere.

    A stance can be torn by a shift of weight that looks like a step but in where it leads.

    Parameters
    ----------
    footfalls : Footfalls
    places : shape (k, 3)
        Of the sensor at their quietest samples [m], z up.
    attitudes : shape (k, 4)
        Quaternions there.
    statistic : shape (n,)
        How much the foot moves; the lesser decides which moment is the quietest.
    """
    if len(footfalls) < 2:
        return footfalls
    rows = footfalls.quietest
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1)
    turn = multiply(attitudes[1:], conjugate(attitudes[:-1]))
    turned = np.abs(to_rotation_vector(turn)[:, 2])
    stepped = (moved > UNMOVED_M) | (turned > UNTURNED)
    begins = np.flatnonzero(np.concatenate(([True], stepped)))
    ends = np.append(begins[1:], len(rows)) - 1
    least = np.minimum.reduceat(statistic[rows], begins)
    owner = np.repeat(np.arange(len(begins)), ends - begins + 1)
    found = np.flatnonzero(statistic[rows] <= least[owner])
    quietest = rows[found[np.flatnonzero(np.diff(owner[found], prepend=-1) > 0)]]
    return Footfalls(footfalls.first[begins], footfalls.last[ends], quietest)


def runs(mask: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the first and the last index of each run of True, shapes (k,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return edges[::2].astype(np.int64), edges[1::2].astype(np.int64) - 1


def _quietest(first: IntArray, last: IntArray, zero_velocity: ZeroVelocity) -> IntArray:
    statistic = np.where(zero_velocity.still, zero_velocity.statistic, np.inf)
    edges = np.column_stack((first, last + 1)).ravel()
    least = np.minimum.reduceat(np.append(statistic, np.inf), edges)[::2]
    owner = np.repeat(np.arange(len(first)), last - first + 1)
    rows = _rows(first, last)
    at_least = np.flatnonzero(statistic[rows] <= least[owner])
    _, where = np.unique(owner[at_least], return_index=True)
    return rows[at_least[where]]


def _information(
    first: IntArray, last: IntArray, zero_velocity: ZeroVelocity, t: FloatArray
) -> FloatArray:
    dt = np.diff(t, prepend=t[0])
    information = np.append(np.minimum(dt, NO_SWING_S) / np.square(zero_velocity.sigma), 0.0)
    edges = np.column_stack((first, last + 1)).ravel()
    return np.asarray(np.add.reduceat(information, edges)[::2])


def _rows(first: IntArray, last: IntArray) -> IntArray:
    """Return all indices from each first to its last."""
    length = last - first + 1
    begins = np.repeat(first - np.concatenate(([0], np.cumsum(length)[:-1])), length)
    return np.asarray(begins + np.arange(length.sum()))


def _strides_apart(t: FloatArray, weight: FloatArray) -> IntArray:
    """Return which of the footfalls at times ``t`` remain."""
    kept = np.arange(len(t))
    while len(kept) > 1:
        gaps = np.diff(t[kept])
        strides = gaps[gaps < LONGEST_STRIDE_S]
        usual = float(np.median(strides)) if len(strides) else 0.0
        mass = weight[kept]
        ratio = np.minimum(mass[1:], mass[:-1]) / np.maximum(mass[1:], mass[:-1])
        close = gaps < LEAST_STRIDE_S
        close |= (gaps < LEAST_SHARE * usual) & (ratio < LIGHT)
        if not close.any():
            break
        # One is dropped if it is the lightest of those that are too close to it.
        left = np.concatenate(([False], close))
        right = np.concatenate((close, [False]))
        lighter_than_left = ~left | (mass <= np.concatenate(([np.inf], mass[:-1])))
        lighter_than_right = ~right | (mass < np.concatenate((mass[1:], [np.inf])))
        dropped = (left | right) & lighter_than_left & lighter_than_right
        kept = kept[~dropped]
    return kept
