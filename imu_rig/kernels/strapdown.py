"""Attitude by the exponential map, on scalars: small functions that compilers put in line.

Quaternions are tuples ``(w, x, y, z)``, sensor to navigation; matrices are tuples of nine numbers,
row by row.
"""

from __future__ import annotations

import math

from imu_rig.kernels.compiled import inlined

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix = tuple[float, float, float, float, float, float, float, float, float]


@inlined
def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product; ``q`` turns first."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


@inlined
def exponential(x: float, y: float, z: float) -> Quaternion:
    """Quaternion of a rotation vector [rad]."""
    quarter = 0.25 * (x * x + y * y + z * z)
    if quarter < 0.06:  # series of cosine and sine / angle, exact to the last bit so far
        cosine = 1.0 + quarter * (
            -1 / 2 + quarter * (1 / 24 + quarter * (-1 / 720 + quarter * (1 / 40320)))
        )
        cosine += quarter**5 * (-1 / 3628800 + quarter * (1 / 479001600))
        sine = 1.0 + quarter * (
            -1 / 6 + quarter * (1 / 120 + quarter * (-1 / 5040 + quarter * (1 / 362880)))
        )
        sine += quarter**5 * (-1 / 39916800 + quarter * (1 / 6227020800))
    else:
        angle = math.sqrt(quarter)
        cosine = math.cos(angle)
        sine = math.sin(angle) / angle
    half = 0.5 * sine
    return (cosine, half * x, half * y, half * z)


@inlined
def unit(q: Quaternion) -> Quaternion:
    """Take rounding out of the length of a quaternion, which is 1 but for that."""
    s = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (s * q[0], s * q[1], s * q[2], s * q[3])


@inlined
def matrix(q: Quaternion) -> Matrix:
    """Rotation matrix of a unit quaternion, sensor to navigation."""
    w, x, y, z = q
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@inlined
def integrated_rate(dt: float, w0: Vector, w1: Vector) -> Vector:
    """Rotation vector [rad] of a step of ``dt`` over which the rate goes linearly from w0 to w1.

    The mean rate, and the coning that a turning axis adds: ``dt^2 / 12 w0 x w1``, the second term
    of the Magnus series (equally of Bortz's equation, IEEE Trans. AES-7, 1971) for a linear rate.
    """
    half, cone = 0.5 * dt, dt * dt / 12.0
    return (
        half * (w0[0] + w1[0]) + cone * (w0[1] * w1[2] - w0[2] * w1[1]),
        half * (w0[1] + w1[1]) + cone * (w0[2] * w1[0] - w0[0] * w1[2]),
        half * (w0[2] + w1[2]) + cone * (w0[0] * w1[1] - w0[1] * w1[0]),
    )
