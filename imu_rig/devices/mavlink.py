"""The conversation with a flight controller: what makes it send its IMU at the rate wanted.

A ground station says that it is there by a heartbeat each second; PX4 does not speak at all on USB
before it has heard one. The message is asked for by SET_MESSAGE_INTERVAL, which is answered by a
COMMAND_ACK; firmware that does not know the command is asked for its whole group of raw sensors by
REQUEST_DATA_STREAM, the old way. It is asked again each second until the message comes, and
whenever it stops or falls below half the rate, as after a restart or when another ground station
asks for something else.

Of several systems on a port the one is spoken to whose messages the decoder takes: both follow
:mod:`firmware_protocols.mavlink_senders`.

Everything is said in MAVLink 2, and once more in MAVLink 1 to a device that answers only so.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterable

from firmware_protocols.mavlink import IMU_MESSAGES, PRESSURE_HZ, MavlinkProtocol
from firmware_protocols.mavlink_frames import Contents, MavlinkFrameDecoder, read_contents
from firmware_protocols.mavlink_messages import (
    COMMAND_ACK,
    HEARTBEAT,
    MESSAGES,
    SCALED_PRESSURE,
    Message,
)
from firmware_protocols.mavlink_senders import clock_s, is_autopilot
from firmware_protocols.protocol import Packets
from firmware_protocols.variable_framing import FramedBytes
from imu_rig.arrays import StructArray
from imu_rig.devices.conversation import Conversation, Hear, Write
from imu_rig.devices.mavlink_parameters import ARDUPILOT, PX4
from imu_rig.devices.mavlink_voice import Address, Voice
from imu_rig.errors import DeviceError
from imu_rig.mavlink_dialect import mavlink

# Constants of time.
START_S = 2.5  # that we listen for a flight controller; a silent one may still be starting
BEGIN_S = 5.0  # that a flight controller has to send the message
SAY_S = 1.0  # between two heartbeats of ours, and two requests
HEAR_S = 0.05  # that one look at the port may take
JUDGE_S = 0.1  # of the flight controller's time, over which the rate is judged at the least
SLOW_S = 2.0  # after which a message that comes too slowly is taken as it comes
SILENT_S = 2.5  # without any message it is not the flight controller that is to blame

ENOUGH = 0.5  # of the rate asked for
TRIES = 2  # after which a refusal is believed, the old way of asking among them
REQUESTS = 10  # one after the other; then, for a rate that is never reached, now and then
RARELY = 30  # of our heartbeats
MOST_SEEN = 256  # senders of IMU messages, by message
MOST_NAMED = 3
MOST_WAITING_BYTES = 1 << 18  # kept between two looks

AUTOPILOTS = {ARDUPILOT: "ArduPilot", PX4: "PX4"}
_RESULTS = {
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "unsupported",
    mavlink.MAV_RESULT_FAILED: "failed",
}

_LAYOUTS = {
    "HIGHRES_IMU": "--layout mavlink-highres",
    "SCALED_IMU": "--layout mavlink-scaled",
    "RAW_IMU": "--layout mavlink-raw",
    "SCALED_IMU2": 'a layout file with message = "SCALED_IMU2"',
    "SCALED_IMU3": 'a layout file with message = "SCALED_IMU3"',
}
"""Which layout reads a message, as advice."""


class Ear(MavlinkFrameDecoder):
    """Hands on the messages of interest, a stretch at a time."""

    def __init__(self, messages: Iterable[Message]) -> None:
        super().__init__()
        self._messages = tuple(messages)
        self._heard: list[dict[str, Contents]] = []

    def _read(self, frames: FramedBytes) -> dict[str, Packets]:
        if len(frames):
            self._heard.append(read_contents(frames, self._messages))
        return {}

    def hear(self, data: bytes) -> list[dict[str, Contents]]:
        """Return what these next bytes complete, by the names of the messages."""
        self.feed(data)
        heard, self._heard = self._heard, []
        return heard


def _places(addresses: list[Address]) -> str:
    """Name some senders."""
    named = [f"system {s} component {c}" for s, c in addresses[:MOST_NAMED]]
    if len(addresses) > MOST_NAMED:
        named.append(f"{len(addresses) - MOST_NAMED} more")
    return " and ".join(named)


def _addresses(found: Contents) -> list[Address]:
    """Return who sent each message."""
    return list(zip(found.system.tolist(), found.component.tolist(), strict=True))


class _Span:
    """How many messages came over which time of the flight controller's clock."""

    def __init__(self) -> None:
        self._count, self._first_s, self._last_s = 0, 0.0, 0.0

    def add(self, payload: StructArray) -> None:
        """Count these messages."""
        times = clock_s(payload)
        if not self._count:
            self._first_s = float(times[0])
        self._count += len(times)
        self._last_s = float(times[-1])

    def reaches(self, rate_hz: float) -> bool:
        """Whether they came at this rate or faster, as far as can be told by now."""
        passed_s = self._last_s - self._first_s
        return passed_s >= JUDGE_S and self._count - 1 >= rate_hz * passed_s


