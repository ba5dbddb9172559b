"""Jig protocols: which poses and rotations a session goes through, as a small readable file."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from imu_rig.errors import InputError
from imu_rig.files import parse_toml, read_small
from imu_rig.validation import sentence

MAX_PROTOCOL_BYTES = 64 * 1024
DEFAULT_PROTOCOL = "full"

AxisName = Literal["pan", "tilt", "roll"]
AXIS_NAMES: tuple[AxisName, ...] = ("pan", "tilt", "roll")
Angle = Annotated[float, Field(ge=-720, le=720, allow_inf_nan=False)]
Seconds = Annotated[float, Field(gt=0, le=600, allow_inf_nan=False)]


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


class Step(BaseModel):
    """One stop of a session; an axis that is left out stays where the step before put it.

    A step with ``kind = "pose"`` is a static pose: held still for ``hold_s``, it counts for the
    accelerometer and for the gyroscope's bias. One with ``kind = "rotation"`` exists for the turn
    that leads to it: it is held only as long as the turn's end needs to be measured.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    pan: Angle | None = None
    tilt: Angle | None = None
    roll: Angle | None = None
    kind: Literal["pose", "rotation"] = "pose"
    hold_s: Seconds | None = None
    name: Annotated[str, Field(max_length=80)] | None = None


class JigProtocol(BaseModel):
    """A whole session as its file describes it.

    ``hold_s`` is the time at each stop; its first ``settle_s`` are not used, and motion begins
    it anew.
    ``order`` says which axes may turn together: the axes of one group start at the same time, the
    groups follow each other with ``pause_s`` between them, so that a turn about a single axis can
    be told from the rest.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(min_length=1, max_length=80)]
    title: Annotated[str, Field(max_length=200)] = ""
    hold_s: Seconds = 2.0
    rotation_hold_s: Seconds = 0.8
    settle_s: Annotated[float, Field(ge=0, le=60, allow_inf_nan=False)] = 0.3
    pause_s: Annotated[float, Field(ge=0, le=60, allow_inf_nan=False)] = 0.3
    order: tuple[tuple[AxisName, ...], ...] = (("pan", "tilt"), ("roll",))
    steps: Annotated[tuple[Step, ...], Field(min_length=1, max_length=2000)]

    @model_validator(mode="after")
    def _every_axis_once(self) -> JigProtocol:
        named = [axis for group in self.order for axis in group]
        if sorted(named) != sorted(AXIS_NAMES):
            raise ValueError("order must name pan, tilt and roll exactly once")
        return self

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
