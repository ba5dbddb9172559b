"""Motion of a foot from its readings: an error-state filter and smoother over a whole trial.

The state is attitude, velocity, height, the biases of gyroscope and accelerometer, the floor's
height and the point about which a standing foot rolls. Corrections are fed back at once, so that
the filter linearizes about its best estimate; the smoother linearizes where the filter did.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.kernels.foot_dense import smooth_dense
from imu_rig.kernels.foot_types import (
    ACCEL_BIAS,
    ATTITUDE,
    FLOOR,
    GYRO_BIAS,
    PIVOT,
    STATES,
    VELOCITY,
    FootInputs,
    FootModel,
    FootState,
    FootStates,
)


def smooth_foot_states(
    inputs: FootInputs,
    model: FootModel,
    *,
    estimate_gyro_bias: bool,
    forward_only: bool = False,
    start: FootState | None = None,
) -> FootStates:
    """Estimate the motion of a foot sensor.

    Parameters
    ----------
    inputs : FootInputs
        At least one sample; all finite but the sigmas.
    model : FootModel
        Physics and noise; its priors serve only without ``start``.
    estimate_gyro_bias : bool
        False takes the gyro bias as exactly what it is at the start (zero without ``start``).
    forward_only : bool
        Return what the filter knew at each sample, not what the whole trial says.
    start : FootState or None
        Go on from here, ``inputs.dt[0]`` after it, instead of from ``q0``, ``v0`` and the priors.
        ``end`` of one stretch starts the next one, as if there had been one filter.

    Returns
    -------
    FootStates
    """
    first = first_state(inputs, model) if start is None else start
    P = np.array(first.covariance)
    bias_walk = model.gyro_bias_walk
    if not estimate_gyro_bias:
        P[GYRO_BIAS, :] = 0.0
        P[:, GYRO_BIAS] = 0.0
        bias_walk = 0.0
    n = len(inputs.dt)
    readings = np.column_stack((inputs.dt, inputs.gyro, inputs.accel))
    if start is None:
        readings[0, 0] = 0.0
    nothing = np.zeros(n)
    sigmas = np.column_stack(
        (
            inputs.velocity_sigma,
            inputs.rest_sigma,
            inputs.floor_sigma,
            inputs.floor_step,
            nothing if inputs.unseen_turn is None else inputs.unseen_turn,
            nothing if inputs.unseen_velocity is None else inputs.unseen_velocity,
        )
    )
    if start is None:
        sigmas[0, 3] = 0.0  # is in the prior
    noise = np.array(
        [
            model.gyro_noise,
            model.gyro_motion,
            model.accel_noise,
            model.accel_motion,
            bias_walk,
            model.accel_bias_walk,
            model.gravity,
            model.gate,
            model.gate_cap,
        ]
    )
    measured = np.isfinite(sigmas[:, :3]) & (sigmas[:, :3] > 0.0)
    gains = np.empty((int(measured.sum(axis=0) @ [3, 3, 1]), STATES + 2))
    x = np.zeros(26)
    x[0:4], x[4:7], x[7] = first.quaternion, first.velocity, first.position[2]
    x[8:11], x[11:14], x[14] = first.gyro_bias, first.accel_bias, first.floor
    x[15:18], x[20:23], x[23:26] = first.pivot, first.gyro, first.accel
    q, v, position = np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3))
    gyro_bias, accel_bias = np.empty((n, 3)), np.empty((n, 3))
    z, floor, nis = np.empty(n), np.empty(n), np.empty(n)
    smooth_dense(
        readings, sigmas, noise, x, P, q, v, z, gyro_bias, accel_bias, floor, nis, gains,
        not forward_only,
    )  # fmt: skip
    means = 0.5 * (v[1:, :2] + v[:-1, :2]) * readings[1:, :1]
    position[0, :2] = first.position[:2]
    if start is not None:
        position[0, :2] += 0.5 * (first.velocity[:2] + v[0, :2]) * readings[0, 0]
    position[1:, :2] = position[0, :2] + np.cumsum(means, axis=0)
    position[:, 2] = z
    end = FootState(
        x[0:4], x[4:7], np.array([*position[-1, :2], x[7]]), x[8:11], x[11:14], float(x[14]),
        x[15:18], P, np.array(inputs.gyro[-1]), np.array(inputs.accel[-1]),
    )  # fmt: skip
    return FootStates(
        q, v, position, gyro_bias, accel_bias, floor, end.pivot, P[GYRO_BIAS, GYRO_BIAS].copy(),
        nis, end,
    )  # fmt: skip


def first_state(inputs: FootInputs, model: FootModel) -> FootState:
    """Return what is known before the first sample's measurements: the model's priors."""
    P = np.zeros((STATES, STATES))
    diagonal: FloatArray = np.einsum("ii->i", P)
    diagonal[ATTITUDE] = model.tilt_prior**2, model.tilt_prior**2, 0.0
    diagonal[VELOCITY] = model.velocity_prior**2
    diagonal[GYRO_BIAS] = np.square(model.gyro_bias_prior)
    diagonal[ACCEL_BIAS] = model.accel_bias_prior**2
    diagonal[FLOOR] = inputs.floor_step[0] ** 2
    diagonal[PIVOT] = model.pivot_sigma**2
    zero = np.zeros(3)
    return FootState(
        np.array(inputs.q0, dtype=float), np.array(inputs.v0, dtype=float), zero, zero, zero, 0.0,
        np.array(model.pivot_prior, dtype=float), P, np.array(inputs.gyro[0], dtype=float),
        np.array(inputs.accel[0], dtype=float),
    )  # fmt: skip
