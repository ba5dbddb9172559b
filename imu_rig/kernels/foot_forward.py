"""The foot filter's pass forward: strapdown, propagation of errors, measurements."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.kernels.blocks3 import (
    applied,
    block_transposed,
    cross,
    crossed,
    less,
    mean,
    plus,
    sum3,
    times,
)
from imu_rig.kernels.compiled import compiled, inlined
from imu_rig.kernels.foot_errors import (
    PHI,
    WIDTH,
    B,
    H,
    R,
    V,
    propagate,
    seen_by_velocity,
    take_one,
    take_three,
)
from imu_rig.kernels.strapdown import (
    Matrix,
    Vector,
    exponential,
    integrated_rate,
    matrix,
    product,
    unit,
)

INNOVATION = WIDTH
SLOPE = WIDTH + 1
ROW = WIDTH + 2
"""A measured number's row of what smoothing needs: gain, innovation, innovation / variance."""

KNOWN = 23
"""Nominal state: quaternion 0-3, velocity 4-6, height over the floor 7, pivot 8-10, biases of
accelerometer 11-13 and gyro 14-16, last readings of gyro 17-19 and accelerometer 20-22."""


@inlined
def usable(sigma: float) -> bool:
    """Tell whether a standard deviation says that there is a measurement."""
    return 0.0 < sigma < np.inf


@inlined
def mean_turn(dt: float, C0: Matrix, C1: Matrix) -> Matrix:
    """Return minus the step times the mean of two attitudes."""
    s = -0.5 * dt
    return (
        s * (C0[0] + C1[0]), s * (C0[1] + C1[1]), s * (C0[2] + C1[2]),
        s * (C0[3] + C1[3]), s * (C0[4] + C1[4]), s * (C0[5] + C1[5]),
        s * (C0[6] + C1[6]), s * (C0[7] + C1[7]), s * (C0[8] + C1[8]),
    )  # fmt: skip


