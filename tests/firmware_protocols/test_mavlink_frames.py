"""Frames of MAVLink against pymavlink, in any chunking and with every kind of damage."""

import hashlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_writer import Writer, numbers_of, parsed, random_fields
from pymavlink.dialects.v10 import all as every_1
from pymavlink.dialects.v20 import all as every

from firmware_protocols import mavlink_frames
from firmware_protocols.checksums import checksum
from firmware_protocols.mavlink_frames import (
    MAVLINK_FORMAT,
    MOST_UNKNOWN_BYTES,
    MavlinkFrameDecoder,
    read_contents,
)
from firmware_protocols.mavlink_messages import CHECKS, HEARTBEAT, MESSAGES, SCALED_IMU2
from firmware_protocols.variable_framing import find_many, find_short

HEARTBEAT_PX4 = bytes.fromhex("FD09000000010100000000000000020C5103031EF8")
HEARTBEAT_GCS_1 = bytes.fromhex("FE0900010100000000000608000003F120")
UNKNOWN = 54_321  # a number that no dialect uses


class Reader(MavlinkFrameDecoder):
    """Keeps every message of the table that it is fed."""

    def __init__(self):
        super().__init__()
        self.found = []

    def _read(self, frames):
        self._note_gaps(frames)
        for name, contents in read_contents(frames, MESSAGES.values()).items():
            ends = frames.end[contents.index].tolist()
            self.found += [
                (end, name, *map(int, who), row.tobytes())
                for end, *who, row in zip(
                    ends,
                    contents.version,
                    contents.system,
                    contents.component,
                    contents.payload,
                    strict=True,
                )
            ]
        return {}


def read(data, cuts=()):
    reader = Reader()
    for start, stop in pairwise([0, *sorted(cuts), len(data)]):
        reader.feed(data[start:stop])
    return sorted(reader.found), reader


def one(data):
    (found,), reader = read(data)
    assert reader.stats.good == 1
    assert reader.stats.skipped_bytes == 0
    return found


def unknown_frame(payload=b"\x01" * 20, *, number=UNKNOWN, signature=b""):
    """A frame of a message that nobody knows; its checksum means nothing here."""
    flags = 1 if signature else 0
    head = bytes([0xFD, len(payload), flags, 0, 7, 1, 1]) + number.to_bytes(3, "little")
    return head + payload + b"\xaa\xbb" + signature


def test_checksum_is_that_of_x25_without_the_last_inversion():
    assert checksum("crc16-mcrf4xx", b"123456789") == 0x6F91


@pytest.mark.parametrize(
    ("frame", "version", "fields"),
    [
        (HEARTBEAT_PX4, 2, [0, 2, 12, 0x51, 3, 3]),
        (HEARTBEAT_GCS_1, 1, [0, 6, 8, 0, 0, 3]),
    ],
    ids=["MAVLink 2, PX4", "MAVLink 1, ground station"],
)
def test_heartbeats_of_the_fact_sheet(frame, version, fields):
    end, name, found_version, system, component, payload = one(frame)
    assert (end, name, found_version) == (len(frame), "HEARTBEAT", version)
    assert (system, component) == (1, 1)
    row = np.frombuffer(payload, HEARTBEAT.dtype)[0]
    assert [int(value) for value in row.tolist()] == fields


def test_every_entry_of_the_table_is_that_of_the_installed_dialects():
    both = CHECKS.keys() & every.mavlink_map.keys()
    assert len(both) > 0.95 * len(CHECKS)  # a later dialect may drop a few
    for number in both:
        check, message = CHECKS[number], every.mavlink_map[number]
        assert check.crc_extra == message.crc_extra
        if number in every_1.mavlink_map:
            assert check.base == every_1.mavlink_map[number].unpacker.size
            assert check.extended == message.unpacker.size
        else:
            assert check.base == 0
    used = {message.number for message in MESSAGES.values()}
    assert used <= both


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("name", MESSAGES)
def test_what_pymavlink_encodes_is_read_the_same_over_the_whole_range(name, version):
    rng = np.random.default_rng(MESSAGES[name].number)
    writer = Writer(9, 200, version=version)
    kind = getattr(writer.dialect, f"MAVLink_{name.lower()}_message")
    frames = [writer(name, *random_fields(kind, rng)) for _ in range(60)]
    found, reader = read(b"".join(frames))
    assert reader.stats.good == len(frames)
    assert reader.stats.skipped_bytes == 0
    for (_, got, seen_version, system, component, payload), frame in zip(
        found, frames, strict=True
    ):
        assert (got, seen_version, system, component) == (name, version, 9, 200)
        (message,) = writer.dialect.MAVLink(None).parse_buffer(bytearray(frame))
        row = np.frombuffer(payload, MESSAGES[name].dtype)[0]
        numbers = []
        for field in row.dtype.names:
            value = row[field]
            numbers += list(value) if value.ndim else [value]
        expected = numbers_of(message)
        for got_number, number in zip(numbers[: len(expected)], expected, strict=True):
            if isinstance(number, bytes | bytearray | str):
                text = number.encode() if isinstance(number, str) else bytes(number)
                assert bytes(got_number).rstrip(b"\0") == text.rstrip(b"\0")
            else:
                assert got_number == number
        if version == 1:  # extension fields are absent
            assert not any(np.frombuffer(payload[len(frame) - 8 :], np.uint8))


