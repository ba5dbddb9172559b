"""System 1's distance: right where its assumptions hold, in doubt or refused where they do not."""

from dataclasses import replace

import numpy as np
import pytest

from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError, InputError
from imu_rig.gait.adaptive import zero_velocity
from imu_rig.gait.detectors import detector_named
from imu_rig.gait.distance import WalkOptions, integrated, unclosed, walk_distance
from imu_rig.rotation import from_rotation_vector, rotate, to_matrix
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.walker.device import Carried
from simulators.walker.path import Straight
from simulators.walker.record import record_walk
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Walker


@pytest.fixture(scope="module")
def walk():
    walker = Walker("level-10m", 2)
    return record_walk(walker, [Carried("left-foot", "mpu9150")], exact=True)["left-foot"].units[0]


@pytest.fixture(scope="module")
def block(walk):
    return ImuBlock(walk.t, walk.means.force, walk.means.rate, walk.t)


@pytest.fixture(scope="module")
def measured(block):
    return walk_distance(block)


def true_way(walk):
    return walk.truth.position[-1] - walk.truth.position[0]


def start_yaw(walk):
    R = to_matrix(walk.truth.attitude[0])
    return float(np.arctan2(R[1, 0], R[0, 0]))


def test_ten_metres_are_measured_as_well_as_the_published_ones(walk, measured):
    assert measured.distance[0] == pytest.approx(true_way(walk)[0], rel=0.04)
    assert abs(measured.distance[1]) < 0.3
    assert abs(measured.distance[2]) < 0.16
    assert measured.notes == ()


def test_with_a_known_yaw_y_is_that_of_the_line(walk, block):
    found = walk_distance(block, WalkOptions(start_yaw=start_yaw(walk)))
    assert np.abs(found.distance - true_way(walk)).max() < 0.4
    assert abs(found.distance[1] - true_way(walk)[1]) < 0.1
    error = to_matrix(found.quaternion[-1]).T @ to_matrix(walk.truth.attitude[-1])
    assert np.arccos((np.trace(error) - 1.0) / 2.0) < 2.0 * DEG


def test_what_figure_10_shows_fits_together(measured):
    stance = measured.zero_velocity.still
    assert np.array_equal(stance, measured.zero_velocity.statistic < 2.0)
    assert np.array_equal(measured.velocity[stance], np.zeros_like(measured.velocity[stance]))
    assert (measured.norm[stance] < 2.0).all()
    assert np.linalg.norm(measured.velocity, axis=1).max() > 3.0
    steps = 0.5 * np.diff(measured.t)[:, None] * (measured.velocity[1:] + measured.velocity[:-1])
    assert np.allclose(measured.position[1:], np.cumsum(steps, axis=0))


def test_the_doubt_is_most_of_the_error(walk, block):
    found = walk_distance(block, WalkOptions(start_yaw=start_yaw(walk)))
    error = found.distance - true_way(walk)
    assert abs(error[0]) > 0.1
    assert np.linalg.norm(error - found.doubt) < 0.6 * np.linalg.norm(error)


def test_a_bias_is_doubted_aloud(block):
    bias = np.array([0.0, 1.0 * DEG, 0.0])
    wrong = walk_distance(replace(block, gyro=block.gyro + bias))
    assert np.linalg.norm(wrong.doubt) > 0.5
    assert any("likely to be wrong by" in note for note in wrong.notes)


@pytest.mark.parametrize("turn", [(np.pi, 0.0, 0.0), (0.3, 1.4, -2.0)])
def test_it_does_not_matter_how_the_sensor_is_put_on(block, measured, turn):
    q = from_rotation_vector(np.array(turn))
    turned = replace(block, accel=rotate(q, block.accel), gyro=rotate(q, block.gyro))
    assert np.allclose(walk_distance(turned).distance, measured.distance, atol=2e-3)


def test_samples_that_come_twice_change_nothing(block, measured):
    twice = block[np.sort(np.concatenate((np.arange(len(block)), np.arange(50, 1500, 7))))]
    assert np.allclose(walk_distance(twice).distance, measured.distance, atol=1e-9)


def test_jitter_of_the_stamps_changes_little(block, measured):
    rng = np.random.default_rng(3)
    t = block.t + rng.uniform(-1.5e-3, 1.5e-3, len(block))
    assert np.abs(walk_distance(replace(block, t=t)).distance - measured.distance).max() < 0.2


def test_a_recording_that_begins_in_the_walk_is_told_of_or_right(walk, block):
    begin = int(np.searchsorted(block.t, 4.0 + 1.9))
    assert np.linalg.norm(walk.truth.velocity[begin - 100 : begin + 1], axis=1).max() > 2.0
    found = walk_distance(block[begin:])
    way = np.linalg.norm(walk.truth.position[-1] - walk.truth.position[begin])
    assert np.linalg.norm(found.distance) == pytest.approx(way, rel=0.1)


