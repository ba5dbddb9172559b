"""A foot smoother as it is usually written, compiled: nine dense states and stored covariances.

Attitude, velocity and position; zero velocity where a mask says so; Rauch-Tung-Striebel with an
inverse for every sample. What ours is compared with for speed.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from imu_rig.arrays import BoolArray, FloatArray


@njit
def smooth(dt: FloatArray, gyro: FloatArray, accel: FloatArray, still: BoolArray) -> FloatArray:
    """Return smoothed positions (n, 3); the sensor starts level and at rest."""
    n = len(dt)
    P = np.zeros((9, 9))
    Q = np.zeros((9, 9))
    H = np.zeros((3, 9))
    for i in range(3):
        H[i, 3 + i] = 1.0
    R = 1e-4 * np.eye(3)
    priors, filtered = np.empty((n, 9, 9)), np.empty((n, 9, 9))
    steps = np.empty((n, 9, 9))
    moves = np.zeros((n, 9))
    position = np.empty((n, 3))
    C, v, p = np.eye(3), np.zeros(3), np.zeros(3)
    for k in range(n):
        x, y, z = gyro[k] * dt[k]
        W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        C = C @ (np.eye(3) + W + 0.5 * W @ W)
        f = C @ accel[k]
        a = f - np.array([0.0, 0.0, 9.81])
        p = p + v * dt[k]
        v = v + a * dt[k]
        F = np.eye(9)
        for i in range(3):
            F[6 + i, 3 + i] = dt[k]
            Q[i, i], Q[3 + i, 3 + i] = 1e-5 * dt[k], 1e-2 * dt[k]
        F[3, 1], F[3, 2] = f[2] * dt[k], -f[1] * dt[k]
        F[4, 0], F[4, 2] = -f[2] * dt[k], f[0] * dt[k]
        F[5, 0], F[5, 1] = f[1] * dt[k], -f[0] * dt[k]
        P = F @ P @ F.T + Q
        priors[k], steps[k] = P, F
        if still[k]:
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            dx = -K @ v
            P = (np.eye(9) - K @ H) @ P
            P = 0.5 * (P + P.T)
            moves[k] = dx
            x, y, z = dx[0], dx[1], dx[2]
            C = (np.eye(3) + np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])) @ C
            v = v + dx[3:6]
            p = p + dx[6:9]
        filtered[k], position[k] = P, p
    e = np.zeros(9)
    for k in range(n - 2, -1, -1):
        behind = filtered[k] @ steps[k + 1].T @ np.linalg.inv(priors[k + 1] + 1e-12 * np.eye(9))
        e = behind @ (e + moves[k + 1])
        position[k] += e[6:9]
    return position
