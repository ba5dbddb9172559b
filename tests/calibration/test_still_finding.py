"""Still intervals: what is one, what only looks like one, and how well its mean is known."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_sessions import DEG, MILLI_G, exact, random_sensor, record, spread_attitudes

from imu_rig import rotation
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.stills import find_stills, sample_rate, summarize
from imu_rig.errors import DataError, InputError

IDEAL_GYRO = exact(np.eye(3), np.array([2.0, -1.0, 0.5]) * DEG)


def session(rng, count=8, **options):
    return record(spread_attitudes(count, rng), random_sensor(rng), rng, **options)


def stills_rows(stills):
    return zip(stills.start, stills.stop, strict=True)


def vertical_turn(rng, rate_dps, *, rest_s=3.0, turn_s=4.0, fs=100.0):
    """Rest, turn steadily about the vertical, rest: the accelerometer sees nothing at all."""
    truth = random_sensor(rng)
    level = np.array([[1.0, 0, 0, 0]])
    still = record(level, truth, rng, hold_s=2 * rest_s + turn_s, rate=fs)
    turning = (still.block.t >= rest_s) & (still.block.t < rest_s + turn_s)
    w = np.zeros((len(still.block), 3))
    w[turning, 2] = rate_dps * DEG
    seen = still.block.gyro + w @ np.linalg.inv(truth.gyro.K).T
    return replace(still.block, gyro=seen), turning


@pytest.mark.parametrize("rate", [100.0, 200.0, 400.0])
def test_every_rest_is_found_and_nothing_of_the_moves(rate):
    rng = np.random.default_rng(1)
    recording = session(rng, rate=rate)
    stills = find_stills(recording.block)
    assert len(stills) == 8
    # The window looks at samples, so half of one may stick out at either end.
    assert np.all(stills.t0 > recording.holds[:, 0] - 0.05)
    assert np.all(stills.t1 < recording.holds[:, 1] + 0.05)
    assert np.all(stills.t1 - stills.t0 > 1.4)


@pytest.mark.parametrize("rate_dps", [2.0, 5.0, 30.0])
def test_a_slow_turn_about_the_vertical_is_not_still(rate_dps):
    block, turning = vertical_turn(np.random.default_rng(2), rate_dps)
    stills = find_stills(block)
    rows = np.concatenate([np.arange(a, b) for a, b in stills_rows(stills)])
    # Half a window at either end of the turn may count as rest.
    assert np.mean(turning[rows]) < 0.1
    assert np.mean(~turning[rows]) > 0.9


def test_the_rests_beside_a_vertical_turn_are_two_poses():
    block, _ = vertical_turn(np.random.default_rng(3), 30.0)
    assert len(find_stills(block)) == 2


def test_a_rest_disturbed_by_a_knock_counts_once():
    rng = np.random.default_rng(4)
    recording = record(spread_attitudes(3, rng), random_sensor(rng), rng, hold_s=4.0)
    accel = recording.block.accel.copy()
    knock = (recording.block.t > 2.5) & (recording.block.t < 2.6)
    accel[knock] += 5.0 * rng.standard_normal((int(knock.sum()), 3))
    assert len(find_stills(replace(recording.block, accel=accel))) == 3


def test_a_table_that_trembles_is_a_rest():
    rng = np.random.default_rng(5)
    recording = session(rng, hold_s=3.0)
    t = recording.block.t
    tremor = 0.8 * DEG * np.sin(2 * np.pi * 3.0 * t)[:, None] * np.array([0.6, -0.5, 0.6])
    stills = find_stills(replace(recording.block, gyro=recording.block.gyro + tremor))
    assert len(stills) == 8


def test_a_still_never_spans_a_gap():
    rng = np.random.default_rng(6)
    recording = record(spread_attitudes(2, rng), random_sensor(rng), rng, hold_s=6.0)
    t = recording.block.t
    block = recording.block[(t < 2.0) | (t > 2.5)]
    stills = find_stills(block)
    assert not np.any((stills.t0 < 2.0) & (stills.t1 > 2.5))
    with pytest.raises(DataError, match="gap"):
        summarize(block, [(1.0, 4.0)])


@pytest.mark.parametrize("jitter", [0.0, 0.9])
def test_jittered_time_stamps_do_no_harm(jitter):
    rng = np.random.default_rng(7)
    assert len(find_stills(session(rng, jitter=jitter, rate=200.0).block)) == 8


def test_what_moves_all_the_time_is_refused_with_advice():
    rng = np.random.default_rng(8)
    recording = session(rng, hold_s=0.2, move_s=2.0)
    with pytest.raises(DataError, match="rest for 2 s"):
        find_stills(recording.block)


def test_standard_errors_tell_the_truth_also_with_vibration():
    rng = np.random.default_rng(9)
    truth = random_sensor(rng)
    attitude = spread_attitudes(1, rng)
    force = rotation.rotate(rotation.conjugate(attitude[0]), np.array([0, 0, 9.80665]))
    z = []
    for _ in range(40):
        recording = record(attitude, truth, rng, hold_s=20.0)
        t = recording.block.t
        phase, frequency = rng.uniform(0, 7), rng.uniform(15, 45)
        shake = 20 * MILLI_G * np.sin(2 * np.pi * frequency * t + phase)[:, None] * [1, 1, 1]
        block = replace(recording.block, accel=recording.block.accel + shake)
        windows = [(2.0 * k, 2.0 * k + 1.9) for k in range(10)]
        stills = summarize(block, windows)
        z.append((stills.accel_mean - truth.accel.undo(force)) / stills.accel_sem)
    # White noise alone has rms 1; a vibration scatters the blocks more than it moves the mean.
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.15
    assert np.mean(np.abs(z) < 2.5) > 0.97


def test_drift_within_a_hold_is_seen_and_noise_is_not():
    rng = np.random.default_rng(10)
    recording = session(rng, count=12, hold_s=3.0)
    quiet = summarize(recording.block, recording.holds)
    assert np.all(quiet.drift < 8.0)
    moved = recording.block.accel.copy()
    hold = (recording.block.t >= recording.holds[4, 0]) & (
        recording.block.t <= recording.holds[4, 1]
    )
    moved[hold] += np.linspace(0, 0.3, int(hold.sum()))[:, None] * [0.0, 1.0, 0.0]
    drifted = summarize(replace(recording.block, accel=moved), recording.holds)
    assert drifted.drift[4] > 8.0
    assert np.all(np.delete(drifted.drift, 4) < 8.0)


def test_a_sensor_that_hangs_is_not_at_rest():
    rng = np.random.default_rng(12)
    block = session(rng, hold_s=3.0).block
    hung = (block.t > 4.2) & (block.t < 9.0)
    first = int(np.argmax(hung))
    accel, gyro = block.accel.copy(), block.gyro.copy()
    accel[hung], gyro[hung] = accel[first], gyro[first]
    stills = find_stills(replace(block, accel=accel, gyro=gyro))
    rows = np.concatenate([np.arange(a, b) for a, b in stills_rows(stills)])
    assert np.mean(hung[rows]) < 0.02
    assert len(stills) >= 5


def test_windows_that_cannot_be_are_named():
    recording = session(np.random.default_rng(11), count=3)
    with pytest.raises(InputError, match="2 ends before it begins"):
        summarize(recording.block, [(0.1, 1.0), (2.0, 1.5)])
    with pytest.raises(InputError, match="2 begins before interval 1 ends"):
        summarize(recording.block, [(0.1, 1.0), (0.9, 1.5)])
    with pytest.raises(DataError, match=r"1 .* holds 5 samples"):
        summarize(recording.block, [(0.1, 0.14)])
    with pytest.raises(DataError, match=r"1 .* holds 0 samples"):
        summarize(recording.block, [(500.0, 501.0)])


def test_time_that_does_not_increase_is_refused():
    assert sample_rate(np.arange(10) / 50.0) == pytest.approx(50.0)
    with pytest.raises(DataError, match="after sample 1"):
        sample_rate(np.array([0.0, 0.1, 0.1, 0.2]))
    with pytest.raises(DataError, match="fewer than two"):
        sample_rate(np.zeros(1))


def test_stills_of_real_recordings(imu_rig_data):
    folder = imu_rig_data / "calibration" / "mikoff_mpu9150"
    for name in ("imu0.log", "imu1.log"):
        data = np.loadtxt(folder / name)
        t = np.arange(len(data)) / 100.0
        stills = find_stills(ImuBlock(t, data[:, :3], data[:, 3:], t))
        assert 20 <= len(stills) <= 24
        # A turn about the vertical taken for a rest would spread this over degrees per second.
        assert np.all(np.ptp(stills.gyro_mean, axis=0) < 0.4 * DEG)
