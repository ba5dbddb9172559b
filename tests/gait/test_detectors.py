"""The classic detectors say what their papers define, whole or in pieces, and find real stances."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imu_rig.blocks import ImuBlock
from imu_rig.errors import InputError
from imu_rig.gait.detector_stream import joined
from imu_rig.gait.detectors import DETECTORS, detector_named
from imu_rig.gait.footfalls import runs
from imu_rig.gait.gravity_removal import GravityRemoval
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.walker.device import Carried
from simulators.walker.path import Straight
from simulators.walker.record import record_walk
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Walker

NAMES = tuple(DETECTORS)
OF_WINDOWS = tuple(name for name in NAMES if name != "threshold")


def block_of(t, accel, gyro):
    return ImuBlock(np.asarray(t, dtype=float), accel, gyro, np.asarray(t, dtype=float))


def random_block(n, seed=0, *, jitter=True):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.0, 0.02, n) * (rng.random(n) > 0.1) if jitter else np.full(n, 0.01))
    accel = rng.normal((0.0, 0.0, STANDARD_GRAVITY), 2.0, (n, 3))
    return block_of(t, accel, rng.normal(0.0, 1.0, (n, 3)))


@pytest.fixture(scope="module")
def walk():
    scenario = Scenario("6m", "6 m", (Stand(3.0), Walk((Straight(6.0),), (1.2,)), Stand(2.0)))
    return record_walk(Walker(scenario, 4), [Carried("left-foot", "mpu9150")], exact=True)[
        "left-foot"
    ].units[0]


@pytest.fixture(scope="module")
def walked(walk):
    return block_of(walk.t, walk.means.force, walk.means.rate)


def by_hand(name, detector, f, w):
    """Return a statistic of one window as its paper writes it."""
    g = STANDARD_GRAVITY
    mean = f.mean(axis=0)

    def size(v):
        return np.linalg.norm(v, axis=1)

    if name == "shoe":
        force = size(f - g * mean / np.linalg.norm(mean)) ** 2 / detector.sigma_accel**2
        return np.mean(force + size(w) ** 2 / detector.sigma_gyro**2)
    if name == "are":
        return np.mean(size(w) ** 2) / detector.sigma_gyro**2
    if name == "variance":
        return np.mean(size(f - mean) ** 2) / detector.sigma_accel**2
    if name == "magnitude":
        return np.mean((size(f) - g) ** 2) / detector.sigma_accel**2
    spread = np.sqrt(np.var(f, axis=0).sum())
    return max(size(w).max() / detector.most_rate, spread / detector.most_scatter)


@pytest.mark.parametrize("name", OF_WINDOWS)
def test_statistic_is_that_of_its_paper_over_the_samples_within_half_a_window(name):
    block = random_block(60)
    detector = detector_named(name, window=0.08)
    found = detector.detect(block)
    for k in (0, 20, 41, 59):
        near = np.abs(block.t - block.t[k]) <= 0.04
        expected = by_hand(name, detector, block.accel[near], block.gyro[near])
        assert near.sum() >= 3
        assert found.statistic[k] == pytest.approx(expected, rel=1e-9)


def test_a_foot_that_rolls_at_ten_degrees_a_second_has_the_angular_rate_energy_of_that():
    n = 20
    accel = np.tile((0.0, 0.0, STANDARD_GRAVITY), (n, 1))
    gyro = np.tile((0.0, 10.0 * DEG, 0.0), (n, 1))
    found = detector_named("are").detect(block_of(0.01 * np.arange(n), accel, gyro))
    assert np.allclose(found.statistic, 100.0**2)
    assert np.allclose(
        detector_named("variance").detect(block_of(0.01 * np.arange(n), accel, gyro)).statistic, 0.0
    )


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0])
def test_a_turn_is_seen_half_a_window_to_either_side_whatever_the_rate(rate):
    t = np.arange(0.0, 2.0, 1.0 / rate)
    turning = (t > 1.0) & (t < 1.2)
    gyro = np.where(turning[:, None], (0.0, 3.0, 0.0), 0.0)
    accel = np.tile((0.0, 0.0, STANDARD_GRAVITY), (len(t), 1))
    moving = t[~detector_named("are", window=0.16).detect(block_of(t, accel, gyro)).still]
    assert moving[0] == pytest.approx(1.0 - 0.08, abs=2.1 / rate)
    assert moving[-1] == pytest.approx(1.2 + 0.08, abs=2.1 / rate)


@pytest.mark.parametrize("name", ["shoe", "variance", "paper"])
def test_a_sample_alone_between_gaps_shows_no_rest(name):
    t = np.concatenate((0.01 * np.arange(50), [1.0], 1.5 + 0.01 * np.arange(50)))
    accel = np.tile((0.0, 0.0, STANDARD_GRAVITY), (len(t), 1))
    still = detector_named(name).detect(block_of(t, accel, np.zeros_like(accel))).still
    assert not still[50]
    assert still[:50].all()


@pytest.mark.parametrize("name", NAMES)
def test_missing_values_are_no_rest(name):
    block = random_block(400, jitter=False)
    accel = np.tile((0.0, 0.0, STANDARD_GRAVITY), (400, 1))
    gyro = np.zeros_like(accel)
    accel[200], gyro[200] = np.nan, np.nan
    found = detector_named(name).detect(block_of(block.t, accel, gyro))
    assert not found.still[200]
    assert found.still[:190].all()
    assert np.isinf(found.sigma[200])


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=25)
@given(cuts=st.lists(st.integers(0, 900), max_size=12), seed=st.integers(0, 5))
def test_pieces_give_bit_for_bit_what_the_whole_does(name, cuts, seed):
    block = random_block(900, seed)
    detector = detector_named(name)
    whole = detector.detect(block)
    stream = detector.stream()
    edges = [0, *sorted(cuts), 900]
    parts = [stream.update(block[a:b]) for a, b in itertools.pairwise(edges)]
    pieced = joined([*parts, stream.finish()])
    assert len(whole) == 900
    for column in ("still", "sigma", "statistic", "threshold"):
        assert np.array_equal(getattr(pieced, column), getattr(whole, column))


@pytest.mark.parametrize("name", NAMES)
def test_verdicts_come_within_half_a_window_and_little_is_kept(name, walked):
    detector = detector_named(name)
    stream = detector.stream()
    told = 0
    for k in range(0, 800, 4):
        told += len(stream.update(walked[k : k + 4]))
        if walked.t[k] > 2.0:  # the fixed threshold waits for a still second
            late = walked.t[k + 3] - walked.t[told - 1]
            assert late <= 0.5 * detector.window + 0.03
            assert len(stream._kept.t) <= 2.0 * detector.window * 100.0 + 4


@pytest.mark.parametrize("name", NAMES)
def test_every_stance_of_a_walk_is_found_and_no_middle_of_a_swing(name, walk, walked):
    found = detector_named(name).detect(walked)
    flat = list(zip(*runs(walk.phase != 0), strict=True))
    swings = list(zip(*runs(walk.phase == 0), strict=True))
    assert len(swings) >= 4
    assert all(found.still[a : b + 1].any() for a, b in flat)
    assert not any(found.still[a + 3 : b - 2].any() for a, b in swings)
    speed = np.linalg.norm(walk.truth.velocity, axis=1)
    assert speed[found.still].max() < 0.7
    assert np.median(speed[found.still]) < 0.01


def test_gravity_is_taken_off_in_pieces_as_from_the_whole(walked):
    whole = GravityRemoval()
    all_of_it = whole.update(walked)
    assert len(whole.finish().t) == 0
    removal = GravityRemoval()
    parts = [removal.update(walked[k : k + 37]) for k in range(0, len(walked), 37)]
    parts.append(removal.finish())
    for column in ("t", "quaternion", "acceleration"):
        pieced = np.concatenate([getattr(part, column) for part in parts])
        assert np.array_equal(pieced, getattr(all_of_it, column))
    assert removal.still_start


def test_unknown_names_and_settings_are_told_with_what_there_is():
    with pytest.raises(InputError, match="take one of paper, shoe, are"):
        detector_named("shoes")
    with pytest.raises(InputError, match="no setting 'gamma'; it has threshold, window"):
        detector_named("shoe", gamma=1.0)
    with pytest.raises(InputError, match=r"window is -1\.0; it must be a positive"):
        detector_named("are", window=-1.0)
    shoe = detector_named("shoe", threshold=7.0)
    assert detector_named(shoe) is shoe
