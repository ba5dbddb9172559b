"""Bytes to blocks: times, losses and scales, live and recorded, against what was sent."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_stream import ImuStream

from firmware_protocols.layout import Checksum, Field, PacketLayout, load_layout
from firmware_protocols.packets import encode
from imu_rig.blocks import ImuBlock
from imu_rig.errors import InputError
from imu_rig.imu_scaling import field_values, si_factors, si_values
from imu_rig.imu_stream import imu_block
from imu_rig.packet_stream import assemble_packets
from imu_rig.units import DEG, STANDARD_GRAVITY

MPU = load_layout("mpu9150-28")
ORIGIN_S = 1000.0


def without(layout, *, clock=False, counter=False, **changes):
    """The layout without its clock, its counter, its rate."""
    return replace(
        layout,
        clock=None if clock else layout.clock,
        counter=None if counter else layout.counter,
        **changes,
    )


def sent(number, *, rate_hz=100.0, first=0, seed=0, clock0_s=0.0):
    """Fields of consecutive packets; accel x counts the packets."""
    index = first + np.arange(number)
    rng = np.random.default_rng(seed)
    accel = rng.integers(-8000, 8000, (number, 3))
    accel[:, 0] = index % 30000
    return {
        "seq": index % 256,
        "status": np.zeros(number, int),
        "time": np.round((clock0_s + index / rate_hz) * 1e6).astype(np.int64) % 2**32,
        "accel": accel,
        "gyro": rng.integers(-8000, 8000, (number, 3)),
        "mag": rng.integers(-100, 100, (number, 3)),
    }


def pick(columns, rows):
    return {name: column[rows] for name, column in columns.items()}


def packets(columns, layout=MPU):
    """Each packet's bytes."""
    data = encode(layout, columns)
    return [data[i : i + layout.length] for i in range(0, len(data), layout.length)]


def feed_each(stream, pieces, arrival_s, together=1):
    """Feed the pieces with their arrivals, ``together`` at a time as a poll does."""
    chunks = [(round(t * 1e9), piece) for t, piece in zip(arrival_s, pieces, strict=True)]
    polls = [chunks[i : i + together] for i in range(0, len(chunks), together)]
    return ImuBlock.concatenate([stream.feed_many(poll) for poll in polls])


def whole(layout, pieces, arrival_s):
    stops = np.cumsum([len(p) for p in pieces])
    return assembled(layout, b"".join(pieces), stops, np.asarray(arrival_s))


def assembled(layout, data, stops, arrival_s):
    """Everything that is known of a whole recording, its samples in SI units."""
    packets = assemble_packets(layout, data, stops, arrival_s)[""]
    return replace(packets, block=imu_block(layout, packets.block))


def on_time(number, *, rate_hz=100.0, first=0):
    return ORIGIN_S + (first + np.arange(number)) / rate_hz


def flushed(arrival_s, seed=0):
    """Arrivals over a link that flushes every 20 to 100 ms."""
    rng = np.random.default_rng(seed)
    flushes = arrival_s[0] + np.cumsum(rng.uniform(0.02, 0.1, int(60 * np.ptp(arrival_s)) + 60))
    return flushes[np.searchsorted(flushes, arrival_s)]


# --- scales -------------------------------------------------------------------------------


def test_counts_become_si_units_on_the_accelerometers_axes():
    columns = sent(1)
    columns["accel"][:] = [[4096, -2048, 0]]
    columns["gyro"][:] = [[328, 0, -3280]]
    columns["mag"][:] = [[10, 20, 30]]
    block = ImuStream(MPU).feed(0, packets(columns)[0])
    np.testing.assert_allclose(block.accel, [[STANDARD_GRAVITY, -STANDARD_GRAVITY / 2, 0]])
    np.testing.assert_allclose(block.gyro, [[10 * DEG, 0, -100 * DEG]])
    np.testing.assert_allclose(block.mag, [[6.0, 3.0, -9.0]])
    assert block.temperature is None


