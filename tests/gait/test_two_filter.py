"""The two-filter smoother: equal to least squares, honest in its covariance, without jumps."""

from dataclasses import fields, replace

import numpy as np
import pytest

from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError, InputError
from imu_rig.gait.triad import triad
from imu_rig.gait.two_filter import TwoFilterOptions, find_stays, smooth_steps
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.kernels.two_filter import run_filter, transition
from imu_rig.rotation import (
    about_z,
    conjugate,
    euler_angles,
    multiply,
    normalize,
    rotate,
    to_matrix,
    to_rotation_vector,
)
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.walker.sensor import SensorMotion
from simulators.walker.walker import Walker

GYRO_NOISE, ACCEL_NOISE = 0.05 * DEG, 0.01
SURE = TwoFilterOptions(gyro_noise=GYRO_NOISE, accel_noise=ACCEL_NOISE, velocity_sigma=1e-4)


@pytest.fixture(scope="module")
def slide():
    """A half circle on a board, 2 s of rest before and after: the truth at 200 Hz."""
    return Walker("half-circle", 1).sensor("left-foot").at(2.0 + 0.005 * np.arange(1400))


def at_100_hz(truth):
    return SensorMotion(*(getattr(truth, f.name)[::2] for f in fields(truth)))


def standing(truth):
    still = np.linalg.norm(truth.velocity, axis=1) < 1e-4
    return stance(still)


def stance(still):
    return ZeroVelocity(still, np.where(still, 0.01, np.inf), 1.0 - still, np.full(len(still), 0.5))


def measured(truth, seed=0, gyro_bias=(0.0, 0.0, 0.0), field=None, noise=1.0):
    rng = np.random.default_rng(seed)
    per_sample = noise / np.sqrt(truth.t[1] - truth.t[0])
    gyro = truth.rate + GYRO_NOISE * per_sample * rng.normal(size=truth.rate.shape) + gyro_bias
    accel = truth.force + ACCEL_NOISE * per_sample * rng.normal(size=truth.force.shape)
    mag = None if field is None else rotate(conjugate(truth.attitude), np.array(field))
    return ImuBlock(truth.t, accel, gyro, truth.t, mag=mag)


def errors(estimate, truth):
    """Attitude (navigation axes), velocity and position of the truth against an estimate."""
    path = estimate.trajectory
    turn = to_rotation_vector(multiply(truth.attitude, conjugate(path.quaternion)))
    moved = truth.position - truth.position[0]
    return np.hstack((turn, truth.velocity - path.velocity, moved - path.position))


def from_the_arc(path):
    return np.abs(np.hypot(path.position[:, 0], path.position[:, 1] - 0.36) - 0.36)


def test_the_forward_filter_drifts_and_jumps_and_the_smoother_does_neither(slide):
    block, zero = measured(slide, noise=0.1), standing(slide)
    result = smooth_steps(block, zero, SURE)
    assert result.boundaries.tolist() == [0, len(slide.t) - 1]
    forward, smoothed = result.forward.trajectory, result.smoothed.trajectory
    stands = np.flatnonzero(zero.still & (slide.t > 5.0))[0]
    drift = np.linalg.norm(errors(result.forward, slide)[stands - 1, 6:])
    assert drift > 3.0 * np.linalg.norm(errors(result.smoothed, slide)[:, 6:], axis=1).max()
    assert from_the_arc(smoothed).max() < 0.005 < from_the_arc(forward).max()
    steps = [np.linalg.norm(np.diff(p.position, axis=0), axis=1) for p in (forward, smoothed)]
    assert steps[0][stands - 1 : stands + 5].sum() > 0.5 * drift
    assert steps[1][stands - 1 : stands + 5].sum() < 0.0005
    # the backward filter errs the other way round: most at the beginning
    back = np.linalg.norm(errors(result.backward, slide)[:, 3:6], axis=1)
    moves = np.flatnonzero(~zero.still)
    assert back[moves[0] : moves[100]].mean() > 2.0 * back[moves[-100] : moves[-1]].mean()


