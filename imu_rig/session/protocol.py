"""Jig protocols: which poses and rotations a session goes through, as a small readable file."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from imu_rig.errors import InputError
from imu_rig.files import parse_toml, read_small
from imu_rig.validation import ONE_LINE, sentence

MAX_PROTOCOL_BYTES = 64 * 1024
MOST_MOUNTINGS = 6
DEFAULT_PROTOCOL = "full"
CHECK_PROTOCOL = "check"

AxisName = Literal["pan", "tilt", "roll"]
StepKind = Literal["pose", "rotation", "check"]
AXIS_NAMES: tuple[AxisName, ...] = ("pan", "tilt", "roll")
Angle = Annotated[float, Field(ge=-720, le=720, allow_inf_nan=False)]
Seconds = Annotated[float, Field(gt=0, le=600, allow_inf_nan=False)]
AxisPart = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]


class Pose(BaseModel):
    """Angles of the three jig axes [deg]; attitude is ``Rz(pan) Ry(tilt) Rx(roll)``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pan: Angle = 0.0
    tilt: Angle = 0.0
    roll: Angle = 0.0

    def angles(self) -> dict[str, float]:
        """Angles by axis name [deg]."""
        return {"pan": self.pan, "tilt": self.tilt, "roll": self.roll}

    def __str__(self) -> str:
        return f"pan {self.pan:+.0f}° tilt {self.tilt:+.0f}° roll {self.roll:+.0f}°"


class CheckLimits(BaseModel):
    """Largest errors with which a calibration passes its own check poses.

    ``accel_mg`` bounds the error of gravity's magnitude in a check pose, ``turn_deg`` that of its
    direction after a move to or from one, ``sigma`` either in predicted standard deviations.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    accel_mg: Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)] = 1.0
    turn_deg: Annotated[float, Field(gt=0, le=90, allow_inf_nan=False)] = 0.3
    sigma: Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)] = 4.0


class Mounting(BaseModel):
    """How the sensor sits on the plate: what a person is told, and the nominal rotation.

    The sensor stands on the plate turned by ``angle_deg`` about ``axis``, which is in the axes of
    the plate (x is the roll axis, y the tilt axis, z up when the jig is parked level).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(min_length=1, max_length=80), ONE_LINE]
    instruction: Annotated[str, Field(max_length=400), ONE_LINE] = ""
    axis: tuple[AxisPart, AxisPart, AxisPart] = (0.0, 0.0, 1.0)
    angle_deg: Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)] = 0.0

    @field_validator("axis")
    @classmethod
    def _has_a_direction(cls, axis: tuple[float, float, float]) -> tuple[float, float, float]:
        if not math.hypot(*axis) > 0.0:
            raise ValueError("must not be zero")
        return axis

    def rotation_vector(self) -> tuple[float, float, float]:
        """Nominal rotation of the sensor on the plate [rad]."""
        scale = math.radians(self.angle_deg) / math.hypot(*self.axis)
        x, y, z = self.axis
        return x * scale, y * scale, z * scale


