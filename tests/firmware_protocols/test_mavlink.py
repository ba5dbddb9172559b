"""A flight controller's messages as rows: units, axes, what is absent, and whose they are."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_writer import Writer

from firmware_protocols.fields import LayoutError
from firmware_protocols.known import load_protocol, protocol_from_dict
from firmware_protocols.mavlink import IMU_MESSAGES, MavlinkProtocol
from firmware_protocols.packets import flag, values

HIGHRES = load_protocol("mavlink-highres")
SCALED = load_protocol("mavlink-scaled")
RAW = load_protocol("mavlink-raw")
INT16 = st.integers(-32768, 32767)
TRIAD = st.tuples(INT16, INT16, INT16)


BEAT = Writer().heartbeat()
"""Of the flight controller, system 1 component 1: what it sends counts from here on."""


def decoded(protocol, data):
    decoder = protocol.decoder()
    return decoder.feed(BEAT + data), decoder


def imu(protocol, data, name):
    packets, _ = decoded(protocol, data)
    return values(protocol.streams["imu"], packets["imu"].rows, name)


def middle(number):
    """Of what was cut off to this whole number."""
    return number + 0.5 * (number > 0) - 0.5 * (number < 0)


def test_level_and_at_rest_the_accelerometer_reads_plus_g_upward():
    """zacc is -9.81 m/s2 or -1000 mg on MAVLink's axes, forward, right, down."""
    np.testing.assert_allclose(imu(HIGHRES, Writer().highres(), "accel"), [[0, 0, 9.81]], rtol=1e-6)
    assert imu(SCALED, Writer().scaled(), "accel").tolist() == [[0, 0, 1000.5]]
    assert SCALED.streams["imu"].field("accel").unit == "mg"


@pytest.mark.parametrize("name", ["accel", "gyro", "mag"])
def test_axes_turn_from_forward_right_down_to_forward_left_up(name):
    data = Writer().highres(acc=(1, 2, 3), gyro=(1, 2, 3), mag=(1, 2, 3))
    assert imu(HIGHRES, data, name).tolist() == [[1, -2, -3]]
    data = Writer().scaled(acc=(1, 2, 3), gyro=(1, 2, 3), mag=(1, 2, 3))
    assert imu(SCALED, data, name).tolist() == [[1.5, -2.5, -3.5]]


