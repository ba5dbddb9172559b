"""Corridors hold the heading of a track that drifts, and leave curved ways alone."""

from dataclasses import replace

import numpy as np
import pytest
from true_tracks import true_track, walk_of

from imu_rig.gait.heading import follow_corridors, turned_by
from imu_rig.gait.trajectory import TrajectoryCovariance
from imu_rig.units import DEG
from simulators.walker.path import Arc, Straight, Turn

BACK = (Straight(14.0), Turn(180.0))


def drifting(track, rate, wander=0.0):
    """The track with its heading turning away [rad/s], and wandering [rad/sqrt(s)]."""
    t = track.trajectory.t
    steps = np.random.default_rng(2).normal(0.0, wander * np.sqrt(t[1] - t[0]), len(t))
    return turned_by(track, rate * (t - t[0]) + np.cumsum(steps) - steps[0])


@pytest.fixture(scope="module")
def there_and_back():
    return true_track(walk_of(*BACK, *BACK, *BACK, *BACK))


@pytest.mark.parametrize("rate", [0.15 * DEG, -0.3 * DEG])
def test_a_drift_along_corridors_is_taken_off(there_and_back, rate):
    wrong = drifting(there_and_back, rate, 0.05 * DEG)
    right = follow_corridors(wrong)
    true = there_and_back.trajectory
    error = [
        np.hypot(*(p.trajectory.position - true.position).T[:2]).max() for p in (wrong, right.track)
    ]
    assert error[0] > 0.8
    assert error[1] < 0.35 * error[0]
    assert len(right.directions) == 1
    assert right.correction[0] == 0.0
    assert right.correction[-1] == pytest.approx(-rate * (true.t[-1] - true.t[0]), abs=2.5 * DEG)
    assert "corridor" in right.track.notes[-1]


def test_corridors_at_an_angle_are_kept_apart():
    square = (Straight(17.0), Turn(70.0), Straight(17.0), Turn(110.0))
    track = true_track(walk_of(*square, *square))
    right = follow_corridors(drifting(track, 0.15 * DEG))
    assert len(right.directions) == 2
    apart = np.degrees(abs(np.diff(right.directions)))[0]
    assert min(apart, 180 - apart) == pytest.approx(70.0, abs=4.0)
    assert (
        np.hypot(*(right.track.trajectory.position[-1] - track.trajectory.position[-1])[:2]) < 1.0
    )


def test_a_true_track_is_hardly_changed(there_and_back):
    right = follow_corridors(there_and_back)
    assert np.abs(right.correction).max() < 1.5 * DEG


@pytest.mark.parametrize(
    "way",
    [
        (Arc(6.0, 180.0),),
        (Arc(20.0, 120.0),),
        (Arc(8.0, 90.0), Arc(8.0, -90.0), Arc(8.0, 90.0), Arc(8.0, -90.0)),
        (Straight(4.0), Turn(90.0)) * 4,
        (Straight(2.0),),
    ],
    ids=["half circle", "wide arc", "bends", "turns", "a few steps"],
)
def test_curved_and_short_ways_are_left_alone(way):
    track = true_track(walk_of(*way))
    left = follow_corridors(track)
    assert left.track is track
    assert not left.correction.any()
    assert len(left.directions) == 0


def test_heading_is_more_certain_after_and_covariances_stay_such(there_and_back):
    rows = there_and_back.footfalls.quietest
    yaw = np.linspace(0.0, 6.0 * DEG, len(rows))
    values = np.zeros((len(rows), 9, 9))
    for k, sigma in enumerate(yaw):
        error = np.zeros(9)
        error[2], error[6:8] = sigma, 5.0 * sigma
        values[k] = np.outer(error, error) + 1e-6 * np.eye(9)
    covariance = TrajectoryCovariance(rows, values, np.zeros((len(rows) - 1, 3, 3)))
    known = follow_corridors(replace(there_and_back, covariance=covariance)).track.covariance
    assert known.heading_sigma[-1] < 0.5 * covariance.heading_sigma[-1]
    assert (known.position_sigma.sum(axis=1) <= covariance.position_sigma.sum(axis=1) + 1e-9).all()
    assert np.linalg.eigvalsh(known.values).min() > -1e-12
