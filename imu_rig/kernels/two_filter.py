"""The recurrences of the two-filter foot smoother: strapdown and Kalman filter, either way.

Suh and Chee, "Foot Motion Estimation Smoother using Inertial Sensors", eqs. (3)-(17). One code runs
both filters: backwards in time every interval counts negative.

The error state is ``[qbar, r, v]``: half the small rotation in sensor axes, position [m] and
velocity [m/s] in navigation axes; truth is ``q ⊗ [1, qbar]``, ``r + r_e``, ``v + v_e``.
"""

from __future__ import annotations

import math

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.kernels.compiled import compiled


@compiled
def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the Hamilton product of two quaternions (4,), of unit norm."""
    out = np.empty(4)
    out[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    out[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    out[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    out[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]
    return out / math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + out[3] ** 2)


@compiled
def turned(q: FloatArray, v: FloatArray) -> FloatArray:
    """Return a vector (3,) of sensor axes in navigation axes."""
    out = np.empty(3)
    tx = 2.0 * (q[2] * v[2] - q[3] * v[1])
    ty = 2.0 * (q[3] * v[0] - q[1] * v[2])
    tz = 2.0 * (q[1] * v[1] - q[2] * v[0])
    out[0] = v[0] + q[0] * tx + q[2] * tz - q[3] * ty
    out[1] = v[1] + q[0] * ty + q[3] * tx - q[1] * tz
    out[2] = v[2] + q[0] * tz + q[1] * ty - q[2] * tx
    return out


@compiled
def _rated(q: FloatArray, w: FloatArray) -> FloatArray:
    """Return ``Omega(w) q``, which is ``q ⊗ [0, w]``."""
    out = np.empty(4)
    out[0] = -q[1] * w[0] - q[2] * w[1] - q[3] * w[2]
    out[1] = q[0] * w[0] + q[2] * w[2] - q[3] * w[1]
    out[2] = q[0] * w[1] - q[1] * w[2] + q[3] * w[0]
    out[3] = q[0] * w[2] + q[1] * w[1] - q[2] * w[0]
    return out


@compiled
def attitude_step(q: FloatArray, rate: FloatArray, earlier: FloatArray, dt: float) -> FloatArray:
    """Return the attitude after ``dt`` [s], eqs. (3) and (6).

    Parameters
    ----------
    q : shape (4,)
        At the start of the step.
    rate : shape (3,)
        At the start of the step [rad/s].
    earlier : shape (3,)
        A whole step before the start.
    dt : float
        Negative backwards.
    """
    by_rate = _rated(q, rate)
    by_earlier = _rated(q, earlier)
    both = _rated(by_earlier, rate)
    square = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
    out: FloatArray = (
        (1.0 - square * dt**2 / 6.0) * q
        + dt * (0.75 * by_rate - 0.25 * by_earlier)
        - dt**2 / 24.0 * both
        - dt**3 * square / 48.0 * by_rate
    )
    out /= math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + out[3] ** 2)
    return out


@compiled
def transition(
    q0: FloatArray, q1: FloatArray, force0: FloatArray, force1: FloatArray, dt: float
) -> FloatArray:
    """Return how a step carries the error state on, (9, 9): eqs. (12) and (16), discrete.

    This is the exact derivative of eqs. (4) and (7), so that it tends to eq. (12) for small steps
    and stays true for long ones.

    Parameters
    ----------
    q0, q1 : shape (4,)
        Attitude before and after the step.
    force0, force1 : shape (3,)
        Specific force in sensor axes then [m/s^2].
    dt : float
        Negative backwards [s].
    """
    F = np.eye(9)
    inverse = np.empty(4)
    inverse[0] = q1[0]
    inverse[1:] = -q1[1:]
    between = product(inverse, q0)  # from sensor axes before to those after
    axis = np.zeros(3)
    for j in range(3):
        axis[:] = 0.0
        axis[j] = 1.0
        after = turned(between, axis)
        F[:3, j] = after
        # -2 C' [y x] qbar = 2 C' (qbar x y), at both ends of the trapezoid
        change = turned(q0, np.cross(axis, force0)) + turned(q1, np.cross(after, force1))
        F[6:, j] = dt * change
        F[3:6, j] = 0.5 * dt * dt * change
        F[3 + j, 6 + j] = dt
    return F


@compiled
def _propagated(F: FloatArray, P: FloatArray, gyro: float, accel: float, dt: float) -> FloatArray:
    """Return the covariance (9, 9) after a step; noises are densities as of `run_filter`."""
    half = np.zeros((9, 9))
    out = np.zeros((9, 9))
    for i in range(9):
        for k in range(9):
            if F[i, k] != 0.0:
                for j in range(9):
                    half[i, j] += F[i, k] * P[k, j]
    for j in range(9):
        for k in range(9):
            if F[j, k] != 0.0:
                for i in range(j + 1):
                    out[i, j] += half[i, k] * F[j, k]
    span = abs(dt)
    for i in range(3):
        out[i, i] += 0.25 * gyro**2 * span
        out[3 + i, 3 + i] += accel**2 * span**3 / 3.0
        out[3 + i, 6 + i] += accel**2 * span * dt / 2.0
        out[6 + i, 6 + i] += accel**2 * span
    for i in range(9):
        for j in range(i):
            out[i, j] = out[j, i]
    return out


@compiled
def _observed(x: FloatArray, P: FloatArray, row: int, seen: float, variance: float) -> None:
    """Learn in place that component ``row`` of the error state was seen, eqs. (13) and (14)."""
    total = P[row, row] + variance
    column = P[:, row].copy()
    gain = column / total
    x += gain * (seen - x[row])
    for i in range(9):
        for j in range(i + 1):
            P[i, j] -= gain[i] * column[j]
            P[j, i] = P[i, j]


@compiled
def yaw_update(q: FloatArray, P: FloatArray, field: FloatArray, variance: float) -> None:
    """Turn the attitude about the vertical towards magnetic north, in place, and nothing else.

    The gain is the best of those that move yaw only; the covariance is that of this gain.

    Parameters
    ----------
    q : shape (4,)
    P : shape (9, 9)
    field : shape (3,)
        Magnetic field in sensor axes, any unit; navigation x points along its level part.
    variance : float
        Of its direction on the level [rad^2].
    """
    level = turned(q, field)
    if level[0] == 0.0 and level[1] == 0.0:
        return
    error = -math.atan2(level[1], level[0])
    inverse = np.empty(4)
    inverse[0] = q[0]
    inverse[1:] = -q[1:]
    up = turned(inverse, np.array([0.0, 0.0, 1.0]))  # the vertical, in sensor axes
    H = np.zeros(9)
    H[:3] = 2.0 * up
    PH = P @ H
    spread = 0.0
    for i in range(9):
        spread += H[i] * PH[i]
    gain = spread / (spread + variance)
    half = 0.5 * gain * error
    turn = np.empty(4)
    turn[0] = math.cos(half)
    turn[1:] = math.sin(half) * up
    q[:] = product(q, turn)
    K = np.zeros(9)
    K[:3] = 0.5 * gain * up
    for i in range(9):
        for j in range(i + 1):
            P[i, j] += (spread + variance) * K[i] * K[j] - K[i] * PH[j] - PH[i] * K[j]
            P[j, i] = P[i, j]


@compiled
def _measured(
    q: FloatArray,
    r: FloatArray,
    v: FloatArray,
    P: FloatArray,
    velocity_variance: float,
    height_variance: float,
    yaw_variance: float,
    field: FloatArray,
) -> None:
    """Take in what is known of one sample, in place; infinite variances say that nothing is."""
    if velocity_variance < math.inf:
        x = np.zeros(9)
        for i in range(3):
            _observed(x, P, 6 + i, -v[i], velocity_variance)
        if height_variance < math.inf:
            _observed(x, P, 5, -r[2], height_variance)
        turn = np.empty(4)
        turn[0] = 1.0
        turn[1:] = x[:3]
        q[:] = product(q, turn)
        r += x[3:6]
        v += x[6:]
    if yaw_variance < math.inf:
        yaw_update(q, P, field, yaw_variance)


@compiled
def run_filter(
    first: int,
    last: int,
    t: FloatArray,
    gyro: FloatArray,
    accel: FloatArray,
    field: FloatArray,
    variances: FloatArray,
    noise: FloatArray,
    start: FloatArray,
    P0: FloatArray,
    states: FloatArray,
    covariances: FloatArray,
) -> None:
    """Filter one step from sample ``first`` to ``last``; backwards in time where last is before.

    Forwards, the start holds what was measured at ``first`` already and every result includes the
    measurement of its sample. Backwards, the measurement at ``last`` is not used, that at ``first``
    is, and results are those **before** the measurement of their sample, which eq. (24) takes.

    Parameters
    ----------
    first, last : int
    t : shape (n,)
        [s].
    gyro, accel : shape (n, 3)
        Sensor axes [rad/s, m/s^2].
    field : shape (n, 3)
        Magnetic field in sensor axes; not looked at where its variance is infinite.
    variances : shape (n, 3)
        Of zero velocity [m^2/s^2], of zero height [m^2], of the field's direction [rad^2]; infinite
        where there is no such measurement.
    noise : shape (3,)
        Densities of gyroscope and accelerometer [rad/s, m/s^2 per root Hz]; gravity [m/s^2].
    start : shape (10,)
        Quaternion, position, velocity at ``first``.
    P0 : shape (9, 9)
    states : shape (n, 10), covariances : shape (n, 9, 9)
        Written from ``first`` to ``last``.
    """
    way = 1 if last >= first else -1
    n = len(t)
    q, r, v = start[:4].copy(), start[4:7].copy(), start[7:].copy()
    P = P0.copy()
    k = first
    while True:
        states[k, :4], states[k, 4:7], states[k, 7:] = q, r, v
        covariances[k] = P
        if way < 0:
            _measured(q, r, v, P, variances[k, 0], variances[k, 1], variances[k, 2], field[k])
        if k == last:
            return
        j = k + way
        dt = t[j] - t[k]
        earlier = gyro[k].copy()
        if 0 <= k - way < n and t[k] != t[k - way]:
            # of unequal steps the longer is not extrapolated by more than the shorter tells
            share = min(1.0, dt / (t[k] - t[k - way]))
            earlier -= share * (gyro[k] - gyro[k - way])
        q1 = attitude_step(q, gyro[k], earlier, dt)
        F = transition(q, q1, accel[k], accel[j], dt)
        P = _propagated(F, P, noise[0], noise[1], dt)
        felt = 0.5 * dt * (turned(q, accel[k]) + turned(q1, accel[j]))
        felt[2] -= dt * noise[2]
        r += dt * (v + 0.5 * felt)
        v += felt
        q = q1
        k = j
        if way > 0:
            _measured(q, r, v, P, variances[k, 0], variances[k, 1], variances[k, 2], field[k])
