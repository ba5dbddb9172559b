"""Rings give back the newest samples whole, however they were written and how slow the reader."""

import multiprocessing
import threading

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from imu_rig.monitor.rings import FEWEST, MOST, Ring, ring_size


@given(
    size=st.integers(1, 50),
    lengths=st.lists(st.integers(0, 120), max_size=12),
    reads=st.lists(st.booleans(), min_size=12, max_size=12),
)
def test_the_newest_samples_come_back_in_order(size, lengths, reads):
    ring, made = Ring(size, 2), 0
    for length, read in zip(lengths, reads, strict=False):
        t = np.arange(made, made + length, dtype=float)
        ring.write(t, [t[:, None] * 2, t[:, None] * 3])
        made += length
        if read:
            rows = ring.read()
            kept = np.arange(max(0, made - size), made, dtype=float)
            assert np.array_equal(rows, np.column_stack((kept, 2 * kept, 3 * kept)))


def test_a_reader_never_sees_half_a_sample_of_a_writer_that_does_not_wait():
    context = multiprocessing.get_context("spawn")
    ring = Ring(64, 1, context.RawArray("d", 128), context.RawArray("q", 2))
    other = Ring(64, 1, ring.numbers, ring.written)  # as another process has it
    done = threading.Event()

    def write():
        for start in range(0, 30_000, 30):
            t = np.arange(start, start + 30, dtype=float)
            ring.write(t, [-t[:, None]])
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    while not done.is_set():
        rows = other.read()
        assert np.array_equal(rows[:, 1], -rows[:, 0])
        assert np.all(np.diff(rows[:, 0]) == 1)
    writer.join()
    assert other.read()[-1, 0] == 29_999


def test_memory_is_bounded_whatever_a_layout_states():
    assert ring_size(1e9, 600.0) == MOST
    assert ring_size(None, 10.0) > FEWEST
    assert ring_size(0.01, 1.0) == FEWEST
    assert ring_size(100.0, 10.0) >= 1000