def test_an_accelerometer_alone_reads_nan_for_the_gyroscope():
    layout = PacketLayout(
        name="accel-only",
        title="",
        byte_order="big",
        header=b"\xaa",
        fields=(Field("accel", "i16", 3, unit="mg"), Field("temperature", "i16", unit="degC")),
        checksum=Checksum("sum8"),
        rate_hz=50.0,
    )
    data = encode(layout, {"accel": [[1000, 0, -1000]], "temperature": [21]})
    block = ImuStream(layout).feed(0, data)
    np.testing.assert_allclose(block.accel, [[STANDARD_GRAVITY, 0, -STANDARD_GRAVITY]])
    assert np.all(np.isnan(block.gyro))
    assert block.temperature == pytest.approx([21.0])


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ((Field("mag", "i16", 3, unit="uT"),), "neither"),
        ((Field("accel", "i16", 3, unit="furlong"),), "furlong"),
        ((Field("gyro", "i16", 2, unit="deg/s"),), "2 numbers"),
    ],
)
def test_layouts_that_hold_no_motion_are_refused_by_name(fields, word):
    layout = PacketLayout(
        name="odd-one", title="", byte_order="little", header=b"\x01", fields=fields
    )
    with pytest.raises(InputError, match=f"odd-one.*{word}"):
        ImuStream(layout)


# --- times --------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), cut=st.integers(1, 90))
def test_any_cutting_of_the_stream_gives_the_same_samples(seed, cut):
    data = b"".join(packets(sent(40, seed=seed)))
    pieces = [data[i : i + cut] for i in range(0, len(data), cut)]
    arrival = ORIGIN_S + np.arange(len(pieces)) * 0.001
    live, recorded = ImuStream(MPU), whole(MPU, pieces, arrival)
    block = feed_each(live, pieces, arrival)
    together = ImuStream(MPU).feed_many(
        [(round(t * 1e9), p) for t, p in zip(arrival, pieces, strict=True)]
    )
    for other in (recorded.block, together):
        np.testing.assert_array_equal(block.accel, other.accel)
        np.testing.assert_array_equal(block.counter, other.counter)
        np.testing.assert_array_equal(block.device_s, other.device_s)
        np.testing.assert_allclose(block.host_s, other.host_s, atol=1e-9)
    assert live.stats == recorded.stats
    assert live.stats.good == len(block) == 40


@pytest.mark.parametrize("seed", range(3))
def test_bluetooth_arrivals_become_even_times(seed):
    columns, true = sent(4000, clock0_s=77.0), on_time(4000)
    arrival = flushed(true, seed)
    recorded = whole(MPU, packets(columns), arrival)
    assert recorded.time_source == "device clock"
    assert np.sqrt(np.mean((recorded.block.t - true) ** 2)) < 2e-3
    live = feed_each(ImuStream(MPU), packets(columns), arrival, together=5)
    assert np.all(np.diff(live.t) > 0)
    assert np.sqrt(np.mean((live.t - true)[2000:] ** 2)) < 2e-3
    assert np.diff(live.t)[200:].std() < 1e-3


def test_live_times_depend_on_the_past_only():
    columns, arrival = sent(1000), flushed(on_time(1000))
    pieces = packets(columns)
    part = feed_each(ImuStream(MPU), pieces[:500], arrival[:500])
    both = feed_each(ImuStream(MPU), pieces, arrival)
    np.testing.assert_array_equal(part.t, both.t[:500])


def test_the_device_clock_wraps_unseen():
    columns = sent(400, clock0_s=2**32 / 1e6 - 2.0)
    block = whole(MPU, packets(columns), on_time(400)).block
    np.testing.assert_allclose(np.diff(block.device_s), 0.01, atol=2e-6)
    np.testing.assert_allclose(block.t, on_time(400), atol=1e-5)


def test_a_counter_tells_time_where_there_is_no_clock():
    layout = without(MPU, clock=True)
    rate = 97.0  # the layout says 100
    columns, true = sent(6000, rate_hz=rate), on_time(6000, rate_hz=rate)
    kept = np.delete(np.arange(6000), np.arange(3000, 3100))
    pieces, arrival = packets(pick(columns, kept), layout), flushed(true)[kept]
    recorded = whole(layout, pieces, arrival)
    assert recorded.time_source == "packet counter"
    assert recorded.block.device_s is None
    assert recorded.stats.lost == 100
    assert np.sqrt(np.mean((recorded.block.t - true[kept]) ** 2)) < 2e-3
    live = feed_each(ImuStream(layout), pieces, arrival, together=5)
    assert np.sqrt(np.mean((live.t - true[kept])[3000:] ** 2)) < 5e-3


