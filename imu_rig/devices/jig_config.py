"""The jig file: which servo turns which axis, how far, how fast. Small, readable, checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from imu_rig.errors import InputError
from imu_rig.files import parse_toml, read_small
from imu_rig.validation import ONE_LINE, sentence

AxisName = Literal["pan", "tilt", "roll"]
AXES: tuple[AxisName, ...] = ("pan", "tilt", "roll")
DEFAULT_JIG_NAME = "paper-jig"

QUARTERS = 4
"""A Maestro counts pulses in quarters of a microsecond."""

LEAST_US, GREATEST_US = 64.0, 4080.0
"""What a Maestro can make at all [us]. Its channels are narrower until they are set wider."""

SPEED_UNIT = 25.0
"""One unit of a Maestro's speed limit [us/s]."""

ACCELERATION_UNIT = 312.5
"""One unit of its acceleration limit [us/s^2]."""

MAX_SPEED, MAX_ACCELERATION = 10_000, 255
MAX_FILE_BYTES = 65_536

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Positive = Annotated[float, Field(gt=0, le=10_000, allow_inf_nan=False)]
_Pair = tuple[_Finite, _Finite]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class AxisConfig(_Model):
    """One axis of the jig and its servo.

    Attributes
    ----------
    channel : int
        Of the Maestro.
    angle_deg, pulse_us : (float, float)
        Two angles of the axis [deg] and the pulses that command them [us]; linear through both.
    limits_deg : (float, float)
        What may be commanded [deg].
    speed_dps, acceleration_dps2 : float
        Limits that the Maestro keeps [deg/s, deg/s^2], rounded to its units, never to none.
    gear_ratio : float or None
        Turns of the servo per turn of the axis; tells the servo's own resolution, no more.
    """

    channel: Annotated[int, Field(ge=0, le=23, strict=True)]
    angle_deg: _Pair
    pulse_us: _Pair
    limits_deg: _Pair
    speed_dps: _Positive
    acceleration_dps2: _Positive
    gear_ratio: _Positive | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.angle_deg[0] == self.angle_deg[1]:
            raise ValueError("angle_deg must give two different angles")
        if self.pulse_us[0] == self.pulse_us[1]:
            raise ValueError("pulse_us must give two different pulses")
        low, high = self.limits_deg
        if not low < high:
            raise ValueError(f"limits_deg must rise, but {low:g} is not below {high:g}")
        for angle in self.limits_deg:
            pulse = self.pulse(angle) / QUARTERS
            if not LEAST_US <= pulse <= GREATEST_US:
                raise ValueError(
                    f"limits_deg lets the axis go to {angle:g} deg, which is a pulse of "
                    f"{pulse:g} us; a Maestro makes {LEAST_US:g} to {GREATEST_US:g} us"
                )
        return self

    @property
    def us_per_deg(self) -> float:
        """Change of the pulse per degree [us/deg]; negative where the servo turns the other way."""
        (a0, a1), (p0, p1) = self.angle_deg, self.pulse_us
        return (p1 - p0) / (a1 - a0)

    def pulse(self, angle_deg: float) -> int:
        """Return the pulse [quarter-us] that commands an angle [deg], nearest."""
        microseconds = self.pulse_us[0] + (angle_deg - self.angle_deg[0]) * self.us_per_deg
        return round(QUARTERS * microseconds)

    def angle(self, quarter_us: float) -> float:
        """Return the angle [deg] that a pulse [quarter-us] commands."""
        return self.angle_deg[0] + (quarter_us / QUARTERS - self.pulse_us[0]) / self.us_per_deg

    @property
    def limits_quarter_us(self) -> tuple[int, int]:
        """Least and greatest pulse [quarter-us] within the limits of angle, rounded to all."""
        first, second = (self.pulse(angle) for angle in self.limits_deg)
        return min(first, second), max(first, second)

    @property
    def speed_units(self) -> int:
        """Speed limit in the Maestro's units; at least 1, because 0 would be no limit."""
        wanted = self.speed_dps * abs(self.us_per_deg) / SPEED_UNIT
        return min(max(1, round(wanted)), MAX_SPEED)

    @property
    def acceleration_units(self) -> int:
        """Acceleration limit in the Maestro's units; at least 1."""
        wanted = self.acceleration_dps2 * abs(self.us_per_deg) / ACCELERATION_UNIT
        return min(max(1, round(wanted)), MAX_ACCELERATION)

    @property
    def resolution_deg(self) -> float:
        """Angle of one quarter-microsecond [deg]."""
        return abs(1.0 / (QUARTERS * self.us_per_deg))

    def travel_time(self, start_deg: float, stop_deg: float) -> float:
        """Predict how long a move from rest to rest takes [s], with the limits as rounded.

        A trapezoid of speed V with ramps of A: ``d/V + V/A``, or ``2 sqrt(d/A)`` where the way
        is too short to reach V.
        """
        way = abs(self.pulse(stop_deg) - self.pulse(start_deg)) / QUARTERS
        speed = self.speed_units * SPEED_UNIT
        acceleration = self.acceleration_units * ACCELERATION_UNIT
        if way < speed**2 / acceleration:
            return 2.0 * math.sqrt(way / acceleration)
        return way / speed + speed / acceleration

    @property
    def braking_time(self) -> float:
        """Time to stop from full speed [s]."""
        return self.speed_units * SPEED_UNIT / (self.acceleration_units * ACCELERATION_UNIT)


