"""Readings at the end of their range make strides uncertain, all of them alike."""

from dataclasses import replace

import numpy as np
import pytest
from walks_read import Read, walk_along

from imu_rig.gait.cut_off import cut_spans, cut_strides, with_cut_off
from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.strides import gait_parameters
from imu_rig.gait.unseen import Clipping, find_holes
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.walker.path import Straight


@pytest.fixture(scope="module")
def walk():
    return Read(walk_along(Straight(20.0)))


CUT = {
    "accelerometer 3 g": ("accel", 3.0 * STANDARD_GRAVITY),
    "accelerometer 4 g": ("accel", 4.0 * STANDARD_GRAVITY),
    "gyroscope 250 deg/s": ("gyro", 250.0 * DEG),
    "gyroscope 400 deg/s": ("gyro", 400.0 * DEG),
}


@pytest.mark.parametrize("case", CUT)
def test_distances_of_cut_readings_are_as_uncertain_as_they_are_wrong(walk, case):
    name, limit = CUT[case]
    block = walk.by("middle")
    block = replace(block, **{name: getattr(block, name).clip(-limit, limit)})
    track = smooth_foot(block, covariance=True)
    strides = gait_parameters(track)
    off = walk.distance_error(track) * strides.distance
    assert abs(off) < 3.0 * strides.distance_sigma
    assert any("end of its range" in note and " to " in note for note in track.notes)


def test_only_strides_with_cut_readings_grow(walk):
    block = walk.by("middle")
    whole = smooth_foot(block, covariance=True)
    rows = whole.footfalls.quietest
    cut = np.zeros((len(block), 3), dtype=bool)
    cut[(rows[4] + rows[5]) // 2, 1] = True
    holes = replace(find_holes(block), gyro=Clipping(cut, np.array([np.inf, 5.0, np.inf])))
    assert np.flatnonzero(cut_strides(holes, whole.footfalls)).tolist() == [4]
    wider = with_cut_off(whole.covariance, holes, whole.trajectory, whole.footfalls)
    before, after = (
        np.trace(c.strides[:, :, :], axis1=1, axis2=2) for c in (whole.covariance, wider)
    )
    assert after[4] > 1.5 * before[4]
    assert np.delete(after, 4) == pytest.approx(np.delete(before, 4), rel=1e-12)
    own = wider.strides - wider.common.transpose(0, 2, 1) @ wider.common
    assert np.linalg.eigvalsh(own).min() > -1e-6
    grown = np.trace(wider.values - whole.covariance.values, axis1=1, axis2=2)
    assert grown[0] == 0.0
    assert grown[-1] > 0.0


def test_stretches_of_cut_readings_are_named():
    t = np.arange(0.0, 100.0, 0.1)
    cut = np.zeros((len(t), 3), dtype=bool)
    cut[(t > 9.95) & (t < 15.0), 0] = cut[(t > 57.95) & (t < 66.05), 2] = True
    assert cut_spans(t, Clipping(cut, np.array([5.0, np.inf, 5.0]))) == "10 to 15 s, 58 to 66 s"
