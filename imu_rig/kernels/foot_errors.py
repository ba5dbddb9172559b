"""Covariance of the foot filter's errors: one step, and what measurements take away.

The 16 error states: attitude 0-2 (a small rotation in navigation axes), velocity 3-5, height above
the floor 6, pivot 7-9, accelerometer bias 10-12, gyro bias 13-15. With the gyro bias known, the
first 13 do. Only the upper triangle of the covariance is read; what the lower holds means nothing.

A step is, in this order: half of the height's change, by the old velocity; half of the turn; the
velocity, by the attitude error in the middle of the step; the other half of the turn; noise; the
other half of the height's change, by the new velocity. Each part touches few rows, and height is
exactly the trapezoid of velocity, after smoothing too.
"""

from __future__ import annotations

from imu_rig.arrays import FloatArray
from imu_rig.kernels.blocks3 import (
    add_block,
    add_column,
    add_diagonal,
    applied,
    block,
    block_transposed,
    column,
    cross,
    crossed,
    diagonal,
    plus,
    row,
    scaled,
    sum3,
    times,
    transpose,
)
from imu_rig.kernels.compiled import as_variable, compiled, inlined
from imu_rig.kernels.strapdown import Matrix, Vector

PHI, V, H = as_variable(0), as_variable(3), as_variable(6)
R, C, B = as_variable(7), as_variable(10), as_variable(13)
"""Where attitude, velocity, height, pivot, accelerometer bias and gyro bias begin."""
WIDTH = 16


@compiled
def turn(P: FloatArray, half: Matrix) -> None:
    """Let attitude errors grow by ``half`` times the gyro bias."""
    by_bias = times(half, diagonal(P, B))
    by_attitude = times(half, block_transposed(P, PHI, B))
    add_diagonal(P, PHI, by_attitude, times(by_bias, transpose(half)))
    add_block(P, PHI, V, times(half, block_transposed(P, V, B)))
    add_column(P, PHI, H, applied(half, row(P, H, B)))
    add_block(P, PHI, R, times(half, block_transposed(P, R, B)))
    add_block(P, PHI, C, times(half, block_transposed(P, C, B)))
    add_block(P, PHI, B, by_bias)


@compiled
def accelerate(P: FloatArray, D: Matrix, a: Vector, with_bias: bool) -> None:
    """Let velocity errors grow by ``-a x`` attitude error and ``D`` times accelerometer bias."""
    down = (-a[0], -a[1], -a[2])
    by_attitude = plus(crossed(down, diagonal(P, PHI)), times(D, block_transposed(P, PHI, C)))
    by_velocity = plus(crossed(down, block(P, PHI, V)), times(D, block_transposed(P, V, C)))
    by_accel = plus(crossed(down, block(P, PHI, C)), times(D, diagonal(P, C)))
    own = plus(crossed(down, transpose(by_attitude)), times(D, transpose(by_accel)))
    add_diagonal(P, V, by_velocity, own)
    add_block(P, PHI, V, transpose(by_attitude))
    add_block(P, V, C, by_accel)
    add_column(P, V, H, sum3(cross(down, column(P, PHI, H)), applied(D, row(P, H, C))))
    add_block(P, V, R, plus(crossed(down, block(P, PHI, R)), times(D, block_transposed(P, R, C))))
    if with_bias:
        add_block(P, V, B, plus(crossed(down, block(P, PHI, B)), times(D, block(P, C, B))))


@inlined
def rise(P: FloatArray, half: float) -> None:
    """Let the height's error grow by ``half`` [s] times that of the vertical velocity."""
    P[6, 6] += half * (2.0 * P[5, 6] + half * P[5, 5])
    for i in range(6):
        P[i, 6] += half * P[i, 5]
    for j in range(7, WIDTH):
        P[6, j] += half * P[5, j]


