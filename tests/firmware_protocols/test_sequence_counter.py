"""Lost, repeated and late packets, by counters of every width."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocols.counting import LATE_WINDOW, SequenceCounter
from firmware_protocols.decoder import StreamDecoder
from firmware_protocols.layout import Field, load_layout
from firmware_protocols.packets import encode

MPU = load_layout("mpu9150-28")
WIDTHS = ["u8", "u16", "u24", "u32"]


def layout_with(width):
    fields = (Field("seq", width), *MPU.fields[1:])
    return replace(MPU, fields=fields)


def stream_of(layout, indices, contents=None):
    """Packets with these numbers; equal numbers make equal packets unless contents differ."""
    indices = np.asarray(indices, dtype=np.int64)
    contents = indices if contents is None else np.asarray(contents)
    modulus = 1 << layout.field("seq").bits
    return encode(
        layout,
        {
            "seq": indices % modulus,
            "status": 0,
            "time": contents % 2**32,
            "accel": (0, 0, 0),
            "gyro": (0, 0, 0),
            "mag": (0, 0, 0),
        },
    )


def count(layout, indices, contents=None):
    decoder = StreamDecoder(layout)
    decoder.feed(stream_of(layout, indices, contents))
    stats = decoder.stats
    assert stats.good == len(indices)
    return stats.lost, stats.duplicates, stats.reordered


@pytest.fixture(params=WIDTHS)
def layout(request):
    return layout_with(request.param)


def test_an_unbroken_run_through_the_wrap(layout):
    modulus = 1 << layout.field("seq").bits
    assert count(layout, np.arange(modulus - 500, modulus + 500)) == (0, 0, 0)


@pytest.mark.parametrize("missing", [1, 2, 8, 63, 64, 65, 190])
def test_a_gap_is_lost(layout, missing):
    modulus = 1 << layout.field("seq").bits
    for first in (0, modulus - 20):
        before = np.arange(first, first + 10)
        after = np.arange(first + 10 + missing, first + 120 + missing)
        assert count(layout, [*before, *after]) == (missing, 0, 0)


def test_repeated_packets(layout):
    assert count(layout, [0, 1, 1, 2, 2, 2, 3]) == (0, 3, 0)
    assert count(layout, np.repeat(np.arange(300), 2)) == (0, 300, 0)


def test_a_repeat_that_comes_late_is_a_duplicate(layout):
    assert count(layout, [0, 1, 2, 3, 1, 4, 5]) == (0, 1, 0)


@pytest.mark.parametrize("late_by", range(1, 9))
def test_a_late_packet_is_reordered_and_not_lost(layout, late_by):
    order = np.arange(600)
    moved = np.concatenate([order[:252], order[253 : 253 + late_by], [252], order[253 + late_by :]])
    assert count(layout, moved) == (0, 0, 1)


def test_a_late_packet_at_the_far_end_of_the_window(layout):
    order = np.arange(300)
    late = np.concatenate([np.delete(order[: 101 + LATE_WINDOW], 100), [100]])
    assert count(layout, late) == (0, 0, 1)
    assert count(layout, [*late, *order[101 + LATE_WINDOW :]]) == (0, 0, 1)


def test_a_late_packet_is_known_across_batches(layout):
    """The missing one, a steady batch, then the one that was missing, then it again."""
    decoder = StreamDecoder(layout)
    for batch in (range(7), range(8, 10), range(10, 40), [7], [7], range(40, 200), [139, 140]):
        decoder.feed(stream_of(layout, list(batch)))
    stats = decoder.stats
    assert (stats.lost, stats.duplicates, stats.reordered) == (0, 3, 1)


def test_a_late_packet_from_before_the_first_is_not_taken_off_the_lost(layout):
    assert count(layout, [5, 4, 7, 8]) == (1, 0, 1)


def test_the_same_number_on_another_packet_counts_nothing(layout):
    assert count(layout, [1, 2, 2, 3], contents=[1, 2, 99, 3]) == (0, 0, 0)


@pytest.mark.parametrize("width", ["u16", "u24", "u32"])
def test_a_restarted_counter_counts_nothing(width):
    layout = layout_with(width)
    assert count(layout, [*range(9_000, 9_400), *range(300), *range(302, 600)]) == (2, 0, 0)


def test_whole_turns_of_a_u8_counter_are_not_seen():
    """What the documentation says of it, so that nobody relies on more."""
    layout = layout_with("u8")
    turns = [*range(100), *range(99 + 256 + 1, 99 + 256 + 100)]
    assert count(layout, turns) == (0, 0, 0)
    assert count(layout, [*range(100), *range(99 + 256 + 11, 500)]) == (10, 0, 0)
    _, duplicates, reordered = count(layout, [*range(100), 100 + 200])
    assert duplicates + reordered == 1


def test_no_counter_counts_nothing():
    layout = replace(MPU, counter=None)
    assert count(layout, [0, 5, 5, 3]) == (0, 0, 0)


@given(
    st.sampled_from(WIDTHS),
    st.lists(st.integers(-70, 260) | st.sampled_from([0, 1, 1, 1, 1, 2, -1]), max_size=80),
    st.lists(st.integers(0, 80), max_size=6),
)
def test_batches_do_not_matter(width, steps, cuts):
    """All at once, one by one or cut anywhere, long steady stretches between the odd steps."""
    indices = 300 + np.cumsum([1, *steps])
    indices = np.concatenate([indices, indices[-1] + np.arange(1, 40), np.atleast_1d(indices[0])])
    modulus = 1 << layout_with(width).field("seq").bits
    numbers = indices % modulus
    rows = indices.astype("<i8").view(np.uint8).reshape(-1, 8)
    results = []
    for places in ((), range(1, len(numbers)), sorted(c for c in cuts if c <= len(numbers))):
        counter = SequenceCounter(modulus)
        for part, part_rows in zip(
            np.split(numbers, list(places)), np.split(rows, list(places)), strict=True
        ):
            counter.add(part, part_rows)
        results.append((counter.lost, counter.duplicates, counter.reordered))
    assert results[0] == results[1] == results[2]
    assert results[0][0] >= 0


@given(st.sampled_from(WIDTHS), st.integers(0, 2**32), st.integers(50, 700))
def test_what_was_done_to_a_stream_is_what_is_counted(width, seed, number):
    """Drops, repeats and delays by up to 8, each counted under its own name."""
    rng = np.random.default_rng(seed)
    keep = rng.random(number) > 0.1
    keep[[0, -1]] = True
    kept = np.flatnonzero(keep)
    late = rng.choice(len(kept) - 20, min(5, len(kept) // 30), replace=False) + 1
    late = np.sort(late)[np.diff(np.sort(late), append=10_000) > 9]
    arrival = np.arange(len(kept), dtype=float)
    arrival[late] += rng.integers(1, 9, len(late)) + 0.5
    order = kept[np.argsort(arrival)]
    repeats = np.where(rng.random(len(order)) < 0.05, 2, 1)
    lost, duplicates, reordered = count(layout_with(width), np.repeat(order, repeats))
    assert lost == number - len(kept)
    assert duplicates == int(repeats.sum()) - len(order)
    assert reordered == len(late)
