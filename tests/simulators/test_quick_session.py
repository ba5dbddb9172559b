"""Sessions made at once obey the physics of the rig that steps through time."""

import numpy as np
import pytest

from firmware_protocols.maestro import SetSpeed, SetTarget
from imu_rig.rotation import (
    about_x,
    about_y,
    about_z,
    compose,
    from_rotation_vector,
    to_matrix,
)
from imu_rig.units import DEG, MILLI_G, STANDARD_GRAVITY
from simulators.config import RigConfig
from simulators.quick_motion import Way, joint_rows, way_steps
from simulators.quick_session import QuickSession, SessionFaults, quick_session
from simulators.rig import AffineTruth
from simulators.servo import STEP_S
from simulators.straight_line import line_over_gravity

POSES = (
    (0.0, 0.0, -90.0),
    (0.0, 60.0, -90.0),
    (90.0, -60.0, -90.0),
    (90.0, 0.0, 45.0),
    (0.0, -90.0, 45.0),
)
QUIET_SENSOR = {
    "quantized": False,
    "accel_noise_ug": 0.0,
    "gyro_noise_dps": 0.0,
    "mag_noise_ut": 0.0,
    "accel_walk_mg": 0.0,
    "gyro_walk_dps": 0.0,
    "warm_up_c": 0.0,
}


def quiet(seed: int) -> RigConfig:
    """A rig with every error of a hobby jig, but a sensor without noise, on an Earth at rest."""
    config = RigConfig.random(seed)
    jig = config.jig.model_copy(update={"vibration_mg": 0.0})
    sensor = config.sensor.model_copy(update=QUIET_SENSOR)
    return config.model_copy(update={"jig": jig, "sensor": sensor, "latitude_deg": None})


def rows_of(session: QuickSession, still: int) -> slice:
    return slice(*np.searchsorted(session.block.t, session.windows[still]))


def still_means(session: QuickSession, readings: np.ndarray) -> np.ndarray:
    return np.array([readings[rows_of(session, i)].mean(axis=0) for i in range(len(POSES))])


def turned(session: QuickSession, first: int, last: int, factor: float = 1.0) -> np.ndarray:
    """Rotation between the middles of two stills by the truly calibrated gyroscope."""
    t = session.block.t / factor
    begin, end = np.searchsorted(session.block.t, session.windows[[first, last]].mean(axis=1))
    rate = session.truth.gyro.apply(session.block.gyro)[begin + 1 : end + 1]
    steps = np.diff(t[begin : end + 1])[:, np.newaxis]
    return to_matrix(compose(from_rotation_vector(rate * steps)))


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b) / np.sqrt(2.0))


def test_at_rest_the_true_calibration_reads_gravity_and_field_in_the_true_attitude():
    session = quick_session(quiet(4), POSES)
    body = np.swapaxes(session.attitudes, 1, 2)
    accel = session.truth.accel.apply(still_means(session, session.block.accel))
    np.testing.assert_allclose(accel, STANDARD_GRAVITY * body[:, :, 2], atol=0.3 * MILLI_G)
    mag = session.truth.mag.apply(still_means(session, session.block.mag))
    np.testing.assert_allclose(mag, body @ session.truth.field, atol=1e-3)
    gyro = session.truth.gyro.apply(still_means(session, session.block.gyro))
    np.testing.assert_allclose(gyro, 0.0, atol=1e-3 * DEG)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_true_gyroscope_turns_from_every_true_attitude_to_the_next(seed):
    session = quick_session(quiet(seed), POSES)
    for i in range(len(POSES) - 1):
        predicted = session.attitudes[i] @ turned(session, i, i + 1)
        assert angle_between(predicted, session.attitudes[i + 1]) < 0.01 * DEG


def test_an_ideal_jig_takes_the_commanded_angles():
    session = quick_session(RigConfig.ideal(), POSES)
    pan, tilt, roll = np.array(POSES).T * DEG
    expected = about_z(pan) @ about_y(tilt) @ about_x(roll)
    quarter_microsecond = 0.1 * DEG
    assert np.abs(session.attitudes - expected).max() < 2 * quarter_microsecond
    assert session.angles_deg.tolist() == [list(pose) for pose in POSES]


def test_a_hobby_jig_misses_the_commanded_angles_by_degrees():
    session = quick_session(quiet(4), POSES)
    expected = quick_session(RigConfig.ideal(), POSES).attitudes
    misses = [angle_between(a, b) / DEG for a, b in zip(session.attitudes, expected, strict=True)]
    assert 1.0 < np.median(misses) < 15.0


