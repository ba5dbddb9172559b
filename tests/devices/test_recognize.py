"""Bytes that are not what was expected, each told by what it is."""

import re
from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20.ardupilotmega import MAVLink

from firmware_protocols.interleaved import InterleavedProtocol
from firmware_protocols.known import builtin_protocols, load_protocol
from firmware_protocols.layout import Checksum, PacketLayout, load_layout
from firmware_protocols.packets import encode
from firmware_protocols.xsens_frames import encode_message
from imu_rig.devices.recognize import explain, explain_unknown, find_protocol, recognize

MPU = load_layout("mpu9150-28")
FOREIGN = replace(MPU, name="foreign-lab", header=b"\x7e\x81")


def stream(layout: PacketLayout, number=60, seed=1):
    rng = np.random.default_rng(seed)
    columns = {}
    for field in layout.fields:
        shape = (number, field.count) if field.count > 1 else (number,)
        if field.is_integer:
            low, high = field.limits
            columns[field.name] = rng.integers(low // 4, high // 4 + 1, shape)
        elif field.type != "pad":
            columns[field.name] = rng.normal(size=shape)
    return encode(layout, columns)


def interleaved(protocol, number=80, seed=2):
    """Packets of every kind in turns, the first three times as often."""
    streams = [
        (layout.length, stream(layout, number, seed)) for layout in protocol.streams.values()
    ]
    turns = [0, 0, 0, *range(1, len(streams))]
    sent, places = [], [0] * len(streams)
    for turn in (turns * number)[:number]:
        length, data = streams[turn]
        sent.append(data[places[turn] : places[turn] + length])
        places[turn] += length
    return b"".join(sent)


def mavlink(*messages, version=2, number=40):
    """What a flight controller sends, made by pymavlink."""
    made = MAVLink(None, srcSystem=1, srcComponent=1)
    sent = []
    for count in range(number):
        for message in messages:
            sent.append(message(count).pack(made, force_mavlink1=version == 1))
            made.seq = (made.seq + 1) % 256
    return b"".join(sent)


def heartbeat(count):
    return ardupilotmega.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)


def highres(count):
    return ardupilotmega.MAVLink_highres_imu_message(
        10_000 * count, 0.1, 0.2, -9.8, 0.0, 0.01, 0.0, 0.2, 0.0, 0.4, 1013.0, 0.0, 0.0, 31.0, 8191
    )


def scaled(count):
    return ardupilotmega.MAVLink_scaled_imu_message(10 * count, 3, 4, -1000, 1, 2, 3, 200, 0, 400)


def raw(count):
    return ardupilotmega.MAVLink_raw_imu_message(10 * count, 3, 4, -1000, 1, 2, 3, 200, 0, 400)


# the worked examples of the manual's two formats
LEGACY = bytes.fromhex(
    "FA FF 32 36 00000000 00000000 411CF5C3 00000000 00000000 00000000 3F000000 00000000 BF4CCCCD "
    "3F800000 00000000 00000000 00000000 1234 9C"
)
MTDATA2 = bytes.fromhex(
    "FA FF 36 4C 1020 02 1234 1060 04 0001E240 4020 0C 00000000 00000000 411CF5C3 8020 0C "
    "00000000 00000000 00000000 C020 0C 3F000000 00000000 BF4CCCCD 2010 10 3F800000 00000000 "
    "00000000 00000000 75"
)


def packets_of(name):
    protocol = load_protocol(name)
    if isinstance(protocol, PacketLayout):
        return stream(protocol)
    if isinstance(protocol, InterleavedProtocol):
        return interleaved(protocol)
    return {
        "mavlink-highres": lambda: mavlink(highres, heartbeat, scaled),
        "mavlink-scaled": lambda: mavlink(scaled, heartbeat),
        "mavlink-raw": lambda: mavlink(raw, heartbeat, version=1),
        "xsens-mti": lambda: MTDATA2 * 40,
        "xsens-mti-legacy": lambda: _with_temperature(LEGACY) * 40,
    }[name]()


def _with_temperature(frame):
    """The layout asks for the temperature too: four more bytes at the front."""
    data = bytes.fromhex("41F80000") + frame[4:-1]
    return encode_message(frame[2], data)


@pytest.mark.parametrize("name", list(builtin_protocols()))
def test_every_builtin_protocol_is_recognized_from_any_point_of_its_stream(name):
    data = packets_of(name)
    assert recognize(data).name == name
    assert recognize(data[13:-5]).name == name
    found = find_protocol(data)
    assert found.share > 0.95
    assert found.packets.keys() == load_protocol(name).streams.keys()
    if not name.startswith("mavlink"):
        assert sum(found.packets.values()) >= 39
    assert f"layout {name}: use that" in explain(data, FOREIGN, 115200)


def test_a_layout_of_ones_own_is_recognized_beside_the_built_in_ones():
    data = stream(FOREIGN)
    assert recognize(data) is None
    assert recognize(data, {**builtin_protocols(), "mine": FOREIGN}) is FOREIGN


def test_the_streams_that_are_heard_are_counted():
    waist = load_protocol("waist-unit")
    only_one = stream(next(iter(waist.streams.values())))
    found = find_protocol(only_one, {"waist-unit": waist})
    assert list(found.packets.values()) == [60] + [0] * (len(waist.streams) - 1)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (mavlink(heartbeat, number=2), "speaks MAVLink (HEARTBEAT) but sends no IMU message"),
        (mavlink(heartbeat, number=30, version=1), "speaks version 1 of MAVLink"),
        (bytes.fromhex("FAFF3E00C3"), "has just woken up"),
        (bytes.fromhex("FAFF3100D0 FAFF0104003000 01CB"), "in its Config state"),
        (bytes.fromhex("FAFF420104BA"), "reports error 4"),
        (LEGACY * 30, "sends legacy MTData with 54 bytes"),
    ],
)
def test_known_devices_in_the_wrong_state_are_named(data, words):
    assert recognize(data) is None
    assert words in explain(data, MPU, 115200)
    assert words in explain_unknown(data, 115200)


@pytest.mark.parametrize("seed", range(20))
def test_noise_is_never_taken_for_a_layout(seed):
    noise = np.random.default_rng(seed).bytes(4096)
    assert recognize(noise) is None
    assert "baud rate (57600) is wrong" in explain(noise, MPU, 57600)


def test_a_sensor_that_fell_silent_is_not_blamed_for_its_layout():
    assert "fallen silent" in explain(stream(MPU), MPU, 115200)
    assert "fallen silent" in explain(stream(MPU) + bytes(500), MPU, 115200)


def test_a_wrong_checksum_and_a_wrong_length_are_told_apart():
    other_sum = replace(MPU, checksum=Checksum("crc16-modbus"))
    assert "another checksum" in explain(stream(other_sum), MPU, 115200)
    shorter = replace(MPU, fields=MPU.fields[:-1])
    said = explain(stream(shorter), MPU, 115200)
    assert f"every {shorter.length} bytes where the layout has 28" in said


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (bytes(500), "nothing but the byte 00"),
        (b"\xff\x00" * 300, "00 and FF"),
        (b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9\r\n" * 20, r"text .*GPGGA"),
        (b"\x01\x02\x03", "only 3 bytes"),
        (np.random.default_rng(30).bytes(30), "only 30 bytes"),
    ],
)
def test_other_streams_are_described(data, word):
    assert re.search(word, explain(data, MPU, 115200))
