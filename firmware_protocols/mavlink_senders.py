"""Whose messages count where a port carries several systems: decided by the bytes alone.

The decoder and whoever speaks to the flight controller follow the same rule, so that what is asked
is what is read, and a recording decodes as it did when it was made.

The first autopilot that says so in a HEARTBEAT counts, of those that the description asks for:
ground stations, cameras, gimbals and radios send heartbeats too, and some of them IMU messages, but
are no autopilots. Heartbeats come each second. Where none comes while a sender's IMU messages go on
for :data:`WAIT_S`, that sender counts. Nothing counts before; a description that names system and
component has nothing to wait for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from firmware_protocols.mavlink_frames import Contents
from firmware_protocols.mavlink_messages import HEARTBEAT
from firmware_protocols.variable_framing import Flags

WAIT_S = 2.0
"""For a heartbeat, by the clock of a sender's IMU messages: two of them are due meanwhile."""

WAIT_PERIODS = 10.0
"""Times as many messages as are due in that time tell the same where that clock stands still."""

MOST_WAITING = 64
"""Senders whose messages are watched while no heartbeat has come."""

MOST_OTHERS = 64
"""Other senders that are kept apart."""

MOST_NAMED = 3
"""Of them, those that are named."""

GROUND_STATION = 6
"""MAV_TYPE_GCS."""

NO_AUTOPILOT = 8
"""MAV_AUTOPILOT_INVALID."""

Address = tuple[int, int]
"""System and component."""

Numbers = npt.NDArray[np.int64]


class Sender(NamedTuple):
    """Who sends a message: system, component, and which of its sensors where the message says."""

    system: int
    component: int
    sensor: int = 0

    def __str__(self) -> str:
        """Return it as people read it."""
        return f"system {self.system} component {self.component} sensor {self.sensor}"


class Asked(NamedTuple):
    """Whose messages a description asks for; None takes any."""

    system: int | None = None
    component: int | None = None
    sensor: int | None = None

    def fits(self, address: Address) -> bool:
        """Return whether an address is one that is asked for."""
        return self.system in (None, address[0]) and self.component in (None, address[1])

    def fitting(self, found: Contents, *, sensor: bool = False) -> Flags:
        """Return which messages are of a system and component, and sensor, that are asked for."""
        fits = np.ones(len(found), dtype=np.bool_)
        for wanted, numbers in ((self.system, found.system), (self.component, found.component)):
            if wanted is not None:
                fits &= numbers == wanted
        if sensor and self.sensor is not None:
            fits &= sensors_of(found) == self.sensor
        return fits


def is_autopilot(heartbeats: npt.NDArray[np.void] | np.void) -> Flags:
    """Return whether heartbeats are not those of a ground station, camera, gimbal or radio."""
    said: Flags = (heartbeats["type"] != GROUND_STATION) & (heartbeats["autopilot"] != NO_AUTOPILOT)
    return said


def sensors_of(found: Contents) -> Numbers:
    """Return which of its sender's sensors each message is of, 0 where messages do not say."""
    if "id" in (found.payload.dtype.names or ()):
        return found.payload["id"].astype(np.int64)
    return np.zeros(len(found), dtype=np.int64)


def clock_s(payload: npt.NDArray[np.void]) -> npt.NDArray[np.float64]:
    """Return the clock of messages of an IMU [s]."""
    if "time_usec" in (payload.dtype.names or ()):
        return payload["time_usec"] / 1e6
    return payload["time_boot_ms"] / 1e3


