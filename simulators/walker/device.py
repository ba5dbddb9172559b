"""A device that a person carries: its sensors, its firmware, and what it sends when."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from simulators.budget import draw_firmware, draw_sensor
from simulators.encoders import Encoder, MadeSamples
from simulators.imu_kinds import IMU_KINDS, ImuKind, check_kind
from simulators.inertial_sensor import InertialSensor
from simulators.models import FirmwareModel, SensorModel
from simulators.sampling import Means
from simulators.walker.air import Weather
from simulators.walker.sensor import IdealSensor
from simulators.walker.walker import PLACES, Walker

UNIT_PLACES = {"foot": "left-foot", "waist": "waist"}
"""Where the units of a device of several are worn."""

AHEAD_S = 1.0
"""Motion is computed for so long at once; it does not depend on what devices do."""


@dataclass(frozen=True)
class Carried:
    """One device to be carried.

    Attributes
    ----------
    name : str
    kind : str
        Of `simulators.imu_kinds.IMU_KINDS`.
    place : str, optional
        Of `PLACES`, for a device of one unit; otherwise what its name tells, or the left foot.
    """

    name: str
    kind: str
    place: str | None = None

    def worn_at(self) -> str:
        """Return the place of a device of one unit.

        Raises
        ------
        ValueError
            If there is no such place.
        """
        if self.place is not None:
            if self.place not in PLACES:
                raise ValueError(
                    f"{self.name}: there is no place {self.place!r}; take {', '.join(PLACES)}."
                )
            return self.place
        told = self.name.replace(" ", "-").replace("_", "-")
        return next((place for place in PLACES if place in told or told in place), PLACES[0])


@runtime_checkable
class EncoderOfUnits(Protocol):
    """Firmware of a device whose units measure each its own."""

    def encode_units(self, samples: Mapping[str, MadeSamples]) -> list[bytes]:
        """Return for every sample the bytes that leave with it."""


@dataclass(frozen=True, eq=False)
class Made:
    """What a device made in some time, unit by unit.

    Attributes
    ----------
    samples : mapping of unit to MadeSamples
        Alike in times and counters; the one unit of most devices is called "".
    means : mapping of unit to Means
        What ideal sensors would have said.
    """

    samples: dict[str, MadeSamples]
    means: dict[str, Means]


class CarriedDevice:
    """A device at its place; time counts from the moment it is switched on.

    Parameters
    ----------
    carried : Carried
    walker : Walker
    seed : int
        Of its errors, its noise and its radio; with its name.
    begin_s : float
        When the walk begins [s]: the person rests before. Infinite until :meth:`begin`.
    exact : bool
        A sensor without errors, noise and counts, of which only the encoder rounds, a right clock
        and no delays.

    Raises
    ------
    ValueError
        If there is no such kind or place.
    """

    def __init__(
        self,
        carried: Carried,
        walker: Walker,
        seed: int = 1,
        *,
        begin_s: float = 0.0,
        exact: bool = False,
    ) -> None:
        check_kind(carried.kind)
        self.name, self.kind = carried.name, IMU_KINDS[carried.kind]
        errors, noise, radio, inside, breeze = _generators(carried.name, seed)
        self._radio = radio
        self.firmware = _firmware(self.kind, errors, exact)
        self._encoder: Encoder = self.kind.encoder(self.firmware, inside)
        of_units = isinstance(self._encoder, EncoderOfUnits)
        worn = UNIT_PLACES if of_units else {"": carried.worn_at()}
        self.ideal = {unit: walker.sensor(place) for unit, place in worn.items()}
        self.places = worn
        self.sensors = {
            unit: InertialSensor(_sensor(self.kind, errors, exact), self.kind.sensor_ranges, child)
            for unit, child in zip(worn, noise.spawn(len(worn)), strict=True)
        }
        self._air: Weather = walker.air
        self._air_rngs = dict(zip(worn, breeze.spawn(len(worn)), strict=True))
        self._true_per_device_s = 1.0 / (1.0 + self.firmware.skew_ppm * 1e-6)
        self.begin_s = begin_s
        self._period_s = 1.0 / self._encoder.sample_hz
        self._made = 0
        self._base_s, self._index = 0.0, 0  # on the device's clock, and samples since
        self._last_s = 0.0
        self._ahead: dict[str, _Ahead] = {}
        self._waiting = deque([(0.0, self._encoder.boot(0.0))])
        self._outbox: deque[tuple[float, bytes]] = deque()
        self._flush_s = 0.0

    @property
    def sample_hz(self) -> float:
        """Samples per second of the device's clock, as of now."""
        return self._encoder.sample_hz

    def begin(self, begin_s: float) -> None:
        """Let the walk begin at a time that has not been reached yet."""
        self.begin_s = begin_s
        self._ahead = {}

    def receive(self, data: bytes, now_s: float) -> Made:
        """Take bytes that the host wrote, after what was due before; return what that made."""
        made = self.advance(now_s)
        self._waiting.append((now_s, self._encoder.receive(data, now_s)))
        return made

    def advance(self, until_s: float) -> Made:
        """Take every sample that is due and send it on its way; return what was made.

        How the time is cut into calls changes nothing.
        """
        period = 1.0 / self._encoder.sample_hz
        if period != self._period_s:
            self._base_s += self._index * self._period_s
            self._index, self._period_s = 0, period
        since_s = until_s / self._true_per_device_s - self._base_s
        number = max(0, math.floor(since_s / period + 1e-9) - self._index)
        made = Made({}, {})
        if number:
            device_s = self._device_s(number)
            counter: IntArray = self._made + np.arange(number)
            for unit, ahead in self._next(number).items():
                made.means[unit] = ahead.means
                made.samples[unit] = self._samples(unit, ahead, device_s, counter)
            self._index += number
            self._made += number
            t = made.means[next(iter(self.ideal))].t.tolist()
            self._waiting += zip(t, self._encoded(made.samples), strict=True)
        self._deliver(until_s)
        return made

    def take(self, until_s: float) -> list[tuple[float, bytes]]:
        """Return, and forget, what has reached the host's port by now, with its times [s]."""
        arrived = []
        while self._outbox and self._outbox[0][0] <= until_s:
            arrived.append(self._outbox.popleft())
        return arrived

    def _device_s(self, number: int) -> FloatArray:
        """Return the device's clock, since it was switched on, at the next samples."""
        numbers: FloatArray = self._index + np.arange(1.0, number + 1.0)
        device_s: FloatArray = self._base_s + self._period_s * numbers
        return device_s

    def _next(self, number: int) -> dict[str, _Ahead]:
        """Return what ideal sensors say of the next samples."""
        ends = self._device_s(number) * self._true_per_device_s
        there = next(iter(self._ahead.values()), None)
        if there is None or not np.array_equal(there.means.t[:number], ends):
            more = max(number, math.ceil(AHEAD_S / self._period_s))
            ends = self._device_s(more) * self._true_per_device_s
            self._ahead = {unit: self._felt(ideal, ends) for unit, ideal in self.ideal.items()}
        taken = {unit: ahead.rows(slice(number)) for unit, ahead in self._ahead.items()}
        self._ahead = {unit: ahead.rows(slice(number, None)) for unit, ahead in self._ahead.items()}
        self._last_s = float(taken[next(iter(taken))].means.t[-1])
        return taken

    def _felt(self, ideal: IdealSensor, ends: FloatArray) -> _Ahead:
        """Return what an ideal sensor says of the intervals after the last that end at times."""
        number, duration = len(ends), np.diff(ends, prepend=self._last_s)
        if ends[-1] < self.begin_s:
            rest = ideal.at(np.zeros(1))
            means = Means(
                ends,
                duration,
                np.repeat(rest.force, number, axis=0),
                np.repeat(rest.rate, number, axis=0),
                np.repeat(rest.field, number, axis=0),
            )
            return _Ahead(means, np.repeat(rest.position[:, 2], number))
        walked = ends - self.begin_s
        felt = ideal.means(walked, self._last_s - self.begin_s)
        means = Means(ends, duration, felt.force, felt.rate, felt.field)
        return _Ahead(means, ideal.height(walked))

    def _samples(
        self, unit: str, ahead: _Ahead, device_s: FloatArray, counter: IntArray
    ) -> MadeSamples:
        t = ahead.means.t
        walked = np.maximum(t - self.begin_s, 0.0)
        noise = self._air_rngs[unit].normal(0.0, 1.0, len(t)) * self._air.noise_pa
        return MadeSamples(
            t=t,
            device_s=self.firmware.clock_offset_s + device_s,
            counter=counter,
            readings=self.sensors[unit].read(ahead.means, None),
            pressure=self._air.pressure(walked, ahead.height) + noise,
            air_c=np.full(len(t), self._air.air_c),
        )

    def _encoded(self, samples: dict[str, MadeSamples]) -> list[bytes]:
        if isinstance(self._encoder, EncoderOfUnits):
            return self._encoder.encode_units(samples)
        return self._encoder.encode(samples[""])

    def _deliver(self, until_s: float) -> None:
        """Let the radio send what is due by now, in bursts if it is one that does so."""
        shortest, longest = self.firmware.burst_s
        while self._waiting and longest <= 0:
            t, data = self._waiting.popleft()
            self._send(t, data)
        while longest > 0 and self._flush_s <= until_s:
            burst = bytearray()
            while self._waiting and self._waiting[0][0] <= self._flush_s:
                burst += self._waiting.popleft()[1]
            self._send(self._flush_s, bytes(burst))
            self._flush_s += float(self._radio.uniform(max(shortest, 1e-3), longest))

    def _send(self, t: float, data: bytes) -> None:
        if data:
            self._outbox.append((t + self.firmware.latency_s, data))