def test_a_walk_cut_out_of_a_longer_one_begins_in_a_stance(walk, block):
    fast = np.linalg.norm(walk.truth.velocity, axis=1) > 1.0
    begin = int(np.argmax(fast & (block.t > 5.0)))
    rows = np.arange(begin, begin + 500)
    found = walk_distance(block[rows])
    assert any("stood still for no second" in note for note in found.notes)
    way = np.linalg.norm(walk.truth.position[rows[-1]] - walk.truth.position[rows[0]])
    assert np.linalg.norm(found.distance) == pytest.approx(way, rel=0.1)


def test_a_run_for_which_the_threshold_is_not_made_is_doubted_aloud():
    scenario = Scenario("run", "Run", (Stand(2.0), Walk((Straight(20.0),), (3.0,)), Stand(2.0)))
    devices = [Carried("left-foot", "mpu9150")]
    foot = record_walk(Walker(scenario, 3), devices, exact=True)["left-foot"].units[0]
    running = (foot.t > 2.5) & (foot.t < 5.5)
    force = np.linalg.norm(foot.means.force, axis=1)
    assert np.median(force[running]) > 1.3 * STANDARD_GRAVITY  # which is no wrong unit
    rate = foot.means.rate + np.array([0.0, 0.3 * DEG, 0.3 * DEG])
    found = walk_distance(ImuBlock(foot.t, foot.means.force, rate, foot.t))
    assert abs(found.distance[0] - true_way(foot)[0]) > 0.5
    assert any("No stance was found for" in note for note in found.notes)


def test_a_gap_in_a_swing_is_told(walk, block):
    swing = int(np.argmax(np.linalg.norm(walk.truth.velocity, axis=1)))
    lost = np.delete(np.arange(len(block)), np.arange(swing - 5, swing + 5))
    notes = walk_distance(block[lost]).notes
    assert any("1 gaps of up to 0.11 s" in note for note in notes)


def test_other_detectors_and_given_stances_can_tell_the_phases(walk, block):
    for found in (
        walk_distance(block, WalkOptions(detector="shoe")),
        walk_distance(block, WalkOptions(detector=detector_named("paper", window=0.08))),
        walk_distance(block, zero_velocity=zero_velocity(block)),
    ):
        assert found.distance[0] == pytest.approx(true_way(walk)[0], rel=0.12)
    with pytest.raises(InputError, match="stance of 10 samples"):
        walk_distance(block, zero_velocity=zero_velocity(block[:10]))


def test_the_magnetic_field_gives_the_yaw(walk, block):
    north = np.array([18.0, 12.0, -40.0])
    field = rotate(walk.truth.attitude * (1.0, -1.0, -1.0, -1.0), north)
    biased = replace(block, gyro=block.gyro + np.array([0.0, 0.0, 0.5 * DEG]))
    options = WalkOptions(start_yaw=start_yaw(walk))
    without = walk_distance(biased, options).distance
    held = walk_distance(replace(biased, mag=field), replace(options, magnetometer=True)).distance
    assert abs(held[1] - true_way(walk)[1]) < 0.4 * abs(without[1] - true_way(walk)[1])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda b: replace(b, accel=b.accel / STANDARD_GRAVITY), "unit of the accelerometer"),
        (lambda b: b[:300], "never swings"),
        (lambda b: b[:2], "2 samples is no walk"),
        (lambda b: replace(b, t=b.t[::-1]), "time stamps go back"),
        (lambda b: replace(b, gyro=np.where(b.t[:, None] == b.t[9], np.nan, b.gyro)), "not finite"),
        (lambda b: replace(b, accel=b.accel + 3.0 * np.sin(50.0 * b.t[:, None])), "never stands"),
    ],
)
def test_what_is_no_walk_is_refused_in_a_sentence(block, change, sentence):
    with pytest.raises(DataError, match=sentence):
        walk_distance(change(block))


def test_integration_knows_uneven_stamps_and_resets_in_stance():
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.0, 0.02, 400))
    still = (t < 1.0) | (t > 2.0)
    begin, end = t[still & (t < 1.0)][-1], t[~still][-1]
    acceleration = np.where(still[:, None], 0.0, (1.0, -2.0, 0.0) * (t - begin)[:, None])
    velocity, position = integrated(t, acceleration, still)
    swing = ~still
    along = 0.5 * (t[swing] - begin) ** 2
    assert np.allclose(velocity[swing], along[:, None] * (1.0, -2.0, 0.0), atol=1e-9)
    assert not velocity[still].any()
    way = (end - begin) ** 3 / 6.0
    assert position[np.flatnonzero(swing)[-1]] == pytest.approx((way, -2.0 * way, 0.0), abs=1e-3)


def test_a_swing_before_the_first_stance_ends_at_zero():
    t = 0.01 * np.arange(200)
    still = t > 1.0
    acceleration = np.where(still[:, None], 0.0, (-1.0, 0.0, 0.0))
    velocity, _ = integrated(t, acceleration, still)
    assert velocity[0, 0] == pytest.approx(1.0, abs=0.02)


def test_what_a_constant_error_adds_is_doubted_exactly():
    t = 0.01 * np.arange(300)
    still = (t < 1.0) | (t > 1.5)
    velocity, position = integrated(t, np.tile((0.2, 0.0, -0.1), (300, 1)), still)
    end = np.flatnonzero(~still)[-1]
    assert unclosed(t, velocity, still) == pytest.approx(position[end])
