"""What a recording of another program holds, whatever its format."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imu_rig.blocks import ImuBlock, Samples
from imu_rig.errors import InputError
from imu_rig.reference.reference import Reference


@dataclass(frozen=True)
class SharedClock:
    """A clock that several files tell their time by.

    Attributes
    ----------
    name : str
        Files with the same name of a clock can be put together.
    zero_s : float
        Its reading at time 0 of the recording [s].
    wraps_s : float or None
        Reading at which it begins at 0 again [s].
    """

    name: str
    zero_s: float
    wraps_s: float | None = None


@dataclass(frozen=True)
class ForeignRecording:
    """One recording of another program.

    Attributes
    ----------
    format : str
        Name of the format.
    files : tuple of Path
        What was read.
    streams : dict
        Name of each sensor to its samples, in SI units; those in other units keep the file's.
    reference : Reference or None
        Truth by another instrument, where the file has it.
    notes : tuple of str
        What a user should know of how it was read, a sentence each without its stop.
    start_utc_ns : int or None
        Wall clock at time 0 [ns since 1970 UTC], where the file tells it.
    clock : SharedClock or None
        What ties its time to that of other files.
    """

    format: str
    files: tuple[Path, ...]
    streams: dict[str, Samples]
    reference: Reference | None = None
    notes: tuple[str, ...] = ()
    start_utc_ns: int | None = None
    clock: SharedClock | None = None

    @property
    def sensors(self) -> list[str]:
        """Names of the streams with an accelerometer or a gyroscope."""
        return [name for name, s in self.streams.items() if s.is_inertial]

    def imu(self, name: str | None = None) -> ImuBlock:
        """Return the samples of a sensor, by name where there are several.

        A sensor without gyroscope has zeros there, like a table without one.

        Raises
        ------
        InputError
            No such sensor, several to choose from, or no accelerometer.
        """
        there = self.sensors
        shown = self.files[0] if self.files else "The recording"
        if name is None and len(there) != 1:
            raise InputError(
                f"{shown} holds {len(there)} inertial sensors ({', '.join(there) or 'none'}): "
                "make trials of them with imu-rig import, one sensor each"
            )
        chosen = there[0] if name is None else name
        if chosen not in there:
            raise InputError(f"{shown} has no sensor {chosen!r}; it has {', '.join(there)}")
        samples = self.streams[chosen]
        if "accel" not in samples.values:
            raise InputError(f"{shown}: the sensor {chosen!r} has no accelerometer")
        accel = samples.values["accel"]
        return ImuBlock(
            t=samples.t,
            accel=accel,
            gyro=samples.values.get("gyro", np.zeros_like(accel)),
            host_s=samples.host_s,
            device_s=samples.device_s,
            counter=samples.counter,
            mag=samples.values.get("mag"),
            temperature=samples.values.get("temperature"),
        )


def block_samples(block: ImuBlock, *, without_gyro: bool = False) -> Samples:
    """Return a block as samples by field."""
    values = {"accel": block.accel}
    units = {"accel": "m/s2"}
    for name, numbers, unit in (
        ("gyro", None if without_gyro else block.gyro, "rad/s"),
        ("mag", block.mag, "uT"),
        ("temperature", block.temperature, "degC"),
    ):
        if numbers is not None:
            values[name], units[name] = numbers, unit
    return Samples(block.t, block.host_s, block.device_s, block.counter, values, units)


def shifted(samples: Samples, by_s: float) -> Samples:
    """Return samples with all their times later by ``by_s``."""
    return replace(samples, t=samples.t + by_s, host_s=samples.host_s + by_s)
