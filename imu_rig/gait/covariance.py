"""How sure a smoothed foot trajectory is: a covariance that may be published.

A smoother's own covariance knows noise that forgets itself from sample to sample. What spoils a
foot's trajectory most lasts: what is left of the gyroscope's bias, gains and axes that are a little
wrong. So what is published is ``vf P + sum_j J_j J_j'``: the smoother's covariance ``P``, scaled by
how large its innovations really were, and the change ``J_j`` of the smoothed trajectory that each
constant error of one standard uncertainty makes (S. F. Schmidt's consider covariance, carried
through the smoother).
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.gait.bias import GyroBias
from imu_rig.gait.coarse import joined, joined_number, joined_rows, joined_sum, joined_variance
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.trajectory import Footfalls, Trajectory, TrajectoryCovariance
from imu_rig.kernels.foot_covariance import ERRORS, N, smoothed_covariance
from imu_rig.kernels.foot_types import FootInputs, FootModel, FootStates
from imu_rig.rotation import normalize, to_matrix

LEAST_FACTOR = 0.001
"""Of the variances of noise: a thirtieth of the noise that the smoother allows for. It allows for
feet that slip and sensors that lag; where innovations show neither, that much may still be."""

LEAST_VELOCITY = 0.0005, 0.005
"""A foot that stands moves inside of its shoe, and a shoe is not rigid: about as fast as the sensor
still turns times its height, between these bounds [m/s]. The upper one is what the zero-velocity
updates trust at best."""

LEAST_PLACE = 0.005
"""So far does a foot come to rest from where it seemed to: floors are not level, soles not flat,
and what rolls is no rigid body [m]."""

ROW_S = 0.3
"""Longest time between two rows [s]: four rows in a stride of walking, two in that of a sprint."""

BIAS, GYRO, ACCEL, ACCEL_BIAS, LATE = (slice(0, 3), slice(3, 12), slice(12, 21), slice(21, 24), 24)
"""Constant errors, in the order of `TrajectoryCovariance.common`; matrices row by row."""


def track_covariance(
    trajectory: Trajectory,
    states: FootStates,
    inputs: FootInputs,
    model: FootModel,
    footfalls: Footfalls,
    bias: GyroBias,
    grade: SensorGrade,
) -> TrajectoryCovariance:
    """Return the covariance of a trajectory that a smoother made with the gyro bias held fixed.

    Parameters
    ----------
    trajectory : Trajectory
        What is published, in its axes.
    states, inputs, model : FootStates, FootInputs, FootModel
        Of the pass that made it; the gyroscope without bias.
    footfalls : Footfalls
    bias : GyroBias
        What was taken off the gyroscope.
    grade : SensorGrade
        How wrong gains, axes, accelerometer biases and clocks of such a sensor are, after what it
        showed: see `imu_rig.gait.belief`.
    """
    rows = covariance_rows(trajectory.t, footfalls)
    number = joined_number(trajectory.t)
    seen, place = np.unique(joined_rows(rows, trajectory.t, number), return_inverse=True)
    force = joined(inputs.accel - states.accel_bias, number)
    rate = joined(inputs.gyro - states.gyro_bias, number)
    quaternion = normalize(joined(trajectory.quaternion, number))
    times = joined(trajectory.t, number)
    factor = variance_factor(states.nis, footfalls)
    m = len(seen)
    random, constant = np.empty((m, 9, 9)), np.empty((m, 9, ERRORS))
    between = np.zeros((m, 3, 3))
    falls = np.zeros(m, dtype=np.bool_)
    at_falls = place[np.searchsorted(rows, footfalls.quietest)]
    falls[at_falls] = True
    level_row = int(seen[at_falls[0]]) if len(footfalls) else 0
    errors = np.concatenate(
        (
            _root(bias.covariance).ravel(),
            [grade.gyro_matrix, grade.accel_matrix, grade.accel_bias, grade.late_s],
        )
    )
    begin = _begin(inputs, model, grade, quaternion[level_row], force[level_row])
    # What was not seen, and how a recording begins, is as uncertain as the smoother takes it.
    begin[:, :N] /= factor
    process = (model.gyro_noise, model.gyro_motion, model.accel_noise, model.accel_motion)
    smoothed_covariance(
        np.column_stack((np.diff(times, prepend=times[0]), rate, force)),
        quaternion,
        joined_variance(_measured(inputs, model, states), number),
        joined_sum(_unseen(inputs), number) / factor,
        np.array([*process, model.accel_bias_walk, model.gravity, *states.pivot]),
        errors,
        begin,
        seen,
        falls,
        random,
        constant,
        between,
    )
    values = (factor * random + constant @ constant.transpose(0, 2, 1))[place]
    least = np.zeros(9)
    least[3:6] = _creep(inputs.gyro - states.gyro_bias, footfalls, states.pivot) ** 2
    least[6:9] = LEAST_PLACE**2
    values += np.diag(least)
    places = constant[at_falls, 6:9].transpose(0, 2, 1)
    common = places[1:] - places[:-1]
    strides = factor * between[at_falls[:-1]] + common.transpose(0, 2, 1) @ common
    strides += 2.0 * LEAST_PLACE**2 * np.eye(3)
    return TrajectoryCovariance(rows, _even(values), _even(strides), common)


def covariance_rows(t: FloatArray, footfalls: Footfalls) -> IntArray:
    """Return the samples at which a covariance is told.

    The first and the last, the quietest of each footfall, and so many between that they are hardly
    further apart than `ROW_S`, one at least.
    """
    known = np.unique(np.concatenate(([0], footfalls.quietest, [len(t) - 1]))).astype(np.int64)
    number = np.maximum(2, np.ceil(np.diff(t[known]) / ROW_S)).astype(np.int64)
    number = np.minimum(number, np.diff(known))
    extra = [
        first + (last - first) * np.arange(1, parts) // parts
        for first, last, parts in zip(known[:-1], known[1:], number, strict=True)
        if parts > 1
    ]
    return np.unique(np.concatenate((known, *extra))).astype(np.int64)


def variance_factor(nis: FloatArray, footfalls: Footfalls) -> float:
    """Return by how much the noise was smaller or larger than modelled.

    By the innovations at the quietest sample of each footfall: elsewhere in a stance the foot
    still moves, and says more of feet than of the trajectory.

    Parameters
    ----------
    nis : shape (n,)
        Normalized innovation squared per degree of freedom.
    footfalls : Footfalls
    """
    seen = nis[footfalls.quietest]
    seen = seen[np.isfinite(seen)]
    return max(LEAST_FACTOR, float(np.mean(seen))) if len(seen) else 1.0


def _creep(rate: FloatArray, footfalls: Footfalls, pivot: FloatArray) -> float:
    """Return how fast a standing foot moves, as it turns, where it does so least [m/s]."""
    if len(footfalls) == 0:
        return LEAST_VELOCITY[1]
    turning = float(np.median(np.linalg.norm(rate[footfalls.quietest], axis=1)))
    return float(np.clip(turning * np.linalg.norm(pivot), *LEAST_VELOCITY))


def _measured(inputs: FootInputs, model: FootModel, states: FootStates) -> FloatArray:
    """Return the variances with which velocity and height were measured, 0 for none, (n, 2)."""
    inflation = np.clip(np.nan_to_num(states.nis) / model.gate**2, 1.0, model.gate_cap)
    velocity = inflation * _variance(inputs.velocity_sigma)
    return np.column_stack((velocity, _variance(inputs.floor_sigma)))


def _unseen(inputs: FootInputs) -> FloatArray:
    """Return what steps add to the variances of floor, attitude and velocity, (n, 3)."""
    n = len(inputs.dt)
    unseen = np.zeros((n, 3))
    for column, sigma in enumerate((inputs.floor_step, inputs.unseen_turn, inputs.unseen_velocity)):
        if sigma is not None:
            unseen[:, column] = _variance(sigma)
    unseen[0] = 0.0  # is in the priors
    return unseen


def _variance(sigma: FloatArray) -> FloatArray:
    """Return the square of what is neither infinite nor NaN, else 0."""
    variance: FloatArray = np.square(np.where(np.isfinite(sigma), sigma, 0.0))
    return variance


def _begin(
    inputs: FootInputs,
    model: FootModel,
    grade: SensorGrade,
    level: FloatArray,
    force: FloatArray,
) -> FloatArray:
    """Return the covariance of the first errors and, beside it, what constant errors did to them.

    Position and yaw are right by definition. Tilt was read from a wrong force.
    """
    begin = np.zeros((N, N + ERRORS))
    begin[[0, 1], [0, 1]] = model.tilt_prior**2
    begin[[3, 4, 5], [3, 4, 5]] = model.velocity_prior**2
    begin[[9, 10, 11], [9, 10, 11]] = model.accel_bias_prior**2
    begin[12, 12] = inputs.floor_step[0] ** 2
    begin[[13, 14, 15], [13, 14, 15]] = model.pivot_sigma**2
    C = to_matrix(level)
    tilt = np.stack((-C[1], C[0])) / model.gravity
    scaled = tilt[:, :, np.newaxis] * force * grade.accel_matrix
    begin[:2, N:][:, ACCEL] = scaled.reshape(2, 9)
    begin[:2, N:][:, ACCEL_BIAS] = tilt * grade.accel_bias
    return begin


def _root(covariance: FloatArray) -> FloatArray:
    """Return a factor of a covariance (p, p) that may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    factor: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return factor


def _even(covariance: FloatArray) -> FloatArray:
    """Return covariances (..., p, p) without what rounding made uneven."""
    even: FloatArray = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    return even
