"""From the readings of a simulated sensor to strides beside an optical system."""

import numpy as np
import pytest

from imu_rig.blocks import ImuBlock
from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.strides import gait_parameters
from imu_rig.reference.alignment import align
from imu_rig.reference.footprints import Footprints, compare_footprints
from imu_rig.reference.optical_strides import compare_optical_strides
from imu_rig.reference.reference import Reference
from imu_rig.rotation import about_z
from simulators.walker.device import Carried
from simulators.walker.path import Arc, Straight
from simulators.walker.record import record_walk
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Surroundings, Walker

LATE_S = 0.4


@pytest.fixture(scope="module")
def walker():
    legs = (Stand(3.0), Walk((Straight(6.0), Arc(2.0, 120.0), Straight(3.0))), Stand(1.5))
    scenario = Scenario("bend", "A bend", legs)
    return Walker(scenario, seed=11, surroundings=Surroundings.ideal())


@pytest.fixture(scope="module")
def unit(walker):
    return record_walk(walker, [Carried("left-foot", "xsens-mti")], seed=2)["left-foot"].units[0]


@pytest.fixture(scope="module")
def track(unit):
    block = ImuBlock(unit.t, unit.accel, unit.gyro, unit.t)
    return smooth_foot(block, covariance=True)


@pytest.fixture(scope="module")
def strides(track):
    return gait_parameters(track)


def test_strides_are_those_of_the_footprints(walker, strides):
    """Each is found; the distance is right within its own uncertainty, which is no excuse."""
    found = compare_footprints(
        strides, Footprints(np.array([fall.ball for fall in walker.falls[0]]))
    )
    assert found.count == found.true_count
    assert found.mae < 0.02
    assert abs(found.distance - found.true_distance) < 3.0 * strides.distance_sigma + 0.03
    assert strides.distance_sigma < 0.025 * strides.distance
    together = np.sqrt(np.sum(strides.length_sigma**2))
    assert together < strides.distance_sigma < strides.length_sigma.sum() * 1.0001


def test_times_of_contact_and_toe_off_survive_a_real_sensor(walker, strides):
    """As well as from the truth."""
    falls = walker.falls[0]
    contact = strides.contact - [fall.contact for fall in falls[1:]]
    toe_off = strides.toe_off - [fall.toe_off for fall in falls[:-1]]
    assert np.max(np.abs(contact)) < 0.035
    assert np.max(np.abs(toe_off)) < 0.035


def test_an_optical_system_with_all_its_habits(unit, track, strides):
    """Its axes, hand and clock are its own, it sees 1 mm wrong, and loses the marker at times."""
    seen = unit.truth.position @ about_z(-2.0).T + [3.0, 1.0, 0.5]
    seen = seen + 0.001 * np.random.default_rng(1).normal(size=seen.shape)
    seen[200:230] = np.nan
    reference = Reference(unit.t[::2] - LATE_S, seen[::2] * [1.0, -1.0, 1.0])
    path = track.trajectory
    asked = align(path.t, path.position, reference, search_offset_s=1.0)
    assert asked.hands.suspect
    assert "left-handed" in asked.notes[-1]
    found = align(path.t, path.position, reference, search_offset_s=1.0, mirrored=True)
    assert found.time_offset == pytest.approx(LATE_S, abs=0.01)
    assert found.rmse_horizontal < 0.08
    assert found.rmse_vertical < 0.03
    compared = compare_optical_strides(strides, reference, time_offset=found.time_offset)
    assert compared.count >= len(strides) - 2
    assert compared.mae < 0.02
