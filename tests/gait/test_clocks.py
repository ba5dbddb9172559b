"""Clocks and sample rates that are wrong make distances uncertain and are told."""

from dataclasses import replace

import numpy as np
import pytest
from walks_read import Read, walk_along

from imu_rig.gait.clocks import ClockDoubt, with_doubt
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.strides import gait_parameters
from simulators.walker.path import Straight, Turn


@pytest.fixture(scope="module")
def walk():
    return Read(walk_along(Straight(9.0), Turn(60.0), Straight(5.0)), 100.0)


def times(factor):
    return lambda block: replace(block, t=factor * block.t)


def late(seconds):
    def put_off(block):
        gyro = [np.interp(block.t - seconds, block.t, block.gyro[:, k]) for k in range(3)]
        return replace(block, gyro=np.stack(gyro, axis=1))

    return put_off


def pull(walk, block, grade=None):
    """Error of the distance over its uncertainty, its uncertainty as a share, and the notes."""
    track = smooth_foot(block, grade=grade, covariance=True)
    strides = gait_parameters(track)
    off = walk.distance_error(track) * strides.distance / (1 + walk.distance_error(track))
    sigma = strides.distance_sigma
    return off / sigma, sigma / strides.distance, [n for n in track.notes if "contradict" in n]


WRONG = {
    "times 2 % too long": (times(1.02), "sample rate"),
    "times 5 % too long": (times(1.05), "sample rate"),
    "times 10 % too long": (times(1.1), "sample rate"),
    "times 10 % too short": (times(0.9), "sample rate"),
    "gyroscope 10 ms late": (late(0.01), "ms later"),
    "gyroscope 20 ms late": (late(0.02), "ms later"),
    "gyroscope 10 ms early": (late(-0.01), "ms earlier"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_times_are_told_and_make_distances_uncertain(walk, case):
    change, word = WRONG[case]
    off, share, notes = pull(walk, change(walk.by("good")))
    assert abs(off) < 3.0
    assert share > 0.02
    assert len(notes) == 1
    assert word in notes[0]


@pytest.mark.parametrize("grade", ["good", "middle", "poor"])
def test_sensors_in_order_are_not_blamed(walk, grade):
    off, share, notes = pull(walk, walk.by(grade, 3))
    assert abs(off) < 3.0
    assert share < 0.03
    assert not notes


def test_a_sensor_that_is_known_to_be_good_has_a_small_uncertainty(walk):
    known = SensorGrade(gyro_matrix=1e-3, accel_matrix=1e-3, accel_bias=0.01, late_s=1e-4)
    assert pull(walk, walk.by("good"), replace(known, raw_odds=0.0))[1] < 0.006


def test_an_error_of_scale_is_common_to_all_strides(walk):
    track = smooth_foot(walk.by("good"), covariance=True)
    wide = with_doubt(track.covariance, ClockDoubt(0.0, 0.04), track.trajectory, track.footfalls)
    more = gait_parameters(replace(track, covariance=wide))
    without = gait_parameters(track).distance_sigma
    asked = more.distance * (1.04**2.5 - 1.0)
    assert np.hypot(asked, without) == pytest.approx(more.distance_sigma, rel=0.02)
    end = np.hypot(*track.trajectory.position[track.covariance.rows[-1], :2])
    grown = wide.values[-1, 6:8, 6:8].trace() - track.covariance.values[-1, 6:8, 6:8].trace()
    assert np.sqrt(grown) == pytest.approx(end * (1.04**2.5 - 1.0), rel=1e-6)
