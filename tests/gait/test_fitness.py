"""Recordings that cannot give a true answer are refused with what to do; others are not."""

from dataclasses import replace

import numpy as np
import pytest

from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.fitness import check_recording
from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.unseen import unseen_motion, widened
from imu_rig.importing.formats import load_foreign
from imu_rig.rotation import from_rotation_vector, multiply, to_matrix
from imu_rig.units import STANDARD_GRAVITY as G
from simulators.walker.device import Carried
from simulators.walker.path import Straight, Turn
from simulators.walker.record import record_walk
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Walker


def recorded(unit):
    return ImuBlock(unit.t, unit.accel, unit.gyro, unit.t)


@pytest.fixture(scope="module")
def units():
    """A foot and a waist that walk round a corner, sensors with errors of their kind."""
    way = Walk((Straight(5.0), Turn(90.0), Straight(5.0)), (1.3,))
    walker = Walker(Scenario("corner", "Round a corner", (Stand(2.5), way, Stand(1.5))), seed=2)
    worn = [Carried("left-foot", "mpu9150"), Carried("waist", "mpu9150")]
    records = record_walk(walker, worn)
    return {name: record.units[0] for name, record in records.items()}


@pytest.fixture(scope="module")
def foot(units):
    return recorded(units["left-foot"])


@pytest.fixture(scope="module")
def swing(foot):
    """The sample in the middle of the recording in which the foot turns fastest."""
    third = len(foot) // 3
    return third + int(np.argmax(np.linalg.norm(foot.gyro, axis=1)[third : 2 * third]))


def scaled(block, accel=1.0, gyro=1.0):
    return replace(block, accel=block.accel * accel, gyro=block.gyro * gyro)


def without(block, begin, seconds):
    return block[(block.t < begin) | (block.t > begin + seconds)]


def with_value(block, name, row, value):
    values = getattr(block, name).copy()
    values[row] = value
    return replace(block, **{name: values})


def with_times(block, t):
    return replace(block, t=np.asarray(t))


