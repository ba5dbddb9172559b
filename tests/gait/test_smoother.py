"""The default smoother on short simulated walks, and what must not change its answer."""

from dataclasses import replace

import numpy as np
import pytest
from walks_read import Read, named, walk_along

from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.options import FootOptions
from imu_rig.gait.smoother import smooth_foot
from imu_rig.rotation import from_rotation_vector, multiply, rotate, to_rotation_vector
from imu_rig.units import DEG
from simulators.walker.path import Arc, Stairs, Straight, Turn

DISTANCE = 0.005
"""Asked of a straight walk: half a percent."""


@pytest.fixture(scope="module")
def walk():
    """Twelve metres with a bend."""
    return Read(walk_along(Straight(6.0), Arc(1.0, 90.0), Straight(5.0)))


@pytest.fixture(scope="module")
def track(walk):
    return smooth_foot(walk.by("middle"))


def strides_of(track):
    return np.diff(track.trajectory.position[track.footfalls.quietest], axis=0)


def lengths_of(track):
    return np.linalg.norm(strides_of(track), axis=1)


# --- walks of all paces ---------------------------------------------------------------------------

PACES = {
    "slow": walk_along(Straight(4.0), speeds=(0.5,)),
    "normal": walk_along(Straight(10.0)),
    "brisk": walk_along(Straight(14.0), speeds=(1.8,)),
    "run": walk_along(Straight(30.0), speeds=(3.0,)),
    "sprint": walk_along(Straight(50.0), speeds=(3.0, 5.5, 5.5, 3.0), cadence=1.12),
}


@pytest.mark.parametrize("pace", PACES)
def test_every_stride_of_every_pace_is_found_with_its_length(pace):
    walk = Read(PACES[pace])
    track = smooth_foot(walk.by("middle", seed=3))
    assert walk.strides_right(track) == (0, 0)
    # A gain wrong by the grade's 0.3 % makes walks wrong by as much.
    assert abs(walk.distance_error(track)) < DISTANCE + 0.003


def test_turns_on_the_spot_make_no_extra_footfalls():
    walk = Read(walk_along(Straight(2.0), Turn(180.0), Straight(1.0), speeds=(0.4,)))
    assert walk.strides_right(smooth_foot(walk.by("middle"))) == (0, 0)


def test_a_walk_is_traced_within_centimetres_and_begins_along_x(walk, track):
    assert np.all(track.trajectory.position[0] == 0.0)
    ours, true = (
        p[:, :2] - p[:, :2].mean(axis=0) for p in (track.trajectory.position, walk.truth.position)
    )
    cross = np.sum(ours[:, 0] * true[:, 1] - ours[:, 1] * true[:, 0])
    yaw = np.arctan2(cross, np.sum(ours * true))
    turned = track.trajectory.turned(yaw).position[:, :2]
    left = turned - turned.mean(axis=0) - true
    assert np.sqrt(np.mean(np.sum(left**2, axis=1))) < 0.06
    assert (
        np.abs(
            track.trajectory.position[:, 2] - walk.truth.position[:, 2] + walk.truth.position[0, 2]
        ).max()
        < 0.03
    )
    first = strides_of(track)[1]
    assert abs(np.arctan2(first[1], first[0])) < 10.0 * DEG


def test_the_bias_of_a_poor_gyroscope_is_found(walk):
    block = walk.by("poor", seed=2)
    bias = np.array([0.8, -1.2, 0.9]) * DEG
    plain = smooth_foot(block)
    shifted = smooth_foot(replace(block, gyro=block.gyro + bias))
    np.testing.assert_allclose(shifted.gyro_bias - plain.gyro_bias, bias, atol=0.15 * DEG)
    np.testing.assert_allclose(lengths_of(shifted), lengths_of(plain), atol=0.01)


# --- stairs, slopes, level ground -----------------------------------------------------------------


def test_stairs_keep_their_steps_and_level_ground_is_level():
    walk = Read(walk_along(Straight(2.0), Stairs(6), Straight(2.0), speeds=(1.0,)))
    block = walk.by("middle")
    rows = smooth_foot(block).footfalls.quietest
    true = walk.truth.position[rows, 2]
    for level, most in (("auto", 0.03), ("never", 0.06)):
        height = smooth_foot(block, FootOptions(level=level)).trajectory.position[rows, 2]
        assert np.abs(np.diff(height) - np.diff(true)).max() < most
    flattened = smooth_foot(block, FootOptions(level="always")).trajectory.position[rows, 2]
    assert np.ptp(true) > 1.0 > 0.3 > np.ptp(flattened)


def test_a_slope_stays_a_slope():
    walk = Read(walk_along(Straight(3.0), Straight(8.0, 5.5)))
    track = smooth_foot(walk.by("good"))
    rows = track.footfalls.quietest
    rise = np.diff(track.trajectory.position[rows[[0, -1]], 2])
    assert rise == pytest.approx(np.diff(walk.truth.position[rows[[0, -1]], 2]), abs=0.03)


