"""The axes of a foot from its own motion, however the sensor was put on."""

from dataclasses import replace

import numpy as np
import pytest
from true_tracks import true_track, walk_of

from imu_rig.gait.mounting import find_foot_axes, first_heading, foot_matrices
from imu_rig.gait.strides import gait_parameters
from imu_rig.gait.trajectory import Footfalls, Trajectory
from imu_rig.rotation import from_rotation_vector, to_matrix, vector_of_matrix
from imu_rig.units import DEG
from simulators.walker.path import Arc, Stairs, Straight, Turn
from simulators.walker.sensor import Placement
from simulators.walker.steps import TOE_OUT, Manner

MOUNTINGS = [(0.0, 0.35, 0.0), (3.0, 0.3, -0.4), (1.0, 2.0, 0.5)]


@pytest.mark.parametrize("turn", MOUNTINGS)
@pytest.mark.parametrize(
    ("pieces", "speed"),
    [
        ((Straight(6.0),), 1.3),
        ((Straight(2.0), Turn(180.0), Straight(2.0)), 1.0),
        ((Arc(1.0, 180.0),), 1.2),
        ((Stairs(6),), 1.0),
        ((Straight(9.0),), 3.0),
    ],
)
def test_any_mounting_is_found_from_a_walk(pieces, speed, turn):
    """Up within half a degree; forward is where the foot goes, its toe 6 deg outward of that."""
    walker = walk_of(*pieces, speeds=(speed,), manner=Manner.regular())
    track = true_track(walker, placement=Placement((-0.08, 0.0, 0.075), turn))
    axes = find_foot_axes(track.trajectory, track.footfalls)
    true = to_matrix(from_rotation_vector(np.array(turn)))
    off = vector_of_matrix(axes.rotation @ true.T) / DEG
    assert np.hypot(off[0], off[1]) < 0.5
    assert off[2] == pytest.approx(TOE_OUT / DEG, abs=1.5)
    assert axes.forward_known
    assert axes.note is None
    assert np.allclose(axes.rotation @ axes.rotation.T, np.eye(3))
    assert np.linalg.det(axes.rotation) > 0


def test_a_track_turned_by_its_first_heading_sets_out_along_x():
    """Which way is north does not matter, and is undone."""
    track = true_track(walk_of(Straight(6.0)))
    turned = track.trajectory.turned(2.0)
    axes = find_foot_axes(turned, track.footfalls)
    assert np.allclose(
        axes.rotation, find_foot_axes(track.trajectory, track.footfalls).rotation, atol=1e-9
    )
    level = turned.turned(-first_heading(turned, track.footfalls, axes))
    row = track.footfalls.quietest[0]
    x = foot_matrices(level.quaternion[row], axes)[:, 0]
    assert x == pytest.approx([1.0, 0.0, 0.0], abs=0.02)
    way = level.position[-1] - level.position[row]
    assert abs(np.arctan2(way[1], way[0])) < 5 * DEG


@pytest.mark.parametrize("turn", MOUNTINGS)
def test_who_walks_backward_still_has_the_toes_in_front(turn):
    """A walk run backward in time: the same axes, every stride a backward one."""
    placement = Placement((-0.08, 0.0, 0.075), turn)
    track = true_track(walk_of(Straight(6.0)), placement=placement)
    there, falls, n = track.trajectory, track.footfalls, len(track.trajectory)
    back = replace(
        track,
        trajectory=Trajectory(
            there.t, there.quaternion[::-1], -there.velocity[::-1], there.position[::-1]
        ),
        footfalls=Footfalls(
            *(n - 1 - at[::-1] for at in (falls.last, falls.first, falls.quietest))
        ),
    )
    forward = find_foot_axes(there, falls).rotation
    assert find_foot_axes(back.trajectory, back.footfalls).rotation == pytest.approx(
        forward, abs=0.02
    )
    strides = gait_parameters(back)
    assert set(strides.kind) == {"backward"}
    assert not strides.walking.any()


def test_a_foot_that_goes_nowhere_points_nowhere():
    """Turning on the spot says which way is up and not which way is forward."""
    track = true_track(walk_of(Turn(360.0), speeds=(1.0,)))
    axes = find_foot_axes(track.trajectory, track.footfalls)
    assert not axes.forward_known
    assert "which way the foot points" in axes.note


def test_strides_in_all_directions_say_so():
    """Ahead, aside and back again, the foot never turning."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0.0]])
    n = len(corners)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    rows = np.arange(n)
    trajectory = Trajectory(rows * 1.0, upright, np.zeros((n, 3)), corners)
    axes = find_foot_axes(trajectory, Footfalls(rows, rows, rows))
    assert not axes.forward_known
    assert "no common direction" in axes.note


def test_without_footfalls_gravity_alone_is_used():
    """Up is known from the attitude, forward is not."""
    tilted = np.tile(from_rotation_vector(np.array([0.3, -0.2, 0.0])), (5, 1))
    zero = np.zeros((5, 3))
    none = np.empty(0, dtype=np.int64)
    axes = find_foot_axes(
        Trajectory(np.arange(5.0), tilted, zero, zero), Footfalls(none, none, none)
    )
    assert (to_matrix(tilted[0]) @ axes.rotation.T)[:, 2] == pytest.approx([0.0, 0.0, 1.0])
    assert not axes.forward_known
