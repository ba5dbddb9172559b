"""Orientation by gradient descent: Madgwick, Harrison and Vaidyanathan, ICORR 2011.

The gyroscope turns the attitude; a step down the gradient of the disagreement between measured and
expected direction of gravity (and of the magnetic field) draws it back, at a constant speed.
"""

from __future__ import annotations

import math

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.kernels.compiled import compiled


@compiled
def gradient_descent(
    t: FloatArray,
    accel: FloatArray,
    gyro: FloatArray,
    mag: FloatArray,
    start: FloatArray,
    gain: float,
) -> FloatArray:
    """Follow the attitude of a sensor from its first sample on.

    Between samples it turns by the mean of both rates, exactly and not by the paper's Euler step,
    which a foot's 500 deg/s at 100 Hz would leave behind by a degree per stride. The correction
    goes at the speed ``gain``, but not beyond the bottom of the valley: near it the paper's step
    of constant length would only dither, and after a gap overshoot. What of the slope would change
    the quaternion's norm is left out, or the speed would depend on how the sensor is put on.

    Parameters
    ----------
    t : shape (n,)
        Times [s]. Equal ones pass without effect.
    accel, gyro : shape (n, 3)
        Specific force [m/s^2] and angular rate [rad/s].
    mag : shape (n, 3) or (0, 3)
        Magnetic field in any unit; with none, nothing draws the yaw back. A sample of it that is
        not finite is passed over, as is one of the specific force.
    start : shape (4,)
        Attitude at the first sample, sensor to navigation axes with z up; with a magnetic field,
        x points to its north.
    gain : float
        The paper's beta, the speed of the correction [rad/s] of a quaternion; an attitude turns
        twice as fast.

    Returns
    -------
    shape (n, 4)
        Attitude at each sample, sensor to navigation axes.
    """
    n = len(t)
    q = np.empty((n, 4))
    if n == 0:
        return q
    w, x, y, z = start[0], start[1], start[2], start[3]
    q[0] = start
    for k in range(1, n):
        dt = t[k] - t[k - 1]
        if dt > 0.0:
            a = 0.25 * dt * (gyro[k - 1, 0] + gyro[k, 0])
            b = 0.25 * dt * (gyro[k - 1, 1] + gyro[k, 1])
            c = 0.25 * dt * (gyro[k - 1, 2] + gyro[k, 2])
            half = math.sqrt(a * a + b * b + c * c)
            cosine = math.cos(half)
            sine = math.sin(half) / half if half > 1e-12 else 1.0
            a, b, c = sine * a, sine * b, sine * c
            w, x, y, z = (
                w * cosine - x * a - y * b - z * c,
                w * a + x * cosine + y * c - z * b,
                w * b - x * c + y * cosine + z * a,
                w * c + x * b - y * a + z * cosine,
            )
            ga, gb, gc, gd = 0.0, 0.0, 0.0, 0.0
            size = math.sqrt(accel[k, 0] ** 2 + accel[k, 1] ** 2 + accel[k, 2] ** 2)
            if size > 0.0 and math.isfinite(size):
                # f = conj(q) up q - accel / |accel|, and its Jacobian's transpose times f
                fx = 2.0 * (x * z - w * y) - accel[k, 0] / size
                fy = 2.0 * (w * x + y * z) - accel[k, 1] / size
                fz = 1.0 - 2.0 * (x * x + y * y) - accel[k, 2] / size
                ga = -2.0 * y * fx + 2.0 * x * fy
                gb = 2.0 * z * fx + 2.0 * w * fy - 4.0 * x * fz
                gc = -2.0 * w * fx + 2.0 * z * fy - 4.0 * y * fz
                gd = 2.0 * x * fx + 2.0 * y * fy
            if len(mag) > 0:
                size = math.sqrt(mag[k, 0] ** 2 + mag[k, 1] ** 2 + mag[k, 2] ** 2)
                if size > 0.0 and math.isfinite(size):
                    mx, my, mz = mag[k, 0] / size, mag[k, 1] / size, mag[k, 2] / size
                    # The field in navigation axes gives the dip to expect; its azimuth is zero.
                    hx = (
                        (1.0 - 2.0 * (y * y + z * z)) * mx
                        + 2.0 * (x * y - w * z) * my
                        + 2.0 * (x * z + w * y) * mz
                    )
                    hy = (
                        2.0 * (x * y + w * z) * mx
                        + (1.0 - 2.0 * (x * x + z * z)) * my
                        + 2.0 * (y * z - w * x) * mz
                    )
                    bx = math.sqrt(hx * hx + hy * hy)
                    bz = (
                        2.0 * (x * z - w * y) * mx
                        + 2.0 * (y * z + w * x) * my
                        + (1.0 - 2.0 * (x * x + y * y)) * mz
                    )
                    fx = bx * (1.0 - 2.0 * (y * y + z * z)) + 2.0 * bz * (x * z - w * y) - mx
                    fy = 2.0 * bx * (x * y - w * z) + 2.0 * bz * (w * x + y * z) - my
                    fz = 2.0 * bx * (w * y + x * z) + bz * (1.0 - 2.0 * (x * x + y * y)) - mz
                    ga += 2.0 * (-bz * y * fx + (bz * x - bx * z) * fy + bx * y * fz)
                    gb += 2.0 * (
                        bz * z * fx + (bx * y + bz * w) * fy + (bx * z - 2.0 * bz * x) * fz
                    )
                    gc += 2.0 * (
                        -(2.0 * bx * y + bz * w) * fx
                        + (bx * x + bz * z) * fy
                        + (bx * w - 2.0 * bz * y) * fz
                    )
                    gd += 2.0 * (
                        (bz * x - 2.0 * bx * z) * fx + (bz * y - bx * w) * fy + bx * x * fz
                    )
            along = ga * w + gb * x + gc * y + gd * z
            ga, gb, gc, gd = ga - along * w, gb - along * x, gc - along * y, gd - along * z
            slope = math.sqrt(ga * ga + gb * gb + gc * gc + gd * gd)
            if slope > 0.0:
                # Each direction curves the valley by 4: its bottom is slope / 4 or slope / 8 away.
                step = min(gain * dt / slope, 0.125 if len(mag) > 0 else 0.25)
                w, x, y, z = w - step * ga, x - step * gb, y - step * gc, z - step * gd
            size = math.sqrt(w * w + x * x + y * y + z * z)
            w, x, y, z = w / size, x / size, y / size, z / size
        q[k, 0], q[k, 1], q[k, 2], q[k, 3] = w, x, y, z
    return q
