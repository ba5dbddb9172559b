"""Bytes that are not what was expected, each told by what it is."""

import re
from dataclasses import replace

import numpy as np
import pytest

from firmware_protocols.known import builtin_protocols
from firmware_protocols.layout import Checksum, PacketLayout, load_layout
from firmware_protocols.packets import encode
from imu_rig.devices.recognize import explain, recognize

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


@pytest.mark.parametrize("name", list(builtin_protocols()))
def test_every_builtin_layout_is_recognized_from_any_point_of_its_stream(name):
    data = stream(load_layout(name))
    assert recognize(data).name == name
    assert recognize(data[13:-5]).name == name
    assert f"layout {name}: use that" in explain(data, FOREIGN, 115200)


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
