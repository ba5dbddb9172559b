"""Strides of a foot beside its footprints and beside a marker on its heel."""

from dataclasses import replace

import numpy as np
import pytest

from imu_rig.errors import DataError
from imu_rig.gait.strides import gait_parameters
from imu_rig.gait.trajectory import Footfalls, FootTrack, Trajectory
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.reference.footprints import Footprints, compare_footprints
from imu_rig.reference.optical_strides import compare_optical_strides
from imu_rig.reference.reference import Reference
from simulators.walker.path import Straight
from simulators.walker.scenarios import Scenario
from simulators.walker.sensor import Placement
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Walker


@pytest.fixture(scope="module")
def walker():
    legs = (Stand(2.0), Walk((Straight(8.0),)), Stand(1.0))
    return Walker(Scenario("short", "A short walk", legs), seed=6)


@pytest.fixture(scope="module")
def strides(walker):
    t = np.arange(0.0, walker.end_s, 0.01)
    motion = walker.sensor("left-foot").at(t)
    falls = walker.falls[0]
    middle = [0.5 * (max(f.flat, 0.0) + min(f.heel_off, t[-1])) for f in falls]
    rows = np.searchsorted(t, middle)
    zero = np.zeros(len(t))
    return gait_parameters(
        FootTrack(
            Trajectory(t, motion.attitude, motion.velocity, motion.position),
            ZeroVelocity(zero > 1, zero, zero, zero),
            Footfalls(rows, rows, rows),
            *np.zeros((3, 3)),
        )
    )


@pytest.fixture(scope="module")
def footprints(walker):
    return Footprints(np.array([fall.ball for fall in walker.falls[0]]))


def test_strides_meet_their_footprints(strides, footprints):
    """The ball is 8 cm from the sensor, and each foot turns by a few degrees."""
    found = compare_footprints(strides, footprints)
    assert (found.count, found.true_count) == (len(strides), len(footprints) - 1)
    assert found.mae < 0.01
    assert abs(found.distance_percent) < 0.3
    assert found.true_distance == pytest.approx(8.0, abs=0.05)
    assert found.to_dict()["paired"] == len(strides)


def test_shifts_of_a_standing_foot_leave_no_footprint(strides, footprints):
    """They are told by their kind and do not count."""
    length = np.concatenate(([0.02], strides.length))
    kind = np.concatenate((["shift"], strides.kind))
    found = compare_footprints(replace(strides, length=length, kind=kind), footprints)
    assert found.count == found.true_count
    assert found.mae < 0.01


def test_a_missed_stride_is_not_paired_with_another(strides, footprints):
    """The numbers differ: no length error is made up, the distance still compares."""
    found = compare_footprints(strides, Footprints(footprints.position[:-1]))
    assert found.count == found.true_count + 1
    assert np.isnan(found.mae)
    assert found.to_dict()["mae_m"] is None
    assert found.distance_percent > 3.0
    assert len(found.lines()) == 2


def test_one_footprint_is_no_stride(strides):
    """A sentence."""
    with pytest.raises(DataError, match="two footprints"):
        compare_footprints(strides, Footprints(np.zeros((1, 2))))


def test_footprints_at_one_place_are_refused(strides):
    with pytest.raises(DataError, match="at one place"):
        compare_footprints(strides, Footprints(np.zeros((3, 2))))


def test_a_heel_marker_has_the_same_strides_as_the_sensor(walker, strides):
    """Far from the sensor, in axes of its own, at 50 Hz and lost at times."""
    t = np.arange(0.0, walker.end_s, 0.02)
    heel = walker.sensor("left-foot", Placement((-0.20, 0.0, 0.04))).at(t).position
    heel = heel[:, [1, 0, 2]] + 30.0
    lost = (t > strides.end[2] - 0.3) & (t < strides.end[2] + 0.3)
    heel[lost] = np.nan
    found = compare_optical_strides(strides, Reference(t, heel))
    assert found.count == len(strides) - 2
    assert found.mae < 0.025


def test_a_marker_that_never_rests_beside_the_footfalls_is_of_another_time(strides, walker):
    """Half a stride late the marker swings where the foot should stand."""
    t = np.arange(0.0, walker.end_s, 0.02)
    heel = walker.sensor("left-foot").at(t).position
    heel = heel + 1.5 * t[:, None]
    with pytest.raises(DataError, match="not seen at rest"):
        compare_optical_strides(strides, Reference(t, heel))
    with pytest.raises(DataError, match="no positions"):
        compare_optical_strides(strides, Reference(t))
