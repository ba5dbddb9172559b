"""The firmware between sensor and radio: sample instants, packets, counter, clock, bursts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocols.layout import Field, PacketLayout
from firmware_protocols.packets import encode, quantize
from imu_rig.arrays import FloatArray
from imu_rig.units import ACCELERATION_UNITS, FIELD_UNITS, RATE_UNITS
from simulators.faults import WRONG_FACTOR, FaultSet
from simulators.link import Outbox
from simulators.models import FirmwareModel
from simulators.mpu9150 import Mpu9150, Readings, Vibration
from simulators.sampling import Sampler

DEFAULT_RATE_HZ = 100.0

STATUS_RESTARTED = 0x01
"""Status bit: the device started less than a second ago."""

STATUS_SATURATED = 0x02
"""Status bit: an axis of the accelerometer or gyroscope is at the end of its range."""

RESTARTED_S = 1.0


class ImuFirmware:
    """Samples the sensor by its own clock and hands packets to the radio.

    A sample holds the mean over the interval that ends at its time stamp.

    Parameters
    ----------
    model : FirmwareModel
    layout : PacketLayout
    sensor : Mpu9150
    sampler : Sampler
    rng, garbage_rng : numpy Generator
        For the radio's bursts, and for the bytes of the fault "garbage".
    """

    def __init__(
        self,
        model: FirmwareModel,
        layout: PacketLayout,
        sensor: Mpu9150,
        sampler: Sampler,
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
        self._layout = layout
        self._rng = rng
        self._garbage_rng = garbage_rng
        self._true_per_device_s = 1.0 / (1.0 + model.skew_ppm * 1e-6)
        rate = model.rate_hz or layout.rate_hz or DEFAULT_RATE_HZ
        self._period_s = 1.0 / rate
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
        self._next_s = self._period_s
        self._counter = 0
        self.sampler.restart(now_s)

    def device_clock_s(self, t: FloatArray) -> FloatArray:
        """Return what the device's clock shows at world times."""
        return self._boot_clock_s + (t - self._boot_s) / self._true_per_device_s

    def set_stuck(self, stuck: bool) -> None:
        """Repeat the last sample from now on, or no longer."""
        self._stuck = self._last if stuck else None

    def catch_up(self, now_s: float) -> None:
        """Take every sample that is due and give its packet to the radio."""
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
        self._transmit(self._pack(device_s, counter, readings), means.t)

    def _transmit(self, packets: bytes, t: FloatArray) -> None:
        if self.faults.has("garbage"):
            packets = self._garbage_rng.bytes(len(packets))
        length = self._layout.length
        if not self.faults:
            self._queue += packets
            self.sent += len(t)
            return
        for row, moment in enumerate(t):
            if not self.faults.silent(float(moment)):
                self._queue += packets[row * length : (row + 1) * length]
                self.sent += 1

    def flush(self, now_s: float) -> None:
        """Let the radio deliver what is due, and settle when it does so next."""
        self.catch_up(now_s)
        if self._queue:
            self.outbox.put(bytes(self._queue), now_s + self._model.latency_s, self.faults)
            self._queue.clear()
        shortest, longest = self._model.burst_s
        wait = float(self._rng.uniform(shortest, longest)) if longest > 0 else self._period_s
        self.flush_at_s = now_s + wait

    def _pack(
        self, device_s: FloatArray, counter: np.ndarray[Any, Any], readings: Readings
    ) -> bytes:
        layout = self._layout
        columns: dict[str, np.ndarray[Any, Any]] = {}
        for field in layout.fields:
            if field.type == "pad":
                continue
            shape = (len(counter), field.count) if field.count > 1 else (len(counter),)
            if field.name == layout.counter:
                columns[field.name] = counter % (field.limits[1] + 1)
            elif field.name == layout.clock:
                ticks = np.floor((self._boot_clock_s + device_s) / layout.clock_tick_s + 0.5)
                columns[field.name] = ticks.astype(np.int64) % (field.limits[1] + 1)
            elif field.name == "status" and field.is_integer and field.count == 1:
                restarted = self._boot_s > 0 and device_s < RESTARTED_S
                flags = STATUS_RESTARTED * np.asarray(restarted, dtype=np.int64)
                columns[field.name] = flags | STATUS_SATURATED * readings.saturated
            else:
                values = _values(field, readings)
                columns[field.name] = (
                    np.zeros(shape, dtype=np.int64)
                    if values is None or values.shape != shape
                    else quantize(layout, field.name, values)
                )
        return encode(layout, columns)


def _values(field: Field, readings: Readings) -> FloatArray | None:
    """Return readings in the unit of the field that carries them; None for an unknown field."""
    match field.name:
        case "accel":
            return readings.accel / ACCELERATION_UNITS.get(field.unit, 1.0)
        case "gyro":
            return readings.gyro / RATE_UNITS.get(field.unit, 1.0)
        case "mag":
            return readings.mag / FIELD_UNITS.get(field.unit, 1.0)
        case "temperature":
            return readings.temperature
        case _:
            return None


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
