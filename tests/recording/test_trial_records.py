"""The record stream itself: what is written is found, and nothing else."""

import io
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_record import encode_record

from imu_rig.recording.format import (
    HEADER_SIZE,
    MAX_PAYLOAD,
    SYNC,
    FileHeader,
)
from imu_rig.recording.scan import Damage, scan_records

HEADER = FileHeader(b"file id.", 1_700_000_000_000_000_000)
OTHER = FileHeader(b"other id", 1_700_000_000_000_000_000)
WINDOW = 1500  # so that small examples cross its edges

foreign_payloads = st.one_of(
    st.binary(max_size=120),
    st.binary(max_size=40).map(lambda part: SYNC + part + SYNC),
    st.integers(0, 400).map(bytes),
    st.binary(max_size=40).map(lambda part: encode_record(OTHER.seed, 3, 1, 5, 0, part)),
)
own_records = st.binary(max_size=40).map(lambda part: encode_record(HEADER.seed, 3, 1, 5, 0, part))
heads = st.tuples(st.integers(0, 255), st.integers(0, 255), st.integers(-(2**63), 2**63 - 1))
drafts = st.lists(st.tuples(heads, foreign_payloads), max_size=60)
nested_drafts = st.lists(st.tuples(heads, foreign_payloads | own_records), max_size=60)


def encode(records, header=HEADER):
    return [
        encode_record(header.seed, kind, source, sequence, time_ns, payload)
        for sequence, ((kind, source, time_ns), payload) in enumerate(records)
    ]


def scan(content, **options):
    return scan_records(io.BytesIO(HEADER.encode() + content), HEADER, **options)


def payloads_of(found, content):
    file = HEADER.encode() + content
    return [
        file[offset : offset + length]
        for offset, length in zip(found.offset.tolist(), found.length.tolist(), strict=True)
    ]


@given(nested_drafts)
def test_records_come_back_as_they_were_written(records):
    content = b"".join(encode(records))
    found, damage = scan(content, window_bytes=WINDOW)
    assert damage == Damage()
    assert found.sequence.tolist() == list(range(len(records)))
    assert [
        ((kind, source, time_ns), payload)
        for kind, source, time_ns, payload in zip(
            found.kind.tolist(),
            found.source.tolist(),
            found.time_ns.tolist(),
            payloads_of(found, content),
            strict=True,
        )
    ] == records


@given(drafts, st.data())
def test_garbage_between_records_costs_none_of_them(records, data):
    garbage = data.draw(st.lists(foreign_payloads, max_size=len(records) + 1))
    parts = encode(records)
    content = b"".join(
        (garbage[i] if i < len(garbage) else b"") + (parts[i] if i < len(parts) else b"")
        for i in range(len(parts) + 1)
    )
    found, damage = scan(content, window_bytes=WINDOW)
    assert payloads_of(found, content) == [payload for _, payload in records]
    assert damage.records_lost == damage.records_repeated == damage.records_reordered == 0
    assert damage.bytes_skipped + damage.tail_bytes == sum(map(len, garbage))


@settings(max_examples=200)
@given(drafts, st.lists(st.tuples(st.integers(0, 10**6), st.binary(min_size=1, max_size=50))))
def test_overwritten_bytes_never_alter_a_record(records, overwritten):
    content = bytearray(b"".join(encode(records)))
    for place, garbage in overwritten:
        place %= len(content) + 1
        content[place : place + len(garbage)] = garbage
    found, damage = scan(bytes(content), window_bytes=WINDOW)
    sequences = found.sequence.tolist()
    assert sequences == sorted(set(sequences))
    for row, payload in enumerate(payloads_of(found, bytes(content))):
        (_, source, time_ns), expected = records[sequences[row]]
        assert payload == expected
        assert (found.source[row], found.time_ns[row]) == (source, time_ns)
    total = sum(map(len, payloads_of(found, bytes(content)))) + 28 * len(found)
    assert total + damage.bytes_skipped + damage.tail_bytes == len(content)


def test_lost_records_are_counted_by_their_numbers():
    parts = encode([((3, 1, 0), bytes([n])) for n in range(100)])
    kept = [part for n, part in enumerate(parts) if n not in (0, 7, 8, 50)]
    found, damage = scan(b"".join(kept))
    assert len(found) == 96
    assert damage == Damage(records_lost=4)