def test_a_trimmed_scaled_imu2_is_filled_with_zeros():
    frame = Writer().scaled(77, mag=(1, -2, -3), name="SCALED_IMU2")
    assert frame[1] == 22  # of 24: the temperature is 0
    row = np.frombuffer(one(frame)[-1], SCALED_IMU2.dtype)[0]
    assert row["mag"].tolist() == [1, -2, -3]
    assert row["temperature"] == 0
    zeros = Writer()("SCALED_IMU2", *[0] * 10)
    assert zeros[1] == 1
    assert one(zeros)[-1] == bytes(24)


def test_a_longer_payload_than_known_is_a_later_extension():
    body = bytes([33, 0, 0, 5, 1, 1, 29, 0, 0]) + bytes(range(33))
    crc = checksum("crc16-mcrf4xx", body + bytes([CHECKS[29].crc_extra]))
    assert one(b"\xfd" + body + crc.to_bytes(2, "little"))[-1] == bytes(range(16))


def test_signed_frames_carry_thirteen_bytes_more():
    key = bytes(range(32))
    writer = Writer(key=key)
    signed = writer.heartbeat()
    assert signed[2] == 1
    assert len(signed) == len(HEARTBEAT_PX4) + 13
    assert signed[-13] == 3
    assert signed[-6:] == hashlib.sha256(key + signed[:-6]).digest()[:6]
    assert one(signed)[1] == "HEARTBEAT"
    stream = signed + HEARTBEAT_PX4 + writer.highres() + HEARTBEAT_GCS_1
    found, reader = read(stream)
    assert [name for _, name, *_ in found] == ["HEARTBEAT", "HEARTBEAT", "HIGHRES_IMU", "HEARTBEAT"]
    assert reader.stats.skipped_bytes == 0


def test_other_incompatible_flags_are_no_frame():
    frame = bytearray(HEARTBEAT_PX4)
    frame[2] = 2
    crc = checksum("crc16-mcrf4xx", bytes(frame[1:-2]) + bytes([50]))
    frame[-2:] = crc.to_bytes(2, "little")
    found, reader = read(bytes(frame) + HEARTBEAT_PX4)
    assert len(found) == 1
    assert reader.stats.corrupt >= 1


def test_every_bit_of_a_frame_counts():
    frame = Writer().scaled(123456)
    for bit in range(8 * len(frame)):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        found, _ = read(bytes(damaged) + HEARTBEAT_PX4)
        names = [name for _, name, *_ in found]
        # the compatible flags may say anything, but the checksum covers them too
        assert names in (["HEARTBEAT"], []), bit


def test_unknown_messages_between_sound_frames_are_not_garbage():
    stranger = unknown_frame(b"\xfd\xfe" * 10)
    signed = unknown_frame(signature=bytes(13))
    data = HEARTBEAT_PX4 + stranger + signed + HEARTBEAT_PX4 + stranger + HEARTBEAT_PX4
    found, reader = read(data)
    assert len(found) == 3
    assert reader.unknown == 3
    assert (reader.stats.corrupt, reader.stats.skipped_bytes) == (0, 0)


def test_a_known_message_with_a_wrong_checksum_is_corrupt_wherever_it_stands():
    damaged = bytearray(Writer().heartbeat())
    damaged[12] ^= 1
    _, reader = read(HEARTBEAT_PX4 + bytes(damaged) + unknown_frame() + HEARTBEAT_PX4)
    assert reader.unknown == 0
    assert reader.stats.corrupt >= 1
    assert reader.stats.skipped_bytes == len(damaged) + len(unknown_frame())