class Step(BaseModel):
    """One stop of a session; an axis that is left out stays where the step before put it.

    A step with ``kind = "pose"`` is a static pose: held still for ``hold_s``, it counts for the
    accelerometer and for the gyroscope's bias. One with ``kind = "check"`` is held likewise and
    kept out of the fit, with the moves to and from it, to verify the calibration. One with
    ``kind = "rotation"`` exists for the turn that leads to it: it is held only as long as the
    turn's end needs to be measured.

    ``mounting`` counts the protocol's mountings from 1 and stays, like an angle, until another is
    named; before its first step the jig parks and waits for the sensor to be turned over.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    pan: Angle | None = None
    tilt: Angle | None = None
    roll: Angle | None = None
    kind: StepKind = "pose"
    hold_s: Seconds | None = None
    mounting: Annotated[int, Field(ge=1, le=MOST_MOUNTINGS)] | None = None
    name: Annotated[str, Field(max_length=80), ONE_LINE] | None = None


class JigProtocol(BaseModel):
    """A whole session as its file describes it.

    ``hold_s`` is the time at each stop; its first ``settle_s`` are not used, and motion begins
    it anew.
    ``order`` says which axes may turn together: the axes of one group start at the same time, the
    groups follow each other with ``pause_s`` between them, so that a turn about a single axis can
    be told from the rest.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(min_length=1, max_length=80), ONE_LINE]
    title: Annotated[str, Field(max_length=200), ONE_LINE] = ""
    hold_s: Seconds = 2.0
    rotation_hold_s: Seconds = 0.8
    settle_s: Annotated[float, Field(ge=0, le=60, allow_inf_nan=False)] = 0.3
    pause_s: Annotated[float, Field(ge=0, le=60, allow_inf_nan=False)] = 0.3
    order: tuple[tuple[AxisName, ...], ...] = (("pan", "tilt"), ("roll",))
    steps: Annotated[tuple[Step, ...], Field(min_length=1, max_length=2000)]
    limits: CheckLimits = CheckLimits()
    mountings: Annotated[tuple[Mounting, ...], Field(max_length=MOST_MOUNTINGS)] = ()

    @model_validator(mode="after")
    def _every_axis_once(self) -> JigProtocol:
        named = [axis for group in self.order for axis in group]
        if sorted(named) != sorted(AXIS_NAMES):
            raise ValueError("order must name pan, tilt and roll exactly once")
        return self

    @model_validator(mode="after")
    def _every_mounting_described(self) -> JigProtocol:
        most = max((step.mounting or 1 for step in self.steps), default=1)
        if most > max(1, len(self.mountings)):
            raise ValueError(
                f"a step names mounting {most}, and {len(self.mountings)} are described: add it "
                "to mountings"
            )
        return self

    @property
    def mounting_of_steps(self) -> tuple[int, ...]:
        """Mounting of every step, counted from 0."""
        current, found = 0, []
        for step in self.steps:
            current = current if step.mounting is None else step.mounting - 1
            found.append(current)
        return tuple(found)

    @property
    def mounting_turns(self) -> tuple[tuple[float, float, float], ...]:
        """Nominal rotation vector of every mounting [rad]; one of none where none is described."""
        turns = tuple(mounting.rotation_vector() for mounting in self.mountings)
        return turns or ((0.0, 0.0, 0.0),)

    @property
    def only_checks(self) -> bool:
        """Whether the protocol checks a certificate and calibrates nothing."""
        return all(step.kind == "check" for step in self.steps)

    def hold_of(self, step: Step) -> float:
        """Seconds that ``step`` is held, settling included."""
        if step.hold_s is not None:
            return step.hold_s
        return self.rotation_hold_s if step.kind == "rotation" else self.hold_s


def builtin_protocols() -> dict[str, str]:
    """Names of the protocols that come with imu-rig, with the text of each file."""
    folder = resources.files("jig_scripts") / "protocols"
    return {
        entry.name.removesuffix(".toml"): entry.read_text(encoding="utf-8")
        for entry in sorted(folder.iterdir(), key=lambda entry: entry.name)
        if entry.name.endswith(".toml")
    }


def load_protocol(name_or_path: str | Path) -> JigProtocol:
    """Read a protocol by the name of a built-in one or the path of a TOML file.

    Raises
    ------
    InputError
        If there is no such protocol, or its file says something that cannot be done.
    """
    builtin = builtin_protocols()
    if str(name_or_path) in builtin:
        return _parse(builtin[str(name_or_path)].encode(), f"protocol {name_or_path}")
    if not Path(name_or_path).is_file():
        raise InputError(
            f"There is no jig protocol '{name_or_path}': give one of {', '.join(builtin)}, or the "
            "path of a TOML file."
        )
    data = read_small(name_or_path, MAX_PROTOCOL_BYTES, what="a jig protocol")
    return _parse(data, str(name_or_path))


def _parse(data: bytes, origin: str) -> JigProtocol:
    try:
        return JigProtocol.model_validate(parse_toml(data, origin))
    except ValidationError as error:
        raise InputError(f"{origin}: {sentence(error, 'a jig protocol')}.") from error
