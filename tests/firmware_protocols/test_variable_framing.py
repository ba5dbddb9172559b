"""Frames of variable length, against the rule as it is written, and in any chunking."""

import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from firmware_protocols import undecided
from firmware_protocols.decoder import Packets
from firmware_protocols.variable_framing import (
    FrameDecoder,
    find_frames,
    find_many,
    find_short,
)


class Tiny:
    """01 LEN DATA SUM, LEN up to 4, or 02 02 LEN DATA SUM; the sum is that of the data, mod 3.

    In streams of the bytes 0 to 2 everything comes about by chance, also inside frames.
    """

    longest = 8
    head = 3
    header = re.compile(rb"\x01|\x02(?:\x02|\Z)")

    def length(self, data, at):
        place = at + 1 if data[at] == 1 else at + 2
        if place >= len(data):
            return None
        return place - at + 2 + data[place] if data[place] <= 4 else 0

    def is_good(self, frame):
        first = 2 if frame[0] == 1 else 3
        return sum(frame[first:-1]) % 3 == frame[-1]

    def candidates(self, data):
        count = max(0, len(data) - 2)
        first, second = data[:count], data[1 : count + 1]
        return np.flatnonzero((first == 1) | ((first == 2) & (second == 2)))

    def lengths(self, data, at):
        return np.array([self.length(data.tobytes(), place) for place in at.tolist()], np.int64)

    def good(self, rows):
        return np.array([self.is_good(row.tobytes()) for row in rows], dtype=bool)


TINY = Tiny()
TINY_STREAMS = st.binary(max_size=80).map(lambda data: bytes(b % 3 + 3 * (b > 240) for b in data))


def expected(data):
    """Frames, corrupt headers and the first undecided position, one position after the other."""
    frames, corrupt, position = [], 0, 0
    while position < len(data):
        rest = data[position:]
        if rest[0] == 1:
            lead = 1
        elif rest[0] == 2 and (len(rest) == 1 or rest[1] == 2):
            lead = 2
        else:
            position += 1
            continue
        if len(rest) <= lead:
            break
        if rest[lead] > 4:
            corrupt += 1
            position += 1
            continue
        length = lead + 2 + rest[lead]
        if len(rest) < length:
            break
        if sum(rest[lead + 1 : length - 1]) % 3 == rest[length - 1]:
            frames.append((position, length))
            position += length
        else:
            corrupt += 1
            position += 1
    return frames, corrupt, position


def said(found):
    frames = list(zip(found.starts.tolist(), found.lengths.tolist(), strict=True))
    return frames, found.corrupt, found.decided


class Ends(FrameDecoder):
    """Gives where each frame ends, and its length as its row."""

    def _read(self, frames):
        rows = frames.lengths.astype(">u2").view([("length", ">u2")])
        for index, bytes_of in frames.by_length():
            assert all(TINY.is_good(row.tobytes()) for row in bytes_of)
            assert (frames.lengths[index] == bytes_of.shape[1]).all()
        return {"": Packets(rows, frames.end)}


def decode(stream, cuts=()):
    decoder = Ends(TINY)
    found = []
    for start, stop in pairwise([0, *sorted(cuts), len(stream)]):
        packets = decoder.feed(stream[start:stop])[""]
        assert decoder.pending < TINY.longest
        found += zip(packets.end.tolist(), packets.rows["length"].tolist(), strict=True)
    return found, decoder


@settings(max_examples=100)
@given(TINY_STREAMS)
@example(b"")
@example(b"\x02")
@example(b"\x01\x00\x00" * 12 + b"\x02\x02")
@example(b"\x02\x02\x01\x00\x00" * 40)
@example(b"\x01" * 80)
def test_arrays_and_plain_python_follow_the_rule(stream):
    rule = expected(stream)
    assert said(find_short(TINY, stream)) == rule
    assert said(find_many(TINY, stream)) == rule
    assert said(find_frames(TINY, stream)) == rule


@settings(max_examples=30)
@given(TINY_STREAMS, st.data())
def test_chunks_do_not_matter(stream, data):
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=6))
    frames, corrupt, decided = expected(stream)
    for places in ((), cuts, range(len(stream))):
        found, decoder = decode(stream, places)
        assert found == [(start + length, length) for start, length in frames]
        assert decoder.stats.good == len(frames)
        assert decoder.stats.corrupt == corrupt
        assert decoder.stats.skipped_bytes == decided - sum(length for _, length in frames)
        assert decoder.pending == len(stream) - decided


def test_long_stretches_follow_the_rule_too():
    rng = np.random.default_rng(3)
    good = [b"\x01\x03\x01\x01\x00\x02", b"\x02\x02\x02\x01\x01\x02", b"\x01\x00\x00"]
    for broken in (0.0, 0.05, 0.6):
        parts = [
            rng.integers(0, 3, 7, dtype=np.uint8).tobytes() if rng.random() < broken else good[k]
            for k in rng.integers(0, 3, 1500)
        ]
        stream = b"".join(parts)
        assert said(find_many(TINY, stream)) == expected(stream)


def test_a_cut_loses_what_is_undecided_and_nothing_else():
    whole = b"\x01\x03\x01\x01\x00\x02"
    decoder = Ends(TINY)
    assert len(decoder.feed(whole + whole[:4])[""]) == 1
    decoder.cut()
    assert decoder.pending == 0
    assert decoder.stats.skipped_bytes == 4
    after = decoder.feed(whole[4:] + whole)[""]
    assert after.end.tolist() == [6 + 4 + 2 + 6]


def test_pieces_join(monkeypatch):
    monkeypatch.setattr(undecided, "PIECE_BYTES", 1100)
    stream = b"\x01\x03\x01\x01\x00\x02" * 700
    found, decoder = decode(stream)
    assert found == [(end, 6) for end in range(6, len(stream) + 1, 6)]
    assert decoder.stats.skipped_bytes == decoder.pending == 0
    assert len(decoder.feed(b"")[""]) == 0


@pytest.mark.parametrize("length", [4, 8])
def test_a_length_that_lies_holds_back_no_more_than_the_longest_frame(length):
    decoder = Ends(TINY)
    decoder.feed(b"\x02\x02\x04" if length == 8 else b"\x01\x01")
    for _ in range(5):
        decoder.feed(b"\x01\x00\x00")
    assert decoder.stats.good >= 2
