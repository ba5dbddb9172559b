"""The paper's equations (5) and (6), and what they cost when the jig's angles are wrong."""

from itertools import pairwise

import numpy as np
import pytest
from simulated_sessions import (
    DEG,
    Truth,
    exact,
    jig_attitudes,
    random_sensor,
    record,
)

from imu_rig import rotation
from imu_rig.calibration.paper import integrated_turn, paper_accelerometer, paper_gyroscope
from imu_rig.calibration.session import CommandedPoses, CommandedTurn
from imu_rig.calibration.solve import solve
from imu_rig.errors import DataError, InputError

G = 9.80665
# One servo at a time, every servo both ways, and turned while the others stand differently.
ANGLES = np.array(
    [(0, 0, r) for r in (-180, -135, -90, -45, 0, 45, 90, 135)]
    + [(0, t, 135) for t in (-60, 60)]
    + [(0, t, 90) for t in (60, -60)]
    + [(90, -60, 90), (0, -60, 90), (0, -60, 0), (0, 60, 0), (90, 60, 0), (0, 60, 0)],
    dtype=float,
)


def turn_between(start, stop):
    return CommandedTurn(0.0, 1.0, tuple(start), tuple(stop)).rotation_vector()


def any_gain(rng):
    return np.eye(3) + 0.05 * rng.standard_normal((3, 3))


def test_accelerometer_is_exact_on_noiseless_data():
    rng = np.random.default_rng(1)
    K, b = any_gain(rng), rng.standard_normal(3)
    gravity = CommandedPoses(ANGLES).gravity(G)
    fit = paper_accelerometer(exact(K, b).undo(gravity), gravity)
    assert np.allclose(fit.affine.K, K, atol=1e-12)
    assert np.allclose(fit.affine.b, b, atol=1e-11)
    assert np.allclose(fit.residual, 0, atol=1e-11)


def test_diagonal_model_is_exact_where_the_sensor_is_diagonal_and_least_squares_where_not():
    rng = np.random.default_rng(2)
    gravity = CommandedPoses(ANGLES).gravity(G)
    K, b = np.diag([1.02, 0.97, 1.01]), np.array([0.3, -0.2, 0.1])
    fit = paper_accelerometer(exact(K, b).undo(gravity), gravity, "diagonal")
    assert np.allclose(fit.affine.K, K, atol=1e-12)
    assert np.allclose(fit.affine.b, b, atol=1e-11)
    skewed = exact(any_gain(rng), b).undo(gravity)
    fit = paper_accelerometer(skewed, gravity, "diagonal")
    best = np.sum(fit.residual**2)
    for _ in range(50):
        K = np.diag(np.diag(fit.affine.K) + 1e-3 * rng.standard_normal(3))
        o = fit.affine.b + 1e-3 * rng.standard_normal(3)
        assert np.sum((skewed @ K.T - o - gravity) ** 2) >= best


def test_gyroscope_is_exact_on_noiseless_turns_with_uneven_time_stamps():
    rng = np.random.default_rng(3)
    truth = Truth(exact(np.eye(3), np.zeros(3)), exact(any_gain(rng), rng.standard_normal(3)))
    turns, durations, theta = [], [], []
    for i in range(len(ANGLES) - 1):
        known = turn_between(ANGLES[i], ANGLES[i + 1])
        if known is None:
            continue
        t = np.cumsum(rng.uniform(0.002, 0.02, 300))
        # Piecewise linear rates: the trapezoid is exact for any time stamps.
        profile = np.interp(t, [t[0], t[100], t[200], t[-1]], [0.0, 1.0, 1.0, 0.0])
        area = np.trapezoid(profile, t)
        w = profile[:, None] * known / area
        turn, duration = integrated_turn(t, truth.gyro.undo(w))
        turns.append(turn)
        durations.append(duration)
        theta.append(known)
    fit = paper_gyroscope(np.array(turns), np.array(durations), np.array(theta))
    assert np.allclose(fit.affine.K, truth.gyro.K, atol=1e-11)
    assert np.allclose(fit.affine.b, truth.gyro.b, atol=1e-10)