@dataclass(frozen=True, eq=False)
class _Ahead:
    """Means over coming sample intervals, and the sensor's height at their ends [m]."""

    means: Means
    height: FloatArray

    def rows(self, rows: slice) -> _Ahead:
        means = self.means
        part = Means(
            means.t[rows],
            means.duration[rows],
            means.force[rows],
            means.rate[rows],
            means.field[rows],
        )
        return _Ahead(part, self.height[rows])


def worn_sensor(name: str, kind: str, seed: int = 1) -> SensorModel:
    """Return the sensor of a carried device, for who would calibrate it before or after the walk.

    Parameters
    ----------
    name, kind : str
        As of `Carried`, of a device with one unit.
    seed : int
        Of the walk.
    """
    errors = _generators(name, seed)[0]
    _firmware(IMU_KINDS[kind], errors, exact=False)  # is drawn first
    return _sensor(IMU_KINDS[kind], errors, exact=False)


def _generators(name: str, seed: int) -> list[np.random.Generator]:
    """Return what draws a device's errors, noise, radio, firmware and air."""
    letters = [ord(letter) for letter in name]
    return [
        np.random.default_rng(child) for child in np.random.SeedSequence([seed, *letters]).spawn(5)
    ]


def _sensor(kind: ImuKind, rng: np.random.Generator, exact: bool) -> SensorModel:
    drawn = draw_sensor(rng, kind.budget, kind.sensor)
    if not exact:
        return drawn
    return SensorModel.exact(quantized=False)


def _firmware(kind: ImuKind, rng: np.random.Generator, exact: bool) -> FirmwareModel:
    drawn = draw_firmware(rng, kind.budget, kind.firmware)
    if not exact:
        return drawn
    return drawn.model_copy(
        update={"skew_ppm": 0.0, "clock_offset_s": 0.0, "burst_s": (0.0, 0.0), "latency_s": 0.0}
    )
