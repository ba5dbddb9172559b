"""The strapdown steps and the linear model of the two-filter smoother, by calculus and physics."""

import numpy as np
import pytest

from imu_rig.kernels.two_filter import attitude_step, run_filter, transition, yaw_update
from imu_rig.rotation import (
    compose,
    conjugate,
    from_rotation_vector,
    multiply,
    normalize,
    rotate,
    skew,
    to_matrix,
    to_rotation_vector,
)
from imu_rig.units import DEG

G = 9.81
START_RATE, RATE_SLOPE = np.array((1.0, -2.0, 3.0)), np.array((20.0, 30.0, -10.0))
Q0 = normalize(np.array((0.7, -0.2, 0.5, 0.4)))


def turn_of_linear_rate(rate, slope, dt):
    """The turn over ``dt`` by very many small ones, each about the rate in its middle."""
    n = 2000
    middle = (np.arange(n) + 0.5) * dt / n
    return compose(from_rotation_vector((rate + middle[:, None] * slope) * dt / n))


def local_error(dt):
    truth = multiply(Q0, turn_of_linear_rate(START_RATE, RATE_SLOPE, dt))
    step = attitude_step(Q0, START_RATE, START_RATE - dt * RATE_SLOPE, dt)
    return np.linalg.norm(to_rotation_vector(multiply(conjugate(truth), step)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_local_error_of_the_attitude_step_falls_by_8_when_the_interval_halves(sign):
    errors = [local_error(sign * dt) for dt in (0.02, 0.01, 0.005)]
    assert errors[0] / errors[1] == pytest.approx(8.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(8.0, rel=0.1)


def test_a_constant_rate_turns_as_it_should():
    dt, rate = 0.01, np.array((5.0, -3.0, 2.0))
    step = attitude_step(Q0, rate, rate, dt)
    truth = multiply(Q0, from_rotation_vector(rate * dt))
    assert np.abs(step - truth).max() < 0.2 * (np.linalg.norm(rate) * dt) ** 4


def motion(n=50, dt=0.01, seed=0):
    """Smooth readings of no motion in particular."""
    t = dt * np.arange(n)
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 6.0, (2, 3))
    gyro = 3.0 * np.sin(8.0 * t[:, None] + phase[0])
    accel = np.array((0.5, -1.0, 9.0)) + 4.0 * np.sin(10.0 * t[:, None] + phase[1])
    return t, gyro, accel


def strapdown(t, gyro, accel, first, last, start, noise=(1e-3, 1e-2), P0=None):
    n = len(t)
    states, P = np.zeros((n, 10)), np.zeros((n, 9, 9))
    nothing = np.full((n, 3), np.inf)
    densities = np.array((*noise, G))
    P0 = np.eye(9) if P0 is None else P0
    run_filter(
        first, last, t, gyro, accel, np.zeros((n, 3)), nothing, densities, start, P0, states, P
    )
    return states, P


def moved(state, x):
    """A state of which ``x`` is the error."""
    turn = np.concatenate(([np.sqrt(1.0 - x[:3] @ x[:3])], x[:3]))
    return np.concatenate((multiply(state[:4], turn), state[4:] + x[3:]))


def error(truth, state):
    d = multiply(conjugate(state[:4]), truth[:4])
    return np.concatenate((d[1:] * np.sign(d[0]), truth[4:] - state[4:]))


@pytest.mark.parametrize(("k", "j"), [(20, 21), (21, 20)])
def test_the_transition_is_the_derivative_of_the_strapdown_step(k, j):
    t, gyro, accel = motion()
    state = np.concatenate((Q0, (1.0, 2.0, 3.0, -0.5, 0.4, 0.3)))
    one = strapdown(t, gyro, accel, k, j, state)[0][j]
    F = transition(Q0, one[:4], accel[k], accel[j], t[j] - t[k])
    eps = 1e-5
    by_difference = np.empty((9, 9))
    for column in range(9):
        x = np.zeros(9)
        x[column] = eps
        plus = strapdown(t, gyro, accel, k, j, moved(state, x))[0][j]
        minus = strapdown(t, gyro, accel, k, j, moved(state, -x))[0][j]
        by_difference[:, column] = (error(plus, one) - error(minus, one)) / (2.0 * eps)
    assert np.abs(F - by_difference).max() < 1e-8


def test_the_transition_tends_to_the_printed_differential_equation():
    w, f, dt = np.array((1.0, -2.0, 0.5)), np.array((3.0, -1.0, 9.0)), 1e-6
    q1 = multiply(Q0, from_rotation_vector(w * dt))
    A = np.zeros((9, 9))
    A[:3, :3] = -skew(w)
    A[3:6, 6:] = np.eye(3)
    A[6:, :3] = -2.0 * to_matrix(Q0) @ skew(f)
    assert np.abs((transition(Q0, q1, f, f, dt) - np.eye(9)) / dt - A).max() < 1e-4


def test_covariance_is_that_of_many_runs_with_noisy_readings():
    t, gyro, accel = motion(30)
    start = np.concatenate((Q0, np.zeros(6)))
    rng = np.random.default_rng(1)
    dt, noise = t[1] - t[0], (0.02, 0.1)
    exact, P = strapdown(t, gyro, accel, 0, 29, start, noise, np.zeros((9, 9)))
    runs = []
    for _ in range(600):
        g = gyro + rng.normal(0.0, noise[0] / np.sqrt(dt), gyro.shape)
        a = accel + rng.normal(0.0, noise[1] / np.sqrt(dt), accel.shape)
        runs.append(error(exact[29], strapdown(t, g, a, 0, 29, start, noise)[0][29]))
    scatter = np.cov(np.array(runs).T)
    # 29 intervals from 30 readings; the trapezoid halves the first and the last
    ratio = np.diag(scatter) / np.diag(P[29])
    assert np.all(np.abs(ratio - 1.0) < 0.25)
    whitened = np.linalg.solve(np.linalg.cholesky(P[29]), np.array(runs).T)
    assert np.mean(np.sum(whitened**2, axis=0)) / 9.0 == pytest.approx(1.0, abs=0.1)


def test_backwards_undoes_forwards():
    t, gyro, accel = motion(60, 0.005)
    start = np.concatenate((Q0, (1.0, 2.0, 3.0, -0.5, 0.4, 0.3)))
    there = strapdown(t, gyro, accel, 1, 58, start)[0][58]
    back = strapdown(t, gyro, accel, 58, 1, there)[0][1]
    assert np.abs(error(start, back)).max() < 1e-4
    assert np.abs(error(start, there)).max() > 0.1


def test_equal_stamps_change_nothing_and_unequal_ones_little():
    t, gyro, accel = motion(60, 0.005)
    start = np.concatenate((Q0, np.zeros(6)))
    even = strapdown(t, gyro, accel, 0, 59, start)[0][59]
    twice = np.insert(np.arange(60), 30, 30)
    again = strapdown(t[twice], gyro[twice], accel[twice], 0, 60, start)[0][60]
    assert np.abs(error(even, again)).max() < 1e-3
    kept = np.delete(np.arange(60), [10, 25, 26, 40])
    uneven = strapdown(t[kept], gyro[kept], accel[kept], 0, len(kept) - 1, start)[0][-len(t) :]
    assert np.abs(error(even, uneven[len(kept) - 1])).max() < 0.01


@pytest.mark.parametrize("seed", range(4))
def test_the_field_turns_yaw_and_leaves_roll_and_pitch(seed):
    rng = np.random.default_rng(seed)
    q = normalize(rng.normal(size=4))
    A = rng.normal(size=(9, 9))
    P = A @ A.T * 1e-3
    before, P_before = q.copy(), P.copy()
    # a field that is wrong in dip and strength as well
    field = rotate(conjugate(q), 80.0 * np.array((np.cos(0.3), np.sin(0.3), -2.0)))
    yaw_update(q, P, field, (5.0 * DEG) ** 2)
    up = np.array((0.0, 0.0, 1.0))
    assert np.abs(rotate(conjugate(q), up) - rotate(conjugate(before), up)).max() < 1e-14
    turn = to_rotation_vector(multiply(q, conjugate(before)))
    J = 2.0 * to_matrix(before)
    spread = (J @ P_before[:3, :3] @ J.T)[2, 2]
    assert turn[2] == pytest.approx(-0.3 * spread / (spread + (5.0 * DEG) ** 2))
    # nothing but yaw is known better than before, and the covariance stays one
    after = np.zeros((9, 9))
    after[:3, :3], after[3:, 3:] = J, np.eye(6)
    was, now = after @ P_before @ after.T, after @ P @ after.T
    others = [0, 1, 3, 4, 5, 6, 7, 8]
    assert np.abs(now[np.ix_(others, others)] - was[np.ix_(others, others)]).max() < 1e-12
    assert now[2, 2] == pytest.approx(1.0 / (1.0 / spread + 1.0 / (5.0 * DEG) ** 2))
    assert np.linalg.eigvalsh(P).min() > 0.0
