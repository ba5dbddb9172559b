"""The foot smoother's pass back, without covariances and without inverses.

The modified Bryson-Frazier smoother (G. J. Bierman, "Fixed interval smoothing with discrete
measurements", Int. J. Control 18, 1973) carries an adjoint variable back: with innovation nu of
variance S and gain K, it changes by ``-H' (nu / S + K' adjoint)`` at a measured number and to
``F' adjoint`` over a step. It then needs the covariance of every sample to tell the smoothed state.
But a step is easily undone, so that here the smoothed less the filtered error ``e`` goes back with
the adjoint: zero at the end; ``e + K nu`` before a measurement; ``F^-1 (e + Q adjoint)`` a step
earlier. Only gains of measured numbers are kept.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.kernels.blocks3 import applied, cross, less, mean, transpose
from imu_rig.kernels.compiled import compiled, inlined
from imu_rig.kernels.foot_errors import PHI, WIDTH, B, C, H, R, V
from imu_rig.kernels.foot_forward import (
    SLOPE,
    add_correction,
    added_variances,
    by_gyro_bias,
    by_pivot,
    mean_turn,
    usable,
)
from imu_rig.kernels.strapdown import Matrix, Vector, exponential, matrix, product, unit


@inlined
def at(e: FloatArray, i: int) -> Vector:
    """Read three elements."""
    return (e[i], e[i + 1], e[i + 2])


@inlined
def add(e: FloatArray, i: int, s: float, v: Vector) -> None:
    """Add a multiple to three elements."""
    e[i] += s * v[0]
    e[i + 1] += s * v[1]
    e[i + 2] += s * v[2]


@inlined
def slope_of(adjoint: FloatArray, gains: FloatArray, row: int) -> float:
    """Return innovation / variance plus gain times adjoint."""
    s0, s1, s2, s3 = float(gains[row, SLOPE]), 0.0, 0.0, 0.0
    for j in range(0, WIDTH, 4):  # four sums do not wait for each other
        s0 += gains[row, j] * adjoint[j]
        s1 += gains[row, j + 1] * adjoint[j + 1]
        s2 += gains[row, j + 2] * adjoint[j + 2]
        s3 += gains[row, j + 3] * adjoint[j + 3]
    return (s0 + s1) + (s2 + s3)


@compiled
def forget_velocity(
    adjoint: FloatArray, gains: FloatArray, row: int, u: Vector, J: Matrix, G: Matrix
) -> None:
    """Carry the adjoint back over the three measured numbers of a rolling foot, last first."""
    s = slope_of(adjoint, gains, row + 2)
    add(adjoint, PHI, -s, (-u[1], u[0], 0.0))
    adjoint[V + 2] -= s
    add(adjoint, R, -s, (J[6], J[7], J[8]))
    add(adjoint, B, -s, (G[6], G[7], G[8]))
    s = slope_of(adjoint, gains, row + 1)
    add(adjoint, PHI, -s, (u[2], 0.0, -u[0]))
    adjoint[V + 1] -= s
    add(adjoint, R, -s, (J[3], J[4], J[5]))
    add(adjoint, B, -s, (G[3], G[4], G[5]))
    s = slope_of(adjoint, gains, row)
    add(adjoint, PHI, -s, (0.0, -u[2], u[1]))
    adjoint[V] -= s
    add(adjoint, R, -s, (J[0], J[1], J[2]))
    add(adjoint, B, -s, (G[0], G[1], G[2]))


@compiled
def undo_step(
    e: FloatArray,
    adjoint: FloatArray,
    D: Matrix,
    a: Vector,
    half: float,
    added: tuple[float, float, float, float, float],
) -> None:
    """Carry error and adjoint back over a step; the parts of `foot_errors`, last first.

    ``added`` are the variances that the step adds, as in `foot_errors.propagate`.
    """
    e[H] -= half * e[5]
    adjoint[5] += half * adjoint[H]
    add(e, PHI, added[0], at(adjoint, PHI))
    add(e, V, added[1], at(adjoint, V))
    e[H] += added[2] * adjoint[H]
    add(e, C, added[3], at(adjoint, C))
    add(e, B, added[4], at(adjoint, B))
    Dt = transpose(D)
    bias = applied(D, at(e, B))
    add(e, PHI, -0.5, bias)
    add(e, V, 1.0, cross(a, at(e, PHI)))
    add(e, V, -1.0, applied(D, at(e, C)))
    add(e, PHI, -0.5, bias)
    e[H] -= half * e[5]
    add(adjoint, B, 0.5, applied(Dt, at(adjoint, PHI)))
    add(adjoint, PHI, 1.0, cross(a, at(adjoint, V)))
    add(adjoint, C, 1.0, applied(Dt, at(adjoint, V)))
    add(adjoint, B, 0.5, applied(Dt, at(adjoint, PHI)))
    adjoint[5] += half * adjoint[H]


@compiled
def smooth_backward(
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
    quaternion: FloatArray,
    velocity: FloatArray,
    height: FloatArray,
    gyro_bias: FloatArray,
    accel_bias: FloatArray,
    gains: FloatArray,
) -> None:
    """Turn what `filter_forward` wrote into smoothed states, in place.

    ``x`` is the nominal state that the filter ended with; the rest is as there.
    """
    adjoint = np.zeros(WIDTH)
    e = np.zeros(WIDTH)
    dx = np.zeros(WIDTH)
    seen_all = len(unseen_turn) == 0
    r = (x[8], x[9], x[10])
    b = (x[14], x[15], x[16])
    row = len(gains)
    q = (x[0], x[1], x[2], x[3])
    after = matrix(q)
    for k in range(len(dt) - 1, -1, -1):
        quaternion[k, 0], quaternion[k, 1], quaternion[k, 2], quaternion[k, 3] = unit(
            product(exponential(e[0], e[1], e[2]), q)
        )
        for i in range(3):
            velocity[k, i] += e[V + i]
            accel_bias[k, i] += e[C + i]
        if with_bias:
            for i in range(3):
                gyro_bias[k, i] += e[B + i]
        height[k] += e[H]
        if k == 0:
            break

        rolls, rests = usable(velocity_sigma[k]), with_bias and usable(rest_sigma[k])
        level = usable(floor_sigma[k])
        first = row - (3 if rolls else 0) - (3 if rests else 0) - (1 if level else 0)
        C1 = after
        if first < row:
            dx[:] = 0.0
            add_correction(dx, gains, first, row)
            for j in range(WIDTH):
                e[j] += dx[j]
            C1 = matrix(unit(product(exponential(-dx[0], -dx[1], -dx[2]), q)))
            r = less(r, (dx[R], dx[R + 1], dx[R + 2]))
        if with_bias:
            b = (gyro_bias[k - 1, 0], gyro_bias[k - 1, 1], gyro_bias[k - 1, 2])
        c = (accel_bias[k - 1, 0], accel_bias[k - 1, 1], accel_bias[k - 1, 2])
        w = less((gyro[k, 0], gyro[k, 1], gyro[k, 2]), b)
        if level:
            row -= 1
            adjoint[H] -= slope_of(adjoint, gains, row)
        if rests:
            for i in range(2, -1, -1):
                row -= 1
                adjoint[B + i] -= slope_of(adjoint, gains, row)
        if rolls:
            row -= 3
            u = applied(C1, cross(w, r))
            forget_velocity(adjoint, gains, row, u, by_pivot(C1, w), by_gyro_bias(C1, r))

        q = (
            quaternion[k - 1, 0],
            quaternion[k - 1, 1],
            quaternion[k - 1, 2],
            quaternion[k - 1, 3],
        )
        after = matrix(q)
        step = dt[k]
        f0 = applied(after, less((accel[k - 1, 0], accel[k - 1, 1], accel[k - 1, 2]), c))
        f1 = applied(C1, less((accel[k, 0], accel[k, 1], accel[k, 2]), c))
        f = mean(f0, f1)
        turn, surge = 0.0, 0.0
        if not seen_all:
            turn, surge = unseen_turn[k], unseen_velocity[k]
        turning, moving = added_variances(
            step, w, (f[0], f[1], f[2] - noise[6]), noise, turn, surge
        )
        floor = floor_step[k] * floor_step[k]
        undo_step(
            e,
            adjoint,
            mean_turn(step, after, C1),
            (step * f[0], step * f[1], step * f[2]),
            0.5 * step,
            (turning, moving, floor, step * noise[5], step * noise[4] if with_bias else 0.0),
        )


@compiled
def integrate(
    dt: FloatArray, v0: FloatArray, p0: FloatArray, velocity: FloatArray, position: FloatArray
) -> None:
    """Write the trapezoid of velocities (n, 3) into ``position``, from ``v0`` and ``p0`` on."""
    v = (v0[0], v0[1], v0[2])
    p = (p0[0], p0[1], p0[2])
    for k in range(len(dt)):
        half = 0.5 * dt[k]
        now = (velocity[k, 0], velocity[k, 1], velocity[k, 2])
        p = (
            p[0] + half * (v[0] + now[0]),
            p[1] + half * (v[1] + now[1]),
            p[2] + half * (v[2] + now[2]),
        )
        v = now
        position[k, 0], position[k, 1], position[k, 2] = p
