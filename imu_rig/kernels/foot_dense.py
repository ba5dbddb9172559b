"""The foot filter with full matrices: plain to read, slow to run."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.kernels.compiled import compiled
from imu_rig.kernels.strapdown import (
    Matrix,
    Vector,
    exponential,
    integrated_rate,
    matrix,
    product,
    turned,
    unit,
)

N = 17


@compiled
def usable(sigma: float) -> bool:
    """Tell whether a standard deviation says that there is a measurement."""
    return 0.0 < sigma < np.inf


@compiled
def transition(dt: float, C0: Matrix, C1: Matrix, a0: Vector, a1: Vector) -> FloatArray:
    """Return the error's transition (17, 17) over a step.

    With the attitude before and after it and the specific forces in navigation axes. Attitude
    errors turn by the bias over the mean attitude, velocity errors see the attitude error at the
    middle of the step, height errors the mean of both velocities.
    """
    F = np.eye(N)
    turn = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            turn[i, j] = -0.5 * dt * (C0[3 * i + j] + C1[3 * i + j])
    x, y, z = (0.5 * dt * (a0[0] + a1[0]), 0.5 * dt * (a0[1] + a1[1]), 0.5 * dt * (a0[2] + a1[2]))
    tilt = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    F[0:3, 7:10] = turn
    F[3:6, 0:3] = tilt
    for i in range(3):
        for j in range(3):
            for k in range(3):
                F[3 + i, 7 + j] += 0.5 * tilt[i, k] * turn[k, j]
    F[3:6, 10:13] = turn
    for j in range(N):
        F[6, j] += 0.5 * dt * F[5, j]
    F[6, 5] += 0.5 * dt
    return F


@compiled
def velocity_jacobian(C: Matrix, w: Vector, r: Vector) -> FloatArray:
    """Return the derivative (3, 17) of ``v - C (w x r)`` with respect to the error state."""
    H = np.zeros((3, N))
    u0, u1, u2 = turned(
        C, w[1] * r[2] - w[2] * r[1], w[2] * r[0] - w[0] * r[2], w[0] * r[1] - w[1] * r[0]
    )
    H[0, 1], H[0, 2] = -u2, u1
    H[1, 0], H[1, 2] = u2, -u0
    H[2, 0], H[2, 1] = -u1, u0
    for i in range(3):
        a, b, c = C[3 * i], C[3 * i + 1], C[3 * i + 2]
        H[i, 3 + i] = 1.0
        H[i, 7] = r[1] * c - r[2] * b
        H[i, 8] = r[2] * a - r[0] * c
        H[i, 9] = r[0] * b - r[1] * a
        H[i, 14] = w[1] * c - w[2] * b
        H[i, 15] = w[2] * a - w[0] * c
        H[i, 16] = w[0] * b - w[1] * a
    return H


@compiled
def propagate(P: FloatArray, F: FloatArray) -> None:
    """Replace a covariance by ``F P F'``."""
    FP = np.zeros((N, N))
    for i in range(N):
        for k in range(N):
            if F[i, k] != 0.0:
                for j in range(N):
                    FP[i, j] += F[i, k] * P[k, j]
    P[:] = 0.0
    for j in range(N):
        for k in range(N):
            if F[j, k] != 0.0:
                for i in range(N):
                    P[i, j] += FP[i, k] * F[j, k]


@compiled
def update(P: FloatArray, H: FloatArray, variance: float, nu: float, row: FloatArray) -> None:
    """Measure one number: reduce ``P``, write gain (17), innovation / variance and innovation."""
    b = np.zeros(N)
    for k in range(N):
        if H[k] != 0.0:
            for i in range(N):
                b[i] += P[i, k] * H[k]
    s = variance
    for k in range(N):
        s += H[k] * b[k]
    for i in range(N):
        row[i] = b[i] / s
        for j in range(N):
            P[i, j] -= b[i] * b[j] / s
    row[N] = nu / s
    row[N + 1] = nu


