"""Motion of a foot from its readings: an error-state filter and smoother over a whole trial.

The state is attitude, velocity, height over the floor, the point about which a standing foot rolls
and the biases of accelerometer and gyroscope. Corrections are fed back at once, so that the filter
linearizes about its best estimate; the smoother linearizes where the filter did. A floor that may
have moved adds to the variance of the height over it; the height itself is the velocity's
integral.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.kernels.foot_backward import integrate, smooth_backward
from imu_rig.kernels.foot_forward import ROW, filter_forward
from imu_rig.kernels.foot_types import (
    ACCEL_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    HEIGHT,
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
    n = len(inputs.dt)
    first = first_state(inputs, model) if start is None else start
    dt, floor_step = np.array(inputs.dt, dtype=float), np.array(inputs.floor_step, dtype=float)
    if start is None:  # nothing comes before, and the floor's first step is in the prior
        dt[0] = floor_step[0] = 0.0
    P = np.array(first.covariance)
    if not estimate_gyro_bias:
        P[GYRO_BIAS, :] = P[:, GYRO_BIAS] = 0.0
    given = (
        dt,
        contiguous(inputs.gyro),
        contiguous(inputs.accel),
        contiguous(inputs.velocity_sigma),
        contiguous(inputs.rest_sigma),
        contiguous(inputs.floor_sigma),
        floor_step,
        contiguous(inputs.unseen_turn),
        contiguous(inputs.unseen_velocity),
        noise_of(model),
        estimate_gyro_bias,
    )
    counts = [np.count_nonzero((s > 0.0) & (s < np.inf)) for s in given[3:6]]
    gains = np.empty((3 * counts[0] + 3 * counts[1] * estimate_gyro_bias + counts[2], ROW))
    x = nominal(first)
    quaternion, velocity, height = np.empty((n, 4)), np.empty((n, 3)), np.empty(n)
    accel_bias, nis = np.empty((n, 3)), np.empty(n)
    gyro_bias = np.empty((n if estimate_gyro_bias else 0, 3))
    states = (quaternion, velocity, height, gyro_bias, accel_bias)
    filter_forward(*given, x, P, *states, nis, gains)
    last = velocity[-1].copy()
    if not forward_only:
        smooth_backward(*given, x, *states, gains)
    if not estimate_gyro_bias:
        gyro_bias = np.broadcast_to(first.gyro_bias, (n, 3))
    position = np.empty((n, 3))
    integrate(dt, first.velocity, first.position, velocity, position)
    P = np.triu(P) + np.triu(P, 1).T
    end = FootState(
        x[0:4], last, position[-1].copy(), float(x[7]), x[8:11], x[11:14], x[14:17], P,
        np.array(inputs.gyro[-1]), np.array(inputs.accel[-1]),
    )  # fmt: skip
    return FootStates(
        quaternion, velocity, position, gyro_bias, accel_bias, position[:, 2] - height, end.pivot,
        P[GYRO_BIAS, GYRO_BIAS].copy(), nis, end,
    )  # fmt: skip


def contiguous(values: FloatArray | None) -> FloatArray:
    """Return floats as kernels take them; none where there are none."""
    return np.empty(0) if values is None else np.ascontiguousarray(values, dtype=float)


def noise_of(model: FootModel) -> FloatArray:
    """Lay out a model's noise and gate as `filter_forward` takes them."""
    m = model
    densities = (
        m.gyro_noise, m.gyro_motion, m.accel_noise, m.accel_motion, m.gyro_bias_walk,
        m.accel_bias_walk,
    )  # fmt: skip
    return np.array([*np.square(densities), m.gravity, m.gate, m.gate_cap])


def nominal(state: FootState) -> FloatArray:
    """Lay out a state as `filter_forward` takes it."""
    s = state
    return np.concatenate(
        (s.quaternion, s.velocity, [s.height], s.pivot, s.accel_bias, s.gyro_bias, s.gyro, s.accel)
    )


def first_state(inputs: FootInputs, model: FootModel) -> FootState:
    """Return what is known before the first sample's measurements: the model's priors."""
    variances = np.zeros(STATES)
    variances[ATTITUDE] = model.tilt_prior**2, model.tilt_prior**2, 0.0
    variances[VELOCITY] = model.velocity_prior**2
    variances[HEIGHT] = inputs.floor_step[0] ** 2
    variances[PIVOT] = model.pivot_sigma**2
    variances[ACCEL_BIAS] = model.accel_bias_prior**2
    variances[GYRO_BIAS] = np.square(model.gyro_bias_prior)
    zero = np.zeros(3)
    q0 = np.asarray(inputs.q0, dtype=float)
    return FootState(
        q0 / np.linalg.norm(q0), np.array(inputs.v0, dtype=float), zero, 0.0,
        np.array(model.pivot_prior, dtype=float), zero, zero, np.diag(variances),
        np.array(inputs.gyro[0], dtype=float), np.array(inputs.accel[0], dtype=float),
    )  # fmt: skip
