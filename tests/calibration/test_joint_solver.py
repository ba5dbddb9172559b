"""The joint fit of sensor and jig against simulated truth: derivatives, invariances, faults."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from jig_sessions import DEG, MILLI_G, commanded, full_protocol, session_of, solved

from imu_rig import rotation
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.joint_data import earth_prior, joint_data
from imu_rig.calibration.joint_fit import default_prior, fit_joint, start
from imu_rig.calibration.joint_model import (
    CLASSES,
    MOUNTING,
    Places,
    Turned,
    attitudes,
    system,
)
from imu_rig.calibration.magnitude import fit_magnitude
from imu_rig.calibration.model import physical_figures, sensor_frame
from imu_rig.calibration.moves import moves_between
from imu_rig.calibration.session import Session
from imu_rig.calibration.solve import solve
from imu_rig.calibration.stills import summarize
from imu_rig.errors import DataError
from simulators.config import RigConfig
from simulators.quick_session import SessionFaults, quick_session


@cache
def clean(seed):
    return solved(session_of(seed))


def prepared(session):
    stills = summarize(session.block, session.windows)
    names = tuple(f"pose {i + 1}" for i in range(len(stills)))
    bad = np.zeros(session.block.gyro.shape, dtype=bool)
    told = commanded(session)
    whole = Session(
        session.block,
        stills,
        names,
        np.arange(len(stills)),
        Gravity.given(session.truth.gravity),
        told,
        bad,
        has_gyro=True,
    )
    moves = moves_between(session.block, stills, stills.gyro_mean, bad)
    accel = fit_magnitude(stills.accel_mean, stills.accel_cov, session.truth.gravity).affine
    data = joint_data(whole, told, moves, accel)
    return data, start(data, accel)


def figures(affine, accel=None):
    f = physical_figures(affine, accel)
    return (
        np.concatenate((f.scale_percent, f.cross_rad, f.bias)),
        np.concatenate((f.scale_percent_u, f.cross_rad_u, f.bias_u)),
    )


def test_every_derivative_is_the_difference_of_residuals():
    data, begin = prepared(session_of(3))
    prior = default_prior(data)
    places = Places.of(data)
    # Derivatives hold where residuals are small: at a solution, moved a little off.
    state = fit_joint(data, prior, begin, components=False).state
    state = state.moved(np.random.default_rng(1).normal(0, 1e-4, places.count), places)
    rows = system(data, state, Turned.at(data, state), prior, places)
    assert rows.jacobian.shape == (len(rows.residual), places.count)
    # All common unknowns, and those of three poses: the first, a locked one, the last.
    poses = np.array([0, 7, len(data) - 1])
    own = (3 * poses[:, None] + np.arange(3)).ravel()
    latent = [part.start + own for part in (places.deviation, places.wobble, places.bias)]
    for column in (*range(places.mounting.stop), *np.concatenate(latent).tolist()):
        step = np.zeros(places.count)
        step[column] = 1e-4 if column < MOUNTING else 1e-5
        there = []
        for sign in (1.0, -1.0):
            moved = state.moved(sign * step, places)
            there.append(system(data, moved, Turned.at(data, moved), prior, places).residual)
        slope = (there[0] - there[1]) / (2 * step[column])
        size = np.abs(rows.jacobian[:, column]).max()
        assert np.abs(slope - rows.jacobian[:, column]).max() < 0.02 * size + 1e-6, column


def test_the_attitudes_are_those_of_the_simulated_jig():
    session = session_of(4)
    result = clean(4)
    assert result.jig is not None
    true = session.truth.jig
    gain = np.array([true.pan.gain_error, true.tilt.gain_error, true.roll.gain_error])
    error = np.abs(result.jig.servo_gain.value - gain)
    # No straight line follows a servo's sine of 0.3 deg per turn: up to 0.42 deg in 90 deg.
    assert np.all(error < 4.0 * result.jig.servo_gain.sigma + 0.42 / 90.0)
    base = np.array(true.base_tilt_deg) * DEG
    assert np.all(np.abs(result.jig.base.value - base) < 4.0 * result.jig.base.sigma)
    axis = roll_axis(session)
    error = result.jig.roll_axis.value[0] - axis
    across = result.jig.roll_axis.sigma[0] > 1e-4
    assert np.all(np.abs(error[across]) < 4.0 * result.jig.roll_axis.sigma[0][across])


def roll_axis(session):
    """Direction of the roll axis in the frame in which the accelerometer's K is triangular."""
    skew = rotation.about_z(session.truth.jig.roll_skew_deg * DEG)
    Q, _ = sensor_frame(session.truth.accel.K)
    return Q.T @ session.mounting_matrices[0].T @ skew[:, 0]


