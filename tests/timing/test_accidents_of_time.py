"""Wraps, restarts, repetitions, reordering and a computer that sleeps: each under its own name."""

import ast
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_stream import PacketStream

import imu_rig.timing
from firmware_protocols.layout import Checksum, Field, PacketLayout
from firmware_protocols.packets import encode
from imu_rig.packet_stream import PacketBlock, StreamStats, assemble_packets
from imu_rig.timing import device_time
from imu_rig.timing.counters import wrapped_steps

ORIGIN_S = 1000.0
RATE_HZ = 100.0


def layout(counter_bits=16, *, clock=True):
    """Packets with a counter and, if wanted, a clock of microseconds in 32 bits."""
    times = (Field("time", "u32"),) if clock else ()
    return PacketLayout(
        name="clocked",
        title="",
        byte_order="little",
        header=b"\xa5\x5a",
        fields=(Field("seq", f"u{counter_bits}"), *times, Field("number", "u32")),
        checksum=Checksum("sum8"),
        counter="seq",
        clock="time" if clock else None,
        clock_tick_s=1e-6,
        rate_hz=RATE_HZ,
    )


def packets(plan, number, device_s=None, *, first=0):
    """Bytes of packets, given which packet each is and its device's clock [s]."""
    number = np.asarray(number)
    device_s = number / RATE_HZ if device_s is None else device_s
    fields = {"number": number, "seq": (first + number) % (1 << plan.field("seq").bits)}
    if plan.clock is not None:
        fields["time"] = np.round(device_s * 1e6).astype(np.int64) % 2**32
    data = encode(plan, fields)
    return [data[i : i + plan.length] for i in range(0, len(data), plan.length)]


def timed(plan, pieces, host_s, together=20):
    """Time the same pieces live and recorded."""
    stream = PacketStream(plan)
    chunks = [(round(t * 1e9), piece) for t, piece in zip(host_s, pieces, strict=True)]
    blocks = [stream.feed_many(chunks[i : i + together]) for i in range(0, len(chunks), together)]
    stops = np.cumsum([len(piece) for piece in pieces])
    whole = assemble_packets(plan, b"".join(pieces), stops, np.asarray(host_s))[""]
    return stream.stats, PacketBlock.concatenate(plan, blocks), whole


def flushed(true_s, seed=0):
    rng = np.random.default_rng(seed)
    flushes = true_s[0] + np.cumsum(rng.uniform(0.02, 0.1, int(60 * np.ptp(true_s)) + 60))
    return flushes[np.searchsorted(flushes, true_s)]


@pytest.mark.parametrize("clock", [True, False])
@pytest.mark.parametrize("asleep_s", [1.5, 10.0, 45.0, 1800.0])
def test_a_computer_that_slept_ends_a_stretch_and_no_clock_is_blamed(asleep_s, clock):
    """The monotonic clock stood still, the device went on, what it sent meanwhile is lost."""
    plan = layout(clock=clock)
    number = np.concatenate((np.arange(3000), 3000 + round(asleep_s * RATE_HZ) + np.arange(3000)))
    true = ORIGIN_S + np.concatenate((np.arange(3000), 3000 + np.arange(3000))) / RATE_HZ
    stats, block, whole = timed(plan, packets(plan, number), flushed(true))
    for told in (stats, whole.stats):
        assert (told.leaps, told.restarts, told.strays) == (1, 0, 0)
    assert len(whole.fits) == 2
    assert all(fit.impossible_skew is None and abs(fit.skew) < 1e-3 for fit in whole.fits)
    assert np.sqrt(np.mean((whole.block.t - true) ** 2)) < 2e-3
    for got in (block, whole.block):
        assert len(got) == 6000
        assert np.all(np.diff(got.t) > 0)


@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    out_s=st.floats(0.5, 20.0),
    kept_s=st.floats(0.0, 4.0),
    clock=st.booleans(),
)
def test_a_link_that_overflows_in_a_drop_out_is_no_leap(seed, out_s, kept_s, clock):
    """What the device could keep arrives late, the rest is lost, then all is prompt again."""
    plan = layout(clock=clock)
    true = ORIGIN_S + np.arange(5000) / RATE_HZ
    host = flushed(true, seed)
    out = slice(*np.searchsorted(host, (ORIGIN_S + 20.0, ORIGIN_S + 20.0 + out_s)))
    host[out] = ORIGIN_S + 20.0 + out_s
    late = np.arange(5000)[out]
    kept = np.delete(np.arange(5000), late[round(kept_s * RATE_HZ) :])
    stats, block, whole = timed(plan, packets(plan, kept), host[kept])
    for told in (stats, whole.stats):
        assert (told.leaps, told.restarts, told.strays) == (0, 0, 0)
        assert told.lost == 5000 - len(kept)
    assert np.sqrt(np.mean((whole.block.t - true[kept]) ** 2)) < 2e-3
    np.testing.assert_array_equal(block.rows["number"], kept)


