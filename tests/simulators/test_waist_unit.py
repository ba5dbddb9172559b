"""The simulated waist unit through its own bytes: accelerometer, barometer, what can be wrong."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_protocols import ms5803
from firmware_protocols.known import load_protocol
from firmware_protocols.layout import PacketLayout
from firmware_protocols.packets import counts, values
from imu_rig.imu_scaling import field_values, si_factors, si_values
from imu_rig.row_faults import CONVERSION_FAULT, CONVERTER_FAULT, PROM_FAULT, faults_of
from imu_rig.units import STANDARD_GRAVITY
from simulators.encoders import MadeSamples
from simulators.inertial_sensor import Readings
from simulators.ms5803_chip import Ms5803Chip, typical_prom
from simulators.waist_unit import WaistUnit

WAIST = load_protocol("waist-unit")
ACCEL, BAROMETER = WAIST.streams["accel"], WAIST.streams["barometer"]


def samples(accel, first=0, *, pressure=101_325.0, air_c=25.0):
    accel = np.atleast_2d(np.asarray(accel, dtype=float))
    n = len(accel)
    counter = first + np.arange(n)
    return MadeSamples(
        t=(counter + 1) / 100.0,
        device_s=(counter + 1) / 100.0,
        counter=counter,
        readings=Readings(
            accel=accel,
            gyro=np.full((n, 3), np.nan),
            mag=np.full((n, 3), np.nan),
            temperature=np.full(n, 25.0),
            saturated=np.zeros(n, dtype=bool),
            offsets=np.zeros((n, 6)),
        ),
        pressure=np.full(n, pressure),
        air_c=np.full(n, air_c),
    )


def unit(**options):
    chip = Ms5803Chip(typical_prom(), np.random.default_rng(1))
    made = WaistUnit(chip, **options)
    made.boot(0.0)
    return made


def at_rest(number):
    return np.tile([0.0, 0.0, STANDARD_GRAVITY], (number, 1))


def decoded(data):
    return WAIST.decoder().feed(b"".join(data))


@pytest.mark.parametrize(
    ("g_select", "per_g"), [(0, 992.97), (1, 744.727), (2, 372.364), (3, 248.242)]
)
def test_one_g_reads_one_g_at_every_setting(g_select, per_g):
    force = STANDARD_GRAVITY * np.array([[1.0, -1.0, 0.5], [-0.25, 0.0, 1.0]])
    rows = decoded(unit(g_select=g_select).encode(samples(force)))["accel"].rows
    read = si_values(ACCEL, rows, si_factors(ACCEL))["accel"]

    np.testing.assert_allclose(read, force, atol=0.51 * STANDARD_GRAVITY / per_g)
    assert counts(ACCEL, rows, "accel")[0, 0] == 2048 + round(per_g)
    assert values(ACCEL, rows, "supply")[0] == pytest.approx(3300.0, abs=1.0)


def test_a_tenth_of_the_samples_brings_a_barometer_packet():
    sent = unit().encode(samples(at_rest(100)))
    got = decoded(sent)

    assert [len(s) for s in sent] == [*[18] * 9, 50] * 10
    assert counts(BAROMETER, got["barometer"].rows, "seq").tolist() == list(range(10))
    np.testing.assert_array_equal(
        counts(BAROMETER, got["barometer"].rows, "time"), 100_000 * np.arange(1, 11)
    )


def test_the_barometer_tells_the_air():
    sent = unit().encode(samples(at_rest(1000), pressure=95_000.0, air_c=-5.0))
    columns, units = field_values(BAROMETER, decoded(sent)["barometer"].rows)

    assert units["pressure"] == "Pa"
    assert np.mean(columns["pressure"]) == pytest.approx(95_000.0, abs=5 * 2.4 / 10)
    assert np.mean(columns["temperature"]) == pytest.approx(-5.0, abs=0.01)
    assert faults_of(BAROMETER, decoded(sent)["barometer"].rows) == {}


def test_how_samples_are_cut_into_calls_changes_nothing():
    whole = unit().encode(samples(at_rest(95)))
    cut = unit()
    parts = [
        b"".join(cut.encode(samples(at_rest(n), first))) for first, n in ((0, 1), (1, 33), (34, 61))
    ]

    assert b"".join(parts) == b"".join(whole)


def test_a_damaged_prom_is_named_and_gives_no_pressure():
    of = unit()
    of.chip.damage_prom(2, 9)
    rows = decoded(of.encode(samples(at_rest(20))))["barometer"].rows
    columns, _ = field_values(BAROMETER, rows)

    assert np.isnan(columns["pressure"]).all()
    assert faults_of(BAROMETER, rows) == {PROM_FAULT: 1}


def test_beyond_the_range_the_accelerometer_stops_at_its_swing():
    rows = decoded(unit(g_select=0).encode(samples([[90.0, -90.0, 0.0]])))["accel"].rows

    assert counts(ACCEL, rows, "accel").tolist() == [[3786, 310, 2048]]


def test_a_setting_that_there_is_not_is_named_and_gives_no_acceleration():
    rows = decoded(unit().encode(samples(at_rest(3))))["accel"].rows
    rows["g_select"][1] = 7

    assert list(faults_of(ACCEL, rows)) == [
        "g_select is a setting that the layout does not know: no accel"
    ]
    assert np.isnan(values(ACCEL, rows, "accel")).any(axis=1).tolist() == [False, True, False]


@pytest.mark.parametrize("end", [0, 4095])
def test_a_converter_at_its_end_is_named(end):
    rows = decoded(unit().encode(samples(at_rest(3))))["accel"].rows
    rows["accel"][2, 1] = end

    assert faults_of(ACCEL, rows) == {CONVERTER_FAULT.format("accel"): 2}


@pytest.mark.parametrize("raw", ["d1", "d2"])
def test_a_reading_of_more_than_24_bits_is_named(raw):
    """A layout may hold D1 and D2 in 32 bits."""
    described = BAROMETER.to_dict()
    for field in described["fields"]:
        field["type"] = "u32" if field["name"] in ("d1", "d2") else field["type"]
    wide = PacketLayout.from_dict(described)
    rows = np.zeros(2, wide.dtype)
    rows["prom"], rows["d1"], rows["d2"] = typical_prom("02BA"), 6_465_444, 8_077_636
    rows[raw][1] |= 1 << 30

    assert faults_of(wide, rows) == {CONVERSION_FAULT: 1}
    assert np.isnan(field_values(wide, rows)[0]["pressure"]).tolist() == [False, True]


def test_a_conversion_that_was_not_over_is_named_and_gives_no_pressure():
    rows = decoded(unit().encode(samples(at_rest(30))))["barometer"].rows
    rows["d1"][1] = 0

    assert faults_of(BAROMETER, rows) == {CONVERSION_FAULT: 1}
    assert np.isnan(field_values(BAROMETER, rows)[0]["pressure"]).tolist() == [False, True, False]


def test_the_two_sensors_need_a_fifth_of_a_115200_line():
    assert WAIST.bytes_per_s == 100 * 18 + 10 * 32
    assert WAIST.bytes_per_s * 10 < 0.2 * 115_200


def test_a_packet_of_the_barometer_is_decoded_by_itself():
    """Any one packet, without anything that came before."""
    data = b"".join(unit().encode(samples(at_rest(40))))
    one = data[-32:]
    row = WAIST.decoder().feed(one)["barometer"].rows
    pressure, _ = ms5803.compensate(
        "02BA",
        counts(BAROMETER, row, "prom"),
        counts(BAROMETER, row, "d1"),
        counts(BAROMETER, row, "d2"),
    )

    assert pressure[0] == pytest.approx(101_325.0, abs=15.0)
