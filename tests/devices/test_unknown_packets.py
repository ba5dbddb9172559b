"""Packets of which no layout is known: what is found in them is what they were made of."""

import tomllib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_protocols.checksums import SIZES
from firmware_protocols.known import load_protocol, protocol_from_dict
from firmware_protocols.layout import Checksum, Field, PacketLayout
from firmware_protocols.packets import encode
from imu_rig.devices.unknown.counting import tick_s
from imu_rig.devices.unknown.draft import draft_layout
from imu_rig.devices.unknown.kinds import analyse_kinds
from imu_rig.devices.unknown.period import find_period
from imu_rig.devices.unknown.variable import find_frames_of_variable_length
from simulators.device_packets import DevicePackets

PACKETS = 300
RATE_HZ = 100.0
GRAVITY_COUNTS = 4096


def analyse(data, seconds=None, pauses=()):
    """Return the only kind of packets that is found; None for none."""
    kinds = analyse_kinds(data, seconds, pauses)
    assert len(kinds) <= 1
    return kinds[0] if kinds else None


def signal(rng, size, *, amplitude=3000.0, noise=12.0):
    """A sensor that is moved by hand: slow, with noise on top."""
    t = np.arange(PACKETS) / RATE_HZ
    phase = rng.uniform(0, 2 * np.pi, size)
    center = rng.uniform(-amplitude, amplitude, size)
    slow = np.sin(2 * np.pi * rng.uniform(0.2, 0.8) * t[:, None] + phase)
    return center + amplitude * slow + rng.normal(0, noise, (PACKETS, size))


def gravity(rng, noise=8.0):
    t = np.arange(PACKETS) / RATE_HZ
    tilt, turn = 0.5 + 0.8 * np.sin(1.9 * t), 0.7 * t
    axes = np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)
    return GRAVITY_COUNTS * np.stack(axes, axis=1) + rng.normal(0, noise, (PACKETS, 3))


@st.composite
def layouts(draw):
    byte_order = draw(st.sampled_from(["little", "big"]))
    mark = st.integers(1, 254)
    header = bytes(draw(st.lists(mark, min_size=2, max_size=3, unique=True)))
    fields, counter, clock = [], None, None
    if draw(st.booleans()):
        counter = "seq"
        fields.append(Field("seq", draw(st.sampled_from(["u8", "u16"]))))
    if draw(st.booleans()):
        fields.append(Field("status", "u8"))
    if draw(st.booleans()):
        clock = "time"
        fields.append(Field("time", "u32"))
    for number in range(draw(st.integers(1, 3))):
        fields.append(Field(f"axes{number}", draw(st.sampled_from(["i16", "i16", "f32"])), count=3))
    kind = draw(st.sampled_from([None, *SIZES]))
    check = None
    if kind is not None:
        start = draw(st.sampled_from([0, len(header)]))
        check = Checksum(kind, start, draw(st.sampled_from([None, "little", "big"])))
    return PacketLayout(
        name="made",
        title="",
        byte_order=byte_order,
        header=header,
        fields=tuple(fields),
        checksum=check,
        counter=counter,
        clock=clock,
    )


def made(layout, seed):
    rng = np.random.default_rng(seed)
    columns = {}
    for field in layout.fields:
        if field.name == "seq":
            columns["seq"] = (rng.integers(1 << 15) + np.arange(PACKETS)) % (1 << field.bits)
        elif field.name == "status":
            columns["status"] = np.full(PACKETS, 0)
        elif field.name == "time":
            jitter = rng.integers(-40, 41, PACKETS)
            columns["time"] = rng.integers(1 << 24) + 10_000 * np.arange(PACKETS) + jitter
        elif field.type == "f32":
            columns[field.name] = signal(rng, 3) / 1000.0
        else:
            columns[field.name] = np.rint(signal(rng, 3)).astype(int)
    return encode(layout, columns)


def offsets(layout):
    at, places = len(layout.header), {}
    for field in layout.fields:
        places[field.name] = at
        at += field.size
    return places