def test_a_small_counter_without_a_clock_still_counts_seconds_of_loss():
    layout = without(MPU, clock=True)
    kept = np.delete(np.arange(3000), np.arange(1000, 1700))
    pieces, arrival = packets(pick(sent(3000), kept), layout), flushed(on_time(3000))[kept]
    stream = ImuStream(layout)
    block = feed_each(stream, pieces, arrival)
    assert stream.stats.lost == whole(layout, pieces, arrival).stats.lost == 700
    assert block.counter[-1] - block.counter[0] == 2999


@pytest.mark.parametrize("rate_hz", [40.0, 100.0, 250.0])
def test_arrivals_are_made_even_where_packets_carry_neither_clock_nor_counter(rate_hz):
    layout = without(MPU, clock=True, counter=True, rate_hz=None)
    number = round(40 * rate_hz)
    true = on_time(number, rate_hz=rate_hz)
    recorded = whole(layout, packets(sent(number), layout), flushed(true))
    assert recorded.time_source == "arrival"
    assert recorded.block.counter is None
    assert np.sqrt(np.mean((recorded.block.t - true) ** 2)) < 2e-3
    live = feed_each(ImuStream(layout), packets(sent(number), layout), flushed(true), together=10)
    assert np.all(np.diff(live.t) > 0)
    assert np.sqrt(np.mean((live.t - true)[number // 2 :] ** 2)) < 5e-3


def test_silence_does_not_shift_samples_that_nothing_counts():
    layout = without(MPU, clock=True, counter=True)
    kept = np.delete(np.arange(3000), np.arange(1000, 1300))
    true = on_time(3000)[kept]
    block = whole(layout, packets(pick(sent(3000), kept), layout), true).block
    np.testing.assert_allclose(block.t, true, atol=1e-3)


# --- losses and other accidents --------------------------------------------------------------


@settings(max_examples=12, deadline=None)
@given(
    gaps=st.lists(st.tuples(st.integers(5, 1900), st.integers(1, 900)), max_size=4),
    bursty=st.booleans(),
)
def test_losses_longer_than_the_counters_turn_are_counted_by_the_clock(gaps, bursty):
    lost = np.unique(np.concatenate([np.arange(a, min(a + n, 1999)) for a, n in gaps] or [[]]))
    kept = np.delete(np.arange(2000), lost.astype(int))
    true = on_time(2000)
    arrival = (flushed(true) if bursty else true)[kept]
    pieces = packets(pick(sent(2000), kept))
    stream = ImuStream(MPU)
    block = feed_each(stream, pieces, arrival, together=9)
    recorded = whole(MPU, pieces, arrival)
    assert stream.stats.lost == recorded.stats.lost == len(lost)
    assert stream.stats.restarts == stream.stats.strays == 0
    np.testing.assert_array_equal(block.counter - block.counter[0], kept - kept[0])


@settings(max_examples=15, deadline=None)
@given(
    moved=st.lists(st.tuples(st.integers(10, 105), st.integers(1, 8)), max_size=4),
    repeated=st.lists(st.integers(1, 118), max_size=4, unique=True),
)
def test_reordered_and_repeated_packets_are_each_counted_under_their_name(moved, repeated):
    order = list(range(120))
    for row, by in moved:
        order.insert(row + by, order.pop(row))
    late = sum(max(order[: i + 1]) > n for i, n in enumerate(order))
    for row in repeated:
        order.insert(order.index(row) + 1, row)
    pieces = packets(pick(sent(120), np.array(order)))
    arrival = ORIGIN_S + np.arange(len(order)) * 0.01
    recorded = whole(MPU, pieces, arrival)
    assert recorded.stats.duplicates == len(repeated)
    assert recorded.stats.reordered == late
    assert recorded.stats.lost == 0
    np.testing.assert_array_equal(recorded.block.counter, np.arange(120))
    assert np.all(np.diff(recorded.block.t) > 0)

    live = ImuStream(MPU)
    block = feed_each(live, pieces, arrival)
    assert live.stats.duplicates == len(repeated)
    assert np.all(np.diff(block.t) > 0)
    assert np.all(np.diff(block.counter) > 0)
    assert len(block) == 120 - live.stats.reordered == 120 - late


@pytest.mark.parametrize("silent_s", [0.0, 0.8, 30.0, 600.0])
def test_a_restart_begins_a_new_stretch_of_time(silent_s):
    before, after = sent(1200, clock0_s=50.0), sent(800)
    true = np.concatenate((on_time(1200), on_time(800) + 12.0 + silent_s))
    pieces = packets(before) + packets(after)
    stream = ImuStream(MPU)
    block = feed_each(stream, pieces, true, together=3)
    recorded = whole(MPU, pieces, true)
    for stats in (stream.stats, recorded.stats):
        assert stats.restarts == 1
        assert stats.lost == stats.strays == 0
    for got in (block, recorded.block):
        assert len(got) == 2000
        assert np.all(np.diff(got.t) > 0)
        np.testing.assert_allclose(got.t, true, atol=2e-3)
        np.testing.assert_array_equal(got.counter, np.arange(2000))
    assert len(recorded.fits) == 2


def test_a_stray_packet_is_left_out_and_ends_nothing():
    layout = replace(MPU, checksum=None)
    columns = sent(600)
    columns["time"][300] = 3_000_000_000
    pieces = packets(columns, layout)
    stream = ImuStream(layout)
    block = feed_each(stream, pieces, on_time(600))
    recorded = whole(layout, pieces, on_time(600))
    for stats in (stream.stats, recorded.stats):
        assert (stats.strays, stats.restarts, stats.lost) == (1, 0, 1)
    assert len(block) == len(recorded.block) == 599


def test_garbage_between_packets_is_counted_and_passed_over():
    rng = np.random.default_rng(1)
    pieces = packets(sent(300))
    pieces.insert(100, rng.bytes(700))
    arrival = np.insert(on_time(300), 100, on_time(300)[100])
    stream = ImuStream(MPU)
    block = feed_each(stream, pieces, arrival)
    assert len(block) >= 299
    assert stream.stats.skipped_bytes + 28 * stream.stats.good == 300 * 28 + 700
    assert stream.stats.lost == 300 - len(block)


@settings(max_examples=30, deadline=None)
@given(data=st.lists(st.binary(max_size=200), max_size=20), checked=st.booleans())
def test_no_bytes_whatsoever_upset_it(data, checked):
    layout = MPU if checked else replace(MPU, checksum=None, header=b"\xa5")
    stream = ImuStream(layout)
    blocks = [stream.feed(i * 10_000_000, piece) for i, piece in enumerate(data)]
    block = ImuBlock.concatenate(blocks)
    assert np.all(np.diff(block.t) > 0)
    pieces = [p for p in data if p]
    whole(layout, pieces, np.arange(len(pieces)) * 0.01)


def test_identical_samples_are_noticed():
    columns = sent(100)
    columns["accel"][60:] = columns["accel"][60]
    columns["gyro"][60:] = columns["gyro"][60]
    stream = ImuStream(MPU)
    feed_each(stream, packets(columns), on_time(100))
    assert stream.identical == 40
    feed_each(stream, packets(sent(1, first=100, seed=3)), [ORIGIN_S + 1])
    assert stream.identical == 1


def test_an_empty_recording_is_an_empty_block():
    assert len(assembled(MPU, b"", np.empty(0, np.int64), np.empty(0)).block) == 0


def test_pieces_must_cover_the_data():
    with pytest.raises(InputError, match="end at byte 3, its data at byte 5"):
        assembled(MPU, b"12345", np.array([3]), np.array([0.0]))


def test_a_clock_that_cannot_be_right_is_said_and_one_that_can_is_not():
    pieces = packets(sent(2000))
    for pace, word in ((1.05, r"\+5 %"), (0.95, "-5 %"), (1.005, None)):
        problem = whole(MPU, pieces, ORIGIN_S + pace * np.arange(2000) / 100.0).time_problem
        assert problem is None if word is None else re.search(word, problem)


def test_a_hostile_scale_gives_infinities_without_a_warning():  # warnings are errors here
    accel = Field("accel", "i16", count=3, unit="g", counts_per_unit=1e-304)
    hostile = PacketLayout(name="x", title="", header=b"\x7e", fields=(accel,), byte_order="little")
    rows = np.zeros(1, hostile.dtype)
    rows["accel"] = 32767
    found = si_values(hostile, rows, si_factors(hostile))["accel"]
    assert np.isinf(found).all()
    assert np.array_equal(field_values(hostile, rows)[0]["accel"], found)