@settings(max_examples=40)
@given(acc=TRIAD, gyro=TRIAD, mag=TRIAD, t=st.integers(0, 2**32 - 1))
def test_whole_numbers_come_back_over_their_whole_range(acc, gyro, mag, t):
    """As the middle of the step that they were cut off from."""
    for name in ("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "RAW_IMU"):
        protocol = MavlinkProtocol("test", message=name)
        packets, _ = decoded(protocol, Writer()(name, t, *acc, *gyro, *mag))
        rows = packets["imu"].rows
        assert rows["time"].tolist() == [t]
        assert rows["accel"].tolist() == [[middle(n) for n in acc]]
        assert rows["gyro"].tolist() == [[middle(n) for n in gyro]]
        if any(mag):
            assert rows["mag"].tolist() == [[middle(n) for n in mag]]
        assert np.trunc(rows["accel"]).tolist() == [list(acc)]


FLOAT = st.floats(width=32, allow_nan=False)


@settings(max_examples=40)
@given(
    numbers=st.lists(FLOAT, min_size=9, max_size=9),
    pressure=FLOAT,
    celsius=FLOAT,
    t=st.integers(0, 2**64 - 1),
)
def test_floating_point_comes_back_over_its_whole_range(numbers, pressure, celsius, t):
    writer = Writer()
    data = writer("HIGHRES_IMU", t, *numbers, pressure, 0, 0, celsius, 0x1FFF)
    rows = decoded(HIGHRES, data)[0]["imu"].rows
    assert rows["time"].tolist() == [t % 2**32]  # of the microseconds the lower half
    assert rows["accel"].tolist() == [numbers[:3]]
    assert rows["gyro"].tolist() == [numbers[3:6]]
    assert rows["temperature"].tolist() == [celsius]
    if any(numbers[6:]):
        assert rows["mag"].tolist() == [numbers[6:]]
    if pressure:
        assert rows["pressure"].tolist() == [pressure]


def test_what_a_missing_sensor_leaves_zero_is_no_measurement():
    data = Writer()("HIGHRES_IMU", 5, 0, 0, -9.81, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0b111111)
    assert np.isnan(imu(HIGHRES, data, "mag")).all()
    assert np.isnan(imu(HIGHRES, data, "pressure")).all()
    assert np.isnan(imu(HIGHRES, data, "temperature")).all()
    freezing = Writer()("HIGHRES_IMU", 5, *[0] * 9, 1000, 0, 0, 0.0, 1 << 12)
    assert imu(HIGHRES, freezing, "temperature").tolist() == [0.0]
    assert np.isnan(imu(SCALED, Writer().scaled(mag=(0, 0, 0)), "mag")).all()
    assert np.isnan(imu(SCALED, Writer().scaled(), "temperature")).all()  # 0 means none
    warm = Writer()("SCALED_IMU", 5, *[1] * 9, 2550)
    assert imu(SCALED, warm, "temperature").tolist() == [25.5]


def test_fields_updated_become_flags():
    layout = HIGHRES.streams["imu"]
    data = Writer().highres(updated=0b111111) + Writer().highres(1, updated=0b1001111111111)
    rows = decoded(HIGHRES, data)[0]["imu"].rows
    expected = {"accel": [1, 1], "gyro": [1, 1], "mag": [0, 1], "pressure": [0, 1]}
    bits = dict(layout.field("updated").flags)
    for name, seen in expected.items():
        assert flag(layout, rows, "updated", bits[f"{name}_updated"]).tolist() == seen


def test_pressure_is_a_stream_of_its_own():
    writer = Writer()
    data = writer.highres() + writer("SCALED_PRESSURE", 1234, 1013.25, 0.0, -1234)
    packets, _ = decoded(HIGHRES, data)
    layout, rows = HIGHRES.streams["pressure"], packets["pressure"].rows
    assert layout.clock_tick_s == 1e-3
    assert rows["time"].tolist() == [1234]
    assert values(layout, rows, "pressure").tolist() == [1013.25]
    assert values(layout, rows, "temperature").tolist() == [-12.34]
    assert packets["pressure"].end.tolist() == [len(BEAT + data)]


def test_extension_fields_are_absent_in_version_1():
    writer = Writer(version=1)
    packets, _ = decoded(SCALED, writer.scaled(9) + writer("SCALED_PRESSURE", 1, 1000, 0, 5))
    assert packets["imu"].rows["accel"].tolist() == [[0, 0, -1000.5]]
    assert np.isnan(packets["imu"].rows["temperature"]).all()
    assert len(packets["pressure"]) == 1


def test_the_sensor_of_a_message_can_be_asked_for():
    writer = Writer()
    data = b"".join(
        writer("HIGHRES_IMU", k, *[1.0] * 9, 1000, 0, 0, 20, 0x1FFF, k % 2) for k in range(6)
    )
    assert decoded(HIGHRES, data)[0]["imu"].rows["time"].tolist() == [0, 2, 4]
    second = protocol_from_dict({**HIGHRES.to_dict(), "sensor": 1})
    assert decoded(second, data)[0]["imu"].rows["time"].tolist() == [1, 3, 5]


@settings(max_examples=8)
@given(seed=st.integers(0, 2**32), cuts=st.lists(st.floats(0, 1), max_size=5))
def test_rows_do_not_depend_on_chunks(seed, cuts):
    rng = np.random.default_rng(seed)
    writers = [Writer(1, 1), Writer(2, 1), Writer(1, 1, version=1)]
    pieces = []
    for k in range(20):
        writer = writers[rng.choice(3, p=[0.6, 0.2, 0.2])]
        what = rng.integers(6)
        if what == 0:
            pieces.append(writer("SCALED_PRESSURE", k, 1000 + k, 0, 0))
        elif what == 1:
            pieces.append(rng.bytes(int(rng.integers(1, 20))))
        elif what == 2:
            pieces.append(writer.heartbeat(*((6, 8) if k % 2 else (2, 3))))
        else:
            pieces.append(writer.scaled(k * 300))
    data = b"".join(pieces)
    one_piece = SCALED.decoder()
    whole = one_piece.feed(data)
    told = one_piece.take_faults()
    for places in ([int(c * len(data)) for c in cuts], [len(data) // 2], range(len(data))):
        edges = [0, *sorted(places), len(data)]
        decoder = SCALED.decoder()
        parts = [decoder.feed(data[a:b]) for a, b in pairwise(edges)]
        for name, expected in whole.items():
            rows = np.concatenate([part[name].rows for part in parts])
            assert rows.tobytes() == expected.rows.tobytes()
            ends = np.concatenate([part[name].end for part in parts])
            assert ends.tolist() == expected.end.tolist()
        assert decoder.stats == one_piece.stats
        assert (decoder.sender, decoder.others) == (one_piece.sender, one_piece.others)
        assert decoder.take_faults() == told


def test_the_clock_of_microseconds_comes_round_without_a_seam():
    t = 2**32 - 5_000 + 10_000 * np.arange(4)
    writer = Writer()
    data = b"".join(writer.highres(int(k) + 3 * 2**32) for k in t)
    rows = decoded(HIGHRES, data)[0]["imu"].rows
    assert np.diff(rows["time"].astype(np.int64)).tolist() == [10_000 - 2**32, 10_000, 10_000]


@pytest.mark.parametrize("name", ["mavlink-highres", "mavlink-scaled", "mavlink-raw"])
def test_built_in_protocols_are_kept_in_trial_files(name):
    protocol = load_protocol(name)
    assert protocol_from_dict(protocol.to_dict()) == protocol
    assert protocol.to_dict()["kind"] == "mavlink"
    assert protocol.message in IMU_MESSAGES
    assert protocol.inertial_streams == ("imu",)
    assert protocol.proves_packets
    assert 2_000 < protocol.bytes_per_s < 11_520  # fits a port of 115200 baud


def test_a_file_may_ask_for_system_component_and_rate(tmp_path):
    path = tmp_path / "second.toml"
    asked = MavlinkProtocol("second", "", "SCALED_IMU2", 3, 4, None, 50)
    path.write_text(asked.to_toml())
    assert load_protocol(path) == asked
    assert load_protocol(path).streams["imu"].rate_hz == 50


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"message": "ATTITUDE"}, "message 'ATTITUDE' is not known, take one of HIGHRES_IMU"),
        ({"system": 256}, "system must be 0 to 255"),
        ({"system": "1"}, "system must be a whole number"),
        ({"component": True}, "component must be a whole number"),
        ({"rate_hz": 0}, "rate_hz must be 0.01 to 8000"),
        ({"rate_hz": math.nan}, "rate_hz must be 0.01 to 8000"),
        ({"rate_hz": 5e-324}, "rate_hz must be 0.01 to 8000"),
        ({"rate_hz": 10**400}, "rate_hz is too large a number"),
        ({"baud": 9600}, "the key 'baud' is not known"),
        ({"name": "a b"}, "name 'a b' cannot be used"),
    ],
)
def test_a_description_that_cannot_be_used_is_refused_in_one_sentence(change, words):
    with pytest.raises(LayoutError, match=words):
        protocol_from_dict({**HIGHRES.to_dict(), **change})
    with pytest.raises(LayoutError, match="'name' is missing"):
        protocol_from_dict({"kind": "mavlink"})