def test_the_frame_is_as_good_as_it_says():
    errors = []
    for seed in range(20, 26):
        session, result = session_of(seed), clean(seed)
        axis = roll_axis(session)
        errors.append((result.jig.roll_axis.value[0] - axis) / result.jig.roll_axis.sigma[0])
    assert np.sqrt(np.mean(np.array(errors)[:, 1:] ** 2)) < 1.6


def test_servo_errors_do_not_reach_the_sensor():
    """Degrees in every servo, and scales that are right to some 0.01 %."""
    errors = {"accel": [], "gyro": []}
    for seed in range(20, 26):
        truth, result = session_of(seed).truth, clean(seed)
        found = figures(result.accel)[0] - figures(as_affine(truth.accel))[0]
        errors["accel"].append(found)
        gyro = figures(result.gyro, result.accel)[0]
        errors["gyro"].append(gyro - figures(as_affine(truth.gyro), as_affine(truth.accel))[0])
        assert not result.warnings
    accel, gyro = np.array(errors["accel"]), np.array(errors["gyro"])
    assert np.sqrt(np.mean(accel[:, :3] ** 2)) < 0.02
    assert np.sqrt(np.mean(accel[:, 3:6] ** 2)) < 0.2e-3
    assert np.sqrt(np.mean(accel[:, 6:] ** 2)) < 0.15 * MILLI_G
    assert np.sqrt(np.mean(gyro[:, :3] ** 2)) < 0.02
    assert np.sqrt(np.mean(gyro[:, 3:9] ** 2)) < 0.2e-3
    assert np.sqrt(np.mean(gyro[:, 9:] ** 2)) < 0.002 * DEG


def as_affine(truth):
    from imu_rig.calibration.model import Affine

    return Affine(truth.K, truth.b, np.zeros((12, 12)))


def test_errors_are_as_large_as_stated():
    z = []
    for seed in range(20, 26):
        truth, result = session_of(seed).truth, clean(seed)
        value, sigma = figures(result.accel)
        z.append((value - figures(as_affine(truth.accel))[0]) / sigma)
        value, sigma = figures(result.gyro, result.accel)
        z.append((value - figures(as_affine(truth.gyro), as_affine(truth.accel))[0]) / sigma)
    z = np.concatenate(z)  # 6 sessions, 21 figures each
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.3
    assert np.abs(z).max() < 4.5


def test_a_left_out_pose_errs_as_predicted_and_as_a_fit_without_it():
    session, result = session_of(20), clean(20)
    z = np.array([p.left_out / p.left_out_sigma for s in (20, 21, 22) for p in clean(s).poses])
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.25
    told = commanded(session)
    for i in (5, 17):
        check = tuple(k == i for k in range(len(session.windows)))
        without = solved(session, commanded=replace(told, check=check))
        row = next(r for r in without.verification.rows if r.kind == "pose")
        assert row.error == pytest.approx(result.poses[i].left_out, abs=0.12 * MILLI_G)


def test_the_frame_of_the_jig_changes_nothing_in_the_sensor():
    session = session_of(20)
    told = commanded(session)
    shifted = replace(told, angles_deg=told.angles_deg + np.array((37.0, 0.0, 0.0)))
    value, sigma = figures(clean(20).accel)
    other = figures(solved(session, commanded=shifted).accel)[0]
    assert np.all(np.abs(other - value) < 0.05 * sigma)


def test_the_earth_is_told_from_the_bias_by_turning_over():
    mean, sigma = earth_prior(52.0)
    assert np.linalg.norm(mean) < 7.3e-5
    assert mean[2] == pytest.approx(7.292e-5 * np.sin(52 * DEG), rel=1e-3)
    assert earth_prior(None)[0] == pytest.approx(np.zeros(3))
    south = earth_prior(-52.0)
    assert south[0][2] < 0
    assert np.all(south[1] == sigma)


@pytest.mark.parametrize(
    ("axis", "name", "pose", "size"),
    [(0, "pan", 12, 5.0), (1, "tilt", 9, -5.0), (2, "roll", 14, 5.0)],
)
def test_a_servo_that_slips_is_named(axis, name, pose, size):
    session = session_of(31, SessionFaults(slip=(axis, pose, size)))
    result = solved(session)
    (finding,) = result.findings
    assert (finding.kind, finding.axis) == ("slip", name)
    assert abs(finding.poses[0] - pose) <= 1
    assert finding.size == pytest.approx(size, abs=1.5)
    assert finding.text in result.warnings
    same_sensor(session, result)