def test_the_combination_is_the_least_squares_solution(slide):
    """Kalman filter and Rauch-Tung-Striebel sweep over the same linear model, written densely."""
    part = slice(200, 1300, 4)
    t, truth_still = slide.t[part], standing(slide).still[part]
    options = replace(SURE, velocity_sigma=0.003, height_sigma=0.002, correlated_s=1e-9)
    options = replace(options, tilt_sigma=0.2 * DEG)
    # errors that a strapdown step takes alike in both directions
    block = measured(slide, gyro_bias=(2e-3, -1e-3, 3e-3), noise=0.0)[part]
    smoothed = smooth_steps(block, stance(truth_still), options).smoothed
    n = len(t)

    nominal, P = np.zeros((n, 10)), np.zeros((n, 9, 9))
    near = t < t[0] + 0.1
    first = triad(block.accel[near].mean(axis=0))
    P0 = np.diag(np.repeat((0.0, 1e-6, options.velocity_sigma), 3) ** 2)
    R = to_matrix(first)
    P0[:3, :3] = R.T @ np.diag(np.array((options.tilt_sigma, options.tilt_sigma, 1e-6)) ** 2) @ R
    P0[:3, :3] /= 4.0
    noise = np.array((GYRO_NOISE, ACCEL_NOISE, STANDARD_GRAVITY))
    nothing = np.full((n, 3), np.inf)
    start = np.concatenate((first, np.zeros(6)))
    inputs = (t, np.array(block.gyro), np.array(block.accel), np.zeros((n, 3)), nothing, noise)
    run_filter(0, n - 1, *inputs, start, P0, nominal, P)

    q_nominal = nominal[:, :4].copy()
    Q = np.zeros((9, 9))
    dt = t[1] - t[0]
    Q[:3, :3] = 0.25 * GYRO_NOISE**2 * dt * np.eye(3)
    Q[3:, 3:] = ACCEL_NOISE**2 * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(3))
    up = block.accel[t >= t[-1] - 0.1].mean(axis=0)
    x, P = np.zeros(9), P0
    stored = []
    for k in range(n):
        F = np.eye(9)
        if k:
            F = transition(q_nominal[k - 1], q_nominal[k], *inputs[2][k - 1 : k + 1], dt)
            x, P = F @ x, F @ P @ F.T + Q
        predicted = (x, P)
        rows, seen, sigmas = np.zeros((0, 9)), np.zeros(0), np.zeros(0)
        if k and truth_still[k]:
            rows = np.eye(9)[[5, 6, 7, 8]]
            seen = -nominal[k][[6, 7, 8, 9]]
            sigmas = np.array((options.height_sigma, *[options.velocity_sigma] * 3))
        if k == n - 1:  # gravity shows the tilt at the end
            seen_up = rotate(nominal[k, :4], up / np.linalg.norm(up))
            level = np.zeros((2, 9))
            level[:, :3] = to_matrix(nominal[k, :4])[:2]
            rows, seen = (
                np.vstack((rows, level)),
                np.append(seen, 0.5 * np.array((seen_up[1], -seen_up[0]))),
            )
            sigmas = np.append(sigmas, [0.5 * options.tilt_sigma] * 2)
        gain = P @ rows.T @ np.linalg.inv(rows @ P @ rows.T + np.diag(sigmas**2))
        x, P = x + gain @ (seen - rows @ x), P - gain @ rows @ P
        stored.append((x, P, *predicted, F))
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            (x0, P0, *_), (_, _, xp, Pp, F) = stored[k], stored[k + 1]
            back = np.linalg.solve(Pp, F @ P0).T
            x, P = x0 + back @ (x - xp), P0 + back @ (P - Pp) @ back.T
        turn = np.concatenate(([1.0], x[:3]))
        q = normalize(multiply(nominal[k, :4], turn))
        path = smoothed.trajectory
        J = np.zeros((9, 9))
        J[:3, :3], J[3:6, 6:], J[6:, 3:6] = 2.0 * to_matrix(q), np.eye(3), np.eye(3)
        sigma = np.sqrt(np.diag(J @ P @ J.T))
        off = np.concatenate(
            (
                to_rotation_vector(multiply(path.quaternion[k], conjugate(q))),
                path.velocity[k] - nominal[k, 7:] - x[6:],
                path.position[k] - nominal[k, 4:7] - x[3:6],
            )
        )
        assert np.all(np.abs(off) < 0.02 * sigma + 1e-7), (k, off / sigma)
        own = np.sqrt(np.diag(smoothed.covariance[k]))
        assert own == pytest.approx(sigma, rel=0.02, abs=1e-8), k


def test_errors_are_as_large_as_the_covariance_says(slide):
    slide = at_100_hz(slide)
    zero = standing(slide)
    # at rest, and just after, the velocity is nearer to zero than is claimed
    rows = np.flatnonzero(~zero.still)[30::30]
    per_sample = ACCEL_NOISE / np.sqrt(slide.t[1] - slide.t[0])
    options = replace(SURE, tilt_sigma=per_sample / np.sqrt(10.0) / STANDARD_GRAVITY)
    squares = []
    for seed in range(15):
        estimate = smooth_steps(measured(slide, seed), zero, options).smoothed
        e = errors(estimate, slide)[rows]
        P = estimate.covariance[rows]
        squares.append(np.sum(e * np.linalg.solve(P, e[..., np.newaxis])[..., 0], axis=1))
    mean = np.mean(squares, axis=0) / 9.0
    assert np.all((mean > 0.6) & (mean < 1.6)), mean
    assert 0.75 < np.mean(mean) < 1.3, mean


