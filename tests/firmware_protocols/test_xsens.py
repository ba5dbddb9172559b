"""The MTi's bytes as rows: printed and recorded packets, any configuration, any chunking."""

import struct
import tomllib
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocols.fields import LayoutError
from firmware_protocols.known import load_protocol, protocol_from_dict
from firmware_protocols.packets import values
from firmware_protocols.xsens import LEGACY, MTDATA2, XsensProtocol, describe
from firmware_protocols.xsens_data import ITEMS, NUMBER_BYTES, item_of, size_of, write_numbers
from firmware_protocols.xsens_frames import LONGEST_SHORT, Message, Mid, encode_message
from imu_rig.packet_stream import PacketStreams

MTI = load_protocol("xsens-mti")
OLD_MTI = load_protocol("xsens-mti-legacy")
PRINTED_LEGACY = bytes.fromhex(
    "FAFF3236 00000000 00000000 411CF5C3 00000000 00000000 00000000 3F000000 00000000 BF4CCCCD"
    "3F800000 00000000 00000000 00000000 1234 9C"
)
PRINTED_MTDATA2 = bytes.fromhex(
    "FAFF364C 102002 1234 106004 0001E240 40200C 00000000 00000000 411CF5C3"
    "80200C" + 12 * "00" + "C0200C 3F000000 00000000 BF4CCCCD 201010 3F800000" + 12 * "00" + "75"
)
# Recorded from an MTi-300 with the maker's own program, which showed the numbers below.
AT_REST = bytes.fromhex(
    "102002A655 1060040057472E 2010103F7F7DC4BC10107D3BA15770BD7EC656 40200CBDA21AF8BE2A8E964"
    "11D27A2 40100CB94FC800B9DA24003CC92880 40300C3C02C89C3C35F6C83CDB0C00 80200CBBB17D81BB96"
    "32003C01E841 8030103F800000B6E33001B6C0400037264800 C0200CBE999C243FB61B563F166AEB 301004"
    "000186DE E0200400400003"
)
SHAKEN = bytes.fromhex(
    "102002FB85 10600401A498DE 2010103F2A1463BED7EFA73CDEE5083F1DCEC9 40200CC1F246C3C1ECE076C2"
    "8F853F C0200C3EDC7439BE752B483FAF9A3F E0200400481401"
)
RECORDED = XsensProtocol(
    "recorded",
    rate_hz=400.0,
    outputs=(
        0x1020,
        0x1060,
        0x2010,
        0x4020,
        0x4010,
        0x4030,
        0x8020,
        0x8030,
        0xC020,
        0x3010,
        0xE020,
    ),
)
KINDS = {"xsens-mti": MTI, "xsens-mti-legacy": OLD_MTI}


def rows_of(protocol, data):
    return protocol.decoder().feed(data)[""].rows


def value(protocol, rows, name):
    return values(protocol.layout, rows, name)[0]


def message_bytes(items):
    """An MTData2 message of identifiers and the bytes of their data."""
    data = b"".join(struct.pack(">HB", i, len(raw)) + raw for i, raw in items)
    return encode_message(Mid.MT_DATA2, data)


def utc(moment):
    """Data of the item for a moment in seconds since 1970."""
    of = datetime.fromtimestamp(moment, UTC)
    return struct.pack(">IH6B", 0, of.year, of.month, of.day, of.hour, of.minute, of.second, 0x7)


def full_message(counter, accel=(0.0, 0.0, 9.81)):
    return message_bytes(
        [
            (0x1020, struct.pack(">H", counter & 0xFFFF)),
            (0x1060, struct.pack(">I", 100 * counter)),
            (0x4020, struct.pack(">3f", *accel)),
            (0x8020, bytes(12)),
        ]
    )


def test_the_printed_legacy_message():
    protocol = replace(OLD_MTI, name="calibrated", output_mode=0x0006)
    rows = rows_of(protocol, PRINTED_LEGACY)
    assert len(rows) == 1
    assert rows["counter"][0] == 0x1234
    assert value(protocol, rows, "accel") == pytest.approx([0, 0, 9.81], abs=1e-6)
    assert value(protocol, rows, "gyro").tolist() == [0, 0, 0]
    assert value(protocol, rows, "mag") == pytest.approx([24.5, 0, -39.2], abs=1e-5)
    # no turn against north, west, up is a quarter turn to the left against east, north, up
    assert value(protocol, rows, "quaternion") == pytest.approx([0.5**0.5, 0, 0, 0.5**0.5])


