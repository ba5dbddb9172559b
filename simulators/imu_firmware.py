"""The firmware between sensor and radio: sample instants, packets, counter, clock, bursts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from simulators.encoders import Encoder, MadeSamples
from simulators.faults import WRONG_FACTOR, FaultSet
from simulators.inertial_sensor import InertialSensor, Readings, Vibration
from simulators.link import Outbox
from simulators.models import FirmwareModel
from simulators.sampling import Sampler


@dataclass(frozen=True)
class Air:
    """The air around the device: pressure [Pa] and temperature [degC], alike at all times."""

    pressure: float
    temperature_c: float


class ImuFirmware:
    """Samples the sensor by its own clock and hands the packets that come of it to the radio.

    A sample holds the mean over the interval that ends at its time stamp.

    Parameters
    ----------
    model : FirmwareModel
    encoder : Encoder
        What the device makes of its samples and of what the host says.
    sensor : InertialSensor
    sampler : Sampler
    air : Air
    rng, garbage_rng : numpy Generator
        For the radio's bursts, and for the bytes of the fault "garbage".
    """

    def __init__(
        self,
        model: FirmwareModel,
        encoder: Encoder,
        sensor: InertialSensor,
        sampler: Sampler,
        air: Air,
        rng: np.random.Generator,
        garbage_rng: np.random.Generator,
    ) -> None:
        self.sensor = sensor
        self.sampler = sampler
        self.faults = FaultSet()
        self.outbox = Outbox()
        self.vibration: Vibration | None = None
        self.sent = 0
        self._model = model
        self._encoder = encoder
        self._air = air
        self._rng = rng
        self._garbage_rng = garbage_rng
        self._true_per_device_s = 1.0 / (1.0 + model.skew_ppm * 1e-6)
        self._queue = bytearray()
        self._stuck: Readings | None = None
        self._last: Readings | None = None
        self.flush_at_s = 0.0
        self._running = True
        self._start(0.0, model.clock_offset_s)

    def power_down(self) -> None:
        """Stop, and lose what the radio holds."""
        self._running = False
        self._queue.clear()

    def boot(self, now_s: float) -> None:
        """Start with counter and clock at zero, as after power-up."""
        self._queue.clear()
        self._last = self._stuck = None
        self._running = True
        self._start(now_s, 0.0)

    def _start(self, now_s: float, clock_s: float) -> None:
        self._boot_s = now_s
        self._boot_clock_s = clock_s
        self._queue += self._encoder.boot(now_s)
        self._next_s = self._period_s
        self._counter = 0
        self.sampler.restart(now_s)

    @property
    def _period_s(self) -> float:
        return 1.0 / self._encoder.sample_hz

    def set_stuck(self, stuck: bool) -> None:
        """Repeat the last sample from now on, or no longer."""
        self._stuck = self._last if stuck else None

    def catch_up(self, now_s: float) -> None:
        """Take every sample that is due and give what it sends to the radio."""
        if not self._running:
            self.sampler.restart(now_s)
            return
        period = self._period_s * (2.0 if self.faults.has("slow") else 1.0)
        since_boot_s = (now_s - self._boot_s) / self._true_per_device_s
        number = max(0, math.floor((since_boot_s - self._next_s) / period + 1e-9) + 1)
        device_s: FloatArray = self._next_s + period * np.arange(number, dtype=np.float64)
        means = self.sampler.means(self._boot_s + device_s * self._true_per_device_s)
        if not number:
            return
        self._next_s = float(device_s[-1]) + period
        factor = WRONG_FACTOR if self.faults.has("wrong") else 1.0
        readings = self.sensor.read(means, self.vibration, factor=factor)
        self._last = _last_of(readings)
        if self._stuck is not None:
            readings = _repeated(self._stuck, number)
        counter = self._counter + np.arange(number)
        self._counter += number
        samples = MadeSamples(
            t=means.t,
            device_s=self._boot_clock_s + device_s,
            counter=counter,
            readings=readings,
            pressure=np.full(number, self._air.pressure),
            air_c=np.full(number, self._air.temperature_c),
        )
        self._transmit(self._encoder.encode(samples), means.t)

    def receive(self, data: bytes, now_s: float) -> None:
        """Hear what the host wrote, after the samples that came before, and answer."""
        if not data or not self._running or self.faults.silent(now_s):
            return
        self.catch_up(now_s)
        answer = self._encoder.receive(data, now_s)
        if answer and self.faults.has("garbage"):
            answer = self._garbage_rng.bytes(len(answer))
        self._queue += answer

    def _transmit(self, packets: list[bytes], t: FloatArray) -> None:
        if self.faults.has("garbage"):
            packets = _cut_as(packets, self._garbage_rng.bytes(sum(map(len, packets))))
        if self.faults:
            heard = [not self.faults.silent(moment) for moment in t.tolist()]
            packets = [packet for packet, loud in zip(packets, heard, strict=True) if loud]
        self._queue += b"".join(packets)
        self.sent += sum(1 for packet in packets if packet)

    def flush(self, now_s: float) -> None:
        """Let the radio deliver what is due, and settle when it does so next."""
        self.catch_up(now_s)
        if self._queue:
            self.outbox.put(bytes(self._queue), now_s + self._model.latency_s, self.faults)
            self._queue.clear()
        shortest, longest = self._model.burst_s
        wait = float(self._rng.uniform(shortest, longest)) if longest > 0 else self._period_s
        self.flush_at_s = now_s + wait


def _cut_as(packets: list[bytes], data: bytes) -> list[bytes]:
    """Cut as many bytes into pieces of the packets' lengths."""
    ends = np.cumsum([len(packet) for packet in packets]).tolist()
    return [data[end - len(packet) : end] for packet, end in zip(packets, ends, strict=True)]


def _last_of(readings: Readings) -> Readings:
    return Readings(
        readings.accel[-1:],
        readings.gyro[-1:],
        readings.mag[-1:],
        readings.temperature[-1:],
        readings.saturated[-1:],
        readings.offsets[-1:],
    )


def _repeated(readings: Readings, number: int) -> Readings:
    return Readings(
        np.repeat(readings.accel, number, axis=0),
        np.repeat(readings.gyro, number, axis=0),
        np.repeat(readings.mag, number, axis=0),
        np.repeat(readings.temperature, number),
        np.repeat(readings.saturated, number),
        np.repeat(readings.offsets, number, axis=0),
    )