@compiled
def mean_square(P: FloatArray, H: FloatArray, variance: float, nu: FloatArray) -> float:
    """Return ``nu' (H P H' + variance I)^-1 nu / 3``."""
    S = variance * np.eye(3)
    for i in range(3):
        for j in range(3):
            for k in range(N):
                for m in range(N):
                    S[i, j] += H[i, k] * P[k, m] * H[j, m]
    y1 = nu[1] - S[1, 0] / S[0, 0] * nu[0]
    s11 = S[1, 1] - S[1, 0] ** 2 / S[0, 0]
    s21 = S[2, 1] - S[2, 0] * S[1, 0] / S[0, 0]
    y2 = nu[2] - S[2, 0] / S[0, 0] * nu[0] - s21 / s11 * y1
    s22 = S[2, 2] - S[2, 0] ** 2 / S[0, 0] - s21**2 / s11
    return float(nu[0] ** 2 / S[0, 0] + y1**2 / s11 + y2**2 / s22) / 3.0


@compiled
def inflation(nis: float, gate: float, cap: float) -> float:
    """Return by what a measurement's variance grows for its normalized innovation squared."""
    return min(max(nis / (gate * gate), 1.0), cap)


@compiled
def smooth_dense(
    inputs: FloatArray,
    sigmas: FloatArray,
    noise: FloatArray,
    x: FloatArray,
    P: FloatArray,
    q: FloatArray,
    v: FloatArray,
    z: FloatArray,
    bg: FloatArray,
    ba: FloatArray,
    floor: FloatArray,
    nis: FloatArray,
    gains: FloatArray,
    smooth: bool,
) -> None:
    """Filter, and smooth back if told; see `foot_filter`, which lays out the arrays."""
    n = len(inputs)
    previous_w = (x[20], x[21], x[22])
    previous_f = (x[23], x[24], x[25])
    at = (x[0], x[1], x[2], x[3])
    vx, vy, vz, pz = x[4], x[5], x[6], x[7]
    b = x[8:11].copy()
    c = x[11:14].copy()
    level = x[14]
    r = x[15:18].copy()
    dx = np.zeros(N)
    H = np.zeros(N)
    used = 0
    for k in range(n):
        dt = inputs[k, 0]
        reading_w = (inputs[k, 1], inputs[k, 2], inputs[k, 3])
        reading_f = (inputs[k, 4], inputs[k, 5], inputs[k, 6])
        w0 = (previous_w[0] - b[0], previous_w[1] - b[1], previous_w[2] - b[2])
        w1 = (reading_w[0] - b[0], reading_w[1] - b[1], reading_w[2] - b[2])
        C0 = matrix(at)
        a0 = turned(C0, previous_f[0] - c[0], previous_f[1] - c[1], previous_f[2] - c[2])
        turn = integrated_rate(dt, w0, w1)
        at = unit(product(at, exponential(turn[0], turn[1], turn[2])))
        C1 = matrix(at)
        a1 = turned(C1, reading_f[0] - c[0], reading_f[1] - c[1], reading_f[2] - c[2])
        propagate(P, transition(dt, C0, C1, a0, a1))
        ax, ay, az = 0.5 * (a0[0] + a1[0]), 0.5 * (a0[1] + a1[1]), 0.5 * (a0[2] + a1[2]) - noise[6]
        add_noise(P, dt, w1, (ax, ay, az), sigmas[k], noise)
        pz += dt * (vz + 0.5 * dt * az)
        vx += dt * ax
        vy += dt * ay
        vz += dt * az
        dx[:] = 0.0
        nis[k] = np.nan
        if usable(sigmas[k, 0]):
            J = velocity_jacobian(C1, w1, (r[0], r[1], r[2]))
            u = turned(
                C1,
                w1[1] * r[2] - w1[2] * r[1],
                w1[2] * r[0] - w1[0] * r[2],
                w1[0] * r[1] - w1[1] * r[0],
            )
            nu = np.array([u[0] - vx, u[1] - vy, u[2] - vz])
            variance = sigmas[k, 0] ** 2
            nis[k] = mean_square(P, J, variance, nu)
            variance *= inflation(nis[k], noise[7], noise[8])
            for i in range(3):
                residual = nu[i]
                for j in range(N):
                    residual -= J[i, j] * dx[j]
                update(P, J[i], variance, residual, gains[used])
                for j in range(N):
                    dx[j] += gains[used, j] * residual
                used += 1
        if usable(sigmas[k, 1]):
            for i in range(3):
                H[:] = 0.0
                H[7 + i] = 1.0
                residual = w1[i] - dx[7 + i]
                update(P, H, sigmas[k, 1] ** 2, residual, gains[used])
                for j in range(N):
                    dx[j] += gains[used, j] * residual
                used += 1
        if usable(sigmas[k, 2]):
            H[:] = 0.0
            H[6], H[13] = 1.0, -1.0
            residual = level - pz - dx[6] + dx[13]
            variance = sigmas[k, 2] ** 2
            spread = P[6, 6] + P[13, 13] - 2.0 * P[6, 13] + variance
            variance *= inflation(residual**2 / spread, noise[7], noise[8])
            update(P, H, variance, residual, gains[used])
            for j in range(N):
                dx[j] += gains[used, j] * residual
            used += 1
        at = unit(product(exponential(dx[0], dx[1], dx[2]), at))
        vx, vy, vz, pz = vx + dx[3], vy + dx[4], vz + dx[5], pz + dx[6]
        for i in range(3):
            b[i] += dx[7 + i]
            c[i] += dx[10 + i]
            r[i] += dx[14 + i]
        level += dx[13]
        previous_w, previous_f = reading_w, reading_f
        q[k, 0], q[k, 1], q[k, 2], q[k, 3] = at
        v[k, 0], v[k, 1], v[k, 2] = vx, vy, vz
        z[k], floor[k] = pz, level
        bg[k], ba[k] = b, c
    x[0], x[1], x[2], x[3] = at
    x[4], x[5], x[6], x[7] = vx, vy, vz, pz
    x[8:11], x[11:14], x[14], x[15:18] = b, c, level, r
    x[20], x[21], x[22] = previous_w
    x[23], x[24], x[25] = previous_f
    if smooth:
        smooth_back(inputs, sigmas, noise, r, q, v, z, bg, ba, floor, gains, used)


