"""The compiled foot smoother: equal to the textbook's, and true to its invariances."""

from __future__ import annotations

import numpy as np
import pytest
import textbook_smoother as textbook
from foot_motion import MODEL, known, readings

from imu_rig import rotation
from imu_rig.kernels.foot_filter import smooth_foot_states
from imu_rig.kernels.foot_types import FootInputs, FootState


def column(states: list[FootState], name: str):
    return np.array([getattr(s, name) for s in states])


@pytest.fixture(scope="module")
def case():
    inputs = readings()
    start = known(inputs)
    return inputs, start, textbook.smooth(inputs, MODEL, start)


@pytest.mark.parametrize("forward", [True, False])
def test_equals_the_textbook_to_rounding(case, forward):
    inputs, start, (filtered, smoothed, covariances) = case
    ours = smooth_foot_states(
        inputs, MODEL, estimate_gyro_bias=True, forward_only=forward, start=start
    )
    theirs = filtered if forward else smoothed
    for name in ("quaternion", "velocity", "gyro_bias", "accel_bias"):
        want = column(theirs, name)
        assert getattr(ours, name) == pytest.approx(want, abs=1e-10 * np.abs(want).max()), name
    want = column(theirs, "height")
    height = ours.position[:, 2] - ours.floor
    assert height == pytest.approx(want, abs=1e-10 * np.abs(want).max())
    assert ours.pivot == pytest.approx(smoothed[-1].pivot, rel=1e-10)
    scale = np.sqrt(np.diag(covariances[-1]))
    close = (ours.end.covariance - covariances[-1]) / np.outer(scale, scale)
    assert np.abs(close).max() < 1e-10
    assert ours.gyro_bias_covariance == pytest.approx(covariances[-1][13:16, 13:16], rel=1e-8)


def test_the_textbook_derives_its_steps_and_measurements_rightly():
    """Derivatives against differences: the comparison above is worth what these are."""
    inputs = readings()
    before = known(inputs)._replace(
        velocity=np.array([0.3, -0.2, 0.1]),
        gyro=np.array([2.0, -1.0, 3.0]),
        accel=np.array([3.1, -5.0, 10.9]),
    )
    dt, gyro, accel = 1e-3, np.array([2.1, -0.9, 2.8]), np.array([3.0, -5.0, 11.0])
    after = textbook.strapdown(before, dt, gyro, accel, 9.81)
    F, (_, H) = textbook.transition(before, after, dt), textbook.rolling(after)
    for i in range(16):
        dx = 1e-5 * np.eye(16)[i]
        ends = [
            textbook.strapdown(textbook.corrected(before, s * dx), dt, gyro, accel, 9.81)
            for s in (1, -1)
        ]
        assert F[:, i] == pytest.approx(textbook.difference(*ends) / 2e-5, abs=4e-8)
        rolls = [textbook.rolling(textbook.corrected(after, s * dx))[0] for s in (1, -1)]
        assert H[:, i] == pytest.approx((rolls[0] - rolls[1]) / 2e-5, abs=1e-8)


def test_known_gyro_bias_is_that_of_no_uncertainty(case):
    inputs, start, _ = case
    inputs = inputs._replace(rest_sigma=np.full(len(inputs.dt), np.inf))
    bias = np.array([0.01, -0.008, 0.004])
    P = start.covariance.copy()
    P[13:, :] = P[:, 13:] = 0.0
    start = start._replace(gyro_bias=bias, covariance=P)
    model = MODEL._replace(gyro_bias_walk=0.0)
    one = smooth_foot_states(inputs, model, estimate_gyro_bias=False, start=start)
    other = smooth_foot_states(inputs, model, estimate_gyro_bias=True, start=start)
    for name in ("quaternion", "velocity", "position", "accel_bias", "floor", "gyro_bias"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-12), name
    assert (one.gyro_bias == bias).all()