def test_the_printed_mtdata2_message():
    rows = rows_of(MTI, PRINTED_MTDATA2)
    assert (rows["counter"][0], rows["time"][0]) == (0x1234, 123_456)
    assert value(MTI, rows, "accel") == pytest.approx([0, 0, 9.81], abs=1e-6)
    assert value(MTI, rows, "gyro").tolist() == [0, 0, 0]
    assert value(MTI, rows, "mag") == pytest.approx([24.5, 0, -39.2], abs=1e-5)
    assert value(MTI, rows, "quaternion").tolist() == [1, 0, 0, 0]
    assert np.isnan(value(MTI, rows, "temperature"))
    assert MTI.layout.clock_tick_s == 1e-4


def test_a_packet_recorded_from_a_unit_at_rest():
    rows = rows_of(RECORDED, encode_message(Mid.MT_DATA2, AT_REST))
    shown = {
        "quaternion": [0.99801278, -0.00879299, 0.00492375, -0.06220087],
        "accel": [-0.07915300, -0.16655955, 9.82217598],
        "delta_v": [-0.00019816, -0.00041607, 0.02455544],
        "free_accel": [0.00798240, 0.01110620, 0.02673912],
        "gyro": [-0.00541657, -0.00458360, 0.00792891],
        "delta_q": [1.0, -0.00000677, -0.00000573, 0.00000991],
    }
    for name, numbers in shown.items():
        assert value(RECORDED, rows, name) == pytest.approx(numbers, abs=6e-9, rel=1e-6)
    assert rows["mag"][0] == pytest.approx([-0.30001938, 1.42270923, 0.58756894], rel=1e-6)
    assert (rows["counter"][0], rows["time"][0]) == (42581, 5719854)
    assert value(RECORDED, rows, "pressure") == 100062
    assert (rows["status"][0], rows["alarms"][0]) == (0x00400003, 0)


def test_the_recorded_orientation_turns_the_sensor_into_east_north_up():
    """The unit itself says what is left of the force there without gravity (9.8 upward)."""
    rows = rows_of(RECORDED, encode_message(Mid.MT_DATA2, AT_REST))
    w, *v = value(RECORDED, rows, "quaternion")
    a = value(RECORDED, rows, "accel")
    turned = a + 2 * w * np.cross(v, a) + 2 * np.cross(v, np.cross(v, a))
    free = value(RECORDED, rows, "free_accel")
    assert turned[:2] == pytest.approx(free[:2], abs=2e-4)
    assert turned[2] - free[2] == pytest.approx(9.797, abs=0.002)


def test_a_unit_that_is_shaken_says_which_axes_clip():
    protocol = replace(RECORDED, outputs=(0x1020, 0x1060, 0x2010, 0x4020, 0xC020, 0xE020))
    rows = rows_of(protocol, encode_message(Mid.MT_DATA2, SHAKEN))
    status = protocol.layout.field("status")
    told = {words for words, bit in status.faults if rows["status"][0] >> bit & 1}
    assert told == {"the accelerometer clips on z", "the gyroscope clips on y"}
    flags = {name: int(rows["status"][0] >> bit & 1) for name, bit in status.flags}
    assert (flags["self_test_passed"], flags["filter_valid"]) == (1, 0)


@pytest.mark.parametrize(("protocol", "mid"), [(MTI, Mid.MT_DATA2), (OLD_MTI, Mid.MT_DATA)])
def test_a_self_test_that_did_not_pass_is_a_fault(protocol, mid):
    for status, failed in ((0x02, 1), (0x03, 0)):
        if mid == Mid.MT_DATA2:
            items = [(0x1020, b"\0\1"), (0x1060, bytes(4)), (0xE010, bytes([status]))]
            sent, told = message_bytes(items), replace(protocol, outputs=(0x1020, 0x1060, 0xE010))
        else:
            sent = encode_message(mid, bytes([status, 0, 1]))
            told = replace(protocol, output_mode=0x0800)
        rows = rows_of(told, sent)
        assert rows["alarms"].tolist() == [failed]
    assert told.layout.field("alarms").faults