def test_integral_uses_the_measured_time_stamps():
    t = np.array([0.0, 0.01, 0.05, 0.06])
    w = np.ones((4, 3)) * 2.0
    turn, duration = integrated_turn(t, w)
    assert np.allclose(turn, 0.12)
    assert duration == pytest.approx(0.06)


def test_commanded_gravity_and_turns_follow_the_jig():
    commanded = CommandedPoses(ANGLES)
    q = jig_attitudes(ANGLES)
    up = rotation.rotate(rotation.conjugate(q), np.array([0.0, 0.0, G]))
    assert np.allclose(commanded.gravity(G), up, atol=1e-12)
    singles = 0
    for i in range(len(ANGLES) - 1):
        turn = turn_between(ANGLES[i], ANGLES[i + 1])
        moved = np.count_nonzero(ANGLES[i + 1] - ANGLES[i])
        assert (turn is None) == (moved != 1)
        if turn is not None:
            singles += 1
            end = rotation.multiply(q[i], rotation.from_rotation_vector(turn))
            same = abs(np.sum(end * q[i + 1]))
            assert same == pytest.approx(1.0, abs=1e-12)
    assert singles > 10
    whole = turn_between((0.0, 0.0, 0.0), (360.0, 0.0, 0.0))
    assert np.allclose(whole, [0, 0, 2 * np.pi])


def test_covariance_covers_the_truth_when_the_errors_are_random():
    rng = np.random.default_rng(4)
    gravity = CommandedPoses(ANGLES).gravity(G)
    inside = []
    for _ in range(200):
        K, b = any_gain(rng), rng.standard_normal(3)
        means = exact(K, b).undo(gravity + 0.05 * rng.standard_normal(gravity.shape))
        affine = paper_accelerometer(means, gravity).affine
        half = affine.coverage_factor * affine.K_uncertainty
        inside.append(np.abs(affine.K - K) < half)
        inside.append(
            np.abs(affine.b - b)[None].repeat(3, 0) < affine.coverage_factor * affine.b_uncertainty
        )
    assert 0.92 < np.mean(inside) < 0.98


def test_poses_that_leave_an_axis_free_are_refused_by_name():
    angles = np.array([(0, 0, r) for r in range(-180, 180, 30)], float)
    gravity = CommandedPoses(angles).gravity(G)
    with pytest.raises(DataError, match=r"x axis|y axis|z axis"):
        paper_accelerometer(gravity, gravity)
    with pytest.raises(DataError, match="add 1 poses or more"):
        paper_accelerometer(gravity[:4], gravity[:4])


@pytest.mark.parametrize("method", ["paper", "paper-diagonal"])
def test_front_door_solves_a_perfect_jig_session(method):
    rng = np.random.default_rng(5)
    diagonal = method == "paper-diagonal"
    K = np.diag([1.02, 0.98, 1.01]) if diagonal else any_gain(rng)
    truth = Truth(exact(K, [0.2, 0.1, -0.3]), exact(K, np.array([1.0, -2.0, 0.5]) * DEG))
    turns = [turn_between(ANGLES[i], ANGLES[i + 1]) for i in range(len(ANGLES) - 1)]
    turns = [np.zeros(3) if turn is None else turn for turn in turns]
    angles = ANGLES[[0, *(i + 1 for i, turn in enumerate(turns) if np.any(turn))]]
    turns = [turn for turn in turns if np.any(turn)]
    recording = record(jig_attitudes(angles), truth, rng, turns=turns, accel_noise=0.005)
    names = tuple(f"hold {i}" for i in range(len(angles)))
    result = solve(
        recording.block,
        recording.holds,
        method=method,
        commanded=CommandedPoses(angles, names),
    )
    assert result.frame == "jig"
    assert np.allclose(result.accel.K, K, atol=5e-4)
    assert np.allclose(result.gyro.K, K, atol=2e-3)
    assert np.allclose(result.gyro.b, truth.gyro.b, atol=0.05 * DEG)
    assert result.poses[3].name == "hold 3"
    assert result.poses[3].commanded_deg == tuple(angles[3])
    assert all(np.linalg.norm(pose.vector_error) < 0.02 for pose in result.poses)
    assert all(pose.left_out is not None for pose in result.poses)
    assert all(np.linalg.norm(move.vector_error) < 0.2 * DEG for move in result.moves)
    assert result.accel_errors.held_out.rms < result.accel_errors.before.rms / 20


