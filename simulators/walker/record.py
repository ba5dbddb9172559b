"""A whole walk at once, without ports: bytes with the times of their arrival, arrays, and truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from simulators.encoders import MadeSamples
from simulators.inertial_sensor import Readings
from simulators.sampling import Means
from simulators.walker.device import Carried, CarriedDevice, Made
from simulators.walker.sensor import SensorMotion
from simulators.walker.walker import Walker

SLICE_S = 5.0
RADIO_S = 0.5
"""So long after the end of the walk is listened for what is still on its way."""

LEAD_S = 0.5
"""From the moment when all devices are set up to the begin of the walk."""


@dataclass(frozen=True, eq=False)
class UnitRecord:
    """What one unit measured, sample by sample, and what was true.

    Attributes
    ----------
    name : str
        Of the device, with "/UNIT" where it has several.
    place : str
    t : shape (n,)
        End of each sample's interval [s], since the begin of the walk.
    device_s : shape (n,)
        The same on the device's clock [s].
    counter : shape (n,)
        Number of each sample since the device was switched on.
    accel, gyro, mag : shape (n, 3)
        Readings in nominal SI units [m/s^2, rad/s, uT]; NaN of a part that the device lacks.
    pressure : shape (n,)
        Of the air at the sensor, with turbulence [Pa].
    means : Means
        Mean force, rate and field over each interval, without any error.
    truth : SensorMotion
        At the end of each interval.
    phase : shape (n,)
        `simulators.walker.feet.Phase` of a foot; 0 for the waist.
    """

    name: str
    place: str
    t: FloatArray
    device_s: FloatArray
    counter: IntArray
    accel: FloatArray
    gyro: FloatArray
    mag: FloatArray
    pressure: FloatArray
    means: Means
    truth: SensorMotion
    phase: IntArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)


@dataclass(frozen=True, eq=False)
class DeviceRecord:
    """What one device sent and measured.

    Attributes
    ----------
    carried : Carried
    protocol : str
        Name of the built-in protocol that it speaks.
    chunks : list of (float, bytes)
        What reached the host, with times since the begin of the walk [s].
    said : list of (float, bytes)
        What the host wrote, likewise.
    units : list of UnitRecord
    """

    carried: Carried
    protocol: str
    chunks: list[tuple[float, bytes]]
    said: list[tuple[float, bytes]]
    units: list[UnitRecord]


class Desk:
    """Where a host speaks with one device before the walk, in time that waits for both.

    Attributes
    ----------
    chunks, said : list of (float, bytes)
        What the device sent and the host wrote, with times since the device was switched on [s].
    """

    def __init__(self, device: CarriedDevice) -> None:
        self.device = device
        self.now_s = 0.0
        self.chunks: list[tuple[float, bytes]] = []
        self.said: list[tuple[float, bytes]] = []

    @property
    def protocol(self) -> str:
        """Name of the protocol that the device speaks."""
        return self.device.kind.protocol

    def write(self, data: bytes) -> None:
        """Write to the device."""
        self.said.append((self.now_s, data))
        self.device.receive(data, self.now_s)

    def hear(self, timeout_s: float) -> bytes:
        """Let time pass and return what came."""
        self.now_s += timeout_s
        self.device.advance(self.now_s)
        came = self.device.take(self.now_s)
        self.chunks += came
        return b"".join(data for _, data in came)


class Collector:
    """Gathers what a device makes, for the truth of it."""

    def __init__(self, device: CarriedDevice) -> None:
        self._device = device
        self._made: list[Made] = []

    def add(self, made: Made) -> None:
        """Remember what was made during the walk, if anything."""
        if made.samples and self._device.begin_s <= next(iter(made.means.values())).t[-1]:
            self._made.append(made)

    def units(self) -> list[UnitRecord]:
        """Return everything gathered, unit by unit."""
        return [self._unit(unit) for unit in self._device.ideal]

    def _unit(self, unit: str) -> UnitRecord:
        device = self._device
        samples = [made.samples[unit] for made in self._made]
        means = _joined_means([made.means[unit] for made in self._made])
        readings: list[Readings] = [part.readings for part in samples]
        ideal = device.ideal[unit]
        t = means.t - device.begin_s
        means = replace(means, t=t)
        return UnitRecord(
            name=f"{device.name}/{unit}" if unit else device.name,
            place=device.places[unit],
            t=t,
            device_s=_joined(samples, lambda part: part.device_s),
            counter=_joined(samples, lambda part: part.counter).astype(np.int64),
            accel=_stacked([part.accel for part in readings]),
            gyro=_stacked([part.gyro for part in readings]),
            mag=_stacked([part.mag for part in readings]),
            pressure=_joined(samples, lambda part: part.pressure),
            means=means,
            truth=ideal.at(t),
            phase=ideal.mover.phase(t),
        )


def record_walk(
    walker: Walker,
    devices: Iterable[Carried],
    seed: int = 1,
    *,
    exact: bool = False,
    until_s: float | None = None,
    introduce: Callable[[Desk], None] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, DeviceRecord]:
    """Let devices be carried through a walk, and return what they sent.

    A device that must be asked, and is not, sends what it sends by itself.

    Parameters
    ----------
    walker : Walker
    devices : of Carried
    seed : int
    exact : bool
        Sensors without errors; see `CarriedDevice`.
    until_s : float, optional
        Otherwise to the end of the walk.
    introduce : callable, optional
        Speaks with each device before the walk, which begins when all are done.
    progress : callable
        Told the part that is done, 0 to 1.

    Raises
    ------
    ValueError
        For a kind or place that there is not, or two devices of one name.
    """
    carried = list(devices)
    check_names(carried)
    end_s = walker.end_s if until_s is None else until_s
    begin_s = 0.0
    desks = [Desk(CarriedDevice(one, walker, seed, exact=exact)) for one in carried]
    if introduce is not None:
        for desk in desks:
            desk.device.begin(math.inf)
            introduce(desk)
        begin_s = max(desk.now_s for desk in desks) + LEAD_S
    records: dict[str, DeviceRecord] = {}
    steps = max(1, math.ceil(end_s / SLICE_S))
    for number, (one, desk) in enumerate(zip(carried, desks, strict=True)):
        device = desk.device
        device.begin(begin_s)
        collector = Collector(device)
        for step in range(1, steps + 1):
            collector.add(device.advance(begin_s + end_s * step / steps))
            progress((number + step / steps) / len(carried))
        device.advance(begin_s + end_s + RADIO_S)  # what the radio still holds
        chunks = desk.chunks + device.take(begin_s + end_s + RADIO_S)
        records[one.name] = DeviceRecord(
            one,
            device.kind.protocol,
            [(t - begin_s, data) for t, data in chunks],
            [(t - begin_s, data) for t, data in desk.said],
            collector.units(),
        )
    return records


def check_names(devices: Sequence[Carried]) -> None:
    """Raise :class:`ValueError` for two devices of one name, or none at all."""
    names = [device.name for device in devices]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"there are two devices {name!r}; name them apart.")
        owner = name.rpartition("/")[0]
        if owner in names:
            raise ValueError(f"{name!r} reads like a stream of {owner!r}; rename one of the two.")
    if not names:
        raise ValueError("nobody carries a device; name at least one.")


def _joined(
    parts: list[MadeSamples], column: Callable[[MadeSamples], FloatArray | IntArray]
) -> FloatArray:
    return np.concatenate([column(part) for part in parts]) if parts else np.empty(0)


def _stacked(parts: list[FloatArray]) -> FloatArray:
    return np.concatenate(parts) if parts else np.empty((0, 3))


def _joined_means(parts: list[Means]) -> Means:
    return Means(
        np.concatenate([part.t for part in parts]) if parts else np.empty(0),
        np.concatenate([part.duration for part in parts]) if parts else np.empty(0),
        _stacked([part.force for part in parts]),
        _stacked([part.rate for part in parts]),
        _stacked([part.field for part in parts]),
    )
