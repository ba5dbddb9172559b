"""Calibration without known angles: right, honest about how right, refused where it cannot be."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_sessions import (
    DEG,
    MILLI_G,
    Truth,
    exact,
    jig_attitudes,
    random_sensor,
    record,
    spread_attitudes,
)

from imu_rig import rotation
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.earth import EARTH_RATE, earth_covariance
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.moves import integrate, integrate_with_slopes, moves_between
from imu_rig.calibration.session import CommandedPoses
from imu_rig.calibration.solve import solve
from imu_rig.calibration.stills import summarize
from imu_rig.errors import DataError, InputError

QUIET = {"accel_noise": 1e-6, "gyro_noise": 1e-8}


def session(seed, count=20, truth=None, **options):
    rng = np.random.default_rng(seed)
    truth = truth or random_sensor(rng)
    return truth, record(spread_attitudes(count, rng), truth, rng, **options)


def deviation(result, truth):
    """Errors of K and b of both sensors in their own standard uncertainties, and in t factors."""
    z, inside = [], []
    for found, true in ((result.accel, truth.accel), (result.gyro, truth.gyro)):
        error = np.concatenate(((found.K - true.K).ravel(), found.b - true.b))
        sigma = np.concatenate((found.K_uncertainty.ravel(), found.b_uncertainty))
        known = sigma > 0
        z.append(error[known] / sigma[known])
        inside.append(np.abs(z[-1]) < found.coverage_factor)
    return np.concatenate(z), np.concatenate(inside)


def test_the_earth_makes_an_unturned_gyroscope_s_bias_uncertain_and_averages_out_when_turned():
    _, recording = session(5, 20)
    result = solve(recording.block, recording.holds)
    stills = summarize(recording.block, recording.holds)
    moves = moves_between(recording.block, stills, stills.gyro_mean)
    turned = earth_covariance(moves, len(stills), result.gyro.K, stills.gyro_mean)
    broken = moves.only(np.arange(len(moves)) != 3)
    unturned = earth_covariance(broken, len(stills), result.gyro.K, stills.gyro_mean)
    assert np.allclose(unturned, np.eye(3) * EARTH_RATE**2 / 3)
    A = rotation.to_matrix(recording.attitudes)
    # in the first still's axes, which no covariance of an isotropic rotation depends on
    mean = np.mean(np.swapaxes(A, 1, 2), axis=0)
    assert np.allclose(turned, mean @ mean.T * EARTH_RATE**2 / 3, atol=0.02 * EARTH_RATE**2)
    assert np.trace(turned) < 0.5 * np.trace(unturned)


def direct(block, a, b):
    """The product of small rotations one by one, trapezoid rates."""
    q = np.array([1.0, 0, 0, 0])
    for k in range(a, b):
        w = 0.5 * (block.gyro[k] + block.gyro[k + 1])
        dt = block.t[k + 1] - block.t[k]
        q = rotation.multiply(q, rotation.from_rotation_vector(w * dt))
    return q


def test_perfect_data_give_the_exact_sensor():
    truth, recording = session(1, rate=200.0, **QUIET)
    result = solve(recording.block, recording.holds)
    assert np.allclose(result.accel.K, truth.accel.K, atol=1e-7)
    assert np.allclose(result.accel.b, truth.accel.b, atol=1e-6)
    # What is left is the trapezoid rule on 200 samples per second.
    assert np.allclose(result.gyro.K, truth.gyro.K, atol=3e-5)
    assert np.allclose(result.gyro.b, truth.gyro.b, atol=1e-6)
    assert result.warnings == ()


def test_convergence_from_a_sensor_far_from_its_data_sheet():
    rng = np.random.default_rng(2)
    T = np.triu(0.1 * rng.standard_normal((3, 3)), 1) + np.diag([1.2, 0.85, 0.9])
    G = 0.9 * np.eye(3) + 0.08 * rng.standard_normal((3, 3))
    truth = Truth(exact(T, [2.0, -3.0, 1.0]), exact(G, np.array([20.0, -30.0, 10.0]) * DEG))
    recording = record(spread_attitudes(24, rng), truth, rng, **QUIET)
    result = solve(recording.block, recording.holds)
    assert np.allclose(result.accel.K, T, atol=1e-6)
    assert np.allclose(result.gyro.K, G, atol=2e-4)
    assert any("off its nominal scale" in warning for warning in result.warnings)


def test_intervals_contain_the_truth_as_often_as_they_say_and_nothing_is_biased():
    z, inside, left_out, warned = [], [], [], 0
    for seed in range(80):
        walk = 0.1 * DEG / np.sqrt(600) if seed % 2 else 0.0
        pole = np.random.default_rng([seed, 7]).standard_normal(3)
        earth = EARTH_RATE * pole / np.linalg.norm(pole)
        truth, recording = session(
            100 + seed, 16 + seed % 3, hold_s=1.3, move_s=0.9, walk=walk, earth=earth
        )
        result = solve(recording.block)
        one_z, one_inside = deviation(result, truth)
        z.append(one_z)
        inside.append(one_inside)
        left_out += [pose.left_out / pose.left_out_sigma for pose in result.poses]
        warned += len(result.warnings)
    z, inside = np.array(z), np.array(inside)
    # 80 sessions: nine accelerometer numbers, nine gains, three biases; standard error 0.01.
    for part in (slice(0, 9), slice(9, 18), slice(18, 21)):
        assert 0.90 < inside[:, part].mean() < 0.99
        assert 0.8 < np.sqrt(np.mean(z[:, part] ** 2)) < 1.2
    assert np.all(np.abs(z.mean(axis=0)) < 0.4)
    assert 0.8 < np.sqrt(np.mean(np.square(left_out))) < 1.15
    assert warned <= 3


def test_held_out_gravity_directions_are_no_better_than_they_should_be():
    _, recording = session(3, 30, move_s=1.5)
    result = solve(recording.block)
    after, held = result.gyro_errors.after.rms, result.gyro_errors.held_out.rms
    assert after < held < 3 * after
    # Two axes of 0.005 deg/s/rtHz over 1.9 s and of the accelerometer's noise.
    assert held < 0.08 * DEG
    assert result.gyro_errors.before.rms > 10 * held
    assert all(move.held_out_rad is not None for move in result.moves)


def test_turning_the_sensor_in_its_housing_changes_no_residual():
    _, recording = session(4, 18)
    Q = rotation.to_matrix(rotation.normalize(np.array([0.9, 0.3, -0.5, 0.2])))
    block = recording.block
    turned = replace(block, accel=block.accel @ Q.T, gyro=block.gyro @ Q.T)
    one, other = (solve(b, recording.holds) for b in (block, turned))
    for a, b in zip(one.poses, other.poses, strict=True):
        assert a.left_out == pytest.approx(b.left_out, abs=5e-2 * MILLI_G)
    assert one.gyro_errors.after.rms == pytest.approx(other.gyro_errors.after.rms, rel=0.05)
    assert one.gyro_errors.held_out.rms == pytest.approx(other.gyro_errors.held_out.rms, rel=0.05)


def test_another_nominal_scale_is_absorbed_by_the_gain():
    _, recording = session(5, 18)
    block = recording.block
    scaled = replace(block, accel=block.accel * 1.1, gyro=block.gyro / 1.05)
    one, other = (solve(b, recording.holds) for b in (block, scaled))
    assert np.allclose(other.accel.K, one.accel.K / 1.1, atol=3e-5)
    assert np.allclose(other.accel.b, one.accel.b, atol=3e-4)
    assert np.allclose(other.gyro.K, one.gyro.K * 1.05, atol=2e-4)


def test_scale_follows_local_gravity_and_the_result_says_which():
    _, recording = session(6, 18, gravity=9.78)
    given = solve(recording.block, recording.holds, gravity=9.78)
    assumed = solve(recording.block, recording.holds)
    ratio = assumed.accel.K[0, 0] / given.accel.K[0, 0]
    assert ratio == pytest.approx(9.80665 / 9.78, rel=1e-6)
    assert given.gravity == Gravity.given(9.78)
    assert not assumed.gravity.known
    with pytest.raises(InputError, match="not possible"):
        solve(recording.block, gravity=1.0)


def test_tree_of_products_is_the_product_one_by_one_and_its_slope_the_difference():
    truth, recording = session(7, 5, rate=60.0)
    block = recording.block
    stills = summarize(block, recording.holds)
    zero = np.zeros((len(stills), 3))
    moves = moves_between(block, stills, zero)
    q = integrate(moves, np.eye(3), zero)
    for j in range(len(moves)):
        one = direct(block, int(stills.stop[j]) - 1, int(stills.start[j + 1]))
        assert np.allclose(q[j], one, atol=1e-12) or np.allclose(q[j], -one, atol=1e-12)
    bias = stills.gyro_mean
    K = truth.gyro.K
    q, J = integrate_with_slopes(moves, K, bias)
    step = 1e-5

    def slope(dK, db):
        there = [integrate(moves, K + s * dK, bias + s * db) for s in (step, -step)]
        turn = rotation.multiply(rotation.conjugate(there[1]), there[0])
        return rotation.to_rotation_vector(turn) / (2 * step)

    for i, unit in enumerate(np.eye(9).reshape(9, 3, 3)):
        assert np.allclose(slope(unit, zero), J[:, :, i], atol=1e-3)
    # Every second still: the begin of the even moves and the end of the odd ones.
    even = (np.arange(len(stills)) % 2 == 0)[:, None]
    for axis, unit in enumerate(np.eye(3)):
        turned = slope(np.zeros((3, 3)), even * unit)
        assert np.allclose(turned[::2], J[::2, :, 9 + axis], atol=1e-3)
        assert np.allclose(turned[1::2], J[1::2, :, 12 + axis], atol=1e-3)


def test_a_pose_that_was_knocked_is_named_and_set_aside():
    truth, recording = session(8, 24)
    hold = recording.holds[7]
    at = (recording.block.t >= hold[0]) & (recording.block.t <= hold[1])
    accel = recording.block.accel.copy()
    accel[at] *= 1.02
    result = solve(replace(recording.block, accel=accel), recording.holds)
    assert any("pose 8 was set aside" in warning for warning in result.warnings)
    assert abs(result.poses[7].left_out) == pytest.approx(0.02 * 9.80665, rel=0.05)
    z, _ = deviation(result, truth)
    assert np.all(np.abs(z[:9]) < 5)


def test_a_move_with_a_wrong_turn_is_named_and_set_aside():
    truth, recording = session(9, 24)
    begin, end = recording.holds[11, 1], recording.holds[12, 0]
    at = (recording.block.t > begin) & (recording.block.t < end)
    gyro = recording.block.gyro.copy()
    gyro[at] *= 1.2
    result = solve(replace(recording.block, gyro=gyro), recording.holds)
    assert any("pose 12 to pose 13 was set aside" in warning for warning in result.warnings)
    z, _ = deviation(result, truth)
    assert np.all(np.abs(z[9:]) < 5)


FACES = [(0, 0, 0), (0, 0, 90), (0, 0, 180), (0, 0, -90), (0, 90, 0), (0, -90, 0)]


def test_six_faces_are_refused_with_the_poses_to_add():
    rng = np.random.default_rng(10)
    recording = record(jig_attitudes(FACES), random_sensor(rng), rng)
    with pytest.raises(DataError, match="6 still poses cannot determine the nine") as caught:
        solve(recording.block)
    # Faces are there already: what helps are edges and corners.
    named = str(caught.value).split(": ")[1].split(". ")[0].split(", ")
    assert all(len(name) in (4, 6) for name in named)
    assert len(named) >= 3


def test_many_poses_on_six_faces_are_refused_by_the_parameters_they_leave_free():
    rng = np.random.default_rng(11)
    recording = record(jig_attitudes(FACES * 3), random_sensor(rng), rng)
    with pytest.raises(
        DataError, match=r"non-orthogonality xy, non-orthogonality xz and non-orthogonality yz.*\+x"
    ):
        solve(recording.block)


def test_poses_all_one_side_up_are_refused_or_reported_as_uncertain():
    rng = np.random.default_rng(12)
    angles = np.column_stack((np.zeros(18), rng.uniform(-30, 30, (18, 2))))
    recording = record(jig_attitudes(angles), random_sensor(rng), rng)
    with pytest.raises(
        DataError, match=r"do not determine .*scale z.*of the accelerometer"
    ) as caught:
        solve(recording.block)
    assert "-z" in str(caught.value)


def test_twelve_poses_are_called_fragile_with_numbers():
    _, recording = session(13, 12)
    result = solve(recording.block)
    (warning,) = [w for w in result.warnings if "fragile" in w]
    assert "12 poses" in warning
    assert "%" in warning
    assert "mrad" in warning


def test_a_saturated_accelerometer_axis_is_named_with_its_poses():
    truth, recording = session(14, 24)
    clipped = recording.block.accel.copy()
    clipped[:, 2] = np.minimum(clipped[:, 2], 8.5)
    result = solve(replace(recording.block, accel=clipped), recording.holds)
    named = [w for w in result.warnings if "range limit" in w]
    assert len(named) == 1
    assert "Axis z of the accelerometer" in named[0]
    assert "8.50" in named[0]
    (finding,) = (f for f in result.findings if f.kind == "saturated")
    assert finding.axis == "z"
    assert len(result.poses) == 24 - len(finding.poses)
    z, _ = deviation(result, truth)
    assert np.all(np.abs(z[:9]) < 5)


def test_a_saturated_gyroscope_is_reported_and_its_moves_left_out():
    truth, recording = session(15, 24, move_s=0.8)
    limit = 250 * DEG
    clipped = np.clip(recording.block.gyro, -limit, limit)
    result = solve(replace(recording.block, gyro=clipped), recording.holds)
    assert any("gyroscope is at its range limit" in w for w in result.warnings)
    assert len(result.moves) < 23
    z, _ = deviation(result, truth)
    assert np.all(np.abs(z[9:]) < 5)


def test_a_known_range_limit_is_used():
    _, recording = session(16, 24)
    limit = float(np.abs(recording.block.gyro).max()) * 0.9
    result = solve(recording.block, recording.holds, gyro_limit=limit)
    assert any("gyroscope is at its range limit" in w for w in result.warnings)


def test_an_unsaturated_recording_raises_no_suspicion_even_when_coarse():
    _, recording = session(17, 18)
    coarse = replace(
        recording.block,
        accel=np.round(recording.block.accel * 4096 / 9.80665) * 9.80665 / 4096,
        gyro=np.round(recording.block.gyro / DEG * 16.4) / 16.4 * DEG,
    )
    assert solve(coarse, recording.holds).warnings == ()


def resampled(block, factor):
    t = block.t * factor
    return replace(block, t=t, host_s=t)


SWAPPED = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda b: replace(b, accel=b.accel / 9.8), r"reads 0\.9.*unit or range"),
        (lambda b: replace(b, accel=b.accel * 2), "unit or range"),
        (lambda b: replace(b, gyro=b.gyro / DEG), "are in deg/s"),
        (lambda b: replace(b, gyro=b.gyro * DEG), "are in rad/s"),
        (lambda b: resampled(b, 2.0), "1/2 times.*sample rate"),
        (lambda b: resampled(b, 0.5), "2 times.*sample rate"),
        (lambda b: replace(b, gyro=-b.gyro), "-x, -y, -z"),
        (lambda b: replace(b, gyro=b.gyro @ SWAPPED), "order and signs"),
    ],
)
def test_wrong_units_rates_and_axes_are_named(spoil, words):
    _, recording = session(18, 20)
    with pytest.raises(DataError, match=words):
        solve(spoil(recording.block))


def test_turning_only_while_an_axis_is_upright_leaves_the_gyroscope_out_and_says_why():
    # Tilt does all the tilting; roll changes only with x upright, where gravity sees nothing.
    angles = []
    for roll in (0, 45, 90, 135, 180):
        angles += [(0, 90, roll), (0, 45, roll), (0, 0, roll), (0, -45, roll), (0, 90, roll)]
    rng = np.random.default_rng(19)
    recording = record(jig_attitudes(angles), random_sensor(rng), rng)
    result = solve(recording.block, recording.holds)
    assert result.gyro is None
    assert result.moves == ()
    (warning,) = [w for w in result.warnings if "gyroscope was not calibrated" in w]
    assert "turns about x:" in warning
    assert "about x while that axis is level" in warning


def test_without_a_gyroscope_the_accelerometer_is_calibrated_all_the_same():
    _, recording = session(20, 18)
    block = replace(recording.block, gyro=np.zeros_like(recording.block.gyro))
    result = solve(block)
    assert result.gyro is None
    assert result.gyro_figures is None
    assert any("only the accelerometer" in w for w in result.warnings)


def test_poses_that_disagree_are_not_answered_with_an_empty_list():
    """Every direction is there, so that none can be named to add."""
    _, recording = session(22, 30)
    wrong = np.random.default_rng(1).uniform(0.6, 1.4, len(recording.holds))
    pose = np.searchsorted(recording.holds[:, 1], recording.block.t).clip(max=len(wrong) - 1)
    block = replace(recording.block, accel=recording.block.accel * wrong[pose, None])
    with pytest.raises(DataError, match="do not determine") as caught:
        solve(block, recording.holds)
    assert "corners up" not in str(caught.value)
    assert "held quite still" in str(caught.value)


def test_gaps_temperature_and_motion_in_a_hold_are_reported():
    _, recording = session(21, 20)
    t = recording.block.t
    temperature = np.linspace(25.0, 32.0, len(t))
    accel = recording.block.accel.copy()
    hold = (t >= recording.holds[4, 0]) & (t <= recording.holds[4, 1])
    accel[hold] += np.linspace(0, 0.5, int(hold.sum()))[:, None] * [0.6, 0.6, 0.5]
    block = replace(recording.block, temperature=temperature, accel=accel)
    gap = (t < recording.holds[9, 0] + 0.9) | (t > recording.holds[9, 0] + 1.2)
    holds = np.delete(recording.holds, 9, axis=0)
    result = solve(block[gap], holds)
    assert any("1 gap" in w for w in result.warnings)
    assert any("7.0 degC" in w for w in result.warnings)
    (moved,) = [w for w in result.warnings if "moved during pose 5" in w]
    assert "less certain: let it settle longer" in moved
    assert result.poses[4].sigma > 3.0 * np.median([pose.sigma for pose in result.poses])
    assert result.temperature_c == (25.0, 32.0)


def test_a_sensor_that_hung_is_reported_and_its_poses_left_out():
    truth, recording = session(25, 24)
    block = recording.block
    hung = (block.t > recording.holds[6, 0] + 0.5) & (block.t < recording.holds[7, 1] - 0.5)
    first = int(np.argmax(hung))
    accel, gyro = block.accel.copy(), block.gyro.copy()
    accel[hung], gyro[hung] = accel[first], gyro[first]
    result = solve(replace(block, accel=accel, gyro=gyro), recording.holds)
    assert any("sensor hung" in w for w in result.warnings)
    assert {"pose 7", "pose 8"}.isdisjoint(pose.name for pose in result.poses)
    z, _ = deviation(result, truth)
    assert np.all(np.abs(z) < 5)


def test_without_a_usable_move_only_the_accelerometer_is_calibrated():
    _, recording = session(26, 18)
    at_rest = np.zeros(len(recording.block), dtype=bool)
    for begin, end in recording.holds:
        at_rest |= (recording.block.t >= begin) & (recording.block.t <= end)
    result = solve(recording.block[at_rest], recording.holds)
    assert result.gyro is None
    assert result.moves == ()
    assert any("0 moves cannot determine" in w for w in result.warnings)
    assert result.accel_errors.held_out.rms < 1.0 * MILLI_G


def test_a_walking_bias_is_reported():
    _, recording = session(22, 24, walk=0.05 * DEG)
    assert any("bias walked" in w for w in solve(recording.block).warnings)


def test_commanded_angles_name_the_poses_whatever_the_method():
    rng = np.random.default_rng(23)
    angles = [(0, t, r) for r in range(-180, 180, 60) for t in (-60, 0, 60)]
    recording = record(jig_attitudes(angles), random_sensor(rng), rng)
    names = tuple(f"stop {i}" for i in range(len(angles)))
    commanded = CommandedPoses(np.array(angles, float), names)
    result = solve(recording.block, recording.holds, commanded=commanded)
    assert [pose.name for pose in result.poses] == list(names)
    assert result.poses[4].commanded_deg == angles[4]
    assert result.moves[0].start == "stop 0"


def test_what_is_not_a_number_is_refused():
    _, recording = session(24, 10)
    bad = recording.block.accel.copy()
    bad[5, 1] = np.nan
    with pytest.raises(DataError, match="not numbers"):
        solve(replace(recording.block, accel=bad))


def read_plain(path, **options) -> ImuBlock:
    data = np.loadtxt(path, **options)
    t = np.arange(len(data)) / 100.0
    return ImuBlock(t, data[:, :3], data[:, 3:6], t)


@pytest.mark.parametrize(("name", "most_mg"), [("imu0.log", 0.30), ("imu1.log", 0.36)])
def test_real_multi_position_recordings(imu_rig_data, name, most_mg):
    block = read_plain(imu_rig_data / "calibration" / "mikoff_mpu9150" / name)
    result = solve(block, gravity=9.81)
    assert result.accel_errors.held_out.rms < most_mg * MILLI_G
    assert result.accel_errors.before.rms > 15 * MILLI_G
    assert result.gyro_errors.held_out.rms < 0.12 * DEG
    assert result.gyro_errors.before.rms > 0.5 * DEG
    z = [pose.left_out / pose.left_out_sigma for pose in result.poses]
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.15
    assert result.warnings == ()


def test_an_ill_posed_and_saturated_recording_is_said_to_be_so(imu_rig_data):
    path = imu_rig_data / "calibration" / "tomisuarez2_mpu6050" / "example_data_calibration.csv"
    counts = read_plain(path, delimiter=",", skiprows=5)
    block = replace(counts, accel=counts.accel / 16384 * 9.80665, gyro=counts.gyro / 131 * DEG)
    result = solve(block)
    assert any("fragile" in w for w in result.warnings)
    assert any("12 of x, 6 of z" in w for w in result.warnings)
    # Ten poses left one lean open to some hundredths of a radian, and the result knows it.
    assert result.accel_figures.cross_rad_u.max() > 0.02
    assert result.accel_errors.held_out.rms < 5 * np.sqrt(
        np.mean([pose.left_out_sigma**2 for pose in result.poses])
    )


def test_a_hold_with_missing_samples_is_set_aside_and_named():
    _, recording = session(21, 20)
    block = recording.block
    begin = recording.holds[4][0]
    gone = (block.t > begin + 0.6) & (block.t < begin + 1.0)
    result = solve(block[~gone], recording.holds)
    assert len(result.poses) == 19
    assert any("pose 5 was set aside" in warning for warning in result.warnings)