def test_a_half_circle_on_a_board_is_followed_within_5_mm():
    slide = named("half-circle")
    place = smooth_foot(slide.by("good")).trajectory.position[:, :2]
    true = slide.truth.position[:, :2]
    ours, aim = place - place.mean(axis=0), true - true.mean(axis=0)
    cross = np.sum(ours[:, 0] * aim[:, 1] - ours[:, 1] * aim[:, 0])
    yaw = np.arctan2(cross, np.sum(ours * aim))
    cos, sin = np.cos(yaw), np.sin(yaw)
    off = ours @ np.array([[cos, sin], [-sin, cos]]) - aim
    assert np.linalg.norm(off, axis=1).max() < 0.005


# --- what must not matter -------------------------------------------------------------------------


def test_the_frame_of_time_does_not_matter(walk, track):
    block = walk.by("middle")
    later = smooth_foot(replace(block, t=block.t + 1e5))
    np.testing.assert_array_equal(later.footfalls.quietest, track.footfalls.quietest)
    # Stamps of 1e5 s are rounded to 1e-11 s.
    np.testing.assert_allclose(later.trajectory.position, track.trajectory.position, atol=1e-5)


@pytest.mark.parametrize(
    "turn", [(0.0, 0.0, 2.0), (np.pi, 0.0, 0.0), (0.0, 1.2, 0.0), (1.0, -2.0, 0.7)]
)
def test_how_the_sensor_is_turned_in_its_case_does_not_matter(walk, track, turn):
    """Upside down, on its side, any heading: the path is the same and only the axes turn."""
    block = walk.by("middle")
    q = from_rotation_vector(np.array(turn))
    turned = smooth_foot(replace(block, accel=rotate(q, block.accel), gyro=rotate(q, block.gyro)))
    np.testing.assert_allclose(turned.trajectory.position, track.trajectory.position, atol=2e-3)
    np.testing.assert_allclose(turned.gyro_bias, rotate(q, track.gyro_bias), atol=1e-4)
    back = multiply(turned.trajectory.quaternion, q)
    apart = to_rotation_vector(multiply(back, track.trajectory.quaternion * [1, -1, -1, -1]))
    assert np.linalg.norm(apart, axis=1).max() < 5e-3


@pytest.mark.parametrize("rate_hz", [100.0, 400.0])
def test_the_sample_rate_hardly_matters(track, rate_hz):
    other = Read(walk_along(Straight(6.0), Arc(1.0, 90.0), Straight(5.0)), rate_hz)
    found = smooth_foot(other.by("middle"))
    assert other.strides_right(found) == (0, 0)
    np.testing.assert_allclose(lengths_of(found), lengths_of(track), atol=0.012)


def test_jittery_and_repeated_stamps_are_survived(walk, track):
    block = walk.by("middle")
    rng = np.random.default_rng(1)
    stamps = np.maximum.accumulate(block.t + rng.uniform(0.0, 0.0005, len(block)))
    stamps[1000:1010] = stamps[1000]
    found = smooth_foot(replace(block, t=stamps))
    assert np.isfinite(found.trajectory.position).all()
    np.testing.assert_allclose(lengths_of(found), lengths_of(track), atol=0.03)


def test_noise_of_a_sensor_scales_the_scatter_only(walk, track):
    block = walk.by("middle")
    rng = np.random.default_rng(2)
    noisy = replace(
        block,
        gyro=block.gyro + rng.normal(0.0, 0.5 * DEG, block.gyro.shape),
        accel=block.accel + rng.normal(0.0, 0.1, block.accel.shape),
    )
    found = smooth_foot(noisy)
    assert walk.strides_right(found) == (0, 0)
    np.testing.assert_allclose(lengths_of(found), lengths_of(track), atol=0.02)


def test_a_recording_may_begin_in_a_swing(walk, track):
    block = walk.by("middle")
    between = (track.footfalls.last[2] + track.footfalls.first[3]) // 2
    found = smooth_foot(block[between:])
    np.testing.assert_allclose(lengths_of(found), lengths_of(track)[3:], atol=0.03)


# --- what cannot be answered ----------------------------------------------------------------------


def test_samples_lost_in_a_swing_are_told_and_make_it_uncertain(walk, track):
    block = walk.by("middle")
    middle = (track.footfalls.last[3] + track.footfalls.first[4]) // 2
    keep = np.ones(len(block), dtype=bool)
    keep[middle - 8 : middle + 8] = False
    found = smooth_foot(block[keep], covariance=True)
    assert found.notes
    whole = smooth_foot(block, covariance=True)
    sigma = [np.sqrt(np.trace(t.covariance.strides[3])) for t in (whole, found)]
    off = abs(lengths_of(found)[3] - lengths_of(whole)[3])
    assert off < 4.0 * sigma[1]
    assert sigma[1] > 2.0 * sigma[0]


def test_two_samples_are_refused():
    with pytest.raises(DataError):
        smooth_foot(ImuBlock(np.arange(2.0), np.ones((2, 3)), np.zeros((2, 3)), np.arange(2.0)))