@settings(max_examples=10, suppress_health_check=[HealthCheck.too_slow])
@given(layout=layouts(), seed=st.integers(0, 1000), cut=st.integers(0, 200))
def test_what_was_put_into_packets_is_found(layout, seed, cut):
    data = made(layout, seed)
    heard = data[cut : len(data) // 2] + data[len(data) // 2 + 5 :]  # five bytes were lost
    found = analyse(heard, len(heard) / layout.length / RATE_HZ)
    assert found is not None
    assert found.length == layout.length
    places = offsets(layout)
    if layout.checksum is not None:
        assert found.beginning_sure
        assert found.checksum is not None
        assert found.checksum.kind == layout.checksum.kind
        assert layout.header.startswith(found.header)
        if layout.checksum.size > 1:
            assert found.checksum.byte_order == layout.checksum_order
    if found.header[:1] == layout.header[:1]:
        if layout.counter is not None:
            low = layout.field("seq").bits // 8 - 1 if layout.byte_order == "big" else 0
            assert found.counter is not None
            assert places["seq"] + low in found.counter.places
        if layout.clock is not None:
            assert found.clock is not None
            assert set(found.clock.places) <= set(range(places["time"], places["time"] + 4))
            assert found.clock.byte_order == layout.byte_order
    assert abs(found.rate_hz / RATE_HZ - 1) < 0.03
    drafted = PacketLayout.from_dict(tomllib.loads(draft_layout([found], "drafted")))
    decoder = drafted.decoder()
    packets = decoder.feed(heard).get("", ())
    assert len(packets) >= 0.95 * PACKETS - 12


def still_packets(kind="i16", *, scale=GRAVITY_COUNTS, seed=5):
    """Accelerometer between other numbers, as a module that is turned slowly sends them."""
    layout = PacketLayout(
        name="three",
        title="",
        byte_order="big",
        header=b"\xeb\x90",
        fields=(
            Field("seq", "u8"),
            Field("gyro", kind, count=3),
            Field("accel", kind, count=3),
        ),
        checksum=Checksum("sum8"),
        counter="seq",
    )
    rng = np.random.default_rng(seed)
    accel = gravity(rng) * (scale / GRAVITY_COUNTS)
    columns = {"seq": np.arange(PACKETS) % 256, "gyro": signal(rng, 3), "accel": accel}
    if kind != "f32":
        columns = {name: np.rint(value).astype(int) for name, value in columns.items()}
    return layout, encode(layout, columns)


@pytest.mark.parametrize("scale", [2048, 4096, 16384])
def test_gravity_is_told_by_its_constant_magnitude(scale):
    layout, data = still_packets(scale=scale)
    found = analyse(data, 3.0)
    drafted = PacketLayout.from_dict(tomllib.loads(draft_layout([found], "drafted")))
    accel = drafted.field("accel")
    assert (accel.count, accel.unit, accel.counts_per_unit) == (3, "g", scale)
    rows = drafted.decoder().feed(data)[""].rows
    sent = layout.decoder().feed(data)[""].rows
    np.testing.assert_array_equal(rows["accel"], sent["accel"])
    np.testing.assert_array_equal(rows["raw1"], sent["gyro"])


def test_gravity_in_metres_per_second_squared():
    _, data = still_packets("f32", scale=9.81)
    drafted = tomllib.loads(draft_layout([analyse(data, 3.0)], "drafted"))
    accel = next(field for field in drafted["fields"] if field["name"] == "accel")
    assert accel == {"name": "accel", "type": "f32", "count": 3, "unit": "m/s2"}


@pytest.mark.parametrize(
    ("step", "rate_hz", "tick"),
    [(10_000, 100.0, 1e-6), (10, 100.4, 1e-3), (120.0, 273.07, 1 / 32_768), (1152, 100.0, None)],
)
def test_the_tick_of_a_clock_follows_from_the_rate(step, rate_hz, tick):
    found, usual = tick_s(step, rate_hz)
    assert usual == (tick is not None)
    assert found == (tick or pytest.approx(1 / (step * rate_hz), rel=1e-3))


def test_pauses_tell_where_packets_begin_that_have_no_checksum():
    layout = PacketLayout(
        name="plain",
        title="",
        byte_order="little",
        header=b"\x01\x02",
        fields=(Field("axes", "i16", count=3), Field("same", "pad", count=2)),
    )
    rng = np.random.default_rng(2)
    data = encode(layout, {"axes": np.rint(signal(rng, 3)).astype(int), "same": [0xA5, 0x5A]})
    assert analyse(data, 3.0).header.startswith(b"\xa5")  # looks more like a header
    length = layout.length
    pauses = tuple(range(5 * length, 200 * length, 7 * length))
    found = analyse(data, 3.0, pauses)
    assert found.header == b"\x01\x02"
    assert found.beginning_sure


@pytest.mark.parametrize("seed", [1])
def test_noise_has_no_period(seed):
    noise = np.random.default_rng(seed).bytes(8_000)
    assert find_period(noise) is None
    assert analyse(noise, 1.0) is None
    assert find_frames_of_variable_length(noise) is None


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xa5",
        bytes(5000),
        b"\xff\x00" * 3000,
        bytes(range(256)) * 20,
        b"\xa5\x5a\x01\x02" * 400,
        b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9\r\n" * 90,
    ],
)
def test_streams_that_hold_no_numbers_are_no_packets(data):
    assert analyse(data, 1.0) is None
    assert find_frames_of_variable_length(data) is None


@settings(max_examples=25)
@given(
    st.one_of(st.binary(max_size=3000), st.binary(min_size=2, max_size=40).map(lambda b: b * 90))
)
def test_no_bytes_break_the_analysis(data):
    kinds = analyse_kinds(data, 1.0)
    if kinds:
        protocol_from_dict(tomllib.loads(draft_layout(kinds, "any")))
    find_frames_of_variable_length(data)


