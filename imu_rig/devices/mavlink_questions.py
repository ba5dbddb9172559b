"""Questions to a flight controller about its parameters, answered over an open port.

What matters on a jig is whether the flight controller corrects its sensors itself: its IMU messages
hold corrected values, and a calibration of those is one on top of its own. `own_calibration` names
the parameters that are not neutral.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from firmware_protocols.mavlink_frames import Contents
from firmware_protocols.mavlink_messages import (
    AUTOPILOT_VERSION,
    HEARTBEAT,
    PARAM_VALUE,
    Message,
)
from firmware_protocols.mavlink_senders import is_autopilot
from imu_rig.devices.conversation import Hear, Write
from imu_rig.devices.mavlink import AUTOPILOTS, Ear
from imu_rig.devices.mavlink_parameters import Encoding, Parameter, encoding_of
from imu_rig.devices.mavlink_voice import Address, Voice
from imu_rig.errors import DeviceError, DeviceLost

# Constants of time.
MEET_S = 5.0  # for a heartbeat; they come each second, and PX4 waits for ours on USB
ANSWER_S = 1.0  # for answers, after which what is not answered is asked again
HEAR_S = 0.05
TRIES = 3

AXES = ("X", "Y", "Z")
OWN_CALIBRATION: Mapping[str, Mapping[str, float]] = {
    "PX4": {
        **{f"CAL_ACC0_{axis}OFF": 0.0 for axis in AXES},
        **{f"CAL_ACC0_{axis}SCALE": 1.0 for axis in AXES},
        **{f"CAL_GYRO0_{axis}OFF": 0.0 for axis in AXES},
        **{f"CAL_MAG0_{axis}OFF": 0.0 for axis in AXES},
        **{f"CAL_MAG0_{axis}SCALE": 1.0 for axis in AXES},
        "SENS_BOARD_ROT": 0,
    },
    "ArduPilot": {
        **{f"INS_ACCOFFS_{axis}": 0.0 for axis in AXES},
        **{f"INS_ACCSCAL_{axis}": 1.0 for axis in AXES},
        **{f"INS_GYROFFS_{axis}": 0.0 for axis in AXES},
        **{f"COMPASS_OFS_{axis}": 0.0 for axis in AXES},
        "AHRS_ORIENTATION": 0,
    },
}
"""The neutral value of what each firmware corrects its first sensors with."""


@dataclass(frozen=True)
class Parameters:
    """What a flight controller answered.

    Attributes
    ----------
    autopilot : str
        "PX4", "ArduPilot", or its number.
    encoding : str or None
        How it encodes whole numbers; None if nothing tells.
    values : dict
        What was asked for and is there, by name.
    missing : tuple of str
        What it has not, or did not answer.
    """

    autopilot: str
    encoding: Encoding | None
    values: dict[str, Parameter] = field(default_factory=dict)
    missing: tuple[str, ...] = ()

    def value(self, name: str) -> float | int:
        """Return a parameter's value; "bytewise" is assumed where nothing tells."""
        return self.values[name].value(self.encoding or "bytewise")

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Sentences about values that must be in the other encoding."""
        encoding = self.encoding or "bytewise"
        found = [parameter.contradiction(encoding) for parameter in self.values.values()]
        return tuple(sentence for sentence in found if sentence is not None)

    @property
    def own_calibration(self) -> dict[str, float]:
        """What the flight controller corrects its sensors with, as far as it is not neutral."""
        neutral = OWN_CALIBRATION.get(self.autopilot, {})
        values = {name: self.value(name) for name in self.values if name in neutral}
        return {name: value for name, value in values.items() if value != neutral[name]}


def read_parameters(write: Write, hear: Hear, names: Iterable[str] | None = None) -> Parameters:
    """Ask the first flight controller on a port for parameters.

    Parameters
    ----------
    write, hear : callable
        As in `imu_rig.devices.conversation.Conversation.begin`.
    names : iterable of str, optional
        Otherwise those of its own calibration.

    Raises
    ------
    DeviceLost
        If no flight controller is heard.
    DeviceError
        If a kind of autopilot is not known and no names are given.
    """
    questions = _Questions(write, hear)
    number = questions.meet()
    autopilot = AUTOPILOTS.get(number, f"autopilot {number}")
    if names is None:
        if autopilot not in OWN_CALIBRATION:
            raise DeviceError(f"{autopilot} is not known here: name the parameters to read.")
        names = OWN_CALIBRATION[autopilot]
    capabilities = questions.capabilities()
    names = tuple(dict.fromkeys(names))
    values = questions.parameters(names)
    return Parameters(
        autopilot,
        encoding_of(number, capabilities),
        {name: values[name] for name in names if name in values},
        tuple(name for name in names if name not in values),
    )


class _Questions:
    """Asks one question after the other."""

    def __init__(self, write: Write, hear: Hear) -> None:
        self._write, self._hear = write, hear
        self._ear = Ear((HEARTBEAT, PARAM_VALUE, AUTOPILOT_VERSION))
        self._voice = Voice()
        self._target: Address = (0, 0)

    def meet(self) -> int:
        """Wait for a flight controller's heartbeat and return the kind of its autopilot."""
        end_s = time.monotonic() + MEET_S
        said_s = -1.0
        while (now_s := time.monotonic()) < end_s:
            if now_s - said_s > 1.0:
                self._write(self._voice.heartbeat())
                said_s = now_s
            for contents in self._ear.hear(self._hear(HEAR_S)):
                beats = contents.get(HEARTBEAT.name)
                for place in range(len(beats) if beats is not None else 0):
                    assert beats is not None
                    if is_autopilot(beats.payload[place]):
                        self._target = int(beats.system[place]), int(beats.component[place])
                        if beats.version[place] == 1:
                            self._voice.versions = (2, 1)
                        return int(beats.payload[place]["autopilot"])
        raise DeviceLost(
            "no flight controller is heard: check that this is its port, its baud rate, and that "
            "MAVLink is switched on there."
        )

    def capabilities(self) -> int | None:
        """Return the bits of its capabilities; None if it does not tell them."""
        for _ in range(TRIES):
            self._write(self._voice.once(self._target, AUTOPILOT_VERSION))
            for found in self._answers(AUTOPILOT_VERSION):
                return int(found.payload["capabilities"][-1])
        return None

    def parameters(self, names: tuple[str, ...]) -> dict[str, Parameter]:
        """Return those that it has."""
        values: dict[str, Parameter] = {}
        for _ in range(TRIES):
            asked = [name for name in names if name not in values]
            self._write(b"".join(self._voice.parameter(self._target, name) for name in asked))
            for found in self._answers(PARAM_VALUE):
                for row in found.payload:
                    name = bytes(row["param_id"]).decode("ascii", "replace")
                    if name in asked:  # its bytes, since a float of Python may change them
                        values[name] = Parameter(name, row.tobytes()[:4], int(row["param_type"]))
                if len(values) == len(names):
                    return values
        return values

    def _answers(self, message: Message) -> Iterator[Contents]:
        """Yield what the flight controller says in a message, for a while."""
        end_s = time.monotonic() + ANSWER_S
        while time.monotonic() < end_s:
            for contents in self._ear.hear(self._hear(HEAR_S)):
                found = contents.get(message.name)
                if found is None:
                    continue
                own = (found.system == self._target[0]) & (found.component == self._target[1])
                if own.any():
                    yield found.taken(own)
