"""A micro-controller that forwards an ADIS16405's bursts over a USART, and what its sensor is like.

It waits for the data-ready pulse, reads a burst after every third, asks for ``DIAG_STAT`` when the
words say that something is wrong, and sends the words as they came.
"""

from __future__ import annotations

import math

import numpy as np

from firmware_protocols.adis16405 import (
    ACCEL_COUNT_G,
    BURST_BYTES,
    BURST_WORDS,
    ERROR,
    GYRO_COUNT_DPS,
    MAG_COUNT_G,
    PRODUCT_ID,
    Register,
    read_frame,
    sens_avg,
    write_frames,
)
from firmware_protocols.layout import PacketLayout, load_layout
from firmware_protocols.packets import encode
from firmware_protocols.unconfirmed import ADIS16405_ANALOG_DELAY_S
from imu_rig.units import DEG, FIELD_UNITS, STANDARD_GRAVITY
from simulators.adis16405_chip import FEED_HZ, Adis16405Chip
from simulators.budget import Budget
from simulators.encoders import Encoder, MadeSamples
from simulators.imu_kinds import ImuKind
from simulators.inertial_sensor import SensorRange, SensorRanges
from simulators.models import FirmwareModel, SensorModel

LAYOUT = "adis16405-36"
EVERY = 3
"""One frame for so many samples of the chip."""

SMPL_PRD = 0x0001  # 819.2 samples per second
SPI_HZ = 1e6

SYNC_PERIOD_US = 500_000
"""Between pulses for the optical system, 2 per second."""

SYNC_PULSE = 1 << 7
NO_NEW_DATA = 1 << 6
NO_ANSWER = 1 << 5
"""Bits of the frame's byte "range", above the three of the range."""

PATIENCE_SAMPLES = 9
"""So long without a data-ready pulse, and a frame says that there are no new data."""

START_PATIENCE_SAMPLES = 246  # 0.3 s: a reset of the chip takes 0.17 s