class JigConfig(_Model):
    """A jig of three servos: pan turns the base, tilt the arm on it, roll the sensor's plate.

    Attributes
    ----------
    name : str
    pan, tilt, roll : AxisConfig
    park_deg : (float, float, float)
        Pose of pan, tilt and roll in which the jig is safe to leave [deg].
    overshoot_deg : float
        How far beyond a pose the jig goes first, so that every pose is approached from one side.
    """

    name: Annotated[str, Field(min_length=1, max_length=80), ONE_LINE]
    pan: AxisConfig
    tilt: AxisConfig
    roll: AxisConfig
    park_deg: tuple[_Finite, _Finite, _Finite] = (0.0, 0.0, 0.0)
    overshoot_deg: Annotated[float, Field(ge=0, le=90, allow_inf_nan=False)] = 6.0

    @model_validator(mode="after")
    def _check(self) -> Self:
        taken: dict[int, str] = {}
        for name, axis in self.axes.items():
            if axis.channel in taken:
                raise ValueError(
                    f"{taken[axis.channel]} and {name} both have channel {axis.channel}"
                )
            taken[axis.channel] = name
        for name, angle in zip(AXES, self.park_deg, strict=True):
            low, high = self.axes[name].limits_deg
            if not low <= angle <= high:
                raise ValueError(
                    f"park_deg parks {name} at {angle:g} deg, outside its limits of {low:g} to "
                    f"{high:g} deg"
                )
        return self

    @property
    def axes(self) -> dict[AxisName, AxisConfig]:
        """The three axes by name."""
        return {"pan": self.pan, "tilt": self.tilt, "roll": self.roll}

    def park(self) -> dict[str, float]:
        """Return the park pose by axis [deg]."""
        pose: dict[str, float] = dict(zip(AXES, self.park_deg, strict=True))
        return pose

    def travel_time(self, start: Mapping[str, float], stop: Mapping[str, float]) -> float:
        """Predict how long a move takes [s]: its slowest axis; axes in ``stop`` only stay."""
        axes = self.axes
        return max(
            (axes[a].travel_time(start[a], stop[a]) for a in AXES if a in stop and a in start),
            default=0.0,
        )


def load_jig(path_or_name: str | Path) -> JigConfig:
    """Load a jig file, or the built-in jig of that name.

    Raises
    ------
    InputError
        If there is no such file or it is not a usable jig; names file and field.
    """
    builtin = files("jig_scripts") / "jigs"
    names = sorted(
        e.name.removesuffix(".toml") for e in builtin.iterdir() if e.name[-5:] == ".toml"
    )
    if str(path_or_name) in names:
        where = f"built-in jig {path_or_name}"
        text = (builtin / f"{path_or_name}.toml").read_bytes()
    else:
        where = str(path_or_name)
        if not Path(path_or_name).is_file():
            raise InputError(
                f"{where}: there is no such jig file, and no built-in jig of that name "
                f"(built in: {', '.join(names)})."
            )
        text = read_small(path_or_name, MAX_FILE_BYTES, what="a jig file")
    data = parse_toml(text, where)
    try:
        return JigConfig.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{where}: {sentence(error, 'a jig file')}.") from error
