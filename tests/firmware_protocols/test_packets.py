"""Rows of packets to counts and values and back to bytes, against hand-made bytes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocols.decoder import StreamDecoder
from firmware_protocols.layout import Checksum, Field, LayoutError, PacketLayout, load_layout
from firmware_protocols.packets import counts, encode, quantize, values

MPU = load_layout("mpu9150-28")
BURST = load_layout("mpu9150-burst-30")

EVERY_TYPE = PacketLayout(
    name="every-type",
    title="One field of each type",
    byte_order="little",
    header=b"\x7e",
    fields=(
        Field("a", "u8"),
        Field("b", "i8", count=2),
        Field("gap", "pad", count=3),
        Field("c", "u16", byte_order="big"),
        Field("d", "i16"),
        Field("e", "u24", count=2),
        Field("f", "i24", byte_order="big"),
        Field("g", "i24", count=3, axes=("-z", "+x", "-y"), counts_per_unit=100.0, zero=7.0),
        Field("h", "u32", byte_order="big"),
        Field("i", "i32"),
        Field("j", "f32", count=2),
        Field("k", "f64", byte_order="big"),
    ),
    checksum=Checksum("crc32", start=1, byte_order="big"),
)


def integers(layout):
    """Counts of every integer field, ends of the range included."""
    columns = {}
    for field in layout.fields:
        if field.is_integer:
            number = st.integers(*field.limits) | st.sampled_from(field.limits)
            shaped = number if field.count == 1 else st.tuples(*[number] * field.count)
            columns[field.name] = shaped
    return st.fixed_dictionaries(columns)


def decode_one(layout, packet):
    decoder = StreamDecoder(replace(layout, checksum=layout.checksum))
    packets = decoder.feed(packet)
    assert len(packets) == 1
    return packets.rows


def by_hand(layout, packet):
    """Numbers of every integer field, read with nothing but int.from_bytes."""
    numbers = {}
    at = len(layout.header)
    for field in layout.fields:
        width = field.size // field.count
        parts = []
        for _ in range(field.count):
            part, at = packet[at : at + width], at + width
            order = field.byte_order or layout.byte_order
            parts.append(int.from_bytes(part, order, signed=field.type[0] == "i"))
        if field.is_integer:
            numbers[field.name] = parts[0] if field.count == 1 else tuple(parts)
    return numbers


@given(integers(EVERY_TYPE))
def test_every_integer_type_survives_the_wire(sent):
    packet = encode(EVERY_TYPE, {**sent, "j": (1.5, -2.25), "k": 1e-300})
    assert by_hand(EVERY_TYPE, packet) == sent
    rows = decode_one(EVERY_TYPE, packet)
    for name, expected in sent.items():
        assert np.array_equal(counts(EVERY_TYPE, rows, name)[0], expected)
    assert counts(EVERY_TYPE, rows, "j").tolist() == [[1.5, -2.25]]
    assert values(EVERY_TYPE, rows, "k").tolist() == [1e-300]
    assert counts(EVERY_TYPE, rows, "gap").tolist() == [[0, 0, 0]]


@given(integers(MPU))
def test_rows_encode_to_the_bytes_they_came_from(sent):
    packet = encode(MPU, sent)
    assert by_hand(MPU, packet) == sent
    assert encode(MPU, decode_one(MPU, packet)) == packet


def test_scale_zero_and_axes_of_a_signed_24_bit_field():
    sent = dict.fromkeys("acdfhi", 0) | {"b": (0, 0), "e": (0, 0), "j": (0, 0), "k": 0}
    rows = decode_one(EVERY_TYPE, encode(EVERY_TYPE, {**sent, "g": (107, -193, 8_000_007)}))
    assert values(EVERY_TYPE, rows, "g").tolist() == [[-80_000.0, 1.0, 2.0]]


def test_worked_burst_of_the_mpu9150():
    """The data sheet's scales on 0, 0, 4096, -3920, 328, -328, 0 and (-33, 100, 150)."""
    burst = bytes.fromhex("00 00 00 00 10 00 F0 B0 01 48 FE B8 00 00")
    mag = bytes.fromhex("DF FF 64 00 96 00")
    sent = encode(
        BURST,
        {
            "seq": 1,
            "status": 0,
            "time": 10_000,
            "accel": (0, 0, 4096),
            "temperature": -3920,
            "gyro": (328, -328, 0),
            "mag": (-33, 100, 150),
        },
    )
    assert sent[8:28] == burst + mag
    rows = decode_one(BURST, sent)
    assert values(BURST, rows, "accel").tolist() == [[0, 0, 1]]
    assert values(BURST, rows, "gyro") == pytest.approx(np.array([[10.0, -10.0, 0.0]]))
    assert values(BURST, rows, "temperature") == pytest.approx([25.0006], abs=5e-5)
    # X of the accelerometer is Y of the magnetometer, Y is X, Z is -Z; 0.3 uT per count
    assert values(BURST, rows, "mag") == pytest.approx(np.array([[30.0, -9.9, -45.0]]))