def test_the_field_holds_yaw_and_leaves_tilt(slide):
    field = about_z(0.7) @ np.array((20.0, 0.0, -45.0))
    biased = measured(slide, gyro_bias=(0.0, 0.0, 0.5 * DEG), field=field)
    zero = standing(slide)
    without = smooth_steps(biased, zero, SURE).smoothed.trajectory
    options = replace(SURE, magnetometer=True, yaw_sigma=0.3 * DEG, gyro_noise=0.5 * DEG)
    held = smooth_steps(biased, zero, options).smoothed.trajectory
    true = euler_angles(slide.attitude)
    assert euler_angles(without.quaternion[0])[2] == pytest.approx(0.0, abs=1e-3)
    assert euler_angles(held.quaternion[0])[2] == pytest.approx(-0.7, abs=2.5 * DEG)
    gone = np.unwrap(euler_angles(without.quaternion)[:, 2])[-1] - np.unwrap(true[:, 2])[-1]
    kept = np.unwrap(euler_angles(held.quaternion)[:, 2])[-1] - np.unwrap(true[:, 2])[-1] + 0.7
    assert gone > 3.0 * DEG
    assert abs(kept) < 0.3 * gone
    # Iron that bends the field up or down, or makes it stronger, moves no horizon.
    wrong = about_z(0.7) @ np.array((70.0, 0.0, 60.0))
    bent = replace(biased, mag=rotate(conjugate(slide.attitude), wrong))
    tilts = [euler_angles(smooth_steps(b, zero, options).smoothed.trajectory.quaternion)[:, :2]
             for b in (biased, bent)]  # fmt: skip
    assert np.abs(tilts[0] - tilts[1]).max() < 0.02 * DEG


def test_a_step_begins_in_the_middle_of_a_stay():
    t = 0.01 * np.arange(300)
    still = np.zeros(300, dtype=bool)
    for first, last in ((0, 40), (100, 120), (125, 140), (170, 171), (250, 290)):
        still[first : last + 1] = True
    assert find_stays(still, t).tolist() == [[0, 40], [100, 140], [250, 290]]
    rest = ImuBlock(t, np.tile((0.0, 0.0, STANDARD_GRAVITY), (300, 1)), np.zeros((300, 3)), t)
    result = smooth_steps(rest, stance(still))
    middle = result.boundaries[1]
    assert result.boundaries.tolist() == [0, middle, 290]
    assert middle in (120, 121)
    assert result.steps.tolist() == [[0, middle], [middle, 290]]
    assert len(result.smoothed.trajectory) == len(result.still) == 291
    assert np.abs(result.smoothed.trajectory.position).max() < 1e-9
    turned = result.turned(0.5)
    assert euler_angles(turned.smoothed.trajectory.quaternion[0])[2] == pytest.approx(0.5)
    assert turned.smoothed.covariance.shape == (291, 9, 9)


@pytest.mark.parametrize(
    "force", [(0.3, -0.2, 9.7), (9.8, 0.1, 0.1), (0.0, 0.0, -9.8), (-5.0, 7.0, -4.0)]
)
def test_triad_takes_tilt_from_gravity_and_yaw_from_the_field(force):
    up = np.array(force) / np.linalg.norm(force)
    field = np.array((10.0, 30.0, -20.0))
    for q in (triad(np.array(force)), triad(np.array(force), field)):
        assert rotate(q, up) == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)
    north = rotate(triad(np.array(force), field), field)
    assert north[1] == pytest.approx(0.0, abs=1e-9)
    assert north[0] > 0.0


def test_what_cannot_be_smoothed_is_named(slide):
    block, zero = measured(slide), standing(slide)
    with pytest.raises(DataError, match="no zero-velocity interval"):
        smooth_steps(block, stance(np.zeros(len(block), dtype=bool)))
    holes = np.ones(len(block), dtype=bool)
    holes[650:700] = False
    with pytest.raises(DataError, match=r"missing for 0\.25 s after 5\.2\d s"):
        smooth_steps(block[holes], stance(zero.still[holes]))
    gyro = block.gyro.copy()
    gyro[700] = np.nan
    with pytest.raises(DataError, match="gyroscope are missing"):
        smooth_steps(replace(block, gyro=gyro), zero)
    with pytest.raises(DataError, match="backwards"):
        smooth_steps(replace(block, t=np.where(np.arange(len(block)) == 700, 0.0, block.t)), zero)
    with pytest.raises(InputError, match="tilt_sigma"):
        TwoFilterOptions(tilt_sigma=0.0)
