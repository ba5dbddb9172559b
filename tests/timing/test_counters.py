"""Counters that wrap, against counting with unlimited integers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imu_rig.timing import Unwrapper, unwrap
from imu_rig.timing.counters import differences

MODULI = st.sampled_from([2**8, 2**16, 2**24, 2**32])


@given(
    modulus=MODULI,
    start=st.integers(0, 2**33),
    steps=st.lists(st.integers(-32, 150), max_size=60),
)
def test_follows_steps_over_any_wrap(modulus, start, steps):
    true = start + np.cumsum([0, *steps])
    unwrapped = unwrap(true % modulus, modulus)
    np.testing.assert_array_equal(unwrapped - unwrapped[0], true - true[0])
    assert unwrapped[0] == start % modulus


@given(
    steps=st.lists(st.integers(1, 200), min_size=1, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=5),
)
def test_pieces_give_the_same_as_the_whole(steps, cuts):
    values = np.cumsum(steps) % 256
    counter = Unwrapper(256)
    pieces = [counter.feed(p) for p in np.split(values, sorted(c for c in cuts if c < len(values)))]
    np.testing.assert_array_equal(np.concatenate(pieces), unwrap(values, 256))
    assert counter.last == unwrap(values, 256)[-1]


@given(lost=st.integers(0, 5000), error=st.floats(-100, 100))
def test_another_clock_shows_the_turns_that_a_small_counter_hides(lost, error):
    counter = Unwrapper(256)
    counter.feed(np.array([250]))
    after = counter.feed(
        np.array([(251 + lost) % 256]), expected=np.array([max(0.0, lost + 1 + error)])
    )
    assert after[0] == 251 + lost


def test_reordered_packets_keep_their_place():
    np.testing.assert_array_equal(unwrap([254, 255, 1, 0, 2], 256), [254, 255, 257, 256, 258])


def test_a_restart_goes_on_by_one():
    counter = Unwrapper(256)
    counter.feed(np.array([100, 101]))
    counter.restart()
    np.testing.assert_array_equal(counter.feed(np.array([0, 1, 3])), [102, 103, 105])


def test_a_float_may_be_anything():
    steps = differences(np.array([np.inf, np.inf, 3e38, -3e38], np.float32), np.float32(1))
    assert np.isposinf(steps[0])
    assert np.isnan(steps[1])
    assert np.isneginf(steps[2:]).all()


def test_nothing_gives_nothing_and_senseless_moduli_are_refused():
    assert len(unwrap(np.empty(0, int), 256)) == 0
    with pytest.raises(ValueError, match="modulus"):
        Unwrapper(1)