@settings(max_examples=20)
@given(st.data())
def test_any_outputs_in_any_format_come_back(data):
    """Every known item once, in any order and format; the numbers are exact in their format."""
    by_field = {}
    for base, item in ITEMS.items():
        by_field.setdefault(item.field, []).append(base)
    chosen = data.draw(st.permutations(sorted(by_field)))[: data.draw(st.integers(1, 12))]
    outputs, sent, wanted = [], [], {}
    for field in chosen:
        base = data.draw(st.sampled_from(by_field[field]))
        item = ITEMS[base]
        if item.code == "utc":
            identifier = base
            moment = data.draw(st.integers(0, 2**32 - 1))
            wanted[field] = float(moment)
            raw = utc(moment)
        elif item.code != "f":
            identifier, size = base, np.dtype(item.code).itemsize
            number = data.draw(st.integers(0, 256**size - 1))
            raw, wanted[field] = number.to_bytes(size, "big"), number
        else:
            number_format = data.draw(st.integers(0, 3))
            identifier = base | number_format
            counts = data.draw(
                st.lists(st.integers(-(2**23), 2**23), min_size=item.count, max_size=item.count)
            )
            numbers = np.array(counts) / 2.0**14
            raw = write_numbers(numbers[np.newaxis], number_format).tobytes()
            if field != "quaternion" or item.count == 4:
                wanted[field] = numbers[0] if item.count == 1 else numbers
        outputs.append(identifier)
        sent.append((identifier, raw))
        assert len(raw) == size_of(identifier)
    protocol = XsensProtocol("any", outputs=tuple(outputs))
    frame = message_bytes(sent)
    assert protocol.longest == len(frame)
    rows = rows_of(protocol, frame)
    assert len(rows) == 1
    for field, numbers in wanted.items():
        assert np.array_equal(rows[field][0], numbers), field


@settings(max_examples=20)
@given(st.integers(0, 3), st.lists(st.integers(-(2**23), 2**23), min_size=10, max_size=10))
def test_legacy_messages_in_any_format_come_back(number_format, counts):
    numbers = np.array(counts) / 2.0**14
    protocol = replace(OLD_MTI, output_mode=0x0003, output_settings=number_format << 8 | 1)
    data = write_numbers(numbers[np.newaxis], number_format).tobytes() + b"\x12\x34"
    assert len(data) == 10 * NUMBER_BYTES[number_format] + 2 == protocol.data_bytes
    rows = rows_of(protocol, encode_message(Mid.MT_DATA, data))
    assert rows["temperature"][0] == numbers[0]
    found = np.concatenate([rows[name][0] for name in ("accel", "gyro", "mag")])
    assert found.tolist() == numbers[1:].tolist()
    assert rows["counter"][0] == 0x1234


@settings(max_examples=25)
@given(st.integers(0, 0xFFFF), st.binary(max_size=60))
def test_unknown_items_are_skipped_by_their_size(identifier, raw):
    item = item_of(identifier)
    if item is not None and item.field in {field.name for field in MTI.layout.fields}:
        return
    head = [(0x1020, b"\x00\x07"), (0x1060, bytes(4)), (identifier, raw)]
    rows = rows_of(MTI, message_bytes([*head, (0x4020, struct.pack(">3f", 1, 2, 3))]))
    assert rows["accel"].tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    "there_is_none",
    ["000000000000000000000000", "0000000007EA0D0100000000", "0000000007EA020018000000",
     "3B9ACA0007EA010100000000", "FFFFFFFFFFFFFFFFFFFFFFFF"],
)  # fmt: skip
def test_a_date_that_there_is_not_is_absent(there_is_none):
    protocol = XsensProtocol("dated", outputs=(0x1010,))
    rows = rows_of(protocol, message_bytes([(0x1010, bytes.fromhex(there_is_none))]))
    assert np.isnan(rows["utc"]).all()


def test_a_known_item_of_another_size_is_skipped_too():
    head = [(0x1020, b"\x00\x07"), (0x1060, bytes(4)), (0x4020, bytes(11))]
    rows = rows_of(MTI, message_bytes([*head, (0x8020, struct.pack(">3f", 1, 2, 3))]))
    assert np.isnan(rows["accel"]).all()
    assert rows["gyro"].tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("number", [-np.inf, np.nan, 3e38])
@pytest.mark.parametrize("base", [base for base, item in ITEMS.items() if item.code == "f"])
def test_numbers_that_are_none_are_taken_without_a_word(base, number):
    for axes in (0x0, 0x4, 0x8) if ITEMS[base].earth else (0x0,):
        for number_format in (0, 3):
            numbers = np.full((1, ITEMS[base].count), number)
            raw = write_numbers(numbers, number_format).tobytes()
            identifier = base | axes | number_format
            protocol = XsensProtocol("none", outputs=(identifier,))
            assert len(rows_of(protocol, message_bytes([(identifier, raw)]))) == 1


def test_a_counter_of_another_size_is_none():
    frame = message_bytes([(0x1020, bytes(4)), (0x1060, bytes(4)), (0x4020, bytes(12))])
    assert len(rows_of(MTI, frame)) == 0