@compiled
def propagate(
    P: FloatArray,
    D: Matrix,
    a: Vector,
    half: float,
    added: tuple[float, float, float, float, float],
    with_bias: bool,
) -> None:
    """Carry the errors over a step.

    Parameters
    ----------
    P : shape (16, 16)
        Changed in place.
    D : 9 floats
        Minus the step times the mean attitude [s].
    a : 3 floats
        The step times the mean specific force, navigation axes [m/s].
    half : float
        Half of the step [s].
    added : 5 floats
        Variances that the step adds to attitude, velocity, height and the biases of accelerometer
        and gyro.
    with_bias : bool
        Whether there is a gyro bias.
    """
    rise(P, half)
    if with_bias:
        turn(P, scaled(0.5, D))
    accelerate(P, D, a, with_bias)
    if with_bias:
        turn(P, scaled(0.5, D))
    for i in range(3):
        P[i, i] += added[0]
        P[V + i, V + i] += added[1]
        P[C + i, C + i] += added[3]
        P[B + i, B + i] += added[4]
    P[H, H] += added[2]
    rise(P, half)


@compiled
def seen_by_velocity(
    P: FloatArray, u: Vector, by_pivot: Matrix, by_bias: Matrix, seen: FloatArray, with_bias: bool
) -> None:
    """Write the covariance of every state with ``v - C (w x r)`` into ``seen`` (3, 16).

    The measurement's derivative is ``[u]x`` by attitude, one by velocity, ``by_pivot`` and
    ``by_bias``; ``u`` is the velocity that rolling makes.
    """
    put(seen, PHI, plus(crossed(u, diagonal(P, PHI)), block_transposed(P, PHI, V)))
    put(seen, V, plus(crossed(u, block(P, PHI, V)), diagonal(P, V)))
    put(seen, R, plus(crossed(u, block(P, PHI, R)), block(P, V, R)))
    put(seen, C, plus(crossed(u, block(P, PHI, C)), block(P, V, C)))
    more(seen, PHI, times(by_pivot, block_transposed(P, PHI, R)))
    more(seen, V, times(by_pivot, block_transposed(P, V, R)))
    more(seen, R, times(by_pivot, diagonal(P, R)))
    more(seen, C, times(by_pivot, block(P, R, C)))
    height = sum3(cross(u, column(P, PHI, H)), column(P, V, H))
    height = sum3(height, applied(by_pivot, row(P, H, R)))
    if with_bias:
        put(seen, B, plus(crossed(u, block(P, PHI, B)), block(P, V, B)))
        more(seen, B, times(by_pivot, block(P, R, B)))
        more(seen, PHI, times(by_bias, block_transposed(P, PHI, B)))
        more(seen, V, times(by_bias, block_transposed(P, V, B)))
        more(seen, R, times(by_bias, block_transposed(P, R, B)))
        more(seen, C, times(by_bias, block_transposed(P, C, B)))
        more(seen, B, times(by_bias, diagonal(P, B)))
        height = sum3(height, applied(by_bias, row(P, H, B)))
    seen[0, H], seen[1, H], seen[2, H] = height


@inlined
def put(seen: FloatArray, j: int, M: Matrix) -> None:
    """Write the block of three columns from ``j``."""
    seen[0, j], seen[0, j + 1], seen[0, j + 2] = M[0], M[1], M[2]
    seen[1, j], seen[1, j + 1], seen[1, j + 2] = M[3], M[4], M[5]
    seen[2, j], seen[2, j + 1], seen[2, j + 2] = M[6], M[7], M[8]


@inlined
def more(seen: FloatArray, j: int, M: Matrix) -> None:
    """Add to the block of three columns from ``j``."""
    add_block(seen, PHI, j, M)


@inlined
def take_three(P: FloatArray, seen: FloatArray, gains: FloatArray, first: int, size: int) -> None:
    """Reduce the covariance by three gains' rows times their ``seen`` rows."""
    width = P.shape[1]
    rows = seen.reshape(3 * WIDTH)
    for i in range(size):
        g0, g1, g2 = gains[first, i], gains[first + 1, i], gains[first + 2, i]
        for j in range(width):
            P[i, j] -= g0 * rows[j] + g1 * rows[WIDTH + j] + g2 * rows[2 * WIDTH + j]


@inlined
def take_one(P: FloatArray, seen: FloatArray, gains: FloatArray, first: int, size: int) -> None:
    """Reduce the covariance by one gain's row times the first row of ``seen``."""
    width = P.shape[1]
    for i in range(size):
        g0 = gains[first, i]
        for j in range(width):
            P[i, j] -= g0 * seen[0, j]