class Adis16405Forwarder:
    """The forwarder with its chip; see :class:`simulators.encoders.Encoder`.

    Parameters
    ----------
    gyro_range : int
        Range bits of SENS_AVG: 4 for +-300, 2 for +-150, 1 for +-75 deg/s.
    m : int
        The chip averages twice over 2**m samples.
    layout : PacketLayout, optional
    """

    def __init__(
        self, gyro_range: int = 4, m: int = 2, *, layout: PacketLayout | None = None
    ) -> None:
        self.chip = Adis16405Chip()
        self.chip.spi_hz = SPI_HZ
        self._wanted = sens_avg(gyro_range, m)
        self._layout = layout or load_layout(LAYOUT)
        self._start()

    def _start(self) -> None:
        self._set_up = False
        self._range = 0
        self._ready = self._waited = self._sent = 0
        self._patience = START_PATIENCE_SAMPLES
        self._pulse: int | None = None
        self._trouble = 0

    @property
    def sample_hz(self) -> float:
        """Samples per second of the chip, three for each frame."""
        return FEED_HZ

    def boot(self, now_s: float) -> bytes:
        """Start without a word; after power-up the chip needs a while."""
        self._start()
        if now_s > 0:
            self.chip.reset()
        return b""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Ignore the host: the line goes one way."""
        del data, now_s
        return b""

    def encode(self, samples: MadeSamples) -> list[bytes]:
        """Return for every sample of the chip the frame that leaves with it, or nothing."""
        stamps = np.floor((samples.device_s + ADIS16405_ANALOG_DELAY_S) * 1e6 + 0.5)
        stamps_us: list[int] = stamps.astype(np.int64).tolist()
        frames = _Frames(self._layout)
        made: list[int] = []
        for row, ready in enumerate(self.chip.play(samples.readings)):
            if self._pulse is None:
                self._pulse = stamps_us[row] // SYNC_PERIOD_US
            if self._due(ready):
                self._forward(frames, stamps_us[row])
                made.append(row)
        sent = [b""] * len(samples)
        for row, frame in zip(made, frames.encoded(), strict=True):
            sent[row] = frame
        return sent

    def _due(self, ready: bool) -> bool:
        """Return whether a frame is to be sent now, after a data-ready pulse or without one."""
        if not ready:
            self._waited += 1
            if self._waited < self._patience:
                return False
            self._waited, self._patience = 0, PATIENCE_SAMPLES
            self._set_up = False
            answers = self._register(Register.PRODUCT_ID) == PRODUCT_ID
            self._trouble = NO_NEW_DATA | (0 if answers else NO_ANSWER)
            return True
        self._waited, self._trouble, self._patience = 0, 0, PATIENCE_SAMPLES
        if not self._set_up:
            self._prepare()
        self._ready += 1
        return self._ready % EVERY == 0

    def _prepare(self) -> None:
        """Tell the chip rate, range and filter, and believe only what it then says."""
        for register, value in ((Register.SMPL_PRD, SMPL_PRD), (Register.SENS_AVG, self._wanted)):
            for frame in write_frames(register, value):
                self.chip.transfer(frame)
        self._range = self._register(Register.SENS_AVG) >> 8 & 7
        self._set_up = True

    def _forward(self, frames: _Frames, stamp_us: int) -> None:
        transfer = self.chip.transfer
        transfer(read_frame(Register.GLOB_CMD))
        words = [transfer(0) for _ in range(BURST_WORDS)]
        diag = self._register(Register.DIAG_STAT) if words[0] & ERROR else 0
        pulse = stamp_us // SYNC_PERIOD_US
        sync = SYNC_PULSE if pulse != self._pulse else 0
        self._pulse = pulse
        frames.add(self._sent, self._range | self._trouble | sync, stamp_us, diag, words)
        self._sent += 1

    def _register(self, register: Register) -> int:
        self.chip.transfer(read_frame(register))
        return self.chip.transfer(0)


class _Frames:
    """Frames that are being put together."""

    def __init__(self, layout: PacketLayout) -> None:
        self._layout = layout
        self._heads: list[tuple[int, int, int, int]] = []
        self._words: list[list[int]] = []

    def add(self, number: int, byte: int, stamp_us: int, diag: int, words: list[int]) -> None:
        """Add one."""
        self._heads.append((number % 256, byte, stamp_us % 2**32, diag))
        self._words.append(words)

    def encoded(self) -> list[bytes]:
        """Return each as bytes."""
        layout, number = self._layout, len(self._heads)
        if not number:
            return []
        rows = np.zeros(number, dtype=layout.dtype)
        heads = np.array(self._heads)
        for column, name in enumerate(("seq", "range", "time", "diag_stat")):
            rows[name] = heads[:, column]
        table = rows.view(np.uint8).reshape(number, layout.length)
        assert layout.dtype.fields is not None
        first = layout.dtype.fields["supply"][1]
        words = np.array(self._words, dtype=">u2")
        table[:, first : first + BURST_BYTES] = words.view(np.uint8).reshape(number, BURST_BYTES)
        data = encode(layout, rows)
        return [data[at : at + layout.length] for at in range(0, len(data), layout.length)]


ADIS16405_RANGES = SensorRanges(
    accel=SensorRange.of_bits(ACCEL_COUNT_G * STANDARD_GRAVITY, 14),
    gyro=SensorRange.of_bits(GYRO_COUNT_DPS[4] * DEG, 14),
    mag=SensorRange.of_bits(MAG_COUNT_G * FIELD_UNITS["G"], 14),
)

ADIS16405_SENSOR = SensorModel(
    accel_noise_ug=500.0,
    gyro_noise_dps=0.05,
    mag_noise_ut=0.0066 * math.sqrt(FEED_HZ / 2.0),  # 0.066 mG per root hertz
    accel_walk_mg=0.2,
    gyro_walk_dps=0.007,
    warm_up_c=5.0,
    accel_offset_mg_per_c=0.3,
    accel_gain_percent_per_c=0.005,
    gyro_offset_dps_per_c=0.01,
)
"""Densities of the data sheet; the in-run stabilities of the offsets are taken as walks."""

ADIS16405_BUDGET = Budget(
    scale=0.01,
    cross_axis=0.009,  # 0.5 deg from the sensors' axes to those of the package
    accel_bias_mg=(50.0, 50.0, 50.0),
    gyro_bias_dps=3.0,
)


def _firmware(model: FirmwareModel, rng: np.random.Generator) -> Encoder:
    del model, rng
    return Adis16405Forwarder()


ADIS16405 = ImuKind(
    name="adis16405",
    title="ADIS16405 forwarded over a USART: +-18 g, +-300 deg/s, +-2.5 gauss",
    protocol=LAYOUT,
    output_hz=FEED_HZ / EVERY,
    ranges=ADIS16405_RANGES,
    encoder=_firmware,
    budget=ADIS16405_BUDGET,
    sensor=ADIS16405_SENSOR,
    firmware=FirmwareModel(layout=LAYOUT, burst_s=(0.008, 0.016), latency_s=0.002),
    encoder_rounds=True,
)
