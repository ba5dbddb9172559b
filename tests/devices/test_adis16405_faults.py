"""What is wrong with an ADIS16405, named by its driver from the bytes of its forwarder."""

import os
import time
import tty
from contextlib import contextmanager

import numpy as np
import pytest

from firmware_protocols.adis16405 import Diag, Register
from firmware_protocols.known import load_protocol
from imu_rig.clock import SteppedClock
from imu_rig.devices.imu import ImuDevice
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.adis16405 import Adis16405Forwarder
from simulators.adis16405_chip import FEED_HZ
from simulators.encoders import MadeSamples
from simulators.inertial_sensor import Readings

PATIENCE_S = 10.0
EA = "error flag (EA) set"


class Sensor:
    """A forwarder that is fed with one attitude and rate, and writes to a port."""

    def __init__(self, descriptor, clock, gyro_range=4):
        self.forwarder = Adis16405Forwarder(gyro_range)
        self.forwarder.boot(0.0)
        self.chip = self.forwarder.chip
        self._descriptor, self._clock, self._made = descriptor, clock, 0

    def run(self, seconds=0.1, gyro_dps=(0.0, 0.0, 0.0)):
        """Live for so long, on the clock of the host as well; return the frames sent."""
        number = round(seconds * FEED_HZ)
        index = self._made + np.arange(number)
        self._made += number
        t = (index + 1) / FEED_HZ
        readings = Readings(
            accel=np.tile((0.0, 0.0, STANDARD_GRAVITY), (number, 1)),
            gyro=np.tile(np.array(gyro_dps) * DEG, (number, 1)),
            mag=np.zeros((number, 3)),
            temperature=np.full(number, 25.0),
            saturated=np.zeros(number, bool),
            offsets=np.zeros((number, 6)),
        )
        still = np.zeros(number)
        frames = self.forwarder.encode(MadeSamples(t, t, index, readings, still, still))
        data = b"".join(frames)
        self._clock.advance(seconds)
        assert os.write(self._descriptor, data) == len(data)
        return sum(map(bool, frames))


@contextmanager
def sensor_and_driver(**options):
    device, host = os.openpty()
    tty.setraw(host)
    clock = SteppedClock(10**9)
    imu = ImuDevice("waist", os.ttyname(host), load_protocol("adis16405-36"), clock)
    imu.start()
    try:
        yield Sensor(device, clock, **options), imu, clock
    finally:
        imu.stop()
        os.close(device)
        os.close(host)


def heard(imu, number):
    """Wait until so many frames have been decoded; return the faults named then."""
    end = time.monotonic() + PATIENCE_S
    while (health := imu.health).good < number:
        assert time.monotonic() < end, f"waited in vain: {health}"
        time.sleep(0.002)
    assert health.corrupt == health.lost == 0
    return set(health.faults)


def _self_test(chip):
    chip.failing = Diag.Z_GYRO
    chip.transfer(0x8000 | (Register.MSC_CTRL + 1) << 8 | 0x04)


CASES = {
    "supply low": (
        lambda chip: setattr(chip, "supply_v", 4.5),
        {"supply below 4.75 V", EA},
    ),
    "self-test": (
        _self_test,
        {"self-test failed", "self-test failed: gyroscope z", EA},
    ),
    "SPI": (
        lambda chip: chip.transfer(0, clocks=7),
        {"SPI transfer of wrong length", EA},
    ),
    "not connected": (
        lambda chip: setattr(chip, "connected", False),
        {"sensor gives no new data", "sensor does not answer"},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_fault_is_named_and_forgotten_a_second_after_it_ends(case):
    upset, names = CASES[case]
    with sensor_and_driver() as (sensor, imu, clock):
        number = sensor.run()
        assert heard(imu, number) == set()
        upset(sensor.chip)
        number += sensor.run()
        assert heard(imu, number) == names
        sensor.chip.supply_v, sensor.chip.connected = 5.0, True
        number += sensor.run()  # a bit of DIAG_STAT stays until it has been read
        heard(imu, number)
        clock.advance(1.5)
        number += sensor.run()
        assert heard(imu, number) == set()


def test_over_range_is_named_in_every_range():
    for gyro_range, rate in ((4, 310.0), (2, 160.0), (1, 80.0)):
        with sensor_and_driver(gyro_range=gyro_range) as (sensor, imu, _):
            number = sensor.run(gyro_dps=(0.9 * rate, 0, 0))
            assert heard(imu, number) == set()
            number += sensor.run(gyro_dps=(rate, 0, 0))
            assert heard(imu, number) == {"sensor over range", EA}


def test_samples_are_in_si_units_whatever_the_range():
    for gyro_range in (4, 2, 1):
        with sensor_and_driver(gyro_range=gyro_range) as (sensor, imu, _):
            heard(imu, sensor.run(gyro_dps=(10.0, -20.0, 30.0)))
            block = imu.poll()
            assert block.gyro[-1] == pytest.approx(np.array([10, -20, 30]) * DEG, abs=0.026 * DEG)
            assert block.accel[-1, 2] == pytest.approx(STANDARD_GRAVITY, abs=0.02)
            assert np.diff(block.t) == pytest.approx(3 / FEED_HZ, abs=2e-6)
