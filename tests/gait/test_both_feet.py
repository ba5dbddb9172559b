"""Feet that cannot be farther apart than a step hold each other's heading."""

from dataclasses import replace

import numpy as np
import pytest
from true_tracks import true_track, walk_of

from imu_rig.errors import DataError
from imu_rig.gait.both_feet import join_feet
from imu_rig.gait.heading import turned_by
from imu_rig.gait.strides import gait_parameters
from imu_rig.gait.trajectory import TrajectoryCovariance
from imu_rig.units import DEG
from simulators.walker.path import Straight, Turn


@pytest.fixture(scope="module")
def feet():
    """A square of 12 m, both feet as they were."""
    walker = walk_of(*(Straight(12.0), Turn(90.0)) * 4)
    return tuple(true_track(walker, place) for place in ("left-foot", "right-foot"))


def drifting(track, rate, first=0.0):
    t = track.trajectory.t
    turned = turned_by(track, first + rate * (t - t[0]))
    return replace(turned, trajectory=turned.trajectory.moved(-turned.trajectory.position[0]))


def error(track, true):
    """Farthest from the truth on the plan [m], begin and first heading as in the track."""
    place = track.trajectory.position - track.trajectory.position[0]
    return np.hypot(*(place - true.trajectory.position + true.trajectory.position[0]).T[:2]).max()


RATES = [(0.3, -0.3), (0.3, 0.0), (0.0, -0.25), (0.1, -0.2), (0.05, 0.0), (0.2, 0.2), (0.0, 0.0)]


@pytest.mark.parametrize("rates", RATES)
def test_the_way_gets_no_worse_and_mostly_better(feet, rates):
    wrong = [drifting(foot, rate * DEG) for foot, rate in zip(feet, rates, strict=True)]
    joined = join_feet(*wrong)
    before = [error(track, foot) for track, foot in zip(wrong, feet, strict=True)]
    left = error(joined.left, feet[0])
    back = turned_by(joined.right, np.full(len(joined.right.trajectory), -joined.turned))
    right = error(back, feet[1])
    assert left**2 + right**2 <= before[0] ** 2 + before[1] ** 2 + 0.05**2
    assert joined.apart_after <= joined.apart_before
    if rates == (0.3, -0.3):
        assert joined.apart_before > 3.0
        assert joined.apart_after < 1.6
        assert left + right < 0.6 * sum(before)


def test_the_first_heading_of_the_other_foot_is_found(feet):
    joined = join_feet(feet[0], drifting(feet[1], 0.0, first=1.0))
    assert joined.turned == pytest.approx(-1.0, abs=5.0 * DEG)
    assert joined.apart_after < 1.2
    true = feet[1].trajectory.position - feet[0].trajectory.position[0]
    found = joined.right.trajectory.position - joined.left.trajectory.position[0]
    assert np.hypot(*(found - true).T[:2]).max() < 1.0


def test_feet_that_agree_are_left_alone(feet):
    joined = join_feet(*feet)
    assert max(np.abs(drift).max() for drift in joined.drift) < 1.0 * DEG
    assert joined.held
    assert joined.note == ""


def sure_to(track, sigma):
    """The track with headings known to ``sigma`` (k,) [rad] at its footfalls."""
    rows = track.footfalls.quietest
    values = np.zeros((len(rows), 9, 9))
    values[:, 2, 2] = np.square(sigma)
    values[:, 6:, 6:] = np.diag([0.04, 0.01, 0.01])
    strides = np.tile(np.diag([1e-3, 1e-4, 1e-4]), (len(rows) - 1, 1, 1))
    return replace(track, covariance=TrajectoryCovariance(rows, values, strides))


def test_poor_headings_are_turned_as_far_as_they_are_uncertain_and_good_ones_are_not(feet):
    """Drifts of 0.8 deg/s put feet of a 12 m square metres apart."""
    wrong = [drifting(foot, rate * DEG) for foot, rate in zip(feet, (0.8, -0.4), strict=True)]
    since = [foot.trajectory.t[foot.footfalls.quietest] for foot in feet]
    poor = join_feet(*(sure_to(f, 0.5 * DEG * t) for f, t in zip(wrong, since, strict=True)))
    assert poor.apart_before > 5.0
    assert poor.held
    assert poor.apart_after < poor.reach + 0.3
    assert "deg" in poor.note
    before = [error(track, foot) for track, foot in zip(wrong, feet, strict=True)]
    after = [error(track, foot) for track, foot in zip((poor.left, poor.right), feet, strict=True)]
    assert np.hypot(*after) < 0.6 * np.hypot(*before)
    good = join_feet(*(sure_to(f, 0.01 * DEG * t) for f, t in zip(wrong, since, strict=True)))
    assert not good.held
    assert good.apart_after == good.apart_before > good.reach + 1.0
    assert not any(drift.any() for drift in good.drift)
    assert "no likely error" in good.note


def test_a_heading_lost_at_one_moment_is_turned_at_that_moment(feet):
    """As by a turn of which the sensor saw but a part; the track knows when that was."""
    t = feet[1].trajectory.t
    jump = 25.0 * DEG * (t > 20.0)
    wrong = turned_by(feet[1], jump)
    seen = feet[1].footfalls.quietest
    joined = join_feet(
        sure_to(feet[0], 0.03 * DEG * feet[0].trajectory.t[feet[0].footfalls.quietest]),
        sure_to(wrong, np.where(t[seen] > 20.0, 12.0 * DEG, 0.03 * DEG * t[seen])),
    )
    assert joined.held
    assert np.abs(joined.drift[0]).max() < 3.0 * DEG
    early, late = joined.drift[1][t < 15.0], joined.drift[1][t > 25.0]
    assert np.abs(early).max() < 6.0 * DEG
    assert late.mean() == pytest.approx(-25.0 * DEG, abs=8.0 * DEG)


def test_feet_of_two_lengths_are_held_by_making_the_unsure_one_fit(feet):
    """A sensor that reads 4 % too much walks away from one that is right."""
    far = walk_of(Straight(40.0))
    left, right = (true_track(far, place) for place in ("left-foot", "right-foot"))
    sigma = 1e-3 * np.ones(len(right.footfalls))
    unsure = turned_by(sure_to(right, sigma), np.zeros(len(right.trajectory)), 1.06)
    common = np.tile([[0.04, 0.0, 0.0]], (len(right.footfalls) - 1, 1, 1))
    unsure = replace(unsure, covariance=replace(unsure.covariance, common=common))
    joined = join_feet(left, unsure)
    assert joined.held
    assert joined.scale[0] == pytest.approx(1.0, abs=0.01)
    assert 0.94 < joined.scale[1] < 0.98


def test_uncertainty_turns_with_the_way(feet):
    sure = sure_to(feet[0], 0.1)
    quarter = turned_by(sure, np.full(len(sure.trajectory), 0.5 * np.pi))
    strides = [gait_parameters(track) for track in (sure, quarter)]
    assert strides[1].distance_sigma == pytest.approx(strides[0].distance_sigma)
    assert strides[1].length_sigma == pytest.approx(strides[0].length_sigma)
    assert np.allclose(quarter.covariance.position_sigma, [0.1, 0.2, 0.1])
    assert np.allclose(quarter.covariance.strides[:, 1, 1], 1e-3)


def test_feet_on_two_clocks_are_refused(feet):
    later = feet[1].trajectory
    later = replace(feet[1], trajectory=replace(later, t=later.t + 1000.0))
    with pytest.raises(DataError, match="one clock"):
        join_feet(feet[0], later)