@compiled
def add_noise(
    P: FloatArray, dt: float, w: Vector, a: Vector, sigmas: FloatArray, noise: FloatArray
) -> None:
    """Add what one step makes uncertain to the diagonal of ``P``."""
    turning = noise[0] ** 2 + noise[1] ** 2 * (w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    moving = noise[2] ** 2 + noise[3] ** 2 * (a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
    for i in range(3):
        P[i, i] += dt * turning + sigmas[4] ** 2
        P[3 + i, 3 + i] += dt * moving + sigmas[5] ** 2
        P[7 + i, 7 + i] += dt * noise[4] ** 2
        P[10 + i, 10 + i] += dt * noise[5] ** 2
    P[13, 13] += sigmas[3] ** 2


@compiled
def smooth_back(
    inputs: FloatArray,
    sigmas: FloatArray,
    noise: FloatArray,
    r: FloatArray,
    q: FloatArray,
    v: FloatArray,
    z: FloatArray,
    bg: FloatArray,
    ba: FloatArray,
    floor: FloatArray,
    gains: FloatArray,
    used: int,
) -> None:
    """Turn filtered into smoothed states.

    Going back, ``adjoint`` is the adjoint variable of the modified Bryson-Frazier smoother (G. J.
    Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18, 1973) and
    ``e`` the smoothed less the filtered error, both after the updates of sample k. Since the
    transition is easily inverted, ``e`` goes back with the adjoint and no covariance is kept:
    before the updates e + K nu; one step earlier F^-1 (e + Q adjoint).
    """
    n = len(inputs)
    adjoint = np.zeros(N)
    e = np.zeros(N)
    dx = np.zeros(N)
    r = r.copy()
    J = np.zeros((3, N))
    for k in range(n - 1, -1, -1):
        filtered = (q[k, 0], q[k, 1], q[k, 2], q[k, 3])
        b = bg[k].copy()
        c = ba[k].copy()
        smoothed = unit(product(exponential(e[0], e[1], e[2]), filtered))
        q[k, 0], q[k, 1], q[k, 2], q[k, 3] = smoothed
        for i in range(3):
            v[k, i] += e[3 + i]
            bg[k, i] += e[7 + i]
            ba[k, i] += e[10 + i]
        z[k] += e[6]
        floor[k] += e[13]
        count = 1 if usable(sigmas[k, 2]) else 0
        if usable(sigmas[k, 0]):
            count += 3
        if usable(sigmas[k, 1]):
            count += 3
        dx[:] = 0.0
        for row in range(used - count, used):
            for j in range(N):
                dx[j] += gains[row, j] * gains[row, N + 1]
        for i in range(3):
            b[i] -= dx[7 + i]
            c[i] -= dx[10 + i]
            r[i] -= dx[14 + i]
        at = unit(product(exponential(-dx[0], -dx[1], -dx[2]), filtered))
        C1 = matrix(at)
        w1 = (inputs[k, 1] - b[0], inputs[k, 2] - b[1], inputs[k, 3] - b[2])
        a1 = turned(C1, inputs[k, 4] - c[0], inputs[k, 5] - c[1], inputs[k, 6] - c[2])
        for j in range(N):
            e[j] += dx[j]
        if usable(sigmas[k, 2]):
            used -= 1
            slope = gains[used, N]
            for j in range(N):
                slope += gains[used, j] * adjoint[j]
            adjoint[6] -= slope
            adjoint[13] += slope
        if usable(sigmas[k, 1]):
            for i in range(2, -1, -1):
                used -= 1
                slope = gains[used, N]
                for j in range(N):
                    slope += gains[used, j] * adjoint[j]
                adjoint[7 + i] -= slope
        if usable(sigmas[k, 0]):
            J = velocity_jacobian(C1, w1, (r[0], r[1], r[2]))
            for i in range(2, -1, -1):
                used -= 1
                slope = gains[used, N]
                for j in range(N):
                    slope += gains[used, j] * adjoint[j]
                for j in range(N):
                    adjoint[j] -= J[i, j] * slope
        if k == 0:
            break
        dt = inputs[k, 0]
        C0 = matrix((q[k - 1, 0], q[k - 1, 1], q[k - 1, 2], q[k - 1, 3]))
        a0 = turned(C0, inputs[k - 1, 4] - c[0], inputs[k - 1, 5] - c[1], inputs[k - 1, 6] - c[2])
        a = (0.5 * (a0[0] + a1[0]), 0.5 * (a0[1] + a1[1]), 0.5 * (a0[2] + a1[2]) - noise[6])
        Q = np.zeros((N, N))
        add_noise(Q, dt, w1, a, sigmas[k], noise)
        for j in range(N):
            e[j] += Q[j, j] * adjoint[j]
        F = transition(dt, C0, C1, a0, a1)
        undo(F, e)
        earlier = np.zeros(N)
        for i in range(N):
            for j in range(N):
                earlier[j] += F[i, j] * adjoint[i]
        adjoint[:] = earlier


@compiled
def undo(F: FloatArray, e: FloatArray) -> None:
    """Replace ``e`` by ``F^-1 e``: attitude first, then velocity, then height."""
    for i in range(3):
        for j in range(7, 10):
            e[i] -= F[i, j] * e[j]
    for i in range(3, 6):
        for j in range(3):
            e[i] -= F[i, j] * e[j]
        for j in range(7, 13):
            e[i] -= F[i, j] * e[j]
    for j in range(N):
        if j != 6:
            e[6] -= F[6, j] * e[j]
