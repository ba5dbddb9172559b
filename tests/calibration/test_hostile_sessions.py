"""Sessions that are wrong beyond repair: one clear sentence, or figures that say how little."""

from dataclasses import replace

import numpy as np
import pytest
from jig_sessions import DEG, MILLI_G, commanded, session_of, solved

from imu_rig.calibration.certificate import certificate_of
from imu_rig.calibration.session import CommandedPoses
from imu_rig.calibration.solve import solve
from imu_rig.errors import DataError, InputError
from simulators.quick_session import SessionFaults


def spoiled(change):
    """Solve session 20 after ``change(accel, gyro, half)`` has spoiled its samples."""
    session = session_of(20)
    accel, gyro = session.block.accel.copy(), session.block.gyro.copy()
    change(accel, gyro, len(accel) // 2)
    return solve_block(session, replace(session.block, accel=accel, gyro=gyro))


def solve_block(session, block, told=None):
    return solve(
        block,
        session.windows,
        method="joint",
        gravity=session.truth.gravity,
        commanded=told or commanded(session),
    )


def dead_axis(accel, gyro, half):
    gyro[:, 1] = 0


def dead_accel_axis(accel, gyro, half):
    accel[:, 2] = 0


def copied_axis(accel, gyro, half):
    gyro[:, 0] = gyro[:, 1]


def copied_accel_axis(accel, gyro, half):
    accel[:, 1] = accel[:, 2]


def died_half_way(accel, gyro, half):
    gyro[half:] = 0


def died_for_a_while(accel, gyro, half):
    gyro[half : half + 1500] = 0


def one_axis_died(accel, gyro, half):
    gyro[half:, 1] = 0


def accel_stuck(accel, gyro, half):
    accel[half : half + 1500] = accel[half]


def upside_down(accel, gyro, half):
    accel *= -1


def spike(accel, gyro, half):
    accel[half, 1] = 1e12


def not_a_number(accel, gyro, half):
    gyro[half, 2] = np.nan


def mirrored(axis):
    def change(accel, gyro, half):
        gyro[:, axis] *= -1

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dead_axis, "axis y of the gyroscope"),
        (dead_accel_axis, "axis z of the accelerometer"),
        (copied_axis, "axes x and y of the gyroscope"),
        (copied_accel_axis, "axes y and z of the accelerometer"),
        (died_half_way, "of the gyroscope repeats"),
        (died_for_a_while, "of the gyroscope repeats"),
        (one_axis_died, "axis y of the gyroscope"),
        (accel_stuck, "of the accelerometer repeats"),
        (upside_down, "angles|sign|axes"),
        (spike, "which no sensor does"),
        (not_a_number, "not numbers"),
        (mirrored(0), "x|sign|turns"),
        (mirrored(1), "sign|axes|turns"),
        (mirrored(2), "sign|axes|turns"),
    ],
)
def test_a_broken_sensor_is_named(change, words):
    with pytest.raises(DataError, match=words):
        spoiled(change)


@pytest.mark.parametrize(
    "angles",
    [
        lambda a: a * DEG,
        lambda a: np.random.default_rng(1).permutation(a),
        lambda a: np.roll(a, 1, axis=0),
        lambda a: a[:, [1, 0, 2]],
        lambda a: a[:, [0, 2, 1]],
        lambda a: a * 0.0,
        lambda a: a * [-1.0, 1.0, 1.0],
        lambda a: a * [1.0, -1.0, 1.0],
    ],
)
def test_angles_of_something_else_are_refused(angles):
    session = session_of(20)
    told = replace(commanded(session), angles_deg=angles(session.angles_deg))
    with pytest.raises(DataError, match="angles"):
        solve_block(session, session.block, told)


def test_a_pose_far_off_is_named_and_the_rest_certified():
    session = session_of(20)
    angles = session.angles_deg.copy()
    angles[3] = (40.0, 70.0, -100.0)
    result = solve_block(session, session.block, replace(commanded(session), angles_deg=angles))
    assert [(f.kind, f.poses) for f in result.findings] == [("bumped", (3,))]
    assert certificate_of(result).jig is not None


def test_a_large_bump_is_found_once_with_a_possible_angle():
    for seed, bump in ((716, (-7.9, 20.0, -9.5)), (716, (0.0, 90.0, 0.0)), (20, (25.0, 5.0, 0.0))):
        session = session_of(seed, SessionFaults(bumped=5, bump_deg=bump))
        found = [f for f in solved(session).findings if f.kind == "bumped"]
        assert [f.poses for f in found] == [(5,)]
        assert found[0].size <= 180.0


def test_a_spike_in_a_pose_sets_that_pose_aside_only():
    session = session_of(20)
    accel = session.block.accel.copy()
    start = np.searchsorted(session.block.t, session.windows[7, 0])
    accel[start + 60, 1] = 150.0
    result = solve_block(session, replace(session.block, accel=accel))
    assert any(f.kind == "moved" and f.poses == (7,) for f in result.findings)
    assert len(result.poses) == 23
    plain = solved(session)
    sigma = np.sqrt(np.diag(plain.gyro.covariance))[:9]
    assert np.all(np.abs(result.gyro.K - plain.gyro.K).ravel() < 3 * sigma)


def test_a_gyroscope_that_saturates_in_every_move_leaves_the_accelerometer():
    session = session_of(20)
    gyro = np.clip(session.block.gyro, -0.8, 0.8)
    result = solve_block(session, replace(session.block, gyro=gyro))
    assert result.gyro is None
    assert any("gyroscope was not calibrated" in w for w in result.warnings)
    assert certificate_of(result).gyro is None


def test_poses_that_show_nothing_are_refused():
    session = session_of(20)
    told = commanded(session)
    nine = np.zeros(24, dtype=bool)
    nine[:9] = True
    block, windows = session.block, session.windows[:9]
    accel = block.accel.copy()
    rng = np.random.default_rng(2)
    for begin, end in windows:
        rows = (block.t >= begin) & (block.t <= end)
        accel[rows] = accel[0] + 0.03 * rng.standard_normal((rows.sum(), 3))
    same = replace(told.only(nine), angles_deg=np.zeros((9, 3)))
    with pytest.raises(DataError, match="do not determine"):
        solve(replace(block, accel=accel), windows, method="joint", commanded=same)


def test_a_time_base_off_by_a_fifth_is_suspected():
    result = solved(session_of(20, SessionFaults(time_factor=1.2)))
    assert any("sample rate" in w for w in result.warnings)


def test_a_sensor_that_sits_otherwise_is_told_and_still_right():
    session = session_of(20)
    told = replace(commanded(session), mounting=(0,) * 24, mounting_turns=((0.0, 90.0 * DEG, 0.0),))
    result = solve_block(session, session.block, told)
    assert [f.kind for f in result.findings] == ["remounted"]
    plain = solved(session)
    assert result.accel.b == pytest.approx(plain.accel.b, abs=0.01 * MILLI_G)


def test_mountings_that_cannot_be_are_refused():
    angles = np.zeros((3, 3))
    with pytest.raises(InputError, match="count from 0"):
        CommandedPoses(angles, mounting=(-1, 0, 0), mounting_turns=((0.0, 0.0, 0.0),))
    with pytest.raises(InputError, match="finite"):
        CommandedPoses(angles, mounting=(0, 0, 0), mounting_turns=((0.0, np.nan, 0.0),))
