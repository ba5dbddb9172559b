"""The adaptive detector: its statistic, its threshold, footfalls, and pieces of a recording."""

from dataclasses import replace

import numpy as np
import pytest
from walks_read import Read, walk_along

from imu_rig.gait.adaptive import detect_stance, lookahead_s, settled, stride_threshold
from imu_rig.gait.adaptive import zero_velocity as adaptive_zero_velocity
from imu_rig.gait.footfalls import find_footfalls, merge_unmoved, runs
from imu_rig.gait.options import StanceOptions
from imu_rig.gait.stamps import spread_repeats
from imu_rig.gait.statistic import motion_statistic
from imu_rig.gait.trajectory import Footfalls
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.rotation import from_rotation_vector
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.walker.path import Straight

OPTIONS = StanceOptions()
T = np.arange(400) * 0.005
AT_REST = np.tile([0.0, 0.0, STANDARD_GRAVITY], (400, 1))


@pytest.fixture(scope="module")
def walk():
    return Read(walk_along(Straight(6.0)))


def test_a_foot_that_rolls_on_the_ground_moves_at_about_its_statistic():
    """A rate of 1 rad/s at a height of 0.1 m is 0.1 m/s, whatever the axis."""
    gyro = np.tile([0.6, 0.0, -0.8], (400, 1))
    s = motion_statistic(T, AT_REST, gyro, OPTIONS.window_s)
    np.testing.assert_allclose(s, 0.1, rtol=1e-9)


def test_a_tilted_sensor_at_rest_does_not_move():
    tilted = STANDARD_GRAVITY * np.tile([0.48, -0.6, -0.64], (400, 1))
    s = motion_statistic(T, tilted, np.zeros((400, 3)), OPTIONS.window_s)
    assert s.max() < 1e-6


def test_the_threshold_is_the_geometric_middle_within_bounds():
    def threshold(quietest, level):
        return stride_threshold(np.array([quietest]), np.array([level]), OPTIONS)[0]

    assert threshold(0.02, 0.5) == pytest.approx(0.1)
    assert threshold(1e-4, 1e-3) == OPTIONS.lowest
    assert threshold(1e-3, 0.5) == threshold(2e-4, 0.5) > 0.06  # a stand is nearby
    assert threshold(0.09, 0.6) == OPTIONS.highest
    assert threshold(0.4, 1.5) == pytest.approx(0.52)  # the quietest of a sprint counts
    assert threshold(0.4, 0.5) == pytest.approx(0.25)  # but not if all is alike


def test_a_piece_says_the_same_as_the_whole_but_for_its_ends(walk):
    block = walk.by("middle")
    whole = detect_stance(block.t, block.accel, block.gyro)
    a, b = 700, 2100
    piece = detect_stance(block.t[a:b], block.accel[a:b], block.gyro[a:b])
    inner = (block.t[a:b] > block.t[a] + lookahead_s()) & (
        block.t[a:b] < block.t[b - 1] - lookahead_s()
    )
    assert inner.sum() > 500
    np.testing.assert_allclose(piece.threshold[inner], whole.threshold[a:b][inner], rtol=1e-9)
    np.testing.assert_allclose(piece.sigma[inner], whole.sigma[a:b][inner], rtol=1e-6)


def test_every_stance_of_a_walk_is_found_and_nearly_all_of_it_is_slow(walk):
    found = adaptive_zero_velocity(walk.by("good"))
    speed = np.linalg.norm(walk.truth.velocity, axis=1)
    # Sigma says how fast: nearly all lie within two of them.
    assert np.mean(speed[found.still] < 2.0 * found.sigma[found.still]) > 0.95
    for fall in walk.falls:
        on = (walk.t > fall.contact) & (walk.t < fall.toe_off)
        assert found.still[on].any()


def test_long_stands_lose_their_ends_and_short_ones_nothing():
    still = np.zeros(400, dtype=bool)
    still[20:60] = True
    sigma = np.where(still, 0.01, np.inf)
    brief = ZeroVelocity(still, sigma, sigma, sigma)
    np.testing.assert_array_equal(settled(brief, T).still, still)
    slow = settled(brief, 20.0 * T)  # the same samples 0.1 s apart: 3.9 s
    np.testing.assert_array_equal(np.flatnonzero(slow.still), np.arange(22, 58))
    assert np.isinf(slow.sigma[~slow.still]).all()


