"""The kinds of inertial sensors that the simulated world can carry, by name.

A kind is looked up in the module of its device when it is first asked for: devices know this
module, and this one knows only where they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module

import numpy as np

from simulators.budget import Budget
from simulators.encoders import Encoder
from simulators.inertial_sensor import SensorRanges
from simulators.models import FirmwareModel, SensorModel

DEFAULT_KIND = "mpu9150"

PLACES = {
    DEFAULT_KIND: "simulators.mpu9150_module:MPU9150_MODULE",
    "adis16405": "simulators.adis16405:ADIS16405",
    "waist-unit": "simulators.waist_unit:WAIST_UNIT",
    "two-imu": "simulators.two_imu:TWO_IMU",
    "two-imu-waist": "simulators.two_imu:TWO_IMU_WAIST",
    "two-imu-both": "simulators.two_imu:TWO_IMU_BOTH",
    "xsens-mti": "simulators.mti:XSENS_MTI",
    "xsens-mti-legacy": "simulators.mti:XSENS_MTI_LEGACY",
    "mavlink-highres": "simulators.flight_controller:MAVLINK_HIGHRES",
    "mavlink-scaled": "simulators.flight_controller:MAVLINK_SCALED",
    "mavlink-raw": "simulators.flight_controller:MAVLINK_RAW",
}
"""Where each kind is: "module:attribute"."""

EncoderMaker = Callable[[FirmwareModel, np.random.Generator], Encoder]
"""Makes the firmware of one device; the generator is for what is random in it alone."""


@dataclass(frozen=True)
class ImuKind:
    """One kind of device: its sensor, how wrong that may be, and what it sends.

    Attributes
    ----------
    name : str
    title : str
        One line for people.
    protocol : str
        Name of the built-in protocol that it speaks.
    output_hz : float
        Inertial samples per second that reach the host, as the device starts.
    ranges : SensorRanges
        Counts and full scales of its inertial samples as the host sees them.
    encoder : callable
        Makes its firmware.
    budget : Budget
        Limits of the errors of one of these devices.
    sensor : SensorModel
        Noise and drift of one of these devices.
    firmware : FirmwareModel
        The way from the device to the host.
    encoder_rounds : bool
        Whether the firmware is given readings that are not rounded, since it filters them first
        or has ranges to choose from.
    any_layout : bool
        Whether the firmware sends whatever packet layout it is told to.
    stream : str or None
        The inertial stream that is the sensor's on the jig, of a protocol with several.
    """

    name: str
    title: str
    protocol: str
    output_hz: float
    ranges: SensorRanges
    encoder: EncoderMaker
    budget: Budget = field(default_factory=Budget)
    sensor: SensorModel = field(default_factory=SensorModel)
    firmware: FirmwareModel = field(default_factory=FirmwareModel)
    encoder_rounds: bool = False
    any_layout: bool = False
    stream: str | None = None

    @property
    def sensor_ranges(self) -> SensorRanges:
        """What the sensor hands to the firmware."""
        return self.ranges.unrounded() if self.encoder_rounds else self.ranges


class _Kinds(Mapping[str, ImuKind]):
    """Every kind by its name, imported when it is looked up."""

    def __getitem__(self, name: str) -> ImuKind:
        """Return a kind, or raise KeyError."""
        module, attribute = PLACES[name].split(":")
        kind: ImuKind = getattr(import_module(module), attribute)
        return kind

    def __iter__(self) -> Iterator[str]:
        """Return the names."""
        return iter(PLACES)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(PLACES)


IMU_KINDS: Mapping[str, ImuKind] = _Kinds()


def kind_of(name: str) -> str:
    """Return the kind of a name: its own, or that of the protocol that it speaks.

    Raises :class:`ValueError`, listing the kinds, where there is none.
    """
    if name not in PLACES:
        speaking = (kind.name for kind in IMU_KINDS.values() if kind.protocol == name)
        name = next(speaking, name)
    check_kind(name)
    return name


def check_kind(name: str) -> None:
    """Raise :class:`ValueError`, listing the kinds, for one that there is not."""
    if name not in PLACES:
        raise ValueError(f"there is no kind of IMU {name!r}; take one of {', '.join(PLACES)}.")
