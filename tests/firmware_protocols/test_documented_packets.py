"""The worked examples of the documents are what they say they are."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from firmware_protocols.checksums import SIZES
from firmware_protocols.fields import TYPE_SIZES, Field
from firmware_protocols.interleaved import InterleavedProtocol
from firmware_protocols.known import load_protocol, protocol_from_dict
from firmware_protocols.layout import PacketLayout
from firmware_protocols.packets import values
from imu_rig.imu_scaling import field_values
from imu_rig.row_faults import CONVERSION_FAULT, PROM_FAULT, faults_of

DOCS = Path(__file__).parents[2] / "docs"


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)


@pytest.fixture(scope="module")
def shank():
    return protocol_from_dict(tomllib.loads(blocks("own-packets.md", "toml")[0]))


@pytest.fixture(scope="module")
def pair():
    return protocol_from_dict(tomllib.loads(blocks("own-packets.md", "toml")[1]))


def packet(page, number):
    return bytes.fromhex(blocks(page, "hex")[number])


def test_the_shank_units_packet_says_what_the_page_says(shank):
    data = packet("own-packets.md", 0)
    rows = shank.decoder().feed(data)[""].rows
    columns, units = field_values(shank, rows)

    assert isinstance(shank, PacketLayout)
    assert shank.length == len(data) == 24
    assert rows["seq"].tolist() == [7]
    assert values(shank, rows, "time")[0] * shank.clock_tick_s == 1.5
    assert columns["foot_switch"].tolist() == [1.0]
    assert columns["state"].tolist() == [2.0]
    np.testing.assert_allclose(values(shank, rows, "accel"), [[0, 0, 1]])
    np.testing.assert_allclose(values(shank, rows, "gyro"), [[10, 0, 0]])
    assert columns["temperature"][0] == pytest.approx(25.0, abs=0.001)
    assert units["accel"] == "m/s2"
    assert faults_of(shank, rows) == {}


def test_the_shank_units_faults_are_named(shank):
    rows = shank.decoder().feed(packet("own-packets.md", 0))[""].rows
    rows["state"] |= 1 << 6

    assert list(faults_of(shank, rows)) == ["battery is low"]


def test_the_two_streams_packets_are_those_of_the_page(pair):
    got = pair.decoder().feed(packet("own-packets.md", 1))

    assert isinstance(pair, InterleavedProtocol)
    assert values(pair.streams["shank"], got["shank"].rows, "accel").tolist() == [[0, 0, 1000]]
    assert values(pair.streams["sole"], got["sole"].rows, "load").tolist() == [[10, 0, 0, 100]]
    assert values(pair.streams["sole"], got["sole"].rows, "time").tolist() == [50]


def test_the_barometers_packet_is_the_printed_example():
    layout = load_protocol("ms5803-32")
    data = packet("barometer.md", 0)
    rows = layout.decoder().feed(data)[""].rows
    columns, _ = field_values(layout, rows)

    assert len(data) == 32
    assert columns["pressure"].tolist() == [110_002.0]
    assert columns["temperature"].tolist() == [20.0]


def test_a_copy_with_another_variant_is_a_layout():
    data = load_protocol("ms5803-32").to_dict()
    data |= tomllib.loads(blocks("barometer.md", "toml")[0])

    assert protocol_from_dict(data).barometer.variant == "14BA"


def test_every_key_type_and_checksum_is_on_the_page():
    text = (DOCS / "own-packets.md").read_text()
    words = set(re.findall(r"`\[?([a-z][a-z0-9_-]*)\]?`", text))

    assert words >= set(Field.__dataclass_fields__)
    assert words >= set(PacketLayout.__dataclass_fields__)
    assert words >= {*TYPE_SIZES, *SIZES, "none", "kind", "start", "streams"}


def test_every_fault_of_a_barometer_is_on_its_page():
    text = (DOCS / "barometer.md").read_text()

    assert PROM_FAULT in text
    assert CONVERSION_FAULT in text