@pytest.mark.parametrize("clock", [True, False])
def test_a_device_that_restarts_is_counted_as_that(clock):
    plan = layout(clock=clock)
    before, after = np.arange(4000) / RATE_HZ, 43.0 + np.arange(3000) / RATE_HZ
    pieces = packets(plan, np.arange(4000), 300.0 + before, first=30_000)
    pieces += packets(plan, np.arange(3000))
    true = ORIGIN_S + np.concatenate((before, after))
    stats, block, whole = timed(plan, pieces, flushed(true))
    for told in (stats, whole.stats):
        assert (told.restarts, told.leaps, told.strays) == (1, 0, 0)
    assert np.sqrt(np.mean((whole.block.t - true) ** 2)) < 2e-3
    for got in (block, whole.block):
        assert len(got) == 7000
        assert np.all(np.diff(got.t) > 0)


@settings(max_examples=15, deadline=None)
@given(
    bits=st.sampled_from([16, 32]),
    clock=st.booleans(),
    moved=st.lists(st.tuples(st.integers(20, 260), st.integers(1, 8)), max_size=4),
    repeated=st.lists(st.integers(1, 298), max_size=4, unique=True),
    missing=st.sets(st.integers(5, 290), max_size=5),
)
def test_wraps_hide_nothing_and_everything_is_counted_under_its_name(
    bits, clock, moved, repeated, missing
):
    """Counter and clock both wrap in the midst of it."""
    plan = layout(bits, clock=clock)
    order = [n for n in range(300) if n not in missing]
    for row, by in moved:
        order.insert(row + by, order.pop(row))
    late = sum(max(order[: i + 1]) > n for i, n in enumerate(order))
    again = [n for n in repeated if n in order]
    for n in again:
        order.insert(order.index(n) + 1, n)
    number = np.array(order)
    device_s = 2**32 * 1e-6 - 1.5 + number / RATE_HZ
    pieces = packets(plan, number, device_s, first=2**bits - 140)
    host = ORIGIN_S + np.arange(len(number)) / RATE_HZ
    stats, block, whole = timed(plan, pieces, host, together=1)
    told = whole.stats
    assert told == StreamStats(
        good=len(number),
        lost=max(order) - min(order) + 1 - len(set(order)),
        duplicates=len(again),
        reordered=late,
    )
    np.testing.assert_array_equal(whole.block.rows["number"], np.unique(number))
    np.testing.assert_array_equal(np.diff(whole.block.counter), np.diff(np.unique(number)))
    assert stats.duplicates == len(again)
    assert (stats.restarts, stats.strays, stats.leaps) == (0, 0, 0)
    for got in (block, whole.block):
        assert np.all(np.diff(got.t) > 0)
        assert np.all(np.diff(got.counter) > 0)


@pytest.mark.parametrize("off", [-0.03, 0.03])
def test_a_counter_whose_real_rate_is_off_by_3_percent_still_tells_time(off):
    plan = layout(clock=False)
    true = ORIGIN_S + np.arange(6000) / (RATE_HZ * (1 + off))
    stats, block, whole = timed(plan, packets(plan, np.arange(6000)), flushed(true))
    assert (stats.leaps, stats.restarts, stats.lost) == (0, 0, 0)
    assert whole.fits[0].skew == pytest.approx(1 / (1 + off) - 1, abs=1e-4)
    assert np.sqrt(np.mean((whole.block.t - true) ** 2)) < 2e-3
    assert np.sqrt(np.mean((block.t - true)[3000:] ** 2)) < 2e-3


@pytest.mark.parametrize("clock", [True, False])
def test_packets_in_an_impossible_order_are_judged_without_an_array_each(clock, monkeypatch):
    """A device gone mad sends quarter of a million a second; they must not hold up the others."""
    made = 0

    def counting(*arguments):
        nonlocal made
        made += 1
        return wrapped_steps(*arguments)

    monkeypatch.setattr(device_time, "wrapped_steps", counting)
    plan = layout(32, clock=clock)
    number = np.random.default_rng(5).permutation(20_000)
    host = ORIGIN_S + np.arange(20_000) / 250_000
    stops = plan.length * np.arange(1, 20_001)
    whole = assemble_packets(plan, b"".join(packets(plan, number)), stops, host)[""]
    assert whole.stats.good == 20_000
    assert whole.stats.strays > 15_000
    assert made < 2_000


def test_nothing_that_makes_times_knows_the_wall_clock():
    """Stepping it can then change nothing: all times come with the bytes."""
    room = Path(imu_rig.timing.__file__).parent
    for path in (*room.glob("*.py"), room.parent / "packet_stream.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {n.split(".")[0] for n in names} & {"time", "datetime", "os"}, path