class MavlinkConversation:
    """The host's half of the conversation; see `imu_rig.devices.conversation.Conversation`.

    What is wrong may be asked for in any thread while another listens.

    Parameters
    ----------
    protocol : MavlinkProtocol

    Attributes
    ----------
    autopilot : int or None
        Its kind, from its heartbeat (MAV_AUTOPILOT).
    versions : set of int
        Of MAVLink that were heard from it.
    """

    def __init__(self, protocol: MavlinkProtocol) -> None:
        self._protocol = protocol
        self._wanted = protocol.imu
        self._ear = Ear((HEARTBEAT, COMMAND_ACK, *(MESSAGES[name] for name in IMU_MESSAGES)))
        self._voice = Voice()
        self.autopilot: int | None = None
        self.versions: set[int] = set()
        self._choice = protocol.choice()
        self._target: Address | None = None  # the one chosen, once it is heard
        self._knowing = threading.RLock()  # of what was heard
        self._seen: Counter[tuple[str, Address]] = Counter()
        self._waiting: list[bytes] = []  # heard by the reader's thread and not looked at yet
        self._waiting_bytes, self._waiting_s = 0, 0.0
        self._span = _Span()
        self._enough = False
        self._unanswered: Message | None = None  # asked for and not acknowledged
        self._refused: int | None = None
        self._requests = self._said = 0
        self._pressure_asked = False
        self._target_s = self._wanted_s = -SILENT_S  # when it was heard last, and the message was

    def remember(self, before: Conversation) -> None:
        """Go on with the flight controller of the conversation before; the decoder does too."""
        if isinstance(before, MavlinkConversation):
            self._choice = before._choice

    def begin(self, write: Write, hear: Hear) -> None:
        """Ask until the message comes; a silent device is left to come later.

        Raises
        ------
        DeviceError
            If a flight controller is there and does not send the message.
        """
        start_s = said_s = time.monotonic()
        self._say(write)
        while not self._is_settled(time.monotonic() - start_s):
            self._listen(hear(HEAR_S), time.monotonic())
            self._enough = self._span.reaches(ENOUGH * self._protocol.rate_hz)
            now_s = time.monotonic()
            if now_s - start_s > (START_S if self._target is None else BEGIN_S):
                break
            first = self._target is not None and not self._requests
            if first or now_s - said_s >= SAY_S:
                self._say(write)
                said_s = now_s
        self._say(write)
        problem = self.problem
        if problem is not None and not self._wanted_s > start_s:
            raise DeviceError(f"the flight controller {problem}.")

    def heard(self, data: bytes) -> None:
        """Keep what came for the next look."""
        self._waiting_s = time.monotonic()
        if self._waiting_bytes < MOST_WAITING_BYTES:
            self._waiting_bytes += len(data)
            self._waiting.append(data)

    def keep(self, write: Write) -> None:
        """Say that we are there, and ask again where the message does not come."""
        waiting, self._waiting = self._waiting, []
        self._waiting_bytes = 0
        self._listen(b"".join(waiting), self._waiting_s)
        self._enough = self._span.reaches(ENOUGH * self._protocol.rate_hz)
        self._span = _Span()
        self._say(write)

    @property
    def problem(self) -> str | None:
        """Why the message does not come, as far as it can be told."""
        with self._knowing:
            return self._problem()

    def _problem(self) -> str | None:
        now_s, wanted = time.monotonic(), self._wanted.name
        if self._target is None or now_s - self._target_s > SILENT_S:
            return None
        if now_s - self._wanted_s < SILENT_S:
            return None
        who = f"({self.description})"
        if self._seen[wanted, self._target]:
            return f"{who} has stopped sending {wanted} and is asked for it every second"
        others = [name for name in IMU_MESSAGES if self._seen[name, self._target]]
        strangers = sorted(a for name, a in self._seen if name == wanted)
        if self._refused is not None:
            result = _RESULTS.get(self._refused, f"result {self._refused}")
            return f"{who} refuses to send {wanted} ({result}): {self._advice(others)}"
        if others:
            heard = " and ".join(others)
            return f"{who} sends {heard} but no {wanted}: {self._advice(others)}"
        if strangers:
            do = "does" if len(strangers) == 1 else "do"
            return (
                f"{who} sends no {wanted}, but {_places(strangers)} {do}: ask for that system and "
                "component in a layout file"
            )
        return (
            f"{who} was asked for {wanted} {self._requests} times and sends neither that nor "
            f"another message of its IMU: {self._advice(others)}, or look at the stream settings "
            "of this port"
        )

    @property
    def description(self) -> str:
        """Who was heard: kind of autopilot, version, system and component, and other senders."""
        with self._knowing:
            return self._description()

    def _description(self) -> str:
        if self._target is None:
            return "no flight controller"
        if self.autopilot is None:
            kind = "no heartbeat"
        else:
            kind = AUTOPILOTS.get(self.autopilot, f"autopilot {self.autopilot}")
        version = "MAVLink 1 only" if self.versions == {1} else "MAVLink 2"
        others = sorted({address for _, address in self._seen} - {self._target})
        also = f", beside {_places(others)}" if others else ""
        return "{}, {}, system {} component {}{}".format(kind, version, *self._target, also)

    def _advice(self, others: list[str]) -> str:
        """Say which layout to use instead."""
        usual = ("SCALED_IMU", "RAW_IMU", "HIGHRES_IMU")
        use = others[:1] or [name for name in usual if name != self._wanted.name][:2]
        return f"use {' or '.join(_LAYOUTS[name] for name in use)}"

    def _is_settled(self, since_s: float) -> bool:
        """Whether nothing more is to be waited for at the beginning."""
        if self._target is None or not self._requests:
            return False
        heard = self._seen[self._wanted.name, self._target] > 0
        if since_s > SLOW_S and heard:
            return True  # slowly, or from a firmware that acknowledges nothing
        final = self._refused not in (None, mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
        if final and self._requests > TRIES and not heard:
            return True
        return self._enough and self._unanswered is None

    def _listen(self, data: bytes, now_s: float) -> None:
        """Take in what came until now."""
        with self._knowing:
            for contents in self._ear.hear(data):
                self._choice.look(contents)
                heard = {name: _addresses(found) for name, found in contents.items()}
                if self._target is None and self._choice.address in set().union(*heard.values()):
                    self._target = self._choice.address
                for name, found in contents.items():
                    self._take(name, found, heard[name], now_s)

    def _take(self, name: str, found: Contents, addresses: list[Address], now_s: float) -> None:
        """Take in all messages of one name."""
        if name == HEARTBEAT.name:
            self._meet(found, addresses)
        elif name == COMMAND_ACK.name:
            self._acknowledged(found, addresses)
        else:
            self._notice(name, found, addresses, now_s)
        own = [address == self._target for address in addresses]
        if any(own):
            self._target_s = now_s
            self.versions.update(found.version[own].tolist())

    def _meet(self, found: Contents, addresses: list[Address]) -> None:
        """Learn what kind of autopilot it is."""
        for beat, address in zip(found.payload, addresses, strict=True):
            if address == self._target and is_autopilot(beat):
                self.autopilot = int(beat["autopilot"])

    def _notice(self, name: str, found: Contents, addresses: list[Address], now_s: float) -> None:
        """Count the messages of an IMU; there is always room for those of the target."""
        for address in addresses:
            known = address == self._target or (name, address) in self._seen
            if known or len(self._seen) < MOST_SEEN:
                self._seen[name, address] += 1
        own = [address == self._target for address in addresses]
        if name == self._wanted.name and any(own):
            self._wanted_s = now_s
            self._span.add(found.payload[own])

    def _acknowledged(self, found: Contents, addresses: list[Address]) -> None:
        for answer, address in zip(found.payload, addresses, strict=True):
            result = int(answer["result"])
            if (
                address != self._target
                or answer["command"] != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
                or result == mavlink.MAV_RESULT_IN_PROGRESS
            ):
                continue
            if self._unanswered == self._wanted:
                self._refused = None if result == mavlink.MAV_RESULT_ACCEPTED else result
                self._span = _Span()
            self._unanswered = None

    def _say(self, write: Write) -> None:
        """Send a heartbeat, and ask for what does not come."""
        voice, to = self._voice, self._target
        voice.versions = (2, 1) if self.versions == {1} else (2,)
        said = voice.heartbeat()
        self._said += 1
        if to is not None and not self._enough:
            if self._requests < REQUESTS or self._said % RARELY == 0:
                said += self._request(to)
        elif to is not None and not self._pressure_asked:
            said += voice.message_interval(to, SCALED_PRESSURE, PRESSURE_HZ)
            self._pressure_asked = True
            self._unanswered = SCALED_PRESSURE
        write(said)

    def _request(self, to: Address) -> bytes:
        rate_hz = self._protocol.rate_hz
        said = self._voice.message_interval(to, self._wanted, rate_hz)
        old_way = self._refused is not None or self._unanswered is not None
        if old_way and self._wanted.name != "HIGHRES_IMU":
            said += self._voice.raw_sensors(to, rate_hz)
        self._unanswered = self._wanted
        self._requests += 1
        self._span = _Span()
        return said