def test_messages_that_are_no_rows():
    decoder = MTI.decoder()
    for sent in (
        message_bytes([(0x1020, b"\x00\x07"), (0x4020, bytes(12))]),  # no sample time
        message_bytes([(0x1060, bytes(4)), (0x4020, bytes(12))]),  # no counter
        PRINTED_LEGACY,
        encode_message(Mid.WAKE_UP),
        encode_message(Mid.ERROR, b"\x04"),
    ):
        assert len(decoder.feed(sent)[""]) == 0
    assert (decoder.stats.good, decoder.stats.corrupt, decoder.stats.skipped_bytes) == (0, 0, 0)
    decoder.feed(encode_message(Mid.MT_DATA2, bytes.fromhex("102003 1234")))
    assert decoder.stats.corrupt == 1
    assert len(rows_of(OLD_MTI, PRINTED_LEGACY)) == 0  # without a temperature
    assert len(rows_of(OLD_MTI, PRINTED_MTDATA2)) == 0


def test_messages_of_many_shapes_keep_their_order():
    """More arrangements of one length than are worth an array each."""
    rng = np.random.default_rng(2)
    stream, wanted = [], []
    for number in range(60):
        order = rng.permutation(5)
        items = [
            (0x1020, struct.pack(">H", number)),
            (0x1060, struct.pack(">I", number)),
            (0x4020, struct.pack(">3f", number, 0, 0)),
            (0x8020, struct.pack(">3f", 0, number, 0)),
            (0x7010 + number, bytes(3)),
        ]
        stream.append(message_bytes([items[place] for place in order]))
        wanted.append(float(number))
    decoder = MTI.decoder()
    packets = decoder.feed(b"".join(stream))[""]
    assert packets.rows["accel"][:, 0].tolist() == packets.rows["gyro"][:, 1].tolist() == wanted
    assert packets.end.tolist() == np.cumsum([len(frame) for frame in stream]).tolist()


def test_losses_are_counted_by_the_packet_counter():
    decoder = MTI.decoder()
    numbers = [65534, 65535, 0, 1, 5, 6, 6, 8, 7]
    decoder.feed(b"".join(full_message(n) for n in numbers))
    stats = decoder.stats
    assert (stats.good, stats.lost, stats.duplicates, stats.reordered) == (9, 3, 1, 1)


def error_message(number):
    return encode_message(Mid.ERROR, bytes([number]))


def test_errors_while_it_measures_are_told_by_the_next_row():
    """Wherever the bytes are cut; those that answer what it was told are none of its alarms."""
    first, second, third = (full_message(number) for number in range(3))
    stream = first + error_message(0x1E) + second + error_message(0x04) + third
    stream += error_message(0x28) + error_message(0x1E)
    for cuts in ((), range(len(stream))):
        decoder = MTI.decoder()
        rows = []
        for start, stop in pairwise([0, *cuts, len(stream)]):
            rows += decoder.feed(stream[start:stop])[""].rows["alarms"].tolist()
        assert rows == [0, 0b010, 0]
        assert decoder.feed(third)[""].rows["alarms"].tolist() == [0b110]
        assert decoder.feed(third)[""].rows["alarms"].tolist() == [0]
    bits = {bit: words for words, bit in MTI.layout.field("alarms").faults}
    assert "timer overflowed" in bits[1]
    assert "device itself failed" in bits[2]


def test_an_error_is_a_fault_of_the_stream_also_without_a_status():
    protocol = XsensProtocol("plain", outputs=(0x1020, 0x1060, 0x4020, 0x8020))
    streams = PacketStreams(protocol)
    first = b"".join(full_message(number) for number in range(100))
    streams.feed_many([(1_000_000_000, first)])
    assert streams.faults("", 0.0) == ()
    streams.feed_many([(1_010_000_000, error_message(0x1E) + full_message(100))])
    (fault,) = streams.faults("", 0.0)
    assert fault.startswith("reports error 30: its timer overflowed")


@pytest.mark.parametrize("head", ["FAFF36FF0800", "FAFF32FF00FD", "FAFF36FE"])
def test_a_length_that_lies_holds_back_what_one_length_byte_can_say(head):
    decoder = MTI.decoder()
    decoder.feed(bytes.fromhex(head))
    for number in range(12):
        decoder.feed(full_message(number))
        assert decoder.pending < LONGEST_SHORT
    assert decoder.stats.good >= 12 - LONGEST_SHORT // len(full_message(0)) - 1


