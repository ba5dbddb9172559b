"""The velocity that a strapdown integration leaves at the end of each stride."""

from __future__ import annotations

import math

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.kernels.compiled import compiled


@compiled
def turned(
    w: float, x: float, y: float, z: float, a: float, b: float, c: float
) -> tuple[float, float, float]:
    """Turn the vector (a, b, c) by the unit quaternion (w, x, y, z)."""
    return (
        (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c,
        (1 - 2 * (x * x + z * z)) * b + 2 * (x * y + w * z) * a + 2 * (y * z - w * x) * c,
        (1 - 2 * (x * x + y * y)) * c + 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b,
    )


@compiled
def stride_velocities(
    dt: FloatArray,
    gyro: FloatArray,
    accel: FloatArray,
    first: IntArray,
    last: IntArray,
    up: FloatArray,
    gravity: float,
    axes: FloatArray,
) -> FloatArray:
    """Integrate each stride from rest, once for each way of reading the gyroscope's axes.

    A stride begins and ends at rest, so what is left at its end is error. Each begins with the
    tilt that ``up`` says, and any heading.

    Parameters
    ----------
    dt : shape (n,)
        Time since the sample before [s].
    gyro, accel : shape (n, 3)
        [rad/s, m/s^2]
    first, last : shape (k,)
        First and last sample of each stride.
    up : shape (k, 3)
        Specific force at the beginning of each stride, sensor axes.
    gravity : float
        [m/s^2]
    axes : shape (h, 3, 3)
        What the gyroscope's readings are multiplied by.

    Returns
    -------
    shape (h, k, 3)
        [m/s], z up.
    """
    left = np.zeros((len(axes), len(first), 3))
    for h in range(len(axes)):
        a = axes[h]
        for k in range(len(first)):
            ux, uy, uz = up[k, 0], up[k, 1], up[k, 2]
            size = math.sqrt(ux * ux + uy * uy + uz * uz)
            # The shortest rotation that takes the measured "up" to z.
            w, x, y, z = size + uz, uy, -ux, 0.0
            norm = math.sqrt(w * w + x * x + y * y)
            if norm > 1e-6 * size:
                w, x, y = w / norm, x / norm, y / norm
            else:
                w, x, y = 0.0, 1.0, 0.0
            vx, vy, vz = 0.0, 0.0, 0.0
            i = first[k]
            ox, oy, oz = turned(w, x, y, z, accel[i, 0], accel[i, 1], accel[i, 2])
            for i in range(first[k] + 1, last[k] + 1):
                d = dt[i]
                gx = 0.25 * d * (gyro[i, 0] + gyro[i - 1, 0])
                gy = 0.25 * d * (gyro[i, 1] + gyro[i - 1, 1])
                gz = 0.25 * d * (gyro[i, 2] + gyro[i - 1, 2])
                hx = a[0, 0] * gx + a[0, 1] * gy + a[0, 2] * gz
                hy = a[1, 0] * gx + a[1, 1] * gy + a[1, 2] * gz
                hz = a[2, 0] * gx + a[2, 1] * gy + a[2, 2] * gz
                w, x, y, z = (
                    w - x * hx - y * hy - z * hz,
                    x + w * hx + y * hz - z * hy,
                    y + w * hy - x * hz + z * hx,
                    z + w * hz + x * hy - y * hx,
                )
                near = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)  # 1 / norm, near 1
                if near < 0.9:  # turning by a radian a sample
                    near = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
                w, x, y, z = w * near, x * near, y * near, z * near
                nx, ny, nz = turned(w, x, y, z, accel[i, 0], accel[i, 1], accel[i, 2])
                vx += 0.5 * d * (ox + nx)
                vy += 0.5 * d * (oy + ny)
                vz += 0.5 * d * (oz + nz) - gravity * d
                ox, oy, oz = nx, ny, nz
            left[h, k, 0] = vx
            left[h, k, 1] = vy
            left[h, k, 2] = vz
    return left