def test_frames_of_variable_length_are_found_by_their_length_byte():
    rng = np.random.default_rng(1)
    frames = []
    for number in range(300):
        body = bytes([(12, 33, 60)[number % 3] if number % 7 else 5, number % 256])
        body += rng.bytes(body[0])
        frames.append(b"\xb5\x62" + body + bytes([sum(body) % 256]))
    del frames[100]
    frames[200] = frames[200][:9]
    found = find_frames_of_variable_length(b"".join(frames)[11:])
    assert (found.header, found.length_at, found.overhead) == (b"\xb5\x62", 2, 5)
    assert set(found.lengths) >= {17, 38, 65, 10}


def test_packets_of_one_length_are_no_frames_of_variable_length():
    _, data = still_packets()
    assert find_frames_of_variable_length(data) is None


@pytest.mark.parametrize("begin", range(0, 8000, 800))
def test_a_measurement_behind_a_byte_that_stays_is_no_length(begin):
    """A slow signal is 0 or -1 in its high byte, and what the others do next is chance."""
    layout = PacketLayout(
        name="slow",
        title="",
        byte_order="big",
        header=b"\xc3\x3c\x11",
        fields=(
            Field("seq", "u16"),
            Field("time", "u32"),
            Field("status", "u8"),
            Field("axes", "i16", count=6),
        ),
        checksum=Checksum("crc16-ccitt-false"),
    )
    rng, number = np.random.default_rng(begin), begin + np.arange(150)
    t = number / RATE_HZ
    turn = 0.5 * np.sin(0.8 * t)
    level = np.full(150, 6.6)
    axes = np.stack(
        [
            8192 * np.sin(turn),
            246 * np.sin(1.3 * t),
            8192 * np.cos(turn),
            level,
            752 * np.cos(0.8 * t),
            -2 * level,
        ],
        axis=1,
    )
    columns = {
        "seq": number % (1 << 16),
        "time": 5_000_000 + 10_000 * number,
        "status": np.full(150, 0x20),
        "axes": np.rint(axes + rng.normal(0, [12, 12, 12, 4, 4, 4], (150, 6))).astype(int),
    }
    data = encode(layout, columns)[begin % 24 :]
    assert find_frames_of_variable_length(data) is None
    assert analyse(data, 1.5).header == b"\xc3\x3c"


def woven(protocol, seconds=3.0):
    """Packets of every stream at its own rate, in the order of time."""
    due, made = [], {}
    for place, (name, layout) in enumerate(protocol.streams.items()):
        number = round(seconds * layout.rate_hz)
        made[name] = DevicePackets(layout, layout.rate_hz, place + 1).make(0, number)
        due += [(n / layout.rate_hz + 0.001 * place, name, n) for n in range(number)]
    parts = []
    for _, name, number in sorted(due):
        length = protocol.streams[name].length
        parts.append(made[name][number * length : (number + 1) * length])
    return b"".join(parts)


@pytest.mark.parametrize("name", ["two-imu", "waist-unit"])
def test_several_kinds_of_packets_become_several_streams(name):
    protocol = load_protocol(name)
    data = woven(protocol)
    kinds = analyse_kinds(data[9:], 3.0)
    assert len(kinds) == len(protocol.streams)
    drafted = protocol_from_dict(tomllib.loads(draft_layout(kinds, "drafted")))
    for kind, layout in zip(kinds, protocol.streams.values(), strict=True):
        assert kind.length == layout.length
        assert layout.header.startswith(kind.header) or kind.header.startswith(layout.header)
        assert kind.checksum.kind == layout.checksum.kind
        assert kind.rate_hz == pytest.approx(layout.rate_hz, rel=0.03)
        assert tick_s(kind.clock.step, kind.rate_hz) == (layout.clock_tick_s, True)
    sent = protocol.decoder().feed(data)
    found = drafted.decoder().feed(data)
    assert [len(p) for p in found.values()] == [len(p) for p in sent.values()]


def test_of_a_sensor_at_rest_gravity_is_among_the_axes_that_stand_together():
    layout = PacketLayout(
        name="rest",
        title="",
        byte_order="little",
        header=b"\xa5\x5a",
        fields=(Field("seq", "u8"), Field("accel", "i16", count=3), Field("gyro", "i16", count=3)),
        checksum=Checksum("crc16-modbus"),
    )
    rng = np.random.default_rng(8)
    columns = {
        "seq": np.arange(PACKETS) % 256,
        "accel": np.rint(rng.normal([-90, 110, 4270], 20, (PACKETS, 3))).astype(int),
        "gyro": np.rint(rng.normal([3, 50, -70], 2, (PACKETS, 3))).astype(int),
    }
    drafted = tomllib.loads(draft_layout([analyse(encode(layout, columns), 3.0)], "drafted"))
    named = [(field["name"], field.get("count")) for field in drafted["fields"]]
    assert named == [("seq", None), ("accel", 3), ("raw1", 3)]
