"""Devices that a person carries: the bytes of every kind, alike in one go and piece by piece."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_protocols.known import load_protocol
from firmware_protocols.packets import values
from imu_rig.altitude import altitude, pressure_at
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.imu_kinds import IMU_KINDS
from simulators.walker.air import weather
from simulators.walker.device import Carried, CarriedDevice, worn_sensor
from simulators.walker.field import MagneticField, building_field
from simulators.walker.path import Straight
from simulators.walker.record import record_walk
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Surroundings, Walker

SHORT = Scenario("short", "Short", (Stand(0.5), Walk((Straight(1.4),)), Stand(0.2)))
PERSON = Walker(SHORT, 5)
ASKED = ("xsens-mti", "xsens-mti-legacy")
"""Kinds that send nothing of use before they are asked."""


def rows_of(record):
    decoder = load_protocol(record.protocol).decoder()
    decoded = decoder.feed(b"".join(data for _, data in record.chunks))
    return {name: packets.rows for name, packets in decoded.items()}, decoder.stats


@pytest.mark.parametrize("kind", [kind for kind in IMU_KINDS if kind not in ASKED])
def test_every_kind_sends_its_packets(kind):
    record = record_walk(PERSON, [Carried("left-foot", kind)], until_s=2.0)["left-foot"]
    rows, stats = rows_of(record)
    assert record.protocol == IMU_KINDS[kind].protocol
    assert (stats.lost, stats.corrupt, stats.skipped_bytes) == (0, 0, 0)
    most = max(len(part) for part in rows.values())
    assert most >= 2.0 * IMU_KINDS[kind].output_hz - 2
    arrivals = [t for t, _ in record.chunks]
    assert arrivals == sorted(arrivals)


def test_packets_hold_the_means_of_the_motion_and_the_clock_of_the_truth():
    record = record_walk(PERSON, [Carried("waist", "mpu9150")], exact=True)["waist"]
    rows, _ = rows_of(record)
    unit = record.units[0]
    layout = load_protocol(record.protocol)
    sent = rows[""][: len(unit)]
    assert len(unit) == len(sent) > 200
    assert np.array_equal(sent["seq"], unit.counter % 256)
    assert np.abs(sent["time"] * 1e-6 - unit.device_s).max() < 1e-6
    accel = values(layout, sent, "accel") * STANDARD_GRAVITY
    gyro = values(layout, sent, "gyro") * DEG
    assert np.abs(accel - unit.means.force).max() < 0.51 * STANDARD_GRAVITY / 4096
    assert np.abs(gyro - unit.means.rate).max() < 0.51 * DEG / 32.8
    assert np.abs(unit.means.force - unit.truth.force).max() > 0.01  # a mean is not the last value


def test_errors_are_those_of_the_kind_and_of_the_seed():
    devices = [Carried("left-foot", "mpu9150"), Carried("right-foot", "mpu9150")]
    one, same, other = (record_walk(PERSON, devices, seed, until_s=1.0) for seed in (1, 1, 2))
    assert one["left-foot"].chunks == same["left-foot"].chunks
    assert one["left-foot"].chunks != other["left-foot"].chunks
    unit = one["left-foot"].units[0]
    still = unit.t < 0.4
    wrong = np.abs((unit.accel - unit.means.force)[still].mean(axis=0))
    assert 0.01 < wrong.max() < 1.5
    assert np.abs(unit.gyro[still].mean(axis=0)).max() < 6.0 * DEG
    assert one["right-foot"].units[0].place == "right-foot"


def test_the_sensor_of_a_walk_can_be_had_for_its_calibration():
    for name, kind in (("left-foot", "mpu9150"), ("right-foot", "xsens-mti")):
        device = CarriedDevice(Carried(name, kind), Walker("level-10m"), 7)
        assert device.sensors[""].model == worn_sensor(name, kind, 7)
    assert worn_sensor("left-foot", "mpu9150", 8) != worn_sensor("left-foot", "mpu9150", 7)


def test_two_units_of_one_receiver_are_at_foot_and_waist():
    record = record_walk(PERSON, [Carried("feet", "two-imu")])["feet"]
    foot, waist = record.units
    assert (foot.name, foot.place) == ("feet/foot", "left-foot")
    assert (waist.name, waist.place) == ("feet/waist", "waist")
    assert np.array_equal(foot.t, waist.t)
    rows, _ = rows_of(record)
    layouts = load_protocol(record.protocol).streams
    rates = {name: values(layouts[name], rows[name], "gyro") for name in ("foot", "waist")}
    assert np.abs(rates["foot"]).max() > 300.0 > 3.0 * np.abs(rates["waist"]).max()


def test_how_time_is_cut_into_looks_changes_nothing():
    whole = CarriedDevice(Carried("left-foot", "mpu9150"), PERSON, 3, begin_s=0.7)
    whole.advance(2.5)
    pieces = CarriedDevice(Carried("left-foot", "mpu9150"), PERSON, 3, begin_s=math.inf)
    rng = np.random.default_rng(0)
    t, taken = 0.0, []
    while t < 2.5:
        t = min(t + float(rng.uniform(0.0, 0.08)), 2.5)
        if t > 0.3 and math.isinf(pieces.begin_s):
            pieces.begin(0.7)
        pieces.advance(t)
        taken += pieces.take(t)
    assert taken == whole.take(2.5)
    assert len(taken) > 20


def test_a_device_that_is_asked_answers_and_goes_on():
    device = CarriedDevice(Carried("left-foot", "xsens-mti"), PERSON)
    device.advance(0.5)
    device.take(0.5)
    device.receive(bytes.fromhex("FAFF3000D1"), 0.5)  # GoToConfig
    device.advance(0.7)
    answer = b"".join(data for _, data in device.take(0.7))
    assert bytes.fromhex("FAFF3100D0") in answer
    device.receive(bytes.fromhex("FAFF1000F1"), 0.7)  # GoToMeasurement
    device.advance(1.2)
    assert len(b"".join(data for _, data in device.take(1.2))) > 500


def test_iron_changes_the_field_along_the_way_by_what_is_asked_for():
    for share in (0.05, 0.15):
        person = Walker("corridor", 2, surroundings=Surroundings(magnetic=share))
        t = np.arange(0.0, person.end_s, 0.1)
        norm = np.linalg.norm(person.sensor("waist").at(t).field, axis=1)
        assert norm.std() / norm.mean() == pytest.approx(share, rel=0.25)
    foot = np.linalg.norm(person.sensor("left-foot").at(t).field, axis=1)
    assert np.abs(foot - norm).max() > 3.0  # elsewhere it is another field


def test_iron_is_felt_all_along_the_way_and_by_the_feet_too():
    for seed in range(1, 6):
        person = Walker("straight-50m", seed)
        t = np.arange(5.0, person.end_s - 5.0, 0.2)
        for place in ("left-foot", "waist"):
            norm = np.linalg.norm(person.sensor(place).at(t).field, axis=1)
            assert 0.05 < norm.std() / norm.mean() < 0.3
            assert norm.max() < 150.0
            quarters = [part.std() / norm.mean() for part in np.array_split(norm, 4)]
            assert np.sort(quarters)[1] > 0.01  # more than one spot


def test_the_field_of_iron_has_neither_sources_nor_eddies():
    rng = np.random.default_rng(4)
    field = building_field(np.stack([np.linspace(0, 9, 50), *np.zeros((2, 50))], axis=1), rng)
    # one piece, from further off than its size: a dipole
    iron = MagneticField(np.zeros(3), np.zeros((1, 3)), field.moments[:1])
    here, step = rng.uniform(30.0, 40.0, (20, 3)), 1e-3
    slopes = np.stack(
        [(iron.at(here + d) - iron.at(here - d)) / (2 * step) for d in step * np.eye(3)], axis=1
    )
    size = np.abs(slopes).max(axis=(1, 2))
    assert np.abs(np.trace(slopes, axis1=1, axis2=2) / size).max() < 0.01
    assert np.abs((slopes - slopes.transpose(0, 2, 1)) / size[:, None, None]).max() < 0.01


def test_the_air_follows_height_and_drifts_as_barometers_do():
    air = weather(np.random.default_rng(1), 3600.0)
    t = np.arange(0.0, 3600.0, 60.0)
    level = air.pressure(t, np.zeros_like(t))
    drifts = [
        np.diff(altitude(weather(np.random.default_rng(seed), 3600.0).pressure(t, 0.0 * t)))
        for seed in range(10)
    ]
    assert 0.06 < np.median(np.abs(drifts)) < 0.3  # m in a minute, with doors
    higher = air.pressure(t, np.full_like(t, 10.0))
    assert altitude(higher) - altitude(level) == pytest.approx(10.0, rel=2e-2)
    person = Walker("stairs-up", surroundings=Surroundings(drift_m_per_min=0.0, still=True))
    waist = record_walk(person, [Carried("waist", "waist-unit")])["waist"].units[0]
    climbed = altitude(waist.pressure[-50:]).mean() - altitude(waist.pressure[:50]).mean()
    assert climbed == pytest.approx(20 * 0.17, abs=0.02)


def test_the_air_is_as_restless_as_the_documentation_says():
    t = np.arange(0.0, 600.0, 60.0)
    quiet = [weather(np.random.default_rng(seed), 600.0) for seed in range(60)]
    calm = [replace(air, gusts=air.gusts[:0], doors=air.doors[:0]) for air in quiet]
    drifts = [np.diff(altitude(air.pressure(t, 0.0 * t))) for air in calm]
    assert np.sqrt(np.mean(np.square(drifts))) == pytest.approx(0.1, rel=0.25)
    pascals_per_metre = float(pressure_at(0.0) - pressure_at(1.0))
    assert quiet[0].noise_pa / pascals_per_metre == pytest.approx(0.07, rel=0.02)


def test_places_follow_from_names_and_what_is_not_there_is_named():
    told = {
        "left foot": "left-foot",
        "right_foot": "right-foot",
        "waist": "waist",
        "x": "left-foot",
    }
    for name, place in told.items():
        assert Carried(name, "mpu9150").worn_at() == place
    with pytest.raises(ValueError, match="no kind of IMU 'abc'; take one of mpu9150"):
        CarriedDevice(Carried("a", "abc"), PERSON)
    with pytest.raises(ValueError, match="a: there is no place 'head'; take left-foot, right-foot"):
        CarriedDevice(Carried("a", "mpu9150", "head"), PERSON)
    with pytest.raises(ValueError, match="two devices 'a'; name them apart"):
        record_walk(PERSON, [Carried("a", "mpu9150"), Carried("a", "mpu9150")])
    with pytest.raises(ValueError, match="nobody carries a device"):
        record_walk(PERSON, [])
