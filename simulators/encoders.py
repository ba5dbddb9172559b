"""From samples of a simulated sensor to the bytes its device sends: what each device brings along.

A device is told of every sample that its sensor takes and says which bytes leave it then: none, a
packet, or several. It also hears what the host writes, and answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from firmware_protocols.layout import Field, PacketLayout
from firmware_protocols.packets import encode, quantize
from imu_rig.arrays import FloatArray, IntArray
from imu_rig.units import ACCELERATION_UNITS, FIELD_UNITS, RATE_UNITS
from simulators.inertial_sensor import Readings

DEFAULT_RATE_HZ = 100.0

STATUS_RESTARTED = 0x01
"""Status bit: the device started less than a second ago."""

STATUS_SATURATED = 0x02
"""Status bit: an axis of the accelerometer or gyroscope is at the end of its range."""

RESTARTED_S = 1.0

PRESSURE_UNITS = {"Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "kPa": 1000.0, "bar": 1e5}


@dataclass(frozen=True)
class MadeSamples:
    """``n`` consecutive samples of a device's sensor.

    Attributes
    ----------
    t : shape (n,)
        World time [s] at the end of the interval that the sample is the mean of.
    device_s : shape (n,)
        The same moment on the device's clock [s], which may run fast and does not begin at zero;
        it does so after a restart.
    counter : shape (n,)
        Number of the sample since the device started, from 0.
    readings : Readings
        In nominal SI units.
    pressure : shape (n,)
        Of the air [Pa].
    air_c : shape (n,)
        Temperature of the air [degC].
    """

    t: FloatArray
    device_s: FloatArray
    counter: IntArray
    readings: Readings
    pressure: FloatArray
    air_c: FloatArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)


class Encoder(Protocol):
    """The firmware of one kind of device, from its sensor's samples to its port."""

    @property
    def sample_hz(self) -> float:
        """Samples per second of the device's clock, as of now: the host may change it."""

    def boot(self, now_s: float) -> bytes:
        """Start, at the begin of the world (0) or after power-up; return what is sent at once."""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host; return the answer. Samples up to now were encoded before."""

    def encode(self, samples: MadeSamples) -> list[bytes]:
        """Return for every sample the bytes that leave with it, whole packets or none.

        How the samples are cut into calls changes nothing.
        """


class LayoutEncoder:
    """A device that sends one packet of a fixed layout per sample and hears nothing.

    Parameters
    ----------
    layout : PacketLayout
    rate_hz : float, optional
        Otherwise that of the layout, or 100.
    """

    def __init__(self, layout: PacketLayout, rate_hz: float | None = None) -> None:
        self._layout = layout
        self._rate_hz = rate_hz or layout.rate_hz or DEFAULT_RATE_HZ
        self._restarted = False

    @property
    def sample_hz(self) -> float:
        """Packets per second."""
        return self._rate_hz

    def boot(self, now_s: float) -> bytes:
        """Start without a word."""
        self._restarted = now_s > 0
        return b""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Ignore the host."""
        del data, now_s
        return b""

    def encode(self, samples: MadeSamples) -> list[bytes]:
        """Return one packet per sample."""
        layout, length = self._layout, self._layout.length
        columns = {f.name: self._column(f, samples) for f in layout.fields if f.type != "pad"}
        packets = encode(layout, columns)
        return [packets[at : at + length] for at in range(0, len(packets), length)]

    def _column(self, field: Field, samples: MadeSamples) -> np.ndarray[Any, Any]:
        layout = self._layout
        if field.name == layout.counter:
            return samples.counter % (field.limits[1] + 1)
        if field.name == layout.clock:
            ticks = np.floor(samples.device_s / layout.clock_tick_s + 0.5)
            return ticks.astype(np.int64) % (field.limits[1] + 1)
        if field.name == "status" and field.is_integer and field.count == 1:
            restarted = self._restarted & (samples.device_s < RESTARTED_S)
            flags = STATUS_RESTARTED * restarted.astype(np.int64)
            return flags | STATUS_SATURATED * samples.readings.saturated
        shape = (len(samples), field.count) if field.count > 1 else (len(samples),)
        values = values_of(field, samples)
        if values is None or values.shape != shape:
            return np.zeros(shape, dtype=np.int64)
        return quantize(layout, field.name, values)


def values_of(field: Field, samples: MadeSamples) -> FloatArray | None:
    """Return samples in the unit of the field that carries them; None for an unknown field."""
    readings = samples.readings
    match field.name:
        case "accel":
            return readings.accel / ACCELERATION_UNITS.get(field.unit, 1.0)
        case "gyro":
            return readings.gyro / RATE_UNITS.get(field.unit, 1.0)
        case "mag":
            return readings.mag / FIELD_UNITS.get(field.unit, 1.0)
        case "temperature":
            return readings.temperature
        case "pressure":
            return samples.pressure / PRESSURE_UNITS.get(field.unit, 1.0)
        case _:
            return None
