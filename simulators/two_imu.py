"""A receiver of two sensor units, on the foot and at the waist, that sends their packets in turn.

Both units sample together; each numbers its packets, and the receiver stamps all of them by its
one clock. On the way to the receiver packets of a unit are lost, or come late, of one unit as well
as of the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from firmware_protocols.interleaved import InterleavedProtocol
from firmware_protocols.known import load_protocol
from imu_rig.arrays import FloatArray
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.encoders import Encoder, LayoutEncoder, MadeSamples
from simulators.imu_kinds import ImuKind
from simulators.inertial_sensor import Readings, SensorRange, SensorRanges
from simulators.models import FirmwareModel

PROTOCOL = "two-imu"
SAMPLE_HZ = 50.0
UNITS = ("foot", "waist")

REST_FIELD_UT = (0.0, 22.0, -45.0)
REST_NOISE = (0.02, 0.001, 0.3)
"""Standard deviations of a unit that lies still: m/s^2, rad/s, uT."""

OTHER_GAIN = 0.02
OTHER_OFFSETS = (0.3, 0.02, 10.0)
"""How far a second unit on the same plate reads off the first: share, m/s^2, rad/s, uT."""


@dataclass(frozen=True)
class UnitLink:
    """The radio between one unit and the receiver.

    Attributes
    ----------
    loss : float
        Share of the packets that are lost.
    late : int
        A packet may come behind up to so many later ones.
    starts_s, stops_s : float
        When the unit is switched on and off, on the receiver's clock since its start.
    """

    loss: float = 0.0
    late: int = 0
    starts_s: float = 0.0
    stops_s: float = math.inf


class TwoImuReceiver:
    """The receiver; see :class:`simulators.encoders.Encoder`.

    Parameters
    ----------
    rng : numpy Generator
    measured : tuple of str
        The units that measure what is encoded; the other one lies still beside.
    links : mapping of unit to UnitLink
        Perfect where none is given.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        measured: tuple[str, ...] = UNITS,
        links: Mapping[str, UnitLink] | None = None,
    ) -> None:
        protocol = load_protocol(PROTOCOL)
        assert isinstance(protocol, InterleavedProtocol)
        self._radios = {
            name: _Radio(LayoutEncoder(layout), (links or {}).get(name, UnitLink()), generator)
            for (name, layout), generator in zip(protocol.layouts, rng.spawn(2), strict=True)
        }
        self._readings: dict[str, Callable[[Readings], Readings]] = {}
        for name, generator in zip(UNITS, rng.spawn(2), strict=True):
            if name not in measured:
                self._readings[name] = _Resting(generator)
            elif name != measured[0]:
                self._readings[name] = _Other(generator)
            else:
                self._readings[name] = lambda readings: readings

    @property
    def sample_hz(self) -> float:
        """Samples of each unit per second."""
        return SAMPLE_HZ

    def boot(self, now_s: float) -> bytes:
        """Start without a word."""
        for radio in self._radios.values():
            radio.boot(now_s)
        return b""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Ignore the host."""
        del data, now_s
        return b""

    def encode(self, samples: MadeSamples) -> list[bytes]:
        """Return with every sample the packets of both units that reach the receiver then."""
        return self.encode_units(
            {
                name: replace(samples, readings=read(samples.readings))
                for name, read in self._readings.items()
            }
        )

    def encode_units(self, samples: Mapping[str, MadeSamples]) -> list[bytes]:
        """Return the same for units that measure each its own; times and counters are the same."""
        sent = [self._radios[name].send(samples[name]) for name in UNITS]
        return [foot + waist for foot, waist in zip(*sent, strict=True)]


class _Radio:
    """One unit's packets on their way to the receiver."""

    def __init__(self, encoder: LayoutEncoder, link: UnitLink, rng: np.random.Generator) -> None:
        self._encoder = encoder
        self._link = link
        self._rng = rng
        self._on_the_way: dict[int, bytes] = {}
        self._origin_s: float | None = None

    def boot(self, now_s: float) -> None:
        self._encoder.boot(now_s)
        self._on_the_way.clear()
        self._origin_s = None

    def send(self, samples: MadeSamples) -> list[bytes]:
        """Return with every sample what reaches the receiver then."""
        link = self._link
        packets = self._encoder.encode(samples)
        device_s: list[float] = samples.device_s.tolist()
        numbers: list[int] = samples.counter.tolist()
        if self._origin_s is None and device_s:
            self._origin_s = device_s[0]
        sent = []
        for number, since, packet in zip(numbers, device_s, packets, strict=True):
            lost = link.loss > 0 and float(self._rng.random()) < link.loss
            delay = int(self._rng.integers(link.late + 1)) if link.late else 0
            on = link.starts_s <= since - (self._origin_s or 0.0) < link.stops_s
            if on and not lost:
                arrival = number + delay
                self._on_the_way[arrival] = self._on_the_way.get(arrival, b"") + packet
            sent.append(self._on_the_way.pop(number, b""))
        return sent


class _Resting:
    """Readings of a unit that lies level and still."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def __call__(self, readings: Readings) -> Readings:
        noise = self._rng.standard_normal((len(readings), 9))
        accel, gyro, mag = (noise[:, 3 * i : 3 * i + 3] * REST_NOISE[i] for i in range(3))
        accel[:, 2] += STANDARD_GRAVITY
        return replace(
            readings,
            accel=accel,
            gyro=gyro,
            mag=mag + REST_FIELD_UT,
            saturated=np.zeros(len(readings), dtype=np.bool_),
        )


class _Other:
    """Readings of a second unit that feels the same as the first, with errors of its own."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._gains = 1.0 + rng.uniform(-OTHER_GAIN, OTHER_GAIN, (3, 3))
        self._offsets = rng.uniform(-1.0, 1.0, (3, 3)) * np.array(OTHER_OFFSETS)[:, np.newaxis]

    def __call__(self, readings: Readings) -> Readings:
        noise = self._rng.standard_normal((len(readings), 9))

        def of(part: int, values: FloatArray) -> FloatArray:
            own: FloatArray = values * self._gains[part] + self._offsets[part]
            return own + noise[:, 3 * part : 3 * part + 3] * REST_NOISE[part]

        return replace(
            readings,
            accel=of(0, readings.accel),
            gyro=of(1, readings.gyro),
            mag=of(2, readings.mag),
        )


def _maker(
    measured: tuple[str, ...],
) -> Callable[[FirmwareModel, np.random.Generator], Encoder]:
    def make(model: FirmwareModel, rng: np.random.Generator) -> Encoder:
        del model
        return TwoImuReceiver(rng, measured)

    return make


def _kind(name: str, where: str, measured: tuple[str, ...]) -> ImuKind:
    return ImuKind(
        name=name,
        title=f"Receiver of two units, +-8 g, +-2000 deg/s, 50 Hz each: {where}",
        protocol=PROTOCOL,
        output_hz=SAMPLE_HZ,
        ranges=SensorRanges(
            accel=SensorRange.of_bits(STANDARD_GRAVITY / 4096.0, 16),
            gyro=SensorRange.of_bits(DEG / 16.4, 16),
            mag=SensorRange.of_bits(0.3, 16),
        ),
        encoder=_maker(measured),
        firmware=FirmwareModel(layout=PROTOCOL),
        stream=measured[0],
    )


TWO_IMU = _kind("two-imu", "that of the foot on the jig", ("foot",))
TWO_IMU_WAIST = _kind("two-imu-waist", "that of the waist on the jig", ("waist",))
TWO_IMU_BOTH = _kind("two-imu-both", "both on the jig", UNITS)