def test_default_packet_byte_by_byte():
    packet = encode(
        MPU,
        {
            "seq": 0x11,
            "status": 0x22,
            "time": 0x66554433,
            "accel": (0x0102, -2, 32767),
            "gyro": (0, 1, -32768),
            "mag": (4095, -4096, 5),
        },
    )
    body = bytes.fromhex(
        "A5 5A 11 22 33 44 55 66  02 01 FE FF FF 7F  00 00 01 00 00 80  FF 0F 00 F0 05 00"
    )
    assert packet[:26] == body
    register = 0xFFFF  # CRC-16/CCITT-FALSE, bit by bit
    for byte in body:
        register ^= byte << 8
        for _ in range(8):
            register = (register << 1 ^ 0x1021 if register & 0x8000 else register << 1) & 0xFFFF
    assert int.from_bytes(packet[26:], "little") == register


@given(st.lists(st.tuples(*[st.integers(-32768, 32767)] * 3), min_size=1, max_size=5))
def test_quantize_undoes_values(mag):
    sent = {"seq": 0, "status": 0, "time": 0, "accel": (0, 0, 0), "gyro": (0, 0, 0), "mag": mag}
    packets = StreamDecoder(MPU).feed(encode(MPU, sent))
    assert quantize(MPU, "mag", values(MPU, packets.rows, "mag")).tolist() == [list(m) for m in mag]


def test_quantize_saturates_like_the_sensor():
    assert quantize(MPU, "accel", (100.0, -100.0, 7.99976)).tolist() == [32767, -32768, 32767]
    assert quantize(MPU, "gyro", 998.99 * np.ones((2, 3))).tolist() == [[32767] * 3] * 2
    assert quantize(EVERY_TYPE, "j", (0.25, 1.0)).tolist() == [0.25, 1.0]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"seq": 256}, "field 'seq' takes counts of 0 to 255"),
        ({"accel": (0, 0, -32769)}, "field 'accel' takes counts of -32768 to 32767"),
        ({"gyro": (0.5, 0, 0)}, "field 'gyro' takes whole numbers"),
        ({"gyro": (1, 2)}, "field 'gyro' has shape"),
        ({"seq": [1, 2], "status": [1, 2, 3]}, "field 'status' has shape"),
        ({"wheel": 1}, "there is no field 'wheel'"),
        ({"time": None}, "field 'time' is not given"),
    ],
)
def test_what_cannot_be_encoded_is_refused(change, sentence):
    given_counts = {"seq": 0, "status": 0, "time": 0} | dict.fromkeys(
        ("accel", "gyro", "mag"), (0, 0, 0)
    )
    given_counts |= change
    given_counts = {k: v for k, v in given_counts.items() if v is not None}
    with pytest.raises(LayoutError, match=sentence):
        encode(MPU, given_counts)


def test_rows_of_another_layout_are_refused():
    with pytest.raises(ValueError, match="another layout"):
        encode(MPU, np.zeros(1, dtype=BURST.dtype))


def test_no_packets_encode_to_no_bytes():
    assert encode(MPU, np.zeros(0, dtype=MPU.dtype)) == b""


def test_a_scale_beyond_numbers_gives_infinities_without_a_warning():  # warnings are errors here
    fields = (
        Field("accel", "i16", count=3, counts_per_unit=5e-324),
        Field("gyro", "f64", count=3, counts_per_unit=1e-300, zero=-1e300),
        Field("mag", "f32", count=3),
    )
    layout = PacketLayout(name="x", title="", byte_order="little", header=b"\x7e", fields=fields)
    rows = np.zeros(2, layout.dtype)
    rows["accel"] = [[1, -1, 0]]
    rows["gyro"] = 1e308
    rows["mag"].view(np.uint32)[:] = 0x7F800001  # not a number, of the kind that signals
    assert values(layout, rows, "accel")[0].tolist() == [np.inf, -np.inf, 0.0]
    assert np.isinf(values(layout, rows, "gyro")).all()
    assert np.isnan(values(layout, rows, "mag")).all()
    assert np.isnan(counts(layout, rows, "mag")).all()
