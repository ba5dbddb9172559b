"""Feet that cannot be farther apart than a step hold each other's heading."""

from dataclasses import replace

import numpy as np
import pytest
from true_tracks import true_track, walk_of

from imu_rig.errors import DataError
from imu_rig.gait.both_feet import join_feet
from imu_rig.gait.heading import turned_by
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


def test_feet_on_two_clocks_are_refused(feet):
    later = feet[1].trajectory
    later = replace(feet[1], trajectory=replace(later, t=later.t + 1000.0))
    with pytest.raises(DataError, match="one clock"):
        join_feet(feet[0], later)
