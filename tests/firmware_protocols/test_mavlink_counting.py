"""Losses told from jitter by the sequence numbers of a sender's frames."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_writer import Writer

from firmware_protocols.known import load_protocol, protocol_from_dict
from firmware_protocols.mavlink_counting import StreamCounter
from imu_rig.packet_stream import PacketStreams

HIGHRES = protocol_from_dict(  # asked for by name, so that every message counts
    {**load_protocol("mavlink-highres").to_dict(), "system": 1, "component": 1}
)
US = 1_000_000


def sent(times_us, others=2):
    """An inertial message at each time, and others of the same sender after it, as frames."""
    writer = Writer()
    pairs = []
    for t in times_us:
        pairs.append((True, writer.highres(int(t))))
        pairs += [(False, writer.heartbeat()) for _ in range(others)]
    return pairs


def numbers(frames):
    rows = HIGHRES.decoder().feed(b"".join(frames))["imu"].rows
    return rows["seq"].astype(int).tolist()


def test_messages_are_counted_though_the_sequence_counts_others_too():
    frames = [frame for _, frame in sent(10_000 * np.arange(600))]
    assert numbers(frames) == list(range(600))  # the sequence came round seven times


def test_jitter_is_no_loss():
    """PX4 samples every 5 ms and sends when its loop comes round: 5, 10 or 15 ms apart."""
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.choice([5_000, 10_000, 15_000], 500))
    data = b"".join(frame for _, frame in sent(times))
    assert numbers([data]) == list(range(500))
    streams = PacketStreams(HIGHRES)
    chunks = [
        (int(1e9 + 1e7 * k), data[at : at + 200]) for k, at in enumerate(range(0, len(data), 200))
    ]
    streams.feed_many(chunks)
    assert streams.stats("imu").lost == 0
    assert streams.stats("imu").duplicates == 0


@settings(max_examples=25)
@given(data=st.data())
def test_lost_messages_are_missing_in_the_count(data):
    """Any frames may be lost; the first message is there."""
    pairs = sent(10_000 * np.arange(40))
    keep = [True, *(data.draw(st.booleans()) or data.draw(st.booleans()) for _ in pairs[1:])]
    frames = [frame for (_, frame), kept in zip(pairs, keep, strict=True) if kept]
    expected = [number for number in range(40) if keep[3 * number]]
    assert numbers(frames) == expected


def test_losses_of_other_messages_are_none_of_this_stream():
    pairs = sent(10_000 * np.arange(50))
    rng = np.random.default_rng(1)
    frames = [frame for of_stream, frame in pairs if of_stream or rng.random() < 0.5]
    assert numbers(frames) == list(range(50))


def test_a_long_break_is_measured_by_time():
    """3 s: 900 frames are missing, which the sequence tells modulo 256."""
    frames = [frame for _, frame in sent(10_000 * np.arange(500))]
    assert numbers(frames[:300] + frames[1200:]) == [*range(100), *range(400, 500)]


def test_a_restart_goes_on_counting():
    before = [frame for _, frame in sent(50 * US + 10_000 * np.arange(20))]
    after = [frame for _, frame in sent(10_000 * np.arange(20))]
    assert numbers(before[:-1] + after) == list(range(40))


def test_a_repeated_frame_keeps_its_number_and_a_late_one_gets_its_own():
    frames = [frame for _, frame in sent(10_000 * np.arange(30), others=0)]
    assert numbers([*frames[:10], frames[9], *frames[10:]]) == [*range(10), 9, *range(10, 30)]
    late = [*frames[:10], frames[11], frames[10], *frames[12:]]
    assert numbers(late) == [*range(10), 11, 10, *range(12, 30)]


@settings(max_examples=20)
@given(data=st.data(), cuts=st.lists(st.integers(1, 89), max_size=6))
def test_cuts_change_no_number(data, cuts):
    pairs = sent(10_000 * np.arange(30))
    frames = [frame for _, frame in pairs if data.draw(st.integers(0, 9)) < 8]
    whole = numbers(frames)
    decoder = HIGHRES.decoder()
    edges = [0, *sorted(c for c in cuts if c < len(frames)), len(frames)]
    parts = [
        decoder.feed(b"".join(frames[a:b]))["imu"].rows["seq"].astype(int).tolist()
        for a, b in pairwise(edges)
    ]
    assert [number for part in parts for number in part] == whole


def test_nothing_is_no_number():
    counter = StreamCounter(1e-6, 0.01)
    none = np.empty(0, dtype=np.int64)
    assert counter.feed(none, none, none).tolist() == []
    assert counter.feed(np.array([5, 6]), none, none).tolist() == []
    assert counter.feed(np.array([7]), np.array([0]), np.array([100])).tolist() == [0]


@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_the_rate_that_comes_counts_not_the_one_asked_for(rate_hz):
    frames = [frame for _, frame in sent(np.arange(60) * US / rate_hz)]
    assert numbers(frames[:90] + frames[120:]) == [*range(30), *range(40, 60)]
