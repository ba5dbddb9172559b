"""The foot smoother as textbooks write it: full matrices, stored covariances, an inverse per step.

An extended Kalman filter with joint updates and a Rauch-Tung-Striebel sweep (Automatica 3, 1965)
in numpy, against which the compiled kernel is compared. It shares no code with it.
"""

from __future__ import annotations

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import FloatArray
from imu_rig.kernels.foot_types import FootInputs, FootModel, FootState
from imu_rig.rotation import skew


def strapdown(
    state: FootState, dt: float, gyro: FloatArray, accel: FloatArray, gravity: float
) -> FootState:
    """Carry a state over one step by its readings at both ends."""
    w0, w1 = state.gyro - state.gyro_bias, gyro - state.gyro_bias
    turn = 0.5 * dt * (w0 + w1) + dt**2 / 12.0 * np.cross(w0, w1)
    q = rotation.multiply(state.quaternion, rotation.from_rotation_vector(turn))
    f0 = rotation.rotate(state.quaternion, state.accel - state.accel_bias)
    f1 = rotation.rotate(q, accel - state.accel_bias)
    v = state.velocity + dt * (0.5 * (f0 + f1) - [0.0, 0.0, gravity])
    moved = 0.5 * dt * (v + state.velocity)
    return state._replace(
        quaternion=q,
        velocity=v,
        position=state.position + moved,
        height=state.height + moved[2],
        gyro=gyro,
        accel=accel,
    )


def corrected(state: FootState, dx: FloatArray) -> FootState:
    """Add an error (16,) to a state."""
    return state._replace(
        quaternion=rotation.multiply(rotation.from_rotation_vector(dx[0:3]), state.quaternion),
        velocity=state.velocity + dx[3:6],
        height=state.height + dx[6],
        pivot=state.pivot + dx[7:10],
        accel_bias=state.accel_bias + dx[10:13],
        gyro_bias=state.gyro_bias + dx[13:16],
    )


def difference(a: FootState, b: FootState) -> FloatArray:
    """Return the error (16,) that makes ``a`` out of ``b``."""
    turn = rotation.multiply(a.quaternion, rotation.conjugate(b.quaternion))
    return np.concatenate(
        (
            rotation.to_rotation_vector(turn),
            a.velocity - b.velocity,
            [a.height - b.height],
            a.pivot - b.pivot,
            a.accel_bias - b.accel_bias,
            a.gyro_bias - b.gyro_bias,
        )
    )


def transition(before: FootState, after: FootState, dt: float) -> FloatArray:
    """Return the derivative (16, 16) of a step, to the order to which the step itself is exact."""
    C0, C1 = rotation.to_matrix(before.quaternion), rotation.to_matrix(after.quaternion)
    C = 0.5 * (C0 + C1)
    a = 0.5 * (C0 @ (before.accel - before.accel_bias) + C1 @ (after.accel - after.accel_bias))
    F = np.eye(16)
    F[0:3, 13:16] = -C * dt
    F[3:6, 0:3] = -skew(a) * dt
    F[3:6, 10:13] = -C * dt
    F[3:6, 13:16] = 0.5 * skew(a) @ C * dt**2
    F[6] += 0.5 * dt * (F[5] + np.eye(16)[5])
    return F


def added(
    m: FootModel, inputs: FootInputs, k: int, before: FootState, after: FootState
) -> FloatArray:
    """Return the covariance (16, 16) that a step adds; height follows velocity's trapezoid."""
    dt = inputs.dt[k]
    w = after.gyro - after.gyro_bias
    a = (after.velocity - before.velocity) / dt if dt else np.zeros(3)
    Q = np.zeros(16)
    Q[0:3] = dt * (m.gyro_noise**2 + m.gyro_motion**2 * (w @ w))
    Q[3:6] = dt * (m.accel_noise**2 + m.accel_motion**2 * (a @ a))
    Q[6] = inputs.floor_step[k] ** 2
    Q[10:13] = dt * m.accel_bias_walk**2
    Q[13:16] = dt * m.gyro_bias_walk**2
    if inputs.unseen_turn is not None and inputs.unseen_velocity is not None:
        Q[0:3] += inputs.unseen_turn[k] ** 2
        Q[3:6] += inputs.unseen_velocity[k] ** 2
    rising = np.eye(16)
    rising[6, 5] = 0.5 * dt
    return rising @ np.diag(Q) @ rising.T


def rolling(state: FootState) -> tuple[FloatArray, FloatArray]:
    """Return ``v - C (w x r)`` (3,), zero while the foot rolls, and its derivative (3, 16)."""
    C = rotation.to_matrix(state.quaternion)
    w, r = state.gyro - state.gyro_bias, state.pivot
    u = C @ np.cross(w, r)
    H = np.zeros((3, 16))
    H[:, 0:3], H[:, 3:6] = skew(u), np.eye(3)
    H[:, 7:10], H[:, 13:16] = -C @ skew(w), -C @ skew(r)
    return state.velocity - u, H


def smooth(
    inputs: FootInputs, model: FootModel, start: FootState
) -> tuple[list[FootState], list[FootState], list[FloatArray]]:
    """Return the filtered and the smoothed states and the filter's covariances."""
    state, P = start, start.covariance
    filtered, covariances, priors, steps, jumps = [], [], [], [], []
    for k, dt in enumerate(inputs.dt):
        before = state
        state = strapdown(state, dt, inputs.gyro[k], inputs.accel[k], model.gravity)
        F = transition(before, state, dt)
        P = F @ P @ F.T + added(model, inputs, k, before, state)
        priors.append(P)
        steps.append(F)
        dx = np.zeros(16)
        for h, H, sigma, gated in measurements(inputs, k, state):
            nu = -h - H @ dx
            S, R = H @ P @ H.T, sigma**2 * np.eye(len(h))
            if gated:
                chi = nu @ np.linalg.solve(S + R, nu) / len(nu)
                R *= min(max(chi / model.gate**2, 1.0), model.gate_cap)
            K = np.linalg.solve(S + R, H @ P).T
            dx += K @ nu
            P = P - K @ (S + R) @ K.T
        state = corrected(state, dx)
        jumps.append(dx)
        filtered.append(state)
        covariances.append(P)
    e = np.zeros(16)
    smoothed = [filtered[-1]]
    for k in range(len(filtered) - 2, -1, -1):
        behind = np.linalg.solve(priors[k + 1], steps[k + 1] @ covariances[k]).T
        e = behind @ (e + jumps[k + 1])
        smoothed.append(corrected(filtered[k], e))
    return filtered, smoothed[::-1], covariances


def measurements(
    inputs: FootInputs, k: int, state: FootState
) -> list[tuple[FloatArray, FloatArray, float, bool]]:
    """Return what should be zero, its derivative, its standard deviation, and whether gated."""
    found = []
    if np.isfinite(inputs.velocity_sigma[k]):
        found.append((*rolling(state), inputs.velocity_sigma[k], True))
    if np.isfinite(inputs.rest_sigma[k]):
        rate = state.gyro_bias - state.gyro
        found.append((rate, np.eye(16)[13:16], inputs.rest_sigma[k], False))
    if np.isfinite(inputs.floor_sigma[k]):
        found.append((np.array([state.height]), np.eye(16)[6:7], inputs.floor_sigma[k], True))
    return found