def test_stills_and_turns_agree_with_the_world_that_steps_through_time(talk, exact):
    """The same two poses driven over the Maestro's wire in the simulated world."""
    poses = ((40.0, 30.0, 20.0), (40.0, 30.0, 110.0))
    quick = quick_session(exact, poses)
    host = talk(exact)
    host.send(*(SetSpeed(channel, 30) for channel in range(3)))
    servos = (exact.jig.pan, exact.jig.tilt, exact.jig.roll)
    rows, ends = [], []
    for pose in ((0.0, 0.0, 0.0), *poses):
        pulses = [
            servo.pulse_us[0]
            + (angle - servo.angle_deg[0])
            * (servo.pulse_us[1] - servo.pulse_us[0])
            / (servo.angle_deg[1] - servo.angle_deg[0])
            for servo, angle in zip(servos, pose, strict=True)
        ]
        host.send(
            *(SetTarget(s.channel, round(4 * p)) for s, p in zip(servos, pulses, strict=True))
        )
        rows.append(host.run(4.0))
        ends.append(rows[-1][-50:])
    for i in range(2):
        ours = slice(*np.searchsorted(quick.block.t, quick.windows[i]))
        world = host.accel(ends[i + 1])
        np.testing.assert_allclose(
            quick.block.accel[ours].mean(axis=0), world.mean(axis=0), atol=1e-5
        )
        np.testing.assert_allclose(
            quick.block.mag[ours].mean(axis=0), host.mag(ends[i + 1]).mean(axis=0), atol=1e-4
        )
    second = slice(*np.searchsorted(quick.block.t, quick.windows[:, 1]))
    np.testing.assert_allclose(
        quick.block.gyro[second].sum(axis=0) * 0.01,
        host.gyro(rows[2]).sum(axis=0) * 0.01,
        atol=1e-5,
    )


def test_the_structure_rings_as_its_equation_says():
    """e'' + 2/tau e' + w^2 e = -u'', integrated here in small steps by another scheme."""
    model = RigConfig().jig.roll
    ways = [Way(100, way_steps(0.6, 1.4), 0.2, 0.8)]
    rows = joint_rows(ways, 0.2, 2500, model)
    drive = joint_rows(ways, 0.2, 2500, None)
    w2, damping = (2 * np.pi * model.ring_hz) ** 2, 2 / model.ring_tau_s
    e = rate = 0.0
    fine = 20
    for k in range(1200):
        for part in range(fine):
            if part == fine // 2:
                assert rows[k, 0] - drive[k, 0] == pytest.approx(e, abs=2e-5)
            acceleration = -drive[k, 2] - damping * rate - w2 * e
            rate += acceleration * STEP_S / fine
            e += rate * STEP_S / fine
    assert np.abs(rows[:, 0] - drive[:, 0]).max() > 1e-3
    np.testing.assert_allclose(rows[-1], (0.8, 0.0, 0.0), atol=1e-12)


def test_the_noise_of_a_still_is_that_of_the_data_sheet():
    config = RigConfig.random(5)
    jig = config.jig.model_copy(update={"vibration_mg": 0.0})
    session = quick_session(config.model_copy(update={"jig": jig}), POSES, hold_s=8.0)
    settled = [slice(rows_of(session, i).start + 150, rows_of(session, i).stop) for i in range(5)]
    for readings, density in (
        (session.block.accel @ session.truth.accel.K.T, 400e-6 * STANDARD_GRAVITY),
        (session.block.gyro @ session.truth.gyro.K.T, 0.005 * DEG),
    ):
        spread = [np.std(np.diff(readings[rows], axis=0), axis=0) for rows in settled]
        of_sample = density * np.sqrt(100.0 / 2.0)  # one-sided density, 100 samples a second
        assert np.sqrt(np.mean(np.square(spread)) / 2.0) == pytest.approx(of_sample, rel=0.05)


def test_the_same_seed_gives_the_same_session_and_another_another():
    first, again = (quick_session(RigConfig.random(7), POSES) for _ in range(2))
    np.testing.assert_array_equal(first.block.accel, again.block.accel)
    np.testing.assert_array_equal(first.block.gyro, again.block.gyro)
    other = quick_session(RigConfig.random(7).model_copy(update={"seed": 8}), POSES)
    assert not np.array_equal(first.block.gyro[:100], other.block.gyro[:100])


def test_the_truth_follows_walk_and_warm_up_to_the_stills():
    config = quiet(3)
    cold = config.sensor.model_copy(
        update={"warm_up_c": 8.0, "powered_s": 0.0, "accel_gain_percent_per_c": 0.02}
    )
    session = quick_session(config.model_copy(update={"sensor": cold}), POSES)
    body_up = session.attitudes[:, 2, :]
    error = session.truth.accel.apply(still_means(session, session.block.accel))
    error -= STANDARD_GRAVITY * body_up
    assert np.abs(error.mean(axis=0)).max() < 0.5 * MILLI_G
    warm_error = still_means(session, session.block.accel) @ np.array(cold.accel_gain).T
    warm_error -= np.array(cold.accel_offset) + STANDARD_GRAVITY * body_up
    assert np.abs(warm_error.mean(axis=0)).max() > 1.0 * MILLI_G
    assert session.block.temperature[0] == pytest.approx(cold.ambient_c, abs=0.1)