def test_repeated_and_reordered_records_are_put_right():
    parts = encode([((3, 1, n), bytes([n])) for n in range(10)])
    shuffled = [parts[n] for n in (0, 1, 2, 6, 7, 3, 4, 5, 4, 8, 9)]
    content = b"".join(shuffled)
    found, damage = scan(content)
    assert payloads_of(found, content) == [bytes([n]) for n in range(10)]
    assert damage.records_repeated == 1
    assert damage.records_reordered > 0
    assert damage.records_lost == 0


def test_a_record_inside_a_payload_is_payload():
    parts = encode([((3, 1, 0), b"one"), ((3, 1, 0), b"two")])
    outer = encode_record(HEADER.seed, 3, 1, 0, 0, parts[1] + parts[0] + parts[1])
    content = outer + parts[1]
    found, damage = scan(content)
    assert payloads_of(found, content) == [parts[1] + parts[0] + parts[1], b"two"]
    assert damage == Damage()


def test_head_and_payload_of_different_records_do_not_match():
    first = encode_record(HEADER.seed, 3, 1, 0, 0, b"first payload")
    second = encode_record(HEADER.seed, 3, 1, 1, 0, b"other payload")
    found, damage = scan(first[:24] + second[24:])
    assert len(found) == 0
    assert damage == Damage(tail_bytes=len(first))


def test_largest_records_cross_the_edges_of_what_is_read_at_a_time():
    drafted = [((3, 1, n), bytes([n]) * size) for n, size in enumerate((MAX_PAYLOAD, 10) * 5)]
    content = b"".join(encode(drafted))
    found, damage = scan(content)
    assert found.length.tolist() == [MAX_PAYLOAD, 10] * 5
    assert damage == Damage()


def test_checksums_are_those_of_zlib_for_every_length():
    """The vectorized checksum takes other paths by length; many of one length take them all."""
    rng = np.random.default_rng(4)
    for length in (0, 1, 3, 4, 5, 31, 32, 33, 64, 65, 96, 97, 300):
        drafted = [((3, 1, n), rng.bytes(length)) for n in range(300)]
        content = bytearray(b"".join(encode(drafted)))
        assert len(scan(bytes(content))[0]) == 300
        if length:
            content[200 * (length + 28) + 24 + length // 2] ^= 4
            found, damage = scan(bytes(content))
            assert (len(found), damage.records_lost) == (299, 1)


def test_layout_of_a_record_is_as_documented():
    record = encode_record(HEADER.seed, 3, 7, 0x01020304, -2, b"payload")
    fields = b"\x03\x07" + b"\x07\0\0\0" + b"\x04\x03\x02\x01" + b"\xfe" + 7 * b"\xff"
    head_crc = zlib.crc32(HEADER.file_id + fields)
    crc = zlib.crc32(HEADER.file_id + fields + b"payload")
    assert record == (
        b"\xd3\x91"
        + fields
        + head_crc.to_bytes(4, "little")
        + b"payload"
        + crc.to_bytes(4, "little")
    )
    assert len(HEADER.encode()) == HEADER_SIZE


def test_heads_within_heads_do_not_take_for_ever():
    """Every head claims a megabyte of the others; checking each in full would take hours."""
    heads_only = [
        encode_record(HEADER.seed, 3, 1, n, 0, bytes(MAX_PAYLOAD))[:24] for n in range(200)
    ] * 1000
    found, damage = scan(b"".join(heads_only))
    assert len(found) == 0
    assert damage.tail_bytes == 24 * 200_000


def test_memory_for_reading_does_not_grow_with_the_payloads():
    record = encode_record(HEADER.seed, 3, 1, 0, 0, bytes(1000))
    content = HEADER.encode() + record * 50_000
    file = io.BytesIO(content)
    tracemalloc.start()
    try:
        found, _ = scan_records(file, HEADER)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(found) == 1  # one sequence number: all others are repetitions
    assert peak < len(content) // 3


@pytest.mark.parametrize("content", [b"", b"\0" * 5000, SYNC * 3000, b"\xff" * 100])
def test_no_records_in_what_holds_none(content):
    found, damage = scan(content)
    assert len(found) == 0
    assert damage == Damage(tail_bytes=len(content))