class SenderChoice:
    """Whose messages count, as far as the bytes until now tell.

    Parameters
    ----------
    asked : Asked
    message : str
        The IMU message that is read.
    rate_hz : float
        At which it is due.
    wait : bool
        Whether to wait for a heartbeat; otherwise the first sender of anything that fits counts,
        which is enough to recognize a stretch of bytes.

    Attributes
    ----------
    address : (int, int) or None
        System and component that count from now on.
    """

    def __init__(self, asked: Asked, message: str, rate_hz: float, *, wait: bool = True) -> None:
        self._asked, self._message = asked, message
        self._wait_s, self._most = WAIT_S, max(10.0, WAIT_PERIODS * WAIT_S * rate_hz)
        if not wait:
            self._wait_s = self._most = 0.0
        self._waiting: dict[Address, tuple[float, int]] = {}  # since when, and how many came
        self.address: Address | None = None
        if asked.system is not None and asked.component is not None:
            self.address = asked.system, asked.component

    def look(self, found: Mapping[str, Contents]) -> int:
        """Take in the next stretch, and return from which of its frames on messages count.

        Where it is not decided yet nothing does, see ``address``.

        Parameters
        ----------
        found : dict of str to Contents
            Heartbeats and IMU messages of the stretch by the names of the messages.
        """
        if self.address is not None:
            return 0
        beat = self._beat(found.get(HEARTBEAT.name))
        imu = found.get(self._message)
        if imu is not None:
            before = self._asked.fitting(imu, sensor=True)
            if beat is not None:
                before &= imu.index < beat[0]
            since = self._wait(imu.taken(before))
            if since is not None:
                return since
        if beat is None:
            return 0
        since, self.address = beat
        return since

    def _beat(self, beats: Contents | None) -> tuple[int, Address] | None:
        """Return the frame and sender of the first heartbeat of an autopilot that fits."""
        if beats is None:
            return None
        places = np.flatnonzero(is_autopilot(beats.payload) & self._asked.fitting(beats))
        if not len(places):
            return None
        first = int(places[0])
        return int(beats.index[first]), (int(beats.system[first]), int(beats.component[first]))

    def _wait(self, imu: Contents) -> int | None:
        """Return the frame by which a sender has gone on for long enough without a heartbeat."""
        columns = (imu.index, imu.system, imu.component, clock_s(imu.payload))
        for index, system, component, time_s in zip(*(c.tolist() for c in columns), strict=True):
            address = system, component
            if address not in self._waiting and len(self._waiting) >= MOST_WAITING:
                continue
            since_s, number = self._waiting.get(address, (time_s, 0))
            since_s = min(since_s, time_s)  # a clock that began anew
            self._waiting[address] = since_s, number + 1
            if time_s - since_s >= self._wait_s or number + 1 >= self._most:
                self.address = address
                return int(index)
        return None


class OtherSenders:
    """Who else sends the message that is read, and is left out.

    Attributes
    ----------
    counts : Counter of Sender
        How many messages of each of the first few.
    """

    def __init__(self, asked: Asked, message: str) -> None:
        self._asked, self._message = asked, message
        self.counts: Counter[Sender] = Counter()
        self._named: list[Sender] = []
        self._told: dict[str, int] = {}

    def add(self, found: Contents, end: Numbers, own: Sender | None) -> None:
        """Count messages that are left out.

        Parameters
        ----------
        found : Contents
        end : shape (n,)
            Bytes of the stream up to and including each.
        own : Sender or None
            Whose messages are read, if any came.
        """
        keys = found.system << 16 | found.component << 8 | sensors_of(found)
        for key in np.unique(keys).tolist():
            where = np.flatnonzero(keys == key)
            other = Sender(key >> 16, key >> 8 & 0xFF, key & 0xFF)
            if other not in self.counts and len(self.counts) >= MOST_OTHERS:
                continue
            self.counts[other] += len(where)
            if other not in self._named and len(self._named) < MOST_NAMED:
                self._named.append(other)
            if other in self._named and self._could_be_meant(other):
                self._told[self._sentence(other, own)] = int(end[where[-1]])

    def take_told(self) -> dict[str, int]:
        """Return in words who was left out since the last call, and by which byte."""
        told, self._told = self._told, {}
        return told

    def _could_be_meant(self, other: Sender) -> bool:
        """Whether the description would take it too: who is not asked for is rightly left out."""
        return self._asked.fits(other[:2]) and self._asked.sensor in (None, other.sensor)

    def _sentence(self, other: Sender, own: Sender | None) -> str:
        if own is not None and other[:2] == own[:2]:
            return f"sensor {other.sensor} sends {self._message} too (choose with sensor)"
        return (
            f"system {other.system} component {other.component} sends {self._message} too "
            "(choose with system, component)"
        )
