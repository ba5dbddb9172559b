"""A flight controller as an inertial sensor: its IMU and pressure messages over MAVLink.

Streams
-------
"imu"
    One of HIGHRES_IMU, SCALED_IMU, SCALED_IMU2, SCALED_IMU3 and RAW_IMU.
"pressure"
    SCALED_PRESSURE of the same sender.

Axes: MAVLink's are those of the vehicle: x forward, y right, z **down**; at rest on a level table
zacc is -9.81 m/s2. Here x is forward, y left and z up, so that the accelerometer reads +9.81 on z:
(x, -y, -z), alike for accelerometer, gyroscope and magnetometer. It is a turn of half a circle
about x, so right hands stay right hands.

Time is ``time_usec`` (of its eight bytes the lower four, which come round after 71 minutes) or
``time_boot_ms``. The sequence number of a frame counts all messages of its sender, whatever they
say; what it tells of a stream's losses is in the field "seq", see
:mod:`firmware_protocols.mavlink_counting`.

HIGHRES_IMU is a measurement in floating point. The others are whole numbers of 1 mg, 1 mrad/s and
1 mgauss that stop at +-32.767 of the full unit. The firmwares known do not round but cut off, so a
row holds the middle of what a number stands for: 3.5 for 3, -3.5 for -3. 0 stands for everything
between -1 and 1, in which a gyroscope nearly at rest is blind. That is poor for a calibration.

RAW_IMU is in the same units by the definition of its fields and as ArduPilot sends it; its text
speaks of raw counts, and other firmware may mean those: compare 1 g before you trust it.

What a sensor that is not there leaves zero becomes NaN: a magnetic field of exactly (0, 0, 0), a
pressure of 0, and a temperature of 0 where 0 means that there is none.

A port may carry messages of several systems and components: see
:mod:`firmware_protocols.mavlink_senders` for whose count. Of the sensors of that sender the first
that is heard counts, or the one that the description asks for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_protocols.descriptions import every, take
from firmware_protocols.fields import Field, LayoutError, quote
from firmware_protocols.layout import toml_lines
from firmware_protocols.mavlink_counting import StreamCounter
from firmware_protocols.mavlink_frames import (
    MAVLINK_FORMAT,
    Contents,
    MavlinkFrameDecoder,
    no_contents,
    read_contents,
    read_senders,
)
from firmware_protocols.mavlink_messages import HEARTBEAT, MESSAGES, SCALED_PRESSURE, Message
from firmware_protocols.mavlink_senders import (
    Asked,
    OtherSenders,
    Sender,
    SenderChoice,
    sensors_of,
)
from firmware_protocols.protocol import DeviceProtocol, Packets
from firmware_protocols.rows import RowLayout, check_names
from firmware_protocols.unconfirmed import MAVLINK_CUT_OFF
from firmware_protocols.variable_framing import Flags, FramedBytes

KIND = "mavlink"
IMU_MESSAGES = ("HIGHRES_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "RAW_IMU")
DEFAULT_RATE_HZ = 100.0
MIN_RATE_HZ, MAX_RATE_HZ = 0.01, 8000.0
PRESSURE_HZ = 10.0

BODY_AXES = ("+x", "-y", "-z")
"""Forward, left, up out of forward, right, down."""

UPDATED = (
    ("accel_updated", 0),
    ("gyro_updated", 3),
    ("mag_updated", 6),
    ("pressure_updated", 9),
    ("temperature_updated", 12),
)
"""Bits of HIGHRES_IMU.fields_updated: 0-2 accelerometer, 3-5 gyroscope, 6-8 magnetometer,
9 pressure, 12 temperature. What is not updated repeats the measurement before."""

_OVERHEAD = 12  # bytes of a frame of MAVLink 2 without its payload
_HEARTBEAT_BYTES = 21

Rows = npt.NDArray[np.void]


@dataclass(frozen=True)
class MavlinkProtocol(DeviceProtocol):
    """What a flight controller sends.

    Attributes
    ----------
    name, title : str
    message : str
        The inertial message, one of :data:`IMU_MESSAGES`.
    system, component, sensor : int or None
        Of whom; None takes the first, see :mod:`firmware_protocols.mavlink_senders`.
    rate_hz : float
        What to ask the flight controller for, messages per second.
    """

    name: str
    title: str = ""
    message: str = "HIGHRES_IMU"
    system: int | None = None
    component: int | None = None
    sensor: int | None = None
    rate_hz: float = DEFAULT_RATE_HZ

    def __post_init__(self) -> None:
        check_names(self.name, self.title)
        if self.message not in IMU_MESSAGES:
            raise LayoutError(
                f"message {quote(self.message)} is not known, take one of "
                f"{', '.join(IMU_MESSAGES)}."
            )
        for key in ("system", "component", "sensor"):
            number = getattr(self, key)
            if number is not None and not 0 <= number <= 255:
                raise LayoutError(f"{key} must be 0 to 255.")
        if not MIN_RATE_HZ <= self.rate_hz <= MAX_RATE_HZ:
            raise LayoutError(f"rate_hz must be {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}.")

    @property
    def imu(self) -> Message:
        """The inertial message."""
        return MESSAGES[self.message]

    @cached_property
    def streams(self) -> Mapping[str, RowLayout]:
        """The inertial message, and the pressure."""
        return {"imu": self._imu_rows(), "pressure": self._pressure_rows()}

    @property
    def longest(self) -> int:
        """Bytes of the longest frame."""
        return MAVLINK_FORMAT.longest

    @property
    def proves_packets(self) -> bool:
        """Every frame has a checksum."""
        return True

    @property
    def bytes_per_s(self) -> float:
        """What it sends at the rates asked for, without anything else that it may send."""
        return (
            (_OVERHEAD + self.imu.dtype.itemsize) * self.rate_hz
            + (_OVERHEAD + SCALED_PRESSURE.dtype.itemsize) * PRESSURE_HZ
            + _HEARTBEAT_BYTES
        )

    def decoder(self) -> MavlinkDecoder:
        """Return a new decoder."""
        return MavlinkDecoder(self)

    def quick_decoder(self) -> MavlinkDecoder:
        """Return a decoder that waits for no heartbeat."""
        return MavlinkDecoder(self, wait=False)

    @property
    def asked(self) -> Asked:
        """Whose messages are asked for."""
        return Asked(self.system, self.component, self.sensor)

    def choice(self, *, wait: bool = True) -> SenderChoice:
        """Return the rule by which one of several senders is taken, at its beginning."""
        return SenderChoice(self.asked, self.message, self.rate_hz, wait=wait)

    def to_dict(self) -> dict[str, Any]:
        """Return the protocol as plain data, in the form of the TOML files."""
        asked = {key: getattr(self, key) for key in ("system", "component", "sensor")}
        return {
            "name": self.name,
            "title": self.title,
            "kind": KIND,
            "message": self.message,
            "rate_hz": self.rate_hz,
            **{key: number for key, number in asked.items() if number is not None},
        }

    def to_toml(self) -> str:
        """Return the protocol as the text of a file that is read back."""
        return "\n".join(toml_lines(self.to_dict())) + "\n"

    def _imu_rows(self) -> RowLayout:
        name, title = self.name, f"{self.message} over MAVLink"
        if self.message == "HIGHRES_IMU":
            return RowLayout(
                name=name,
                title=title,
                byte_order="little",
                counter="seq",
                clock="time",
                rate_hz=self.rate_hz,
                fields=(
                    Field("seq", "u16"),
                    Field("time", "u32", unit="us"),
                    Field("accel", "f32", 3, unit="m/s2", axes=BODY_AXES),
                    Field("gyro", "f32", 3, unit="rad/s", axes=BODY_AXES),
                    Field("mag", "f32", 3, unit="gauss", axes=BODY_AXES),
                    Field("pressure", "f32", unit="hPa"),
                    Field("temperature", "f32", unit="degC"),
                    Field("updated", "u16", flags=UPDATED),
                ),
            )
        boot_ms = self.message != "RAW_IMU"
        return RowLayout(
            name=name,
            title=title,
            byte_order="little",
            counter="seq",
            clock="time",
            clock_tick_s=1e-3 if boot_ms else 1e-6,
            rate_hz=self.rate_hz,
            fields=(
                Field("seq", "u16"),
                Field("time", "u32", unit="ms" if boot_ms else "us"),
                Field("accel", "f32", 3, unit="mg", axes=BODY_AXES),
                Field("gyro", "f32", 3, unit="mrad/s", axes=BODY_AXES),
                Field("mag", "f32", 3, unit="mG", axes=BODY_AXES),
                Field("temperature", "f32", unit="degC", counts_per_unit=100.0),
            ),
        )

    def _pressure_rows(self) -> RowLayout:
        return RowLayout(
            name=f"{self.name}-pressure",
            title="SCALED_PRESSURE over MAVLink",
            byte_order="little",
            clock="time",
            clock_tick_s=1e-3,
            rate_hz=PRESSURE_HZ,
            fields=(
                Field("time", "u32", unit="ms"),
                Field("pressure", "f32", unit="hPa"),
                Field("temperature", "i16", unit="degC", counts_per_unit=100.0),
            ),
        )


class MavlinkDecoder(MavlinkFrameDecoder):
    """Decoder of what a flight controller sends.

    Parameters
    ----------
    protocol : MavlinkProtocol
    wait : bool
        Whether to wait for a heartbeat before messages count, see
        :mod:`firmware_protocols.mavlink_senders`.
    """

    def __init__(self, protocol: MavlinkProtocol, *, wait: bool = True) -> None:
        super().__init__()
        self._protocol = protocol
        self._choice = protocol.choice(wait=wait)
        self._sensor = protocol.sensor
        self._others = OtherSenders(protocol.asked, protocol.message)
        layout = protocol.streams["imu"]
        self._counter = StreamCounter(layout.clock_tick_s, 1.0 / protocol.rate_hz)

    @property
    def sender(self) -> Sender | None:
        """Whose inertial messages are taken; None until that is known."""
        if self._choice.address is None or self._sensor is None:
            return None
        return Sender(*self._choice.address, self._sensor)

    @property
    def others(self) -> Counter[Sender]:
        """How many inertial messages of the same kind others sent, of the first few of them."""
        return self._others.counts

    def take_faults(self) -> dict[str, int]:
        """Name others that send the message too; see `firmware_protocols.protocol`."""
        return self._others.take_told()

    def _read(self, frames: FramedBytes) -> dict[str, Packets]:
        self._note_gaps(frames)
        streams, message = self._protocol.streams, self._protocol.imu
        found = read_contents(frames, (message, SCALED_PRESSURE, HEARTBEAT))
        since = self._choice.look(found)
        end = frames.end
        imu = self._own_imu(found.get(message.name, no_contents(message)), end, since)
        pressure = self._own(found.get(SCALED_PRESSURE.name, no_contents(SCALED_PRESSURE)), since)
        rows = _imu_rows(streams["imu"], imu.payload)
        rows["seq"] = self._count(frames, imu, rows["time"], since) & 0xFFFF
        return {
            "imu": Packets(rows, end[imu.index]),
            "pressure": Packets(
                _pressure_rows(streams["pressure"], pressure.payload), end[pressure.index]
            ),
        }

    def _own(self, found: Contents, since: int) -> Contents:
        """Return what the sender that counts sent, from the frame on at which it began to."""
        return found.taken(self._is_own(found, since))

    def _is_own(self, found: Contents, since: int) -> Flags:
        if self._choice.address is None:
            return np.zeros(len(found), dtype=np.bool_)
        system, component = self._choice.address
        own: Flags = (found.system == system) & (found.component == component)
        return own & (found.index >= since)

    def _own_imu(self, found: Contents, end: npt.NDArray[np.int64], since: int) -> Contents:
        """Return the sender's inertial messages, and take note of others."""
        own = self._is_own(found, since)
        if self._sensor is None and bool(own.any()):
            self._sensor = int(sensors_of(found)[own.argmax()])
        if self._sensor is not None:
            own &= sensors_of(found) == self._sensor
        if self._choice.address is not None and not bool(own.all()):
            others = found.taken(~own & (found.index >= since))
            self._others.add(others, end[others.index], self.sender)
        return found.taken(own)

    def _count(
        self, frames: FramedBytes, imu: Contents, time: npt.NDArray[np.uint32], since: int
    ) -> npt.NDArray[np.int64]:
        """Return numbers of the sender's inertial messages, counted from the first."""
        if self._choice.address is None:
            return imu.index
        system, component, sequence = read_senders(frames)
        own = (system == self._choice.address[0]) & (component == self._choice.address[1])
        own[:since] = False
        places = np.flatnonzero(own)
        return self._counter.feed(
            sequence[places], np.searchsorted(places, imu.index), time.astype(np.int64)
        )


