"""What a trial file says about the session in it: configuration, visited stops, turns.

Events come from a file and are checked like any other input from outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from firmware_protocols.fields import LayoutError
from firmware_protocols.known import protocol_from_dict
from firmware_protocols.protocol import DeviceProtocol
from imu_rig.devices.jig import JigConfig
from imu_rig.errors import InputError
from imu_rig.recording.reader import Trial
from imu_rig.session.protocol import MOST_MOUNTINGS, AxisName, JigProtocol, Pose, StepKind

SESSION_KIND = "calibration-session"
IMU_SOURCE = "imu"
MAESTRO_SOURCE = "maestro"

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Event(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class Turn(_Event):
    """One driven stage of a move: which axes turned, between which poses, when [s, trial time]."""

    axes: Annotated[tuple[AxisName, ...], Field(min_length=1, max_length=3)]
    from_deg: Pose
    to_deg: Pose
    t_s: tuple[Finite, Finite]


class Visit(_Event):
    """One stop that was held still to its end.

    ``still_s`` is its interval in trial time [s]; ``accel_mean`` [m/s^2] and ``gyro_mean``
    [rad/s; None for a sensor without gyroscope] are what the sensor read there; ``mounting``
    counts from 0.
    """

    index: Annotated[int, Field(ge=0, le=2000)]
    name: Annotated[str, Field(max_length=80)]
    kind: StepKind
    commanded_deg: Pose
    reported_deg: dict[AxisName, Finite] = {}
    approach: dict[AxisName, int] = {}
    accel_mean: tuple[Finite, Finite, Finite] | None = None
    gyro_mean: tuple[Finite, Finite, Finite] | None = None
    still_s: tuple[Finite, Finite]
    turns: Annotated[tuple[Turn, ...], Field(max_length=6)] = ()
    mounting: Annotated[int, Field(ge=0, lt=MOST_MOUNTINGS)] = 0


@dataclass(frozen=True)
class SessionRecord:
    """A session as its trial file tells it; ``visits`` are in the order of time."""

    protocol: JigProtocol
    jig: JigConfig
    layout: DeviceProtocol
    device: str
    serial: str
    visits: tuple[Visit, ...]
    notices: tuple[str, ...]
    recoveries: int
    stream: str | None = None

    @property
    def finished(self) -> set[int]:
        """Indices of the stops that were held to their end."""
        return {visit.index for visit in self.visits}

    @property
    def next_step(self) -> int:
        """Index of the first stop that is not finished; the number of stops if all are."""
        finished = self.finished
        return next(
            (i for i in range(len(self.protocol.steps)) if i not in finished),
            len(self.protocol.steps),
        )


def session_config(
    protocol: JigProtocol, jig: JigConfig, device: str, serial: str, note: str
) -> dict[str, Any]:
    """Put together the configuration that a session's trial file begins with."""
    return {
        "kind": SESSION_KIND,
        "device": device,
        "serial": serial,
        "note": note,
        "protocol": protocol.model_dump(mode="json"),
        "jig": jig.model_dump(mode="json"),
    }


def is_session(trial: Trial) -> bool:
    """Whether a trial holds a calibration session."""
    return trial.config.get("kind") == SESSION_KIND and IMU_SOURCE in trial.sources


def read_session(trial: Trial) -> SessionRecord:
    """Read the session in a trial file.

    Raises
    ------
    InputError
        If the trial holds no session, or one whose configuration or events make no sense.
    """
    if not is_session(trial):
        raise InputError(f"{trial.path} holds no calibration session.")
    try:
        described = trial.sources[IMU_SOURCE].descriptor
        layout = protocol_from_dict(described["layout"])
        visits: dict[int, Visit] = {}
        for event in trial.events:
            if event.name == "pose":
                visit = Visit.model_validate(event.fields)
                visits[visit.index] = visit
        return SessionRecord(
            protocol=JigProtocol.model_validate(trial.config["protocol"]),
            jig=JigConfig.model_validate(trial.config["jig"]),
            layout=layout,
            device=_text(trial.config.get("device", "")),
            serial=_text(trial.config.get("serial", "")),
            visits=tuple(sorted(visits.values(), key=lambda visit: visit.still_s)),
            notices=tuple(
                str(e.fields.get("text", ""))[:500] for e in trial.events if e.name == "notice"
            ),
            recoveries=sum(1 for e in trial.events if e.name == "recovered"),
            stream=_stream(layout, described),
        )
    except (ValidationError, KeyError, TypeError, AttributeError, LayoutError) as error:
        reason = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise InputError(f"{trial.path}: the session in it makes no sense: {reason}.") from error


def _stream(layout: DeviceProtocol, described: Mapping[str, Any]) -> str | None:
    """Return the stream that the session says is its sensor's, if it is an inertial one."""
    stream = described.get("stream")
    return stream if stream in layout.inertial_streams else None


def _text(value: object) -> str:
    """Return a short text that can be written anywhere, whatever a file holds in its place."""
    return str(value)[:80].encode("utf-8", "replace").decode()