def test_what_holds_more_than_one_length_byte_can_say_is_read():
    doubles = [0x1020, 0x1060, *(base | 3 for base, item in ITEMS.items() if item.count in (3, 9))]
    doubles.remove(0x2033)
    protocol = XsensProtocol("long", outputs=tuple(doubles))
    assert protocol.longest > LONGEST_SHORT
    items = [(identifier, bytes(size_of(identifier))) for identifier in doubles]
    frame = message_bytes(items)
    assert len(frame) == protocol.longest
    assert len(rows_of(protocol, frame)) == 1
    assert len(rows_of(MTI, frame)) == 0


@settings(max_examples=15, deadline=None)
@given(st.data())
def test_chunks_do_not_matter(data):
    pieces = data.draw(
        st.lists(
            st.integers(0, 65535).map(full_message)
            | st.binary(max_size=12)
            | st.sampled_from([PRINTED_LEGACY, PRINTED_MTDATA2, b"\xfa\xff", b"\xfa\xff\x36\xff"]),
            max_size=8,
        )
    )
    stream = b"".join(pieces)
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=5))
    results = []
    for places in ((), cuts, range(len(stream))):
        decoder = MTI.decoder()
        rows, ends = b"", []
        for start, stop in pairwise([0, *sorted(places), len(stream)]):
            packets = decoder.feed(stream[start:stop])[""]
            rows += packets.rows.tobytes()
            ends += packets.end.tolist()
        results.append((rows, ends, decoder.stats, decoder.pending))
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("protocol", KINDS.values(), ids=KINDS)
def test_descriptions_come_back(protocol):
    assert protocol_from_dict(protocol.to_dict()) == protocol
    assert protocol_from_dict(tomllib.loads(protocol.to_toml())) == protocol
    assert protocol.inertial_streams == ("",)
    assert protocol.bytes_per_s < 11_520  # fits 115200 baud


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "mtdata3"}, "mtdata3"),
        ({"outputs": []}, "outputs"),
        ({"outputs": ["1234"]}, "1234 is not known"),
        ({"outputs": ["4024"]}, "4024"),
        ({"outputs": ["4020", "4021"]}, "say the same"),
        ({"outputs": [4020]}, "identifier"),
        ({"outputs": "4020"}, "a list"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"rate_hz": 33.3}, "whole"),
        ({"rate_hz": True}, "number"),
        ({"rate_hz": 10**400}, "rate_hz is too large a number"),
        ({"rate_hz": -(10**400)}, "rate_hz is too large a number"),
        ({"rate_hz": 5e-324}, "rate_hz must be 1 to"),
        ({"rate_hz": float("nan")}, "rate_hz must be 1 to"),
        ({"format": "\x1b[31m" * 1000, "output_mode": 7}, r"^.{1,200}$"),
        ({"name": "a b"}, "name"),
        ({"output_mode": 7}, "does not go with"),
        ({"speed": 7}, "speed"),
        ({"format": LEGACY}, "does not go with"),
    ],
)
def test_descriptions_that_cannot_be_used_are_refused(change, words):
    with pytest.raises(LayoutError, match=words):
        protocol_from_dict({**MTI.to_dict(), **change})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rate_hz": 70.0}, "115200 divided"),
        ({"rate_hz": 5.0}, "115200 divided"),
        ({"output_mode": 0}, "no data"),
        ({"output_mode": "7"}, "whole number"),
        ({"output_mode": 16**5000}, "output_mode must be 0 to 0xFFFF"),
        ({"output_mode": -1}, "output_mode must be 0 to 0xFFFF"),
        ({"output_mode": 2, "output_settings": 0x70}, "settings 0x00000070 switch off all"),
        ({"output_mode": 8, "output_settings": 0xC01}, "settings 0x00000c01 switch off all"),
        ({"format": MTDATA2}, "does not go with"),
    ],
)
def test_legacy_descriptions_that_cannot_be_used_are_refused(change, words):
    with pytest.raises(LayoutError, match=words):
        protocol_from_dict({**OLD_MTI.to_dict(), **change})
    without_name = {key: entry for key, entry in OLD_MTI.to_dict().items() if key != "name"}
    with pytest.raises(LayoutError, match="name"):
        protocol_from_dict(without_name)


def test_what_is_sent_is_described():
    assert describe([Message(Mid.ERROR)]) == ""
    assert describe([Message(Mid.MT_DATA, bytes(18))]) == "legacy MTData with 18 bytes"
    assert "1020 4020" in describe([Message(Mid.MT_DATA2, bytes.fromhex("10200100 40200100"))])
    assert describe([Message(Mid.MT_DATA2)])