# --- footfalls ------------------------------------------------------------------------------------


def stances(*spans, weak=()):
    """Zero velocity in spans of time [s] of 12 s, with little weight where ``weak`` says."""
    t = np.arange(2400) * 0.005
    sigma = np.full(len(t), np.inf)
    for begin, end in spans:
        inside = (t >= begin) & (t < end)
        sigma[inside] = 0.2 if begin in weak else 0.01
    still = np.isfinite(sigma)
    return t, ZeroVelocity(still, sigma, np.where(still, 0.5 * sigma, 1.0), np.full(len(t), 0.3))


REGULAR = [(0.0, 1.0), (2.0, 2.5), (3.2, 3.7), (4.4, 4.9), (5.6, 6.1), (6.8, 7.3)]


def test_each_interval_is_a_footfall():
    t, found = stances(*REGULAR)
    falls = find_footfalls(found, t)
    np.testing.assert_allclose(t[falls.first], [a for a, _ in REGULAR], atol=1e-9)
    assert np.all((falls.first <= falls.quietest) & (falls.quietest <= falls.last))


@pytest.mark.parametrize("extra", [(2.9, 2.94), (4.05, 4.07), (7.4, 7.42)])
def test_a_smooth_moment_of_a_swing_is_no_footfall(extra):
    t, found = stances(*REGULAR, extra, weak=(extra[0],))
    assert len(find_footfalls(found, t)) == len(REGULAR)


def test_a_step_of_a_turn_on_the_spot_is_one():
    t, found = stances(*REGULAR, (7.9, 8.1))
    assert len(find_footfalls(found, t)) == len(REGULAR) + 1


def test_an_interval_with_a_hole_too_short_for_a_swing_is_one():
    t, found = stances((0.0, 1.0), (2.0, 2.2), (2.26, 2.5), (3.2, 3.7))
    falls = find_footfalls(found, t)
    np.testing.assert_allclose(t[falls.last], [0.995, 2.495, 3.695], atol=1e-9)


def test_no_interval_makes_no_footfall():
    t, found = stances()
    assert len(find_footfalls(found, t)) == 0


def test_footfalls_between_which_the_foot_went_nowhere_are_one():
    falls = Footfalls(
        *(np.array(rows) for rows in ([0, 10, 20, 30], [5, 15, 25, 35], [3, 12, 21, 33]))
    )
    position = np.zeros((40, 3))
    position[18:, 0] = 0.6
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (40, 1))
    quaternion[28:] = from_rotation_vector(np.array([0.0, 0.0, 40.0 * DEG]))
    statistic = np.ones(40)
    statistic[12] = 0.5
    rows = falls.quietest
    merged = merge_unmoved(falls, position[rows], quaternion[rows], statistic)
    np.testing.assert_array_equal(merged.first, [0, 20, 30])
    np.testing.assert_array_equal(merged.last, [15, 25, 35])
    np.testing.assert_array_equal(merged.quietest, [12, 21, 33])


def test_runs_are_found_at_both_ends():
    first, last = runs(np.array([True, False, True, True]))
    np.testing.assert_array_equal([first, last], [[0, 2], [0, 3]])


# --- stamps ---------------------------------------------------------------------------------------


def test_repeated_stamps_are_spread_over_the_time_they_took():
    late = np.array([0.0, 0.01, 0.04, 0.04, 0.04, 0.05])
    np.testing.assert_allclose(spread_repeats(late), [0.0, 0.01, 0.02, 0.03, 0.04, 0.05])
    hung = np.array([0.0, 0.01, 0.02, 0.02, 0.02, 0.05])
    np.testing.assert_allclose(spread_repeats(hung), [0.0, 0.01, 0.02, 0.03, 0.04, 0.05])
    assert spread_repeats(T) is T


def test_a_detector_in_pieces_needs_no_more_than_it_says():
    slow = replace(OPTIONS, quiet_s=2.0)
    assert lookahead_s(slow) > 2.0
    assert lookahead_s() < 1.7
