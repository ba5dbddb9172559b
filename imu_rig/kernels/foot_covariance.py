"""Covariance of smoothed foot states, and what constant errors of the sensor do to them.

The linear smoother of `foot_filter` once more, on errors instead of states, with horizontal
position as a state of its own and the gyro bias as a constant error in place of one. It goes
forward twice: once to keep what is known at few samples, and again from each of these to the next
while it goes back, so that it needs no memory that grows with what lies between them.

Smoothed covariance by the adjoint form (G. J. Bierman, "Fixed interval smoothing with discrete
measurements", Int. J. Control 18, 1973); covariance between two moments of the smoothed path by
P. de Jong and M. J. Mackinnon, "Covariances for smoothed estimates in state space models",
Biometrika 75, 1988.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.kernels.blocks3 import applied, cross
from imu_rig.kernels.compiled import compiled, inlined
from imu_rig.kernels.strapdown import Matrix, Vector, matrix

N = 16
"""Errors of attitude (3), velocity (3), position (3), accelerometer bias (3), floor, pivot (3)."""

ERRORS = 25
"""Constant ones: gyro bias (3), gyro matrix (9), accelerometer matrix (9) and bias (3), and how
late the gyroscope comes."""

_WIDTH = N + ERRORS
_LOG = 2 * N + 1 + ERRORS


@compiled
def smoothed_covariance(
    readings: FloatArray,
    quaternion: FloatArray,
    measured: FloatArray,
    unseen: FloatArray,
    model: FloatArray,
    errors: FloatArray,
    begin: FloatArray,
    rows: IntArray,
    footfall: BoolArray,
    random: FloatArray,
    constant: FloatArray,
    between: FloatArray,
) -> None:
    """Fill in the covariance of smoothed errors at some samples.

    Parameters
    ----------
    readings : shape (n, 7)
        Time since the sample before [s], angular rate [rad/s] and specific force [m/s^2] without
        bias.
    quaternion : shape (n, 4)
        Smoothed, sensor to navigation.
    measured : shape (n, 2)
        Variances of "as if it turned about the pivot" [m^2/s^2] and of "at the floor's height"
        [m^2], 0 for none.
    unseen : shape (n, 3)
        What the step to the sample adds to the variances of floor [m^2], attitude [rad^2] and
        velocity [m^2/s^2] beside the process noise.
    model : shape (9,)
        Process noise of attitude (constant and per rate), of velocity (constant and per
        acceleration), random walk of the accelerometer's bias, gravity, pivot (3).
    errors : shape (13,)
        Columns of a factor of the gyro bias' covariance (9), standard uncertainties of the gyro's
        and the accelerometer's matrix, of the accelerometer's bias, and of the gyroscope's time
        against the accelerometer's [s].
    begin : shape (16, 41)
        Covariance of the first errors, and beside it what constant errors did to them.
    rows : shape (m,)
        Samples asked for, ascending, the first sample and the last among them.
    footfall : shape (m,)
        Which of them displacements are counted between.
    random : shape (m, 9, 9)
        Out: covariance of attitude, velocity and position by all that is noise.
    constant : shape (m, 9, 25)
        Out: what each constant error of one standard uncertainty adds.
    between : shape (m, 3, 3)
        Out, at footfalls but the last: covariance of the displacement to the next one, by noise.
    """
    m = len(rows)
    known = np.empty((m, N, _WIDTH))
    known[0] = begin
    longest = 4
    for s in range(1, m):
        longest = max(longest, 4 * (rows[s] - rows[s - 1]))
    log = np.empty((longest, _LOG))
    seen = np.empty(_WIDTH + 3)
    for s in range(m):
        if s > 0:
            known[s] = known[s - 1]
        first = rows[s - 1] if s > 0 else -1
        _forward(
            known[s], first, rows[s], readings, quaternion, measured, unseen, model, errors,
            log, seen,
        )  # fmt: skip
    X = np.empty((N, _WIDTH))
    # adjoints of the covariance, of the constant errors, and of the place at the next footfall
    Y = np.zeros((N, _WIDTH + 3))
    ahead = -1
    for s in range(m - 1, -1, -1):
        P = known[s]
        _smoothed(P, Y, random[s], constant[s], seen)
        if footfall[s]:
            if ahead >= 0:
                _between(P, Y, random[s], random[ahead], between[s])
            for i in range(N):
                for j in range(3):
                    Y[i, _WIDTH + j] = 1.0 if i == 6 + j else 0.0
                    for a in range(N):
                        Y[i, _WIDTH + j] -= Y[i, a] * P[a, 6 + j]
            ahead = s
        if s > 0:
            X[:] = known[s - 1]
            used = _forward(
                X, rows[s - 1], rows[s], readings, quaternion, measured, unseen, model, errors, log,
                seen,
            )  # fmt: skip
            for k in range(rows[s], rows[s - 1], -1):
                count = 3 if measured[k, 0] > 0.0 else 0
                if measured[k, 1] > 0.0:
                    count += 1
                for _ in range(count):
                    used -= 1
                    _measure_back(Y, log[used], seen)
                _predict_back(Y, k, readings, quaternion)


@compiled
def _forward(
    X: FloatArray,
    first: int,
    last: int,
    readings: FloatArray,
    quaternion: FloatArray,
    measured: FloatArray,
    unseen: FloatArray,
    model: FloatArray,
    errors: FloatArray,
    log: FloatArray,
    seen: FloatArray,
) -> int:
    """Take covariance and constant errors from one sample to another, and log measurements."""
    used = 0
    for k in range(first + 1, last + 1):
        if k > 0:
            _predict(X, k, readings, quaternion, unseen, model, errors)
        used = _measure(X, k, readings, quaternion, measured, model, log, used, seen)
    return used


@inlined
def _predict(
    X: FloatArray,
    k: int,
    readings: FloatArray,
    quaternion: FloatArray,
    unseen: FloatArray,
    model: FloatArray,
    errors: FloatArray,
) -> None:
    """Take covariance and constant errors from sample k - 1 to k."""
    dt = readings[k, 0]
    C, a = _step(k, readings, quaternion)
    for j in range(_WIDTH):
        bx, by, bz = X[9, j], X[10, j], X[11, j]
        dx = dt * (a[2] * X[1, j] - a[1] * X[2, j] - C[0] * bx - C[1] * by - C[2] * bz)
        dy = dt * (a[0] * X[2, j] - a[2] * X[0, j] - C[3] * bx - C[4] * by - C[5] * bz)
        dz = dt * (a[1] * X[0, j] - a[0] * X[1, j] - C[6] * bx - C[7] * by - C[8] * bz)
        X[6, j] += dt * (X[3, j] + 0.5 * dx)
        X[7, j] += dt * (X[4, j] + 0.5 * dy)
        X[8, j] += dt * (X[5, j] + 0.5 * dz)
        X[3, j] += dx
        X[4, j] += dy
        X[5, j] += dz
    for i in range(N):
        R = X[i]
        dx = dt * (a[2] * R[1] - a[1] * R[2] - C[0] * R[9] - C[1] * R[10] - C[2] * R[11])
        dy = dt * (a[0] * R[2] - a[2] * R[0] - C[3] * R[9] - C[4] * R[10] - C[5] * R[11])
        dz = dt * (a[1] * R[0] - a[0] * R[1] - C[6] * R[9] - C[7] * R[10] - C[8] * R[11])
        R[6] += dt * (R[3] + 0.5 * dx)
        R[7] += dt * (R[4] + 0.5 * dy)
        R[8] += dt * (R[5] + 0.5 * dz)
        R[3] += dx
        R[4] += dy
        R[5] += dz
    w = (readings[k, 1], readings[k, 2], readings[k, 3])
    az = a[2] - model[5]
    turning = model[0] ** 2 + model[1] ** 2 * (w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    moving = model[2] ** 2 + model[3] ** 2 * (a[0] ** 2 + a[1] ** 2 + az**2)
    for i in range(3):
        X[i, i] += dt * turning + unseen[k, 1]
        X[3 + i, 3 + i] += dt * moving + unseen[k, 2]
        X[9 + i, 9 + i] += dt * model[4] ** 2
    X[12, 12] += unseen[k, 0]
    for i in range(3):  # a reading that is too large takes its excess from the error of the state
        for j in range(3):
            late = errors[12] * (readings[k, 1 + j] - readings[k - 1, 1 + j])
            X[i, N + 24] -= C[3 * i + j] * late
            c = -dt * C[3 * i + j]
            for b in range(3):
                X[i, N + b] += c * errors[3 * j + b]
                X[i, N + 3 + 3 * j + b] += c * errors[9] * readings[k, 1 + b]
                push = c * errors[10] * readings[k, 4 + b]
                X[3 + i, N + 12 + 3 * j + b] += push
                X[6 + i, N + 12 + 3 * j + b] += 0.5 * dt * push
            X[3 + i, N + 21 + j] += c * errors[11]
            X[6 + i, N + 21 + j] += 0.5 * dt * c * errors[11]


@inlined
def _step(k: int, readings: FloatArray, quaternion: FloatArray) -> tuple[Matrix, Vector]:
    """Return attitude and specific force, navigation axes, in the middle of a step."""
    p, q = quaternion[k - 1], quaternion[k]
    A = matrix((p[0], p[1], p[2], p[3]))
    B = matrix((q[0], q[1], q[2], q[3]))
    x = applied(A, (readings[k - 1, 4], readings[k - 1, 5], readings[k - 1, 6]))
    y = applied(B, (readings[k, 4], readings[k, 5], readings[k, 6]))
    C = (
        0.5 * (A[0] + B[0]), 0.5 * (A[1] + B[1]), 0.5 * (A[2] + B[2]),
        0.5 * (A[3] + B[3]), 0.5 * (A[4] + B[4]), 0.5 * (A[5] + B[5]),
        0.5 * (A[6] + B[6]), 0.5 * (A[7] + B[7]), 0.5 * (A[8] + B[8]),
    )  # fmt: skip
    return C, (0.5 * (x[0] + y[0]), 0.5 * (x[1] + y[1]), 0.5 * (x[2] + y[2]))


@inlined
def _predict_back(Y: FloatArray, k: int, readings: FloatArray, quaternion: FloatArray) -> None:
    """Take the adjoints from sample k to k - 1: ``F' Y``, and on the right of the covariance's."""
    dt = readings[k, 0]
    C, a = _step(k, readings, quaternion)
    for j in range(_WIDTH + 3):
        x = dt * (Y[3, j] + 0.5 * dt * Y[6, j])
        y = dt * (Y[4, j] + 0.5 * dt * Y[7, j])
        z = dt * (Y[5, j] + 0.5 * dt * Y[8, j])
        Y[3, j] += dt * Y[6, j]
        Y[4, j] += dt * Y[7, j]
        Y[5, j] += dt * Y[8, j]
        Y[0, j] += a[1] * z - a[2] * y
        Y[1, j] += a[2] * x - a[0] * z
        Y[2, j] += a[0] * y - a[1] * x
        Y[9, j] -= C[0] * x + C[3] * y + C[6] * z
        Y[10, j] -= C[1] * x + C[4] * y + C[7] * z
        Y[11, j] -= C[2] * x + C[5] * y + C[8] * z
    for i in range(N):
        R = Y[i]
        x = dt * (R[3] + 0.5 * dt * R[6])
        y = dt * (R[4] + 0.5 * dt * R[7])
        z = dt * (R[5] + 0.5 * dt * R[8])
        R[3] += dt * R[6]
        R[4] += dt * R[7]
        R[5] += dt * R[8]
        R[0] += a[1] * z - a[2] * y
        R[1] += a[2] * x - a[0] * z
        R[2] += a[0] * y - a[1] * x
        R[9] -= C[0] * x + C[3] * y + C[6] * z
        R[10] -= C[1] * x + C[4] * y + C[7] * z
        R[11] -= C[2] * x + C[5] * y + C[8] * z


@inlined
def _measure(
    X: FloatArray,
    k: int,
    readings: FloatArray,
    quaternion: FloatArray,
    measured: FloatArray,
    model: FloatArray,
    log: FloatArray,
    used: int,
    seen: FloatArray,
) -> int:
    """Measure what there is at sample k, write down how, and return the next free line."""
    if measured[k, 0] > 0.0:
        q = quaternion[k]
        C = matrix((q[0], q[1], q[2], q[3]))
        w = (readings[k, 1], readings[k, 2], readings[k, 3])
        r = (model[6], model[7], model[8])
        u = applied(C, cross(w, r))
        for i in range(3):
            h = log[used, :N]
            h[:] = 0.0
            h[3 + i] = 1.0
            if i == 0:
                h[1], h[2] = -u[2], u[1]
            elif i == 1:
                h[0], h[2] = u[2], -u[0]
            else:
                h[0], h[1] = -u[1], u[0]
            h[13], h[14], h[15] = cross(w, (C[3 * i], C[3 * i + 1], C[3 * i + 2]))
            _measure_one(X, measured[k, 0], log[used], seen)
            used += 1
    if measured[k, 1] > 0.0:
        h = log[used, :N]
        h[:] = 0.0
        h[8], h[12] = 1.0, -1.0
        _measure_one(X, measured[k, 1], log[used], seen)
        used += 1
    return used


@inlined
def _measure_one(X: FloatArray, variance: float, line: FloatArray, seen: FloatArray) -> None:
    """Measure one number; ``line`` is its row h, the gain, the variance, and h times errors."""
    seen[:] = 0.0
    for i in range(N):
        h = line[i]
        if h != 0.0:
            for j in range(_WIDTH):
                seen[j] += h * X[i, j]
    s = variance
    for i in range(N):
        s += line[i] * seen[i]
    for i in range(N):
        gain = seen[i] / s
        line[N + i] = gain
        for j in range(_WIDTH):
            X[i, j] -= gain * seen[j]
    line[2 * N] = s
    for j in range(ERRORS):
        line[2 * N + 1 + j] = seen[N + j]


@inlined
def _measure_back(Y: FloatArray, line: FloatArray, pulled: FloatArray) -> None:
    """Take the adjoints to before a measurement."""
    s = line[2 * N]
    pulled[:] = 0.0
    for i in range(N):
        gain = line[N + i]
        for j in range(_WIDTH + 3):
            pulled[j] += gain * Y[i, j]
    for j in range(ERRORS):
        pulled[N + j] += line[2 * N + 1 + j] / s
    for i in range(N):
        h = line[i]
        if h != 0.0:
            for j in range(_WIDTH + 3):
                Y[i, j] -= h * pulled[j]
    for i in range(N):
        pushed = -line[i] / s
        for j in range(N):
            pushed += Y[i, j] * line[N + j]
        for j in range(N):
            Y[i, j] -= pushed * line[j]


@inlined
def _smoothed(
    P: FloatArray, Y: FloatArray, random: FloatArray, constant: FloatArray, half: FloatArray
) -> None:
    """Write the covariance ``P - P Y P`` and the errors ``E + P y`` of the first nine states."""
    for i in range(9):
        half[:] = 0.0
        for a in range(N):
            for j in range(_WIDTH):
                half[j] += P[i, a] * Y[a, j]
        for j in range(9):
            value = P[i, j]
            for a in range(N):
                value -= half[a] * P[a, j]
            random[i, j] = value
        for j in range(ERRORS):
            constant[i, j] = P[i, N + j] + half[N + j]


@inlined
def _between(
    P: FloatArray, Y: FloatArray, here: FloatArray, there: FloatArray, out: FloatArray
) -> None:
    """Write the covariance of the displacement from here to the next footfall."""
    for i in range(3):
        for j in range(3):
            shared = 0.0
            for a in range(N):
                shared += P[6 + i, a] * Y[a, _WIDTH + j] + P[6 + j, a] * Y[a, _WIDTH + i]
            out[i, j] = here[6 + i, 6 + j] + there[6 + i, 6 + j] - shared