def test_windows_one_after_the_other_are_the_whole_filter():
    inputs = readings(seed=3)
    whole = smooth_foot_states(inputs, MODEL, estimate_gyro_bias=True, forward_only=True)
    state, parts = None, []
    for rows in (slice(0, 1), slice(1, 150), slice(150, 151), slice(151, None)):
        piece = inputs._replace(
            **{name: getattr(inputs, name)[rows] for name in inputs._fields[:7]},
            unseen_turn=inputs.unseen_turn[rows],
            unseen_velocity=inputs.unseen_velocity[rows],
        )
        parts.append(
            smooth_foot_states(
                piece, MODEL, estimate_gyro_bias=True, forward_only=True, start=state
            )
        )
        state = parts[-1].end
    for name in ("quaternion", "velocity", "position", "gyro_bias", "accel_bias", "floor", "nis"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert joined == pytest.approx(getattr(whole, name), abs=1e-13, nan_ok=True), name
    assert state.covariance == pytest.approx(whole.end.covariance, rel=1e-10, abs=1e-18)


def smoothed(inputs, model=MODEL):
    return smooth_foot_states(inputs, model, estimate_gyro_bias=True)


def test_heading_is_free():
    inputs = readings(seed=4)
    straight = smoothed(inputs)
    R, turn = rotation.about_z(2.2), rotation.from_rotation_vector(np.array([0.0, 0.0, 2.2]))
    turned = smoothed(inputs._replace(q0=rotation.multiply(turn, inputs.q0), v0=R @ inputs.v0))
    assert turned.position == pytest.approx(straight.position @ R.T, abs=1e-10)
    assert turned.velocity == pytest.approx(straight.velocity @ R.T, abs=1e-10)
    assert turned.gyro_bias == pytest.approx(straight.gyro_bias, abs=1e-12)
    assert turned.nis == pytest.approx(straight.nis, rel=1e-8, nan_ok=True)


def test_sensor_axes_are_free():
    inputs = readings(seed=4)
    one = smoothed(inputs)
    cycle = [1, 2, 0]
    C = np.eye(3)[cycle]  # new = C old
    back = np.full(4, 0.5)  # new to old axes
    assert rotation.to_matrix(back) @ C == pytest.approx(np.eye(3))
    other = smoothed(
        inputs._replace(
            gyro=inputs.gyro[:, cycle],
            accel=inputs.accel[:, cycle],
            q0=rotation.multiply(inputs.q0, back),
        ),
        MODEL._replace(
            gyro_bias_prior=MODEL.gyro_bias_prior[cycle], pivot_prior=MODEL.pivot_prior[cycle]
        ),
    )
    assert other.position == pytest.approx(one.position, abs=1e-10)
    assert other.pivot == pytest.approx(one.pivot[cycle], abs=1e-10)


def test_height_is_the_integral_of_velocity_above_a_floor_that_moves_only_where_it_may():
    inputs = readings(seed=6)
    states = smoothed(inputs._replace(v0=np.zeros(3)))
    moves = np.abs(np.diff(states.floor)) > 1e-9
    assert not moves[inputs.floor_step[1:] == 0.0].any()
    assert moves.any()


def test_rounding_does_not_grow_over_a_long_trial():
    """The pass back must arrive at the first heading and height, which nothing may change."""
    n = 40_000
    inputs = readings(seed=2, n=n)
    states = smooth_foot_states(inputs, MODEL._replace(pivot_sigma=0.0), estimate_gyro_bias=True)
    turn = rotation.multiply(states.quaternion[0], rotation.conjugate(inputs.q0))
    assert abs(rotation.to_rotation_vector(turn)[2]) < 1e-5  # what tilt squared makes
    assert abs(states.floor[0]) < 1e-9
    assert np.linalg.norm(states.quaternion, axis=1) == pytest.approx(np.ones(n), abs=1e-14)


def test_nothing_measured_is_dead_reckoning():
    inputs = readings(seed=7)
    nothing = np.full(len(inputs.dt), np.inf)
    inputs = inputs._replace(velocity_sigma=nothing, rest_sigma=nothing, floor_sigma=nothing)
    state = known(inputs)
    for k, dt in enumerate(inputs.dt):
        state = textbook.strapdown(state, dt, inputs.gyro[k], inputs.accel[k], MODEL.gravity)
    states = smoothed(inputs)
    assert states.velocity[-1] == pytest.approx(state.velocity, rel=1e-12)
    assert states.position[-1] == pytest.approx(state.position, rel=1e-12)
    assert np.isnan(states.nis).all()


def test_a_filter_gone_astray_comes_back():
    """A velocity 500 standard deviations off is gated, and corrected all the same."""
    n = 300
    still = readings(seed=8, n=n)._replace(
        dt=np.full(n, 0.01),
        gyro=np.zeros((n, 3)),
        accel=np.tile([0.0, 0.0, 9.81], (n, 1)),
        velocity_sigma=np.full(n, 0.02),
        q0=np.array([1.0, 0.0, 0.0, 0.0]),
        v0=np.array([5.0, 0.0, 0.0]),
    )
    model = MODEL._replace(velocity_prior=0.01)
    states = smooth_foot_states(still, model, estimate_gyro_bias=True, forward_only=True)
    assert states.nis[0] > 1e4
    assert np.abs(states.velocity[-1]).max() < 0.02


def test_covariance_is_as_large_as_the_errors_of_a_standing_sensor():
    """Normalized errors squared of 80 sensors with errors drawn from the model, per state."""
    rng = np.random.default_rng(11)
    n, dt, runs = 60, 0.02, 80
    nothing = np.full(n, np.inf)
    model = MODEL._replace(gate=1e6)
    truth = known(readings())._replace(
        quaternion=np.array([1.0, 0.0, 0.0, 0.0]), velocity=np.zeros(3), pivot=np.zeros(3)
    )
    scatter = np.linalg.cholesky(truth.covariance / 25.0)  # small, so that all is linear
    kept = [0, 1, 2, *range(7, 16)]  # velocity is measured without error, where the model has some
    total = 0.0
    for _ in range(runs):
        start = textbook.corrected(truth, -scatter @ rng.standard_normal(16))
        gyro = model.gyro_noise / np.sqrt(dt) * rng.standard_normal((n, 3))
        accel = model.accel_noise / np.sqrt(dt) * rng.standard_normal((n, 3)) + [0.0, 0.0, 9.81]
        inputs = FootInputs(
            np.full(n, dt), gyro, accel, np.full(n, 1e-4), nothing, nothing, np.zeros(n),
            start.quaternion, start.velocity,
        )  # fmt: skip
        end = smooth_foot_states(
            inputs,
            model,
            estimate_gyro_bias=True,
            forward_only=True,
            start=start._replace(covariance=truth.covariance / 25.0, gyro=gyro[0], accel=accel[0]),
        ).end
        error = textbook.difference(truth, end)[kept]
        total += error @ np.linalg.solve(end.covariance[np.ix_(kept, kept)], error) / len(kept)
    assert 0.85 < total / runs < 1.15  # three standard deviations of the mean of 80 times 12