def test_exchanged_labels_are_put_right():
    session = session_of(32, SessionFaults(swapped=(4, 16)))
    result = solved(session)
    (finding,) = result.findings
    assert finding.kind == "mislabelled"
    assert sorted(finding.poses) == [4, 16]
    same_sensor(session, result)


def test_a_bumped_pose_is_named_where_pan_and_roll_share_an_axis_too():
    for pose in (10, 7):
        session = session_of(33, SessionFaults(bumped=pose))
        result = solved(session)
        assert [(f.kind, f.poses) for f in result.findings] == [("bumped", (pose,))]
        same_sensor(session, result)


def test_a_wrong_time_base_is_refused():
    for factor in (2.0, 0.5):
        with pytest.raises(DataError, match="sample rate"):
            solved(session_of(34, SessionFaults(time_factor=factor)))


def same_sensor(session, result):
    value, sigma = figures(result.accel)
    truth = figures(as_affine(session.truth.accel))[0]
    assert np.all(np.abs(value - truth) < 4.5 * sigma)


def test_nonlinearity_is_stated_and_both_lines_are_true():
    session = session_of(
        35, accel_quadratic=(1e-3, -1e-3, 1e-3), accel_cubic=(0.5e-3, 0.5e-3, -0.5e-3)
    )
    result = solved(session)
    value, sigma = figures(result.accel_at_zero)
    truth = figures(as_affine(session.truth.accel))[0]
    assert np.all(np.abs(value - truth) < 4.0 * sigma)
    value, sigma = figures(result.accel)
    line = figures(as_affine(session.accel_line))[0]
    assert np.all(np.abs(value - line) < 4.0 * sigma)
    share = result.straightness.quadratic
    assert np.all(np.abs(share.value - [1e-3, -1e-3, 1e-3]) < 4.0 * share.sigma)
    assert np.all(np.abs(share.value) > 2.0 * share.sigma)


def test_a_gyroscope_that_feels_force_is_named_and_its_gain_stays_right():
    G = ((0.1, -0.05, 0.08), (0.06, 0.1, -0.1), (-0.1, 0.07, 0.09))
    session = session_of(36, g_sensitivity=G)
    result = solved(session)
    assert "g-sensitivity" in [f.kind for f in result.findings]
    value, sigma = figures(result.gyro, result.accel)
    truth = figures(as_affine(session.truth.gyro), as_affine(session.truth.accel))[0]
    assert np.all(np.abs(value - truth)[:9] < 4.5 * sigma[:9])


def test_a_slip_is_taken_into_account_where_the_gyroscope_feels_force_too():
    G = ((0.1, -0.05, 0.08), (0.06, 0.1, -0.1), (-0.1, 0.07, 0.09))
    session = session_of(36, SessionFaults(slip=(1, 10, 5.0)), g_sensitivity=G)
    result = solved(session)
    assert {f.kind for f in result.findings} == {"slip", "g-sensitivity"}
    # Angles that kept the slip would look like servos that repeat to degrees.
    assert np.all(result.jig.repeatability < 1.2 * DEG)


def test_an_accelerometer_alone_is_calibrated_and_says_so():
    session = session_of(20)
    still = replace(session.block, gyro=np.zeros_like(session.block.gyro))
    result = solve(
        still,
        session.windows,
        method="joint",
        gravity=session.truth.gravity,
        commanded=commanded(session),
    )
    assert result.gyro is None
    assert any("gyroscope" in w for w in result.warnings)
    same_sensor(session, result)


def test_two_mountings_are_told_apart():
    angles, _ = full_protocol()
    short = np.clip(angles, -60.0, 60.0)
    short[:, 0] = angles[:, 0]
    poses = np.concatenate((short[::2], short[::2]))
    mounting = [0] * 12 + [1] * 12
    session = quick_session(RigConfig.random(37), poses, hold_s=2.0, mounting=mounting)
    result = solved(session)
    assert result.jig.mounting.value.shape == (2, 3)
    same_sensor(session, result)
    assert len(result.moves) == 22


def test_a_session_without_labels_or_with_too_few_poses_is_refused():
    session = session_of(20)
    with pytest.raises(DataError, match="commanded angles"):
        solve(session.block, session.windows, method="joint", gravity=session.truth.gravity)
    told = commanded(session)
    few = np.arange(len(session.windows)) < 8
    with pytest.raises(DataError, match="longer protocol"):
        solve(session.block, session.windows[few], commanded=told.only(few), method="joint")


def test_an_empty_class_has_a_name():
    assert len(set(CLASSES)) == len(CLASSES)
    data, state = prepared(session_of(3))
    A = attitudes(data, state).A
    assert A @ np.swapaxes(A, 1, 2) == pytest.approx(np.broadcast_to(np.eye(3), A.shape))
