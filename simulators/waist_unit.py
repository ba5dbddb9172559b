"""A unit worn at the waist: accelerometer at 100 Hz, barometer at 10 Hz, one radio."""

from __future__ import annotations

import math

import numpy as np

from firmware_protocols.interleaved import InterleavedProtocol
from firmware_protocols.known import load_protocol
from firmware_protocols.packets import encode
from firmware_protocols.unconfirmed import (
    MMA7260_CROSS_AXIS,
    MMA7260_SENSITIVITY_TOLERANCE,
    MMA7260_ZERO_TOLERANCE_V,
)
from imu_rig.arrays import IntArray
from imu_rig.units import STANDARD_GRAVITY
from simulators.budget import Budget
from simulators.encoders import RESTARTED_S, STATUS_RESTARTED, Encoder, MadeSamples
from simulators.imu_kinds import ImuKind
from simulators.inertial_sensor import SensorRange, SensorRanges
from simulators.mma7260 import NOMINAL_SUPPLY_V, Converter, Mma7260, counts_per_g, sampled_noise_ug
from simulators.models import FirmwareModel, SensorModel
from simulators.ms5803_chip import Ms5803Chip, draw_prom

PROTOCOL = "waist-unit"
SAMPLE_HZ = 100.0
BAROMETER_EVERY = 10
"""One packet of the barometer with so many samples of the accelerometer."""

USUAL_G_SELECT = 2
"""+-4 g: walking at the waist reaches more than 2."""

SUPPLY_FALL_V_PER_H = 0.02


class WaistUnit:
    """The firmware with its two sensors; see :class:`simulators.encoders.Encoder`.

    Parameters
    ----------
    chip : Ms5803Chip
    g_select : int
        Setting of the accelerometer's pins, as the packets tell it.
    supply_v : float
        At the start.

    Attributes
    ----------
    asleep : bool
        Whether the accelerometer's pin Sleep is low, as where its wire is off.
    """

    def __init__(
        self,
        chip: Ms5803Chip,
        g_select: int = USUAL_G_SELECT,
        supply_v: float = NOMINAL_SUPPLY_V,
    ) -> None:
        protocol = load_protocol(PROTOCOL)
        assert isinstance(protocol, InterleavedProtocol)
        layouts = dict(protocol.layouts)
        self.chip = chip
        self.g_select = g_select
        self.asleep = False
        self._accel, self._barometer = layouts["accel"], layouts["barometer"]
        self._supply_v = supply_v
        self._restarted = False

    @property
    def sample_hz(self) -> float:
        """Samples of the accelerometer per second."""
        return SAMPLE_HZ

    def boot(self, now_s: float) -> bytes:
        """Start without a word."""
        self._restarted = now_s > 0
        return b""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Ignore the host."""
        del data, now_s
        return b""

    def encode(self, samples: MadeSamples) -> list[bytes]:
        """Return the accelerometer's packet of every sample, with a tenth also a barometer's."""
        sent = self._accel_packets(samples)
        due = np.flatnonzero(samples.counter % BAROMETER_EVERY == BAROMETER_EVERY - 1)
        for row, packet in zip(due.tolist(), self._pressure_packets(samples, due), strict=True):
            sent[row] += packet
        return sent

    def _accel_packets(self, samples: MadeSamples) -> list[bytes]:
        supply_v = self._supply_v - SUPPLY_FALL_V_PER_H * samples.t[:, np.newaxis] / 3600.0
        # Accelerometer and converter live on the same supply: it is not in the counts.
        sensor, converter = Mma7260(self.g_select, asleep=self.asleep), Converter()
        return _cut(
            encode(
                self._accel,
                {
                    "seq": samples.counter % 256,
                    "g_select": self.g_select,
                    "time": _microseconds(samples),
                    "accel": converter.counts(
                        sensor.volts(samples.readings.accel / STANDARD_GRAVITY)
                    ),
                    "supply": np.rint(1000.0 * supply_v[:, 0]).astype(np.int64),
                },
            ),
            self._accel.length,
        )

    def _pressure_packets(self, samples: MadeSamples, due: IntArray) -> list[bytes]:
        if not len(due):
            return []
        d1, d2 = self.chip.counts(samples.pressure[due], samples.air_c[due])
        restarted = self._restarted & (samples.device_s[due] < RESTARTED_S)
        columns = {
            "seq": samples.counter[due] // BAROMETER_EVERY % 256,
            "status": STATUS_RESTARTED * restarted.astype(np.int64),
            "time": _microseconds(samples)[due],
            "prom": np.tile(self.chip.prom, (len(due), 1)),
            "d1": d1,
            "d2": d2,
        }
        return _cut(encode(self._barometer, columns), self._barometer.length)


def _microseconds(samples: MadeSamples) -> IntArray:
    ticks: IntArray = np.floor(samples.device_s * 1e6 + 0.5).astype(np.int64) % 2**32
    return ticks


def _cut(packets: bytes, length: int) -> list[bytes]:
    return [packets[at : at + length] for at in range(0, len(packets), length)]


def _firmware(model: FirmwareModel, rng: np.random.Generator) -> Encoder:
    del model
    return WaistUnit(Ms5803Chip(draw_prom(rng), rng))


_COUNTS_PER_G = counts_per_g(USUAL_G_SELECT, 12, NOMINAL_SUPPLY_V, NOMINAL_SUPPLY_V)
_END_COUNTS = math.floor(Mma7260(USUAL_G_SELECT).end_g * _COUNTS_PER_G)
_ZERO_TOLERANCE_MG = 1e3 * MMA7260_ZERO_TOLERANCE_V / Mma7260(USUAL_G_SELECT).volts_per_g

WAIST_UNIT = ImuKind(
    name="waist-unit",
    title="Waist unit: MMA7260QT accelerometer +-4 g at 100 Hz, MS5803-02BA barometer at 10 Hz",
    protocol=PROTOCOL,
    output_hz=SAMPLE_HZ,
    ranges=SensorRanges(
        accel=SensorRange(STANDARD_GRAVITY / _COUNTS_PER_G, -_END_COUNTS, _END_COUNTS),
        gyro=None,
        mag=None,
    ),
    encoder=_firmware,
    budget=Budget(
        scale=MMA7260_SENSITIVITY_TOLERANCE,
        cross_axis=MMA7260_CROSS_AXIS,
        accel_bias_mg=(_ZERO_TOLERANCE_MG,) * 3,
    ),
    # The converter samples without averaging; z, with less bandwidth, is taken to be as noisy.
    sensor=SensorModel(
        accel_noise_ug=sampled_noise_ug(SAMPLE_HZ),
        accel_walk_mg=0.3,
        accel_offset_mg_per_c=1.0,
        accel_gain_percent_per_c=0.02,
    ),
    firmware=FirmwareModel(layout=PROTOCOL),
    encoder_rounds=True,
)
