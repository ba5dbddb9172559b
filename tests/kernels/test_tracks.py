"""Passes over a whole track do what the plain functions do."""

import numpy as np
import pytest

from imu_rig.kernels.tracks import less_interpolated, rises, turn_about_z
from imu_rig.rotation import about_z, normalize, rotate


@pytest.fixture
def rng():
    return np.random.default_rng(6)


def test_a_track_turned_about_z_is_seen_from_turned_axes(rng):
    q, v, p = normalize(rng.normal(size=(40, 4))), *rng.normal(size=(2, 40, 3))
    turned, axis = [x.copy() for x in (q, v, p)], np.array([0.3, -0.5, 0.8])
    turn_about_z(*turned, 0.7)
    R = about_z(0.7)
    assert rotate(turned[0], axis) == pytest.approx(rotate(q, axis) @ R.T)
    assert turned[1] == pytest.approx(v @ R.T)
    assert turned[2] == pytest.approx(p @ R.T)


def test_rises_are_the_extremes_of_a_rotated_axis(rng):
    q, axis = normalize(rng.normal(size=(60, 4))), normalize(np.array([0.3, -0.5, 0.8]))
    up = rotate(q, axis)[:, 2]
    told = rises(q, np.array([5, 6, 30, 59]), axis)
    want = [(up[a:b].min(), up[a:b].max()) for a, b in ((5, 6), (6, 30), (30, 59))]
    assert told == pytest.approx(np.array(want))


@pytest.mark.parametrize("knots", [[0.5], [-1.0, 0.2, 0.9], [0.0, 0.5, 0.5, 1.0], [2.0, 3.0]])
def test_what_changes_evenly_is_that_of_interpolation(rng, knots):
    t = np.sort(np.append(rng.uniform(0.0, 1.0, 50), [0.5, 0.5]))
    values, at_knots = rng.normal(size=(52, 3)), rng.normal(size=(len(knots), 3))
    want = values - np.column_stack([np.interp(t, knots, column) for column in at_knots.T])
    assert less_interpolated(values, t, np.array(knots), at_knots) == pytest.approx(want)