def _imu_rows(layout: RowLayout, payload: Rows) -> Rows:
    """Return the rows of an inertial message; see the module for what becomes NaN."""
    rows = np.zeros(len(payload), dtype=layout.dtype)
    names = payload.dtype.names or ()
    time = "time_usec" if "time_usec" in names else "time_boot_ms"
    rows["time"] = payload[time] & 0xFFFFFFFF
    for name, sent in (("accel", "acc"), ("gyro", "gyro"), ("mag", "mag")):
        rows[name] = payload[sent]
        if payload[sent].dtype.kind == "i":
            rows[name] += MAVLINK_CUT_OFF * np.sign(payload[sent])
    rows["mag"][np.all(payload["mag"] == 0, axis=1)] = np.nan
    rows["temperature"] = payload["temperature"]
    no_temperature = payload["temperature"] == 0
    if "fields_updated" in names:
        rows["updated"] = payload["fields_updated"]
        rows["pressure"] = payload["abs_pressure"]
        rows["pressure"][payload["abs_pressure"] == 0] = np.nan
        no_temperature &= (
            payload["fields_updated"] >> dict(UPDATED)["temperature_updated"]
        ) & 1 == 0
    rows["temperature"][no_temperature] = np.nan
    return rows


def _pressure_rows(layout: RowLayout, payload: Rows) -> Rows:
    rows = np.zeros(len(payload), dtype=layout.dtype)
    rows["time"] = payload["time_boot_ms"]
    rows["pressure"] = payload["press_abs"]
    rows["pressure"][payload["press_abs"] == 0] = np.nan
    rows["temperature"] = payload["temperature"]
    return rows


_KINDS = {
    "kind": str,
    "name": str,
    "title": str,
    "message": str,
    "system": int,
    "component": int,
    "sensor": int,
    "rate_hz": float,
}
"""What a description may hold, and of which kind."""


def from_dict(data: Mapping[str, Any]) -> MavlinkProtocol:
    """Build a protocol from plain data, as `MavlinkProtocol.to_dict` gives it.

    Raises
    ------
    LayoutError
        For anything that is not a usable description.
    """
    take("the layout", data, "name", str)
    values = every("the layout", data, _KINDS)
    values.pop("kind", None)
    return MavlinkProtocol(**values)