@inlined
def added_variances(
    dt: float, w: Vector, a: Vector, noise: FloatArray, turn: float, velocity: float
) -> tuple[float, float]:
    """Return what a step adds to the variances of attitude and velocity.

    ``noise`` begins with still and moving densities of gyro and accelerometer; ``turn`` and
    ``velocity`` are standard deviations of what was not seen.
    """
    turning = noise[0] + noise[1] * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    moving = noise[2] + noise[3] * (a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    return (dt * turning + turn * turn, dt * moving + velocity * velocity)


@inlined
def by_pivot(at: Matrix, w: Vector) -> Matrix:
    """Return the derivative of ``-C (w x r)`` by r: ``-C [w]x``."""
    return right_cross(at, w, -1.0)


@inlined
def by_gyro_bias(at: Matrix, r: Vector) -> Matrix:
    """Return the derivative of ``-C (w x r)`` by the gyro bias, which w lacks: ``-C [r]x``."""
    return right_cross(at, r, -1.0)


@inlined
def right_cross(M: Matrix, v: Vector, s: float) -> Matrix:
    """Return ``s M [v]x``."""
    x, y, z = s * v[0], s * v[1], s * v[2]
    return (
        M[1] * z - M[2] * y, M[2] * x - M[0] * z, M[0] * y - M[1] * x,
        M[4] * z - M[5] * y, M[5] * x - M[3] * z, M[3] * y - M[4] * x,
        M[7] * z - M[8] * y, M[8] * x - M[6] * z, M[6] * y - M[7] * x,
    )  # fmt: skip


@compiled
def measure_velocity(
    P: FloatArray,
    seen: FloatArray,
    at: Matrix,
    w: Vector,
    r: Vector,
    v: Vector,
    sigma: float,
    gate: float,
    cap: float,
    gains: FloatArray,
    first: int,
    size: int,
    with_bias: bool,
) -> float:
    """Measure that the foot rolls, ``v = C (w x r)``: three rows of ``gains`` from ``first``.

    Returns
    -------
    Normalized innovation squared, over 3, before the gate widened anything.
    """
    u = applied(at, cross(w, r))
    J = by_pivot(at, w)
    G = by_gyro_bias(at, r)
    seen_by_velocity(P, u, J, G, seen, with_bias)
    x, y, z = less(u, v)
    S = plus(crossed(u, block_transposed(seen, PHI, PHI)), block_transposed(seen, PHI, V))
    S = plus(S, times(J, block_transposed(seen, PHI, R)))
    if with_bias:
        S = plus(S, times(G, block_transposed(seen, PHI, B)))
    s00, s01, s02, s11, s12, s22 = S[0], S[1], S[2], S[4], S[5], S[8]
    variance = sigma * sigma
    nis = 0.0
    l10, l20, l21 = 0.0, 0.0, 0.0
    d0, d1, d2 = 1.0, 1.0, 1.0
    y0, z0 = y, z
    for attempt in range(2):  # as it is, and if too far off with a wider variance
        d0 = s00 + variance
        l10, l20 = s01 / d0, s02 / d0
        d1 = s11 + variance - l10 * s01
        l21 = (s12 - l20 * s01) / d1
        d2 = s22 + variance - l20 * s02 - l21 * l21 * d1
        y = y0 - l10 * x
        z = z0 - l20 * x - l21 * y
        if attempt == 1:
            break
        nis = (x * x / d0 + y * y / d1 + z * z / d2) / 3.0
        if nis <= gate * gate:
            break
        variance *= min(nis / (gate * gate), cap)
    i0, i1, i2 = 1.0 / d0, 1.0 / d1, 1.0 / d2
    for j in range(WIDTH):
        b0 = seen[0, j]
        b1 = seen[1, j] - l10 * b0
        b2 = seen[2, j] - l20 * b0 - l21 * b1
        seen[1, j] = b1
        seen[2, j] = b2
        gains[first, j] = i0 * b0
        gains[first + 1, j] = i1 * b1
        gains[first + 2, j] = i2 * b2
    gains[first, INNOVATION], gains[first, SLOPE] = x, x / d0
    gains[first + 1, INNOVATION], gains[first + 1, SLOPE] = y, y / d1
    gains[first + 2, INNOVATION], gains[first + 2, SLOPE] = z, z / d2
    take_three(P, seen, gains, first, size)
    return nis


@compiled
def measure_one(
    P: FloatArray,
    seen: FloatArray,
    state: int,
    nu: float,
    sigma: float,
    gate: float,
    cap: float,
    gains: FloatArray,
    first: int,
    size: int,
) -> None:
    """Measure one state, off by ``nu``: one row of ``gains``."""
    for j in range(WIDTH):
        seen[0, j] = P[min(j, state), max(j, state)]
    variance = sigma * sigma
    nis = nu * nu / (seen[0, state] + variance)
    variance *= min(max(nis / (gate * gate), 1.0), cap)
    weight = 1.0 / (seen[0, state] + variance)
    for j in range(WIDTH):
        gains[first, j] = weight * seen[0, j]
    gains[first, INNOVATION], gains[first, SLOPE] = nu, weight * nu
    take_one(P, seen, gains, first, size)


@compiled
def add_correction(dx: FloatArray, gains: FloatArray, first: int, last: int) -> None:
    """Add what rows of ``gains`` correct to an error state (16,)."""
    width = len(dx)
    for i in range(first, last):
        nu = gains[i, INNOVATION]
        for j in range(width):
            dx[j] += gains[i, j] * nu


@compiled
def filter_forward(
    dt: FloatArray,
    gyro: FloatArray,
    accel: FloatArray,
    velocity_sigma: FloatArray,
    rest_sigma: FloatArray,
    floor_sigma: FloatArray,
    floor_step: FloatArray,
    unseen_turn: FloatArray,
    unseen_velocity: FloatArray,
    noise: FloatArray,
    with_bias: bool,
    x: FloatArray,
    P: FloatArray,
    quaternion: FloatArray,
    velocity: FloatArray,
    height: FloatArray,
    gyro_bias: FloatArray,
    accel_bias: FloatArray,
    nis: FloatArray,
    gains: FloatArray,
) -> None:
    """Run the filter over a trial.

    Parameters
    ----------
    dt, gyro, accel, velocity_sigma, rest_sigma, floor_sigma, floor_step
        As of `FootInputs`; contiguous.
    unseen_turn, unseen_velocity : shape (n,) or (0,)
    noise : shape (9,)
        Squares of gyro_noise, gyro_motion, accel_noise, accel_motion, gyro_bias_walk and
        accel_bias_walk; gravity; gate and gate_cap.
    with_bias : bool
        Whether the gyro bias is estimated.
    x : shape (23,)
        Nominal state, see `KNOWN`; changed in place to that of the end.
    P : shape (16, 16)
        Covariance of the start, upper triangle; changed in place to that of the end.
    quaternion, velocity, height, gyro_bias, accel_bias, nis
        Written: the state after each sample's measurements, ``gyro_bias`` only if estimated.
    gains : shape (m, 18)
        Written: a row for each measured number, in order.
    """
    n = len(dt)
    seen = np.zeros((3, WIDTH))
    dx = np.zeros(WIDTH)
    size = B + 3 if with_bias else B
    seen_all = len(unseen_turn) == 0
    q = (x[0], x[1], x[2], x[3])
    v = (x[4], x[5], x[6])
    h = x[7]
    r = (x[8], x[9], x[10])
    c = (x[11], x[12], x[13])
    b = (x[14], x[15], x[16])
    last_w = (x[17], x[18], x[19])
    last_f = (x[20], x[21], x[22])
    C0 = matrix(q)
    row = PHI  # zero, but not a constant's type
    for k in range(n):
        step = dt[k]
        read_w = (gyro[k, 0], gyro[k, 1], gyro[k, 2])
        read_f = (accel[k, 0], accel[k, 1], accel[k, 2])
        w = less(read_w, b)
        phi = integrated_rate(step, less(last_w, b), w)
        q = unit(product(q, exponential(phi[0], phi[1], phi[2])))
        C1 = matrix(q)
        f = mean(applied(C0, less(last_f, c)), applied(C1, less(read_f, c)))
        a = (f[0], f[1], f[2] - noise[6])
        turn, surge = 0.0, 0.0
        if not seen_all:
            turn, surge = unseen_turn[k], unseen_velocity[k]
        turning, moving = added_variances(step, w, a, noise, turn, surge)
        push = (step * f[0], step * f[1], step * f[2])
        floor = floor_step[k] * floor_step[k]
        added = (turning, moving, floor, step * noise[5], step * noise[4] if with_bias else 0.0)
        propagate(P, mean_turn(step, C0, C1), push, 0.5 * step, added, with_bias)
        h += step * (v[2] + 0.5 * step * a[2])
        v = (v[0] + step * a[0], v[1] + step * a[1], v[2] + step * a[2])
        last_w, last_f = read_w, read_f

        before = row
        nis[k] = np.nan
        if usable(velocity_sigma[k]):
            nis[k] = measure_velocity(
                P,
                seen,
                C1,
                w,
                r,
                v,
                velocity_sigma[k],
                noise[7],
                noise[8],
                gains,
                row,
                size,
                with_bias,
            )
            row += 3
        if with_bias and usable(rest_sigma[k]):
            for i in range(3):
                dx[:] = 0.0
                add_correction(dx, gains, before, row)
                off = w[i] - dx[B + i]
                measure_one(P, seen, B + i, off, rest_sigma[k], np.inf, 1.0, gains, row, size)
                row += 1
        if usable(floor_sigma[k]):
            dx[:] = 0.0
            add_correction(dx, gains, before, row)
            off = -h - dx[H]
            measure_one(P, seen, H, off, floor_sigma[k], noise[7], noise[8], gains, row, size)
            row += 1
        if row > before:
            dx[:] = 0.0
            add_correction(dx, gains, before, row)
            q = unit(product(exponential(dx[0], dx[1], dx[2]), q))
            v = sum3(v, (dx[3], dx[4], dx[5]))
            h += dx[H]
            r = sum3(r, (dx[7], dx[8], dx[9]))
            c = sum3(c, (dx[10], dx[11], dx[12]))
            b = sum3(b, (dx[13], dx[14], dx[15]))
            C0 = matrix(q)
        else:
            C0 = C1
        quaternion[k, 0], quaternion[k, 1], quaternion[k, 2], quaternion[k, 3] = q
        velocity[k, 0], velocity[k, 1], velocity[k, 2] = v
        height[k] = h
        accel_bias[k, 0], accel_bias[k, 1], accel_bias[k, 2] = c
        if with_bias:
            gyro_bias[k, 0], gyro_bias[k, 1], gyro_bias[k, 2] = b
    x[0], x[1], x[2], x[3] = q
    x[4], x[5], x[6] = v
    x[7] = h
    x[8], x[9], x[10] = r
    x[11], x[12], x[13] = c
    x[14], x[15], x[16] = b
    x[17], x[18], x[19] = last_w
    x[20], x[21], x[22] = last_f
