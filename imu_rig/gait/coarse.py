"""The same readings at a lower rate, for what does not need all of them."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.kernels.foot_types import FootInputs

COARSE_S = 0.01
"""Readings within this time [s] are one: biases and uncertainties are as well seen at 100 Hz."""


def joined_number(t: FloatArray, within_s: float = COARSE_S) -> int:
    """Return how many neighbouring samples at times ``t`` (n,) [s] are one; 1 for slow sensors."""
    taken = max(t[-1] - t[0], within_s)
    return max(1, min(int(within_s * (len(t) - 1) / taken + 1e-3), len(t) // 2))


def joined(values: FloatArray, number: int) -> FloatArray:
    """Return means of so many neighbours each, shape (n // number, ...); what is left over goes."""
    total = joined_sum(values, number)
    return total if number == 1 else total / number


def joined_sum(values: FloatArray, number: int) -> FloatArray:
    """Return sums of so many neighbours each, shape (n // number, ...)."""
    if number == 1:
        return values
    whole = len(values) // number * number
    total = values[0:whole:number] + values[1:whole:number]
    for k in range(2, number):
        total += values[k:whole:number]
    return total


def joined_rows(rows: IntArray, t: FloatArray, number: int) -> IntArray:
    """Return which of the joined samples each of the rows at times ``t`` belongs to."""
    return np.minimum(rows // number, len(t) // number - 1)


def joined_variance(variance: FloatArray, number: int) -> FloatArray:
    """Return the variances of what so many neighbours measure together; 0 means no measurement."""
    information = np.zeros_like(variance)
    np.divide(1.0, variance, out=information, where=variance > 0.0)
    total = joined_sum(information, number)
    return np.divide(1.0, total, out=np.zeros_like(total), where=total > 0.0)


def coarse_inputs(inputs: FootInputs, t: FloatArray, number: int) -> FootInputs:
    """Return inputs without a floor with so many neighbours joined.

    Each reading is the mean of theirs at the mean of their times; what they measure and what they
    leave unseen counts as much as before.

    Parameters
    ----------
    inputs : FootInputs
        Of ``n`` samples.
    t : shape (n,)
        Times [s], never decreasing.
    number : int
    """
    if number == 1:
        return inputs
    times = joined(t, number)
    nothing, step = np.full(len(times), np.inf), np.zeros(len(times))
    step[0] = inputs.floor_step[0]
    turn, velocity = (
        None if unseen is None else np.sqrt(joined_sum(np.square(unseen), number))
        for unseen in (inputs.unseen_turn, inputs.unseen_velocity)
    )
    information = joined_sum(1.0 / np.square(inputs.velocity_sigma), number)
    sigma = np.full(len(times), np.inf)
    np.divide(1.0, np.sqrt(information), out=sigma, where=information > 0.0)
    return inputs._replace(
        dt=np.diff(times, prepend=times[0]),
        gyro=joined(inputs.gyro, number),
        accel=joined(inputs.accel, number),
        velocity_sigma=sigma,
        rest_sigma=nothing,
        floor_sigma=nothing,
        floor_step=step,
        unseen_turn=turn,
        unseen_velocity=velocity,
    )
