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
    a = 0.5 * (f0 + f1) - [0.0, 0.0, gravity]
    return state._replace(
        quaternion=q,
        velocity=state.velocity + dt * a,
        position=state.position + dt * (state.velocity + 0.5 * dt * a),
        gyro=gyro,
        accel=accel,
    )


def corrected(state: FootState, dx: FloatArray) -> FootState:
    """Add an error (17,) to a state."""
    return state._replace(
        quaternion=rotation.multiply(rotation.from_rotation_vector(dx[0:3]), state.quaternion),
        velocity=state.velocity + dx[3:6],
        position=state.position + np.array([0.0, 0.0, dx[6]]),
        gyro_bias=state.gyro_bias + dx[7:10],
        accel_bias=state.accel_bias + dx[10:13],
        floor=state.floor + dx[13],
        pivot=state.pivot + dx[14:17],
    )


def difference(a: FootState, b: FootState) -> FloatArray:
    """Return the error (17,) that makes ``a`` out of ``b``."""
    turn = rotation.multiply(a.quaternion, rotation.conjugate(b.quaternion))
    return np.concatenate(
        (
            rotation.to_rotation_vector(turn),
            a.velocity - b.velocity,
            a.position[2:] - b.position[2:],
            a.gyro_bias - b.gyro_bias,
            a.accel_bias - b.accel_bias,
            [a.floor - b.floor],
            a.pivot - b.pivot,
        )
    )


def transition(before: FootState, after: FootState, dt: float) -> FloatArray:
    """Return the derivative (17, 17) of a step, to the order to which the step itself is exact."""
    C0, C1 = rotation.to_matrix(before.quaternion), rotation.to_matrix(after.quaternion)
    C = 0.5 * (C0 + C1)
    a = 0.5 * (C0 @ (before.accel - before.accel_bias) + C1 @ (after.accel - after.accel_bias))
    F = np.eye(17)
    F[0:3, 7:10] = -C * dt
    F[3:6, 0:3] = -skew(a) * dt
    F[3:6, 7:10] = 0.5 * skew(a) @ C * dt**2
    F[3:6, 10:13] = -C * dt
    F[6, 3:6] = [0.0, 0.0, dt]
    F[6] += 0.5 * dt * (F[5] - np.eye(17)[5])
    return F


def rolling(state: FootState) -> tuple[FloatArray, FloatArray]:
    """Return ``v - C (w x r)`` (3,), zero while the foot rolls, and its derivative (3, 17)."""
    C = rotation.to_matrix(state.quaternion)
    w, r = state.gyro - state.gyro_bias, state.pivot
    u = C @ np.cross(w, r)
    H = np.zeros((3, 17))
    H[:, 0:3], H[:, 3:6] = skew(u), np.eye(3)
    H[:, 7:10], H[:, 14:17] = -C @ skew(r), -C @ skew(w)
    return state.velocity - u, H


def smooth(
    inputs: FootInputs, model: FootModel, start: FootState
) -> tuple[list[FootState], list[FootState], list[FloatArray]]:
    """Return the filtered and the smoothed states and the filter's covariances."""
    m = model
    state, P = start, start.covariance
    filtered, covariances, priors, steps, jumps = [], [], [], [], []
    for k, dt in enumerate(inputs.dt):
        before = state
        state = strapdown(state, dt, inputs.gyro[k], inputs.accel[k], m.gravity)
        F = transition(before, state, dt)
        w = state.gyro - state.gyro_bias
        a = (state.velocity - before.velocity) / dt if dt else np.zeros(3)
        Q = np.zeros(17)
        Q[0:3] = m.gyro_noise**2 + m.gyro_motion**2 * (w @ w)
        Q[3:6] = m.accel_noise**2 + m.accel_motion**2 * (a @ a)
        Q[7:10], Q[10:13] = m.gyro_bias_walk**2, m.accel_bias_walk**2
        Q = np.diag(Q * dt)
        if inputs.unseen_turn is not None:
            Q[0:3, 0:3] += np.eye(3) * inputs.unseen_turn[k] ** 2
            Q[3:6, 3:6] += np.eye(3) * inputs.unseen_velocity[k] ** 2
        Q[13, 13] += inputs.floor_step[k] ** 2
        P = F @ P @ F.T + Q
        priors.append(P)
        steps.append(F)
        total = np.zeros(17)
        for residual, H, R in measurements(inputs, k, state, total):
            nu = residual()
            S = H @ P @ H.T + R
            if H[0, 3] or len(nu) == 1:  # of velocity or floor
                chi = nu @ np.linalg.solve(S, nu) / len(nu)
                S = S + R * (min(max(chi / m.gate**2, 1.0), m.gate_cap) - 1.0)
            K = np.linalg.solve(S, H @ P).T
            total += K @ nu
            P = P - K @ S @ K.T
        state = corrected(state, total)
        jumps.append(total)
        filtered.append(state)
        covariances.append(P)
    e = np.zeros(17)
    smoothed = [filtered[-1]]
    for k in range(len(filtered) - 2, -1, -1):
        behind = np.linalg.solve(priors[k + 1], steps[k + 1] @ covariances[k]).T
        e = behind @ (e + jumps[k + 1])
        smoothed.append(corrected(filtered[k], e))
    return filtered, smoothed[::-1], covariances


def measurements(inputs: FootInputs, k: int, state: FootState, dx: FloatArray):
    """Yield (residual given ``dx`` at that moment, H, R) of the sample's measurements."""
    if np.isfinite(inputs.velocity_sigma[k]):
        h, H = rolling(state)
        yield lambda: -h - H @ dx, H, np.eye(3) * inputs.velocity_sigma[k] ** 2
    if np.isfinite(inputs.rest_sigma[k]):
        H = np.eye(17)[7:10]
        yield (
            lambda: state.gyro - state.gyro_bias - dx[7:10],
            H,
            (np.eye(3) * inputs.rest_sigma[k] ** 2),
        )
    if np.isfinite(inputs.floor_sigma[k]):
        H = (np.eye(17)[6] - np.eye(17)[13])[None]
        yield (
            lambda: np.array([state.floor - state.position[2]]) - H @ dx,
            H,
            (np.eye(1) * inputs.floor_sigma[k] ** 2),
        )