def test_servo_gain_error_becomes_sensor_gain_error_here_and_not_without_angles():
    """What the joint use of gravity is for: 2 % of servo gain is 2 % of gyroscope."""
    rng = np.random.default_rng(6)
    truth = random_sensor(rng)
    turns = [turn_between(ANGLES[i], ANGLES[i + 1]) for i in range(len(ANGLES) - 1)]
    real = ANGLES * 1.02
    keep = [0, *(i + 1 for i, turn in enumerate(turns) if turn is not None)]
    real_turns = [turn_between(real[a], real[b]) for a, b in pairwise(keep)]
    assert all(turn is not None for turn in real_turns)
    recording = record(jig_attitudes(real[keep]), truth, rng, turns=real_turns)
    commanded = CommandedPoses(ANGLES[keep])
    trusting = solve(recording.block, recording.holds, method="paper", commanded=commanded)
    gravity_only = solve(recording.block, recording.holds, commanded=commanded)

    def scale_error(result):
        gain = np.linalg.norm(np.linalg.inv(result.gyro.K), axis=1)
        return np.abs(gain / np.linalg.norm(np.linalg.inv(truth.gyro.K), axis=1) - 1)

    assert np.sqrt(np.mean(scale_error(trusting) ** 2)) > 0.01
    assert np.all(scale_error(gravity_only) < 0.003)


def test_the_paper_solver_needs_commanded_angles():
    rng = np.random.default_rng(7)
    recording = record(jig_attitudes(ANGLES[:12]), random_sensor(rng), rng)
    with pytest.raises(InputError, match="multi-position"):
        solve(recording.block, recording.holds, method="paper")
    with pytest.raises(InputError, match="one still window each"):
        solve(recording.block, commanded=CommandedPoses(ANGLES[:12]))
    with pytest.raises(InputError, match="no method 'magic'"):
        solve(recording.block, method="magic")


def test_driven_turns_serve_where_poses_lie_several_servos_apart():
    """Between these poses tilt and roll both turn, one after the other."""
    rng = np.random.default_rng(8)
    truth = Truth(exact(np.eye(3), np.zeros(3)), exact(any_gain(rng), np.zeros(3)))
    stops = np.array(
        [
            *((0, 0, 0), (0, 60, 0), (0, 60, 90), (0, -30, 90), (0, -30, -60), (0, 50, -60)),
            *((90, 50, -60), (90, -50, -60), (90, -50, 30), (0, -50, 30), (0, 40, 30)),
            (0, 40, 120),
        ],
        dtype=float,
    )
    turns = [turn_between(a, b) for a, b in pairwise(stops)]
    recording = record(jig_attitudes(stops), truth, rng, turns=turns, accel_noise=0.005)
    driven = tuple(
        CommandedTurn(before[1], after[0], tuple(a), tuple(b))
        for (before, after), (a, b) in zip(pairwise(recording.holds), pairwise(stops), strict=True)
    )
    # every other stop is only passed
    commanded = CommandedPoses(stops[::2], turns=driven)
    result = solve(recording.block, recording.holds[::2], method="paper", commanded=commanded)
    assert np.allclose(result.gyro.K, truth.gyro.K, atol=2e-3)
    without = CommandedPoses(stops[::2])
    blind = solve(recording.block, recording.holds[::2], method="paper", commanded=without)
    assert blind.gyro is None


def test_an_axis_that_never_turned_is_named():
    turns = np.array([[0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, -1], [0, 1, 1], [0, 1, -1]], float)
    seen = turns + 0.01 * np.random.default_rng(9).standard_normal(turns.shape)
    with pytest.raises(DataError, match="x axis"):
        paper_gyroscope(seen, np.ones(6), turns)
