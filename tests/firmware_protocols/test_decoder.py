"""The stream decoder against a plain model of its rule, damage of every kind, and any chunking."""

import math
import tracemalloc
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from firmware_protocols.checksums import checksum
from firmware_protocols.decoder import PIECE_BYTES, DecodeStats, StreamDecoder
from firmware_protocols.framing import find_many, find_short
from firmware_protocols.layout import Checksum, Field, PacketLayout, load_layout
from firmware_protocols.packets import encode

MPU = load_layout("mpu9150-28")
BARE = replace(MPU, name="bare", checksum=None, fields=(*MPU.fields, Field("rest", "u16")))


def tiny(name, header, checksum=None, **more):
    return PacketLayout(
        name=name,
        title="",
        byte_order="big",
        header=header,
        fields=(Field("n", "u8"),),
        checksum=checksum,
        **more,
    )


# With so few different bytes in the streams below, headers and checksums come about by chance.
TINY = {
    "one-byte header, sum": tiny("a", b"\x01", Checksum("sum8")),
    "two-byte header, xor": tiny("b", b"\x01\x00", Checksum("xor8", start=1), counter="n"),
    "one-byte header": tiny("c", b"\x01", counter="n"),
    "one-byte header, longer": replace(tiny("d", b"\x01"), fields=(Field("n", "u8", count=4),)),
    "two-byte header": tiny("e", b"\x01\x01"),
    "three-byte header": tiny("f", b"\x00\x01\x00"),
}
TINY_STREAMS = st.binary(max_size=60).map(lambda data: bytes(b % 3 for b in data))


def expected(layout, stream):
    """Packets, corrupt headers, skipped bytes and decided bytes, by the rule as it is written."""
    packets, corrupt, skipped = [], 0, 0
    position, packet_end = 0, None
    while len(stream) - position >= layout.length:
        packet = stream[position : position + layout.length]
        after = stream[position + layout.length :][: len(layout.header)]
        good = False
        if packet.startswith(layout.header):
            if layout.checksum:
                size = layout.checksum.size
                sum_of = checksum(layout.checksum.kind, packet[layout.checksum.start : -size])
                good = sum_of.to_bytes(size, layout.checksum_order) == packet[-size:]
            elif position == packet_end:
                good = True
            elif len(after) < len(layout.header):
                break
            else:
                good = after == layout.header
            corrupt += not good
        if good:
            packets.append((position + layout.length, packet))
            position = packet_end = position + layout.length
        else:
            position += 1
            skipped += 1
    return packets, corrupt, skipped, position


def decode(layout, stream, cuts=()):
    """Feed the stream cut at the given places."""
    decoder = StreamDecoder(layout)
    edges = [0, *sorted(cuts), len(stream)]
    packets = []
    for start, stop in pairwise(edges):
        fed = decoder.feed(stream[start:stop])
        assert fed.rows.dtype == layout.dtype
        assert decoder.pending < layout.length + len(layout.header)
        packets += zip(fed.end.tolist(), (row.tobytes() for row in fed.rows), strict=True)
    return packets, decoder


def mpu_packets(number, *, first=0, seed=0):
    rng = np.random.default_rng(seed)
    index = first + np.arange(number)
    return encode(
        MPU,
        {
            "seq": index % 256,
            "status": 0,
            "time": index * 10_000 % 2**32,
            "accel": rng.integers(-32768, 32768, (number, 3)),
            "gyro": rng.integers(-32768, 32768, (number, 3)),
            "mag": rng.integers(-4096, 4096, (number, 3)),
        },
    )


def split(stream):
    return [stream[at : at + 28] for at in range(0, len(stream), 28)]