def test_garbage_is_counted_even_where_unknown_messages_stand_in_it():
    for garbage in (b"\x00" + unknown_frame(), unknown_frame() + b"\x00", unknown_frame()[:-1]):
        _, reader = read(HEARTBEAT_PX4 + garbage + HEARTBEAT_PX4)
        assert reader.unknown == 0
        assert reader.stats.skipped_bytes == len(garbage)
    many = unknown_frame(b"\x01" * 255) * (MOST_UNKNOWN_BYTES // 267 + 1)
    for cuts in ((), range(50, len(many), 50)):
        _, reader = read(HEARTBEAT_PX4 + many + HEARTBEAT_PX4, cuts)
        assert reader.unknown == 0
        assert reader.stats.skipped_bytes == len(many)


@st.composite
def streams(draw):
    """Sound, signed, old, unknown, damaged and cut frames, and garbage with headers in it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    new, old, signing = Writer(), Writer(2, 7, version=1), Writer(3, 3, key=bytes(32))
    pieces = []
    for _ in range(draw(st.integers(1, 25))):
        writer = [new, new, old, signing][rng.integers(4)]
        what = rng.integers(10)
        acc = rng.integers(-32768, 32768, 3).tolist()
        frame = writer.scaled(int(rng.integers(2**32)), acc)
        if what == 0:
            frame = bytes(rng.choice([0xFD, 0xFE, 0, 1, 9], rng.integers(1, 60)).astype(np.uint8))
        elif what == 1:
            frame = unknown_frame(rng.bytes(int(rng.integers(1, 40))))
        elif what == 2:
            frame = frame[: int(rng.integers(len(frame)))]
        elif what == 3:
            damaged = bytearray(frame)
            damaged[rng.integers(len(frame))] ^= 1 << int(rng.integers(8))
            frame = bytes(damaged)
        elif what == 4:
            frame = writer.heartbeat()
        pieces.append(frame)
    return b"".join(pieces)


@settings(max_examples=20)
@given(data=streams(), places=st.lists(st.floats(0, 1), max_size=6))
def test_chunking_never_matters(data, places):
    whole, one_piece = read(data)
    cuts = [int(place * len(data)) for place in places]
    for chosen in (cuts, [len(data) // 2], range(1, len(data))):
        found, reader = read(data, chosen)
        assert found == whole
        assert reader.stats == one_piece.stats
        assert reader.unknown == one_piece.unknown
        assert reader.pending == one_piece.pending < MAVLINK_FORMAT.longest


@settings(max_examples=60)
@given(data=streams())
def test_array_form_and_plain_form_find_the_same(data):
    short, many = find_short(MAVLINK_FORMAT, data), find_many(MAVLINK_FORMAT, data)
    assert short.starts.tolist() == many.starts.tolist()
    assert short.lengths.tolist() == many.lengths.tolist()
    assert (short.decided, short.corrupt) == (many.decided, many.corrupt)


@pytest.mark.parametrize("few", [0, 1000])
def test_few_frames_are_read_as_many_are(few, monkeypatch):
    old, signing = Writer(2, 7, version=1), Writer(3, 3, key=bytes(32))
    data = b"".join(
        writer(
            name, *random_fields(getattr(writer.dialect, f"MAVLink_{name.lower()}_message"), rng)
        )
        for rng in [np.random.default_rng(5)]
        for name in [*MESSAGES] * 3
        for writer in (Writer(), old, signing)
    )
    usual, _ = read(data)
    monkeypatch.setattr(mavlink_frames, "FEW_FRAMES", few)
    assert read(data)[0] == usual


def test_statistics_add_up_at_every_byte():
    """Nothing is counted as garbage that turns out to be an unknown message, not even meanwhile."""
    data = HEARTBEAT_PX4 + unknown_frame() + unknown_frame() + HEARTBEAT_PX4
    reader = Reader()
    for place in range(len(data)):
        reader.feed(data[place : place + 1])
        assert (reader.stats.corrupt, reader.stats.skipped_bytes) == (0, 0)


def test_a_cut_ends_what_waits():
    reader = Reader()
    reader.feed(HEARTBEAT_PX4 + HEARTBEAT_PX4[:10])
    reader.cut()
    assert reader.pending == 0
    reader.feed(HEARTBEAT_PX4[10:] + HEARTBEAT_PX4)
    assert reader.stats.good == 2
    assert reader.stats.skipped_bytes == len(HEARTBEAT_PX4)


def test_random_bytes_hold_no_message_beyond_the_odds_of_their_checksum():
    """Of 2 MB of noise, pymavlink's own parser would be as likely to take a frame."""
    rng = np.random.default_rng(7)
    found, reader = read(rng.bytes(2_000_000))
    # headers FE with a known message and a length that fits: 1/256 * 194/256 * about 1.6/256 each;
    # times 2**-16 for the checksum makes 0.0006 frames expected in 2 MB
    assert found == []
    assert reader.stats.good == 0
    headers = rng.choice([0xFD, 0xFE, 0, 1, 22, 26, 27, 105], 300_000).astype(np.uint8).tobytes()
    _, reader = read(headers)
    assert reader.stats.good <= 6


def test_pymavlink_reads_what_is_read_here():
    """The same stream, interrupted by garbage, through both parsers."""
    writer = Writer()
    data = b"".join(
        writer.highres(1000 * k) + (b"\x00\x13\x37" if k % 7 == 0 else b"") for k in range(50)
    )
    theirs = [m for m in parsed(data) if m.get_type() == "HIGHRES_IMU"]
    found, _ = read(data)
    assert len(found) == len(theirs) == 50