CASES = {
    "too short": (lambda b: b[:30], "lasts 0.29 s"),
    "two samples": (lambda b: b[:2], "only 2 samples"),
    "accelerometer in g": (lambda b: scaled(b, 1 / G), "--accel-unit g"),
    "accelerometer in mg": (lambda b: scaled(b, 1000 / G), "--accel-unit mg"),
    "counts": (lambda b: scaled(b, 4096 / G), "--accel-unit"),
    "without gravity": (lambda b: replace(b, accel=b.accel - b.accel[:50].mean(0)), "taken out"),
    "gyroscope in deg/s": (lambda b: scaled(b, gyro=57.3), "--gyro-unit deg/s"),
    "rad/s taken for deg/s": (lambda b: scaled(b, gyro=1 / 57.3), "rad/s, taken for deg/s"),
    "pitch reversed": (lambda b: scaled(b, gyro=[1, -1, 1]), "left-handed.*--gyro x,-y,z"),
    "yaw reversed": (lambda b: scaled(b, gyro=[1, 1, -1]), "left-handed.*--gyro x,y,-z"),
    "x and y exchanged": (lambda b: replace(b, gyro=b.gyro[:, [1, 0, 2]]), "--gyro y,x,z"),
    "accel z reversed": (lambda b: scaled(b, [1, 1, -1]), "exchanged or reversed.*-x,-y,z"),
    "no gyroscope": (lambda b: scaled(b, gyro=0.0), "gyroscope reads zero"),
    "gyroscope missing": (lambda b: scaled(b, gyro=np.nan), "no gyroscope"),
    "one axis missing": (lambda b: scaled(b, gyro=[1, np.nan, 1]), "y axis .* missing"),
    "dead axis": (lambda b: scaled(b, [1, 0, 1]), "y axis of the accelerometer never changes"),
    "not a number": (lambda b: with_value(b, "gyro", 700, np.nan), "no numbers, the first at 7"),
    "broken sample": (lambda b: with_value(b, "accel", 700, 1e9), "which no foot does"),
    "milliseconds": (lambda b: with_times(b, 1e3 * b.t), "--time-unit"),
    "microseconds down": (lambda b: with_times(b, 1e-3 * b.t), "--time-unit"),
    "time goes back": (lambda b: with_value(b, "t", 700, 5.0), "goes back at"),
    "one time": (lambda b: with_times(b, 0 * b.t), "same time"),
    "bursts": (lambda b: with_times(b, b.t[np.arange(len(b)) // 4 * 4]), "arrival in bursts"),
    "a second missing": (lambda b: without(b, b.t[700], 1.0), "long enough for a step"),
}


@pytest.mark.parametrize("case", CASES)
def test_refused_with_what_to_do(foot, case):
    change, message = CASES[case]
    with pytest.raises(DataError, match=message):
        check_recording(change(foot))


def test_half_a_swing_missing_is_refused(foot, swing):
    with pytest.raises(DataError, match="while the foot swung"):
        check_recording(without(foot, foot.t[swing] - 0.1, 0.2))
    stuck = replace(foot, accel=foot.accel.copy(), gyro=foot.gyro.copy())
    for values in (stuck.accel, stuck.gyro):
        values[swing - 10 : swing + 10] = values[swing - 10]
    with pytest.raises(DataError, match="while the foot swung"):
        check_recording(stuck)


HARMLESS = {
    "as it is": lambda b: b,
    "upside down": lambda b: scaled(b, [1, -1, -1], [1, -1, -1]),
    "on its side": lambda b: replace(b, accel=b.accel[:, [1, 2, 0]], gyro=b.gyro[:, [1, 2, 0]]),
    "a bias of 3 deg/s": lambda b: replace(b, gyro=b.gyro + 0.05),
    "a gain 2 % off": lambda b: scaled(b, gyro=1.02),
    "one equal time": lambda b: with_value(b, "t", 700, b.t[699]),
    "every tenth lost": lambda b: b[np.arange(len(b)) % 10 != 3],
    "missing while it stands": lambda b: without(b, 1.0, 0.3),
}


@pytest.mark.parametrize("case", HARMLESS)
def test_harmless_is_not_refused(foot, case):
    notes = check_recording(HARMLESS[case](foot))
    assert not [note for note in notes if "less certain" in note]


def test_a_scale_that_is_off_is_told(foot):
    notes = check_recording(scaled(foot, 1.05))
    assert any("too much" in note and "calibrate" in note for note in notes)


def test_gaps_and_clipping_are_told_and_add_to_the_uncertainty(foot, swing):
    holed = without(foot, foot.t[swing] - 0.04, 0.08)
    assert any("samples are missing 1 times" in note for note in check_recording(holed))
    unseen = unseen_motion(holed)
    row = int(np.argmax(np.diff(holed.t))) + 1
    assert int(np.argmax(unseen.velocity)) == row
    assert 0.1 < unseen.velocity[row] < 2.0
    assert 0.01 < unseen.turn[row] < 0.5
    gap = smooth_foot(holed, covariance=True)
    stride = int(np.searchsorted(gap.footfalls.quietest, row)) - 1
    wider = widened(gap.covariance, unseen, gap.footfalls)
    more = wider.strides - gap.covariance.strides
    np.testing.assert_allclose(np.diagonal(more[stride]), unseen.place[row] ** 2)
    assert np.count_nonzero(more) == 3
    assert 0.01 < unseen.place[row] < 0.1
    assert wider.position_sigma[-1, 0] > gap.covariance.position_sigma[-1, 0]
    assert widened(gap.covariance, unseen_motion(foot), gap.footfalls) is gap.covariance

    clipped = replace(foot, accel=foot.accel.clip(-30.0, 30.0))
    assert any("end of its range (3" in note for note in check_recording(clipped))
    assert unseen_motion(clipped).velocity.max() > 0.05


def moved(t, place, rates, seed=1):
    """Readings of a sensor that moves along places and turns at body rates, both (n, 3)."""
    rng = np.random.default_rng(seed)
    dt = t[1] - t[0]
    q = np.zeros((len(t), 4))
    q[0, 0] = 1.0
    for k, step in enumerate(from_rotation_vector(rates[1:] * dt)):
        q[k + 1] = multiply(q[k], step)
    force = np.gradient(np.gradient(place, dt, axis=0), dt, axis=0) + np.array([0.0, 0.0, G])
    accel = np.einsum("nji,nj->ni", to_matrix(q), force)
    noisy = rates + rng.normal(0.0, 0.002, rates.shape)
    return ImuBlock(t, accel + rng.normal(0.0, 0.03, accel.shape), noisy, t)


def sines(t, rng, lowest, highest, size):
    """Sums of sines of random frequency [Hz], shape (n, 3), of that root mean square."""
    f, phase = rng.uniform(lowest, highest, (6, 1, 3)), rng.uniform(0.0, 6.28, (6, 1, 3))
    return size * np.sqrt(2 / 6) * np.sin(2 * np.pi * f * t[:, np.newaxis] + phase).sum(axis=0)


def waved():
    rng, t = np.random.default_rng(3), np.arange(0.0, 15.0, 0.01)
    return moved(t, sines(t, rng, 0.3, 1.8, 0.2), sines(t, rng, 0.3, 1.8, 2.0))


def driven():
    """Speeds up, turns, brakes, with the trembling of a car."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 60.0, 0.01)
    speed = 6.0 - 6.0 * np.cos(2 * np.pi * np.clip(t - 5.0, 0.0, 50.0) / 25.0)
    turn = np.pi / 2 * np.exp(-(((t - 17.0) / 2.0) ** 2)) / (2.0 * np.sqrt(np.pi))
    yaw = np.cumsum(turn) * 0.01
    way = np.cumsum(np.stack((speed * np.cos(yaw), speed * np.sin(yaw), 0 * t), axis=1), 0) * 0.01
    rates = np.stack((0 * t, 0 * t, turn), axis=1)
    block = moved(t, way, rates + sines(t, rng, 0.5, 8.0, 0.01))
    return replace(block, accel=block.accel + sines(t, rng, 4.0, 25.0, 0.2))


@pytest.mark.parametrize("what", [waved, driven])
def test_what_is_no_foot_is_refused(what):
    with pytest.raises(DataError, match=r"not a foot that steps|at rest"):
        smooth_foot(what())


def test_a_waist_is_no_foot(units):
    with pytest.raises(DataError, match="not a foot that steps"):
        smooth_foot(recorded(units["waist"]))


def test_a_sensor_that_lies_still_walks_nowhere():
    t = np.arange(0.0, 5.0, 0.01)
    track = smooth_foot(moved(t, np.zeros((500, 3)), np.zeros((500, 3))), covariance=True)
    assert any("stood all the time" in note for note in track.notes)
    assert np.abs(track.trajectory.position).max() < 0.02


def test_moving_at_the_begin_is_told(foot, swing):
    track = smooth_foot(foot[swing - 25 :])
    assert any("before the first stance" in note for note in track.notes)


def test_no_real_recording_is_refused(imu_rig_data):
    for path in sorted((imu_rig_data / "foot" / "pyshoe_vicon").glob("*.mat")):
        check_recording(load_foreign(path).imu())


def test_one_stride_is_enough(foot):
    track = smooth_foot(foot[: int(np.searchsorted(foot.t, 3.75))])
    assert len(track.footfalls) == 2