def test_the_line_over_gravity_is_what_the_magnitude_of_gravity_shows():
    """First order: +27/35 of the cubic share in the own scale, -3/35 in the others', 0.6 q bias."""
    q, c = 1e-3, 5e-4
    one = AffineTruth(np.eye(3), np.zeros(3))
    line = line_over_gravity(one, (q, 0.0, 0.0), (c, 0.0, 0.0), STANDARD_GRAVITY)
    seen = np.diag(np.linalg.inv(line.K)) - 1.0
    np.testing.assert_allclose(seen, np.array((27, -3, -3)) / 35 * c, atol=5e-6)
    np.testing.assert_allclose(line.b, (0.6 * q * STANDARD_GRAVITY, 0.0, 0.0), atol=1e-4)
    assert line_over_gravity(one, (0.0,) * 3, (0.0,) * 3, STANDARD_GRAVITY) is one


def test_turns_tell_the_stages_of_every_move():
    session = quick_session(quiet(1), POSES)
    position = (0.0, 0.0, 0.0)
    for turn in session.turns:
        assert turn.start_deg == position
        assert turn.t0 < turn.t1
        together = turn.stop_deg[2] == turn.start_deg[2]
        alone = turn.stop_deg[:2] == turn.start_deg[:2]
        # Either stage may stay where it is on the way out of the park pose.
        assert together or alone
        position = turn.stop_deg
    assert position == POSES[-1]


def test_a_second_mounting_is_the_nominal_turn_and_an_error_of_its_own():
    poses = (*POSES, *POSES)
    mounting = (0,) * len(POSES) + (1,) * len(POSES)
    session = quick_session(quiet(2), poses, mounting=mounting)
    relative = session.mounting_matrices[0].T @ session.mounting_matrices[1]
    miss = angle_between(relative, about_y(90 * DEG))
    assert 0.1 * DEG < miss < 20 * DEG
    still = rows_of(session, len(POSES))
    accel = session.truth.accel.apply(session.block.accel[still].mean(axis=0))
    up = session.attitudes[len(POSES)].T[:, 2]
    np.testing.assert_allclose(accel, STANDARD_GRAVITY * up, atol=0.3 * MILLI_G)
    predicted = session.attitudes[len(POSES) - 1] @ turned(session, len(POSES) - 1, len(POSES))
    assert angle_between(predicted, session.attitudes[len(POSES)]) < 0.02 * DEG


def faulty(faults: SessionFaults) -> tuple[QuickSession, QuickSession]:
    return quick_session(quiet(6), POSES), quick_session(quiet(6), POSES, faults=faults)


def test_swapped_labels_change_what_was_noted_and_nothing_else():
    clean, swapped = faulty(SessionFaults(swapped=(1, 3)))
    np.testing.assert_array_equal(clean.block.accel, swapped.block.accel)
    assert swapped.angles_deg[[1, 3]].tolist() == clean.angles_deg[[3, 1]].tolist()
    last = [turn.stop_deg for turn in swapped.turns]
    assert POSES[3] in last


def test_a_clipped_axis_reads_no_more_than_its_limit():
    _, clipped = faulty(SessionFaults(clipped=(2, 4.0)))
    assert np.abs(clipped.block.accel[:, 2]).max() == 4.0
    assert np.abs(clipped.block.accel[:, 1]).max() > 4.0


@pytest.mark.parametrize("factor", [2.0, 0.5])
def test_a_wrong_time_base_stretches_all_that_was_noted(factor):
    clean, wrong = faulty(SessionFaults(time_factor=factor))
    np.testing.assert_allclose(wrong.block.t, factor * clean.block.t)
    np.testing.assert_allclose(wrong.windows, factor * clean.windows)
    assert wrong.turns[3].t1 == pytest.approx(factor * clean.turns[3].t1)
    np.testing.assert_array_equal(wrong.block.gyro, clean.block.gyro)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slipped_servo_stands_wrong_from_its_pose_on(axis):
    clean, slipped = faulty(SessionFaults(slip=(axis, 2, 5.0)))
    misses = [
        angle_between(a, b) / DEG for a, b in zip(slipped.attitudes, clean.attitudes, strict=True)
    ]
    np.testing.assert_allclose(misses, (0.0, 0.0, *[5.0] * 3), atol=0.01)
    predicted = slipped.attitudes[1] @ turned(slipped, 1, 2)
    assert angle_between(predicted, slipped.attitudes[2]) < 0.01 * DEG


def test_a_bump_shows_in_one_pose_and_the_gyroscope_sees_it_come_and_go():
    clean, bumped = faulty(SessionFaults(bumped=2))
    misses = [
        angle_between(a, b) / DEG for a, b in zip(bumped.attitudes, clean.attitudes, strict=True)
    ]
    size = np.linalg.norm((3.0, -4.0, 2.0))
    np.testing.assert_allclose(misses, (0.0, 0.0, size, 0.0, 0.0), atol=0.1)
    for i in (1, 2):
        predicted = bumped.attitudes[i] @ turned(bumped, i, i + 1)
        assert angle_between(predicted, bumped.attitudes[i + 1]) < 0.01 * DEG


def test_odd_arguments_are_refused_in_one_sentence():
    with pytest.raises(ValueError, match="no multiple of a sample rate of 273"):
        quick_session(quiet(1), POSES, rate_hz=273.0)
    with pytest.raises(ValueError, match="1 mountings stand for 5 poses"):
        quick_session(quiet(1), POSES, mounting=(0,))
