"""What is wrong with a waist unit or one unit of two, named by the driver of the port."""

import os
import time
import tty
from contextlib import contextmanager

import numpy as np
import pytest

from firmware_protocols.known import load_protocol
from imu_rig.clock import SteppedClock
from imu_rig.devices.stream_device import PacketDevice
from imu_rig.row_faults import CONVERTER_FAULT, PROM_FAULT
from imu_rig.units import STANDARD_GRAVITY
from simulators.encoders import MadeSamples
from simulators.inertial_sensor import Readings
from simulators.ms5803_chip import Ms5803Chip, typical_prom
from simulators.two_imu import TwoImuReceiver, UnitLink
from simulators.waist_unit import WaistUnit

PATIENCE_S = 10.0


class Feeder:
    """A device that lies still and writes to a port, on the host's clock."""

    def __init__(self, encoder, descriptor, clock):
        self.encoder = encoder
        encoder.boot(0.0)
        self._descriptor, self._clock, self._made = descriptor, clock, 0

    def run(self, seconds):
        number = round(seconds * self.encoder.sample_hz)
        index = self._made + np.arange(number)
        self._made += number
        t = (index + 1) / self.encoder.sample_hz
        readings = Readings(
            accel=np.tile((0.0, 0.0, STANDARD_GRAVITY), (number, 1)) + 0.1 * np.sin(9 * t)[:, None],
            gyro=np.zeros((number, 3)),
            mag=np.zeros((number, 3)),
            temperature=np.full(number, 25.0),
            saturated=np.zeros(number, bool),
            offsets=np.zeros((number, 6)),
        )
        air = np.full(number, 101_325.0), np.full(number, 25.0)
        data = b"".join(self.encoder.encode(MadeSamples(t, t, index, readings, *air)))
        self._clock.advance(seconds)
        assert os.write(self._descriptor, data) == len(data)


@contextmanager
def plugged(encoder, protocol):
    device, host = os.openpty()
    tty.setraw(host)
    clock = SteppedClock(10**9)
    driver = PacketDevice("unit", os.ttyname(host), load_protocol(protocol), clock)
    driver.start()
    try:
        yield Feeder(encoder, device, clock), driver
    finally:
        driver.stop()
        os.close(device)
        os.close(host)


def heard(driver, stream, number):
    """Wait until so many packets of a stream have been decoded; return its health then."""
    end = time.monotonic() + PATIENCE_S
    while (health := driver.stream_health(stream)).good < number:
        assert time.monotonic() < end, f"waited in vain: {health}"
        time.sleep(0.002)
    return health


def test_a_damaged_prom_is_named_while_it_lasts_and_only_in_its_stream():
    chip = Ms5803Chip(typical_prom(), np.random.default_rng(1))
    with plugged(WaistUnit(chip), "waist-unit") as (unit, driver):
        unit.run(0.5)
        assert heard(driver, "barometer", 5).faults == ()
        chip.damage_prom(4, 2)
        unit.run(0.5)
        assert heard(driver, "barometer", 10).faults == (PROM_FAULT,)
        assert heard(driver, "accel", 100).faults == ()
        chip.damage_prom(4, 2)
        unit.run(2.0)
        assert heard(driver, "barometer", 30).faults == ()


def test_a_wire_that_is_off_is_named():
    unit = WaistUnit(Ms5803Chip(typical_prom(), np.random.default_rng(1)))
    with plugged(unit, "waist-unit") as (feeder, driver):
        feeder.run(0.2)
        assert heard(driver, "accel", 20).faults == ()
        unit.asleep = True
        feeder.run(0.2)
        assert heard(driver, "accel", 40).faults == (CONVERTER_FAULT.format("accel"),)


@pytest.mark.parametrize(("silent", "other"), [("foot", "waist"), ("waist", "foot")])
def test_a_unit_that_falls_silent_is_seen_and_the_other_goes_on(silent, other):
    links = {silent: UnitLink(stops_s=1.0)}
    receiver = TwoImuReceiver(np.random.default_rng(1), links=links)
    with plugged(receiver, "two-imu") as (unit, driver):
        unit.run(1.0)
        assert heard(driver, silent, 50).last_packet_age_s == pytest.approx(0.0, abs=0.1)
        unit.run(3.0)
        alive = heard(driver, other, 200)
        gone = driver.stream_health(silent)

        assert gone.last_packet_age_s == pytest.approx(3.0, abs=0.1)
        assert (gone.good, gone.rate_hz) == (50, 0.0)
        assert alive.last_packet_age_s == pytest.approx(0.0, abs=0.1)
        assert (alive.good, alive.lost) == (200, 0)