@pytest.mark.parametrize("name", TINY)
@settings(max_examples=70)
@given(stream=TINY_STREAMS, cuts=st.lists(st.integers(0, 60), max_size=8))
def test_decoder_follows_the_rule_in_any_chunking(name, stream, cuts):
    layout = TINY[name]
    packets, corrupt, skipped, decided = expected(layout, stream)
    cuts = [c for c in cuts if c <= len(stream)]
    for places in ((), cuts, range(1, len(stream)), [len(stream) // 2]):
        got, decoder = decode(layout, stream, places)
        assert got == packets
        assert decoder.stats.good == len(packets)
        assert decoder.stats.corrupt == corrupt
        assert decoder.stats.skipped_bytes == skipped
        assert decoder.pending == len(stream) - decided
    assert decode(layout, stream, cuts)[1].stats == decode(layout, stream)[1].stats


@pytest.mark.parametrize("name", TINY)
@settings(max_examples=100)
@given(stream=TINY_STREAMS, in_sync=st.booleans())
@example(stream=b"\x01\x00\x01\x01\x00\x01\x00", in_sync=True)
def test_array_form_and_plain_form_find_the_same(name, stream, in_sync):
    layout = TINY[name]
    short = find_short(layout, stream, in_sync=in_sync)
    many = find_many(layout, np.frombuffer(stream, np.uint8), in_sync=in_sync)
    assert many.starts.tolist() == short.starts.tolist()
    assert (many.decided, many.corrupt) == (short.decided, short.corrupt)


@st.composite
def damaged_streams(draw):
    """A seeded run of packets with garbage, cuts, repeats, swaps and flipped bits between them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    packets = split(mpu_packets(70, seed=int(rng.integers(2**32))))
    pieces = []
    for packet in packets:
        what = rng.choice(
            ["packet", "packet", "packet", "garbage", "header", "cut", "twice", "late", "flip"]
        )
        if what == "garbage":
            pieces.append(rng.bytes(int(rng.integers(1, 90))))
        elif what == "header":
            pieces.append(b"\xa5\x5a" * int(rng.integers(1, 4)) + b"\xa5")
        elif what == "cut":
            packet = packet[: int(rng.integers(28))]
        elif what == "twice":
            pieces.append(packet)
        elif what == "late" and pieces:
            pieces.insert(-1, packet)
            continue
        elif what == "flip":
            packet = flip(packet, int(rng.integers(28 * 8)))
        pieces.append(packet)
    return b"".join(pieces)


def flip(data, *bits):
    flipped = bytearray(data)
    for bit in bits:
        flipped[bit // 8] ^= 1 << bit % 8
    return bytes(flipped)


@pytest.mark.parametrize("layout", [MPU, BARE], ids=["checksum", "no checksum"])
@settings(max_examples=8)
@given(stream=damaged_streams(), cuts=st.lists(st.integers(0, 2000), max_size=12))
def test_whole_halves_bytes_and_random_cuts_agree(layout, stream, cuts):
    packets, corrupt, skipped, decided = expected(layout, stream)
    whole, decoder = decode(layout, stream)
    assert whole == packets
    stats = decoder.stats
    assert (stats.corrupt, stats.skipped_bytes) == (corrupt, skipped)
    cuts = [c for c in cuts if c <= len(stream)]
    for places in (cuts, [len(stream) // 2], range(1, len(stream))):
        again, decoder = decode(layout, stream, places)
        assert again == whole
        assert decoder.stats == stats
        assert decoder.pending == len(stream) - decided


def test_a_long_stream_in_one_piece_and_in_many():
    """More than one internal piece, with a packet torn at every place."""
    packets = split(mpu_packets(40_000))
    for at in range(0, 40_000, 700):
        packets[at] = packets[at][: at // 700 % 28]
    stream = b"".join(packets)
    whole, decoder = decode(MPU, stream)
    assert [p for _, p in whole] == [p for p in packets if len(p) == 28]
    for size in (4096, 65_536, 1 << 20):
        again, other = decode(MPU, stream, range(size, len(stream), size))
        assert again == whole
        assert other.stats == decoder.stats
    assert len(stream) > PIECE_BYTES
    assert decoder.stats.lost == len(range(700, 40_000, 700))
    assert decoder.stats.skipped_bytes + decoder.pending == len(stream) - 28 * len(whole)


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_what_is_fed_may_change_afterwards(kind):
    stream = mpu_packets(100)
    fed = bytearray(stream)
    packets = StreamDecoder(MPU).feed(kind(fed))
    fed[:] = bytes(len(fed))
    assert packets.rows.tobytes() == stream
    assert packets.rows.flags.writeable


def test_nothing_fed_is_nothing_decoded():
    decoder = StreamDecoder(MPU)
    packets = decoder.feed(b"")
    assert len(packets) == 0
    assert packets.rows.dtype == MPU.dtype
    assert packets.end.dtype == np.int64
    assert decoder.stats == DecodeStats()


def false_packet_bound(candidates, bits=16):
    """Return how many packets chance may make of so many tries: mean and six sigma of a Poisson."""
    mean = candidates / 2**bits
    return mean + 6 * math.sqrt(mean) + 6


def test_ten_megabytes_of_noise():
    rng = np.random.default_rng(3)
    decoder = StreamDecoder(MPU)
    noise = rng.bytes(10_000_000)
    decoder.feed(noise)
    stats = decoder.stats
    candidates = stats.corrupt + stats.good
    assert candidates == noise[: len(noise) - decoder.pending].count(b"\xa5\x5a")
    assert stats.good <= 1  # 153 headers by chance, each a packet with odds of 1 in 65536
    assert stats.skipped_bytes + decoder.pending == len(noise)


def test_megabytes_of_headers_and_noise():
    """Every second place a header: as many tries for chance as there can be."""
    rng = np.random.default_rng(4)
    words = np.where(rng.random(1_500_000) < 0.5, 0x5AA5, rng.integers(0, 65536, 1_500_000))
    stream = words.astype("<u2").tobytes()
    decoder = StreamDecoder(MPU)
    for start in range(0, len(stream), 1 << 20):
        decoder.feed(stream[start : start + (1 << 20)])
    stats = decoder.stats
    assert stats.corrupt > 600_000
    assert stats.good <= false_packet_bound(stats.corrupt)
    assert stats.skipped_bytes + 28 * stats.good + decoder.pending == len(stream)


def test_mutated_packets():
    """Flips, bursts, dropped, added and repeated bytes: nothing comes out that was not sent."""
    rng = np.random.default_rng(5)
    packets = split(mpu_packets(60_000, seed=5))
    sent = set(packets)
    for at in rng.choice(len(packets), 10_000, replace=False).tolist():
        packet, place = packets[at], int(rng.integers(28))
        match int(rng.integers(5)):
            case 0:
                packet = flip(packet, *rng.integers(0, 224, int(rng.integers(1, 9))).tolist())
            case 1:
                burst = rng.bytes(int(rng.integers(1, 28)))
                packet = packet[:place] + burst[: 28 - place] + packet[place + len(burst) :]
            case 2:
                packet = packet[:place] + packet[place + int(rng.integers(1, 6)) :]
            case 3:
                packet = packet[:place] + rng.bytes(int(rng.integers(1, 40))) + packet[place:]
            case 4:
                packet = packet[:place] + packet
        packets[at] = packet
    whole = sum(packet in sent for packet in packets)
    stream = b"".join(packets)
    decoder = StreamDecoder(MPU)
    rows = np.concatenate(
        [decoder.feed(stream[at : at + 65_536]).rows for at in range(0, len(stream), 65_536)]
    )
    false = [row for row in split(rows.tobytes()) if row not in sent]
    assert len(false) <= false_packet_bound(decoder.stats.corrupt)
    # A false packet can hide at most the two true ones that it overlaps.
    assert len(rows) - len(false) >= whole - 2 * len(false)


@settings(max_examples=40)
@given(st.integers(1, 4096), st.integers(0, 2**32), st.booleans())
def test_the_packet_after_garbage_is_decoded(length, seed, with_headers):
    rng = np.random.default_rng(seed)
    garbage = rng.bytes(length)
    if with_headers:
        garbage = bytes(b"\xa5\x5a\x00\xff"[byte % 4] for byte in garbage)
    before, after = mpu_packets(2, seed=1), mpu_packets(3, first=2, seed=2)
    by_chance, *_ = expected(MPU, garbage + after[:27])
    assume(not by_chance)  # of 65536 headers in garbage one begins what looks like a packet
    packets, decoder = decode(MPU, before + garbage + after)
    assert [p for _, p in packets] == split(before + after)
    assert packets[2][0] == len(before) + length + 28
    assert decoder.stats.skipped_bytes == length
    assert decoder.stats.lost == 0


def test_one_flipped_bit_costs_one_packet():
    """Every bit of a packet flipped in turn: all the others come through, one is lost."""
    packets = split(mpu_packets(5))
    for bit in range(28 * 8):
        damaged = [*packets[:2], flip(packets[2], bit), *packets[3:]]
        got, decoder = decode(MPU, b"".join(damaged))
        assert [p for _, p in got] == packets[:2] + packets[3:]
        assert decoder.stats.lost == 1
        assert decoder.stats.skipped_bytes == 28


def test_resynchronization_takes_less_than_two_packets():
    """Started anywhere in a stream, the decoder has a packet before two packets' bytes are in."""
    stream = mpu_packets(6)
    for start in range(56):
        for length in range(1, 84):
            packets, _ = decode(MPU, stream[start : start + length])
            if packets:
                break
        assert length < 2 * 28


def test_headers_inside_packets_do_no_harm():
    number = 50
    columns = {
        "seq": np.arange(number),
        "status": 0xA5,
        "time": 0xA55AA55A,
        "accel": np.full((number, 3), 0x5AA5),
        "gyro": np.full((number, 3), -0x5AA6),
        "mag": np.full((number, 3), 0x5AA5),
    }
    stream = encode(MPU, columns)
    for start in range(28):
        packets, decoder = decode(MPU, stream[start:], [7, 500])
        assert [p for _, p in packets] == split(stream)[start > 0 :]
        assert decoder.stats.skipped_bytes == -start % 28


def test_without_checksum_the_last_packet_needs_no_successor():
    stream = mpu_packets(4)
    packets, decoder = decode(BARE, stream)
    assert [p for _, p in packets] == split(stream)
    assert decoder.pending == 0


def test_without_checksum_a_lone_packet_waits_for_the_next_header():
    stream = mpu_packets(2)
    decoder = StreamDecoder(BARE)
    assert len(decoder.feed(stream[:29])) == 0
    assert decoder.pending == 29
    assert len(decoder.feed(stream[29:30])) == 1
    assert len(decoder.feed(stream[30:])) == 1


@pytest.mark.parametrize("begun", [0, 1])
def test_a_whole_packet_stays_at_a_cut_whatever_has_come_of_the_next_header(begun):
    stream = mpu_packets(3)
    decoder = StreamDecoder(BARE)
    decoder.feed(stream[: 28 + begun])
    decoder.cut()
    assert decoder.pending == 28
    packets = decoder.feed(stream[28:])
    assert packets.rows.tobytes() == stream
    assert packets.end.tolist() == [28 + begun, 56 + begun, 84 + begun]
    assert decoder.stats == DecodeStats(good=3, skipped_bytes=begun)


def test_a_packet_that_something_else_follows_does_not_outlive_a_cut():
    decoder = StreamDecoder(BARE)
    decoder.feed(mpu_packets(1) + b"\x00")
    decoder.cut()
    assert decoder.pending == 0
    assert decoder.stats.skipped_bytes == 29


def test_without_checksum_garbage_costs_no_intact_packet():
    before, after = mpu_packets(3), mpu_packets(3, first=3)
    packets, decoder = decode(BARE, before + b"\x01\xa5\x5agarbage" + after)
    assert [p for _, p in packets] == split(before + after)
    assert decoder.stats.corrupt == 1
    assert decoder.stats.skipped_bytes == 10


@pytest.mark.parametrize("chunk", [100, 65_536, 8_000_000])
def test_memory_stays_bounded(chunk):
    """Beside what it returns, and holds once more to join pieces, the decoder needs little."""
    stream = mpu_packets(4000)
    stream = (stream + b"noise" * 3) * (1 if chunk < 1000 else 80)
    StreamDecoder(MPU).feed(stream[:100_000])  # the tables of the checksum stay
    decoder = StreamDecoder(MPU)
    tracemalloc.start()
    try:
        held = worst = 0
        for start in range(0, len(stream), chunk):
            tracemalloc.reset_peak()
            piece = stream[start : start + chunk]
            packets = decoder.feed(piece)
            returned = packets.rows.nbytes + packets.end.nbytes
            copies = 2 if chunk > PIECE_BYTES else 1
            peak = tracemalloc.get_traced_memory()[1]
            worst = max(worst, peak - copies * returned - len(piece))
            del packets, piece
        held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert worst < (1_000_000 if chunk <= 65_536 else 8_000_000)
    assert held < 50_000


def test_endless_noise_leaves_nothing_behind():
    decoder = StreamDecoder(MPU)
    tracemalloc.start()
    try:
        for seed in range(150):
            decoder.feed(b"\xa5\x5a" * 20 + np.random.default_rng(seed).bytes(4000))
            assert decoder.pending < 28
        held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert held < 50_000


def test_statistics_add_up():
    one = DecodeStats(1, 2, 3, 4, 5, 6)
    assert one + one == DecodeStats(2, 4, 6, 8, 10, 12)
