"""What a trial file holds, as its readers hand it out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import in_a_line


@dataclass(frozen=True)
class Source:
    """One device or port of a trial.

    Attributes
    ----------
    id : int
        Its number in the records.
    name, kind : str
        As given by the recorder, for example ``"imu"`` and ``"imu"``.
    descriptor : dict
        What is needed to read its bytes, for example the packet layout.
    """

    id: int
    name: str
    kind: str
    descriptor: dict[str, Any]


@dataclass(frozen=True)
class Event:
    """Something that happened.

    Attributes
    ----------
    t : float
        Trial time [s].
    name : str
        What it was.
    fields : dict
        Particulars, plain JSON values.
    """

    t: float
    name: str
    fields: dict[str, Any]


@dataclass(frozen=True)
class Gap:
    """Data that are known to be missing.

    Attributes
    ----------
    t : float
        Trial time of the first of them [s].
    source : int
        Number of the source.
    fields : dict
        ``reason`` and, where known, ``records``, ``bytes`` and ``until_s``.
    """

    t: float
    source: int
    fields: dict[str, Any]


@dataclass(frozen=True)
class Marker:
    """A moment that a person marked.

    Attributes
    ----------
    t : float
        Trial time [s].
    label : str
        What they called it; may be empty.
    """

    t: float
    label: str


@dataclass(frozen=True)
class Missing:
    """Samples that a sensor made, or should have made, and that are not in the trial.

    Attributes
    ----------
    start_s, stop_s : float
        Trial time of the last sample before and the first one after; the trial's begin and end
        where there is none [s].
    samples : int or None
        How many, by the device's counter or clock; None where nothing tells.
    reason : str
        ``"unplugged"``, ``"silent"``, ``"queue full"`` and so on as the recorder stated it,
        ``"lost on the way"`` where only the device's numbers tell, ``"restarted"``,
        ``"the computer slept"``, ``"lost in the file"``, ``"recording interrupted"``.
    """

    start_s: float
    stop_s: float
    samples: int | None
    reason: str


@dataclass(frozen=True)
class ClockPairs:
    """The trial's time next to two other clocks, one row each second.

    Attributes
    ----------
    t : shape (n,)
        Trial time [s].
    host_ns : shape (n,)
        The recording host's monotonic clock [ns]; starts anew when a trial is resumed.
    wall_ns : shape (n,)
        The host's wall clock [ns since 1970 UTC]; may have been set meanwhile.
    """

    t: FloatArray
    host_ns: IntArray
    wall_ns: IntArray


@dataclass(frozen=True)
class Wire:
    """What went over one wire in one direction.

    Attributes
    ----------
    data : bytes
        All bytes, in order.
    t : shape (n,)
        Trial time at which each of ``n`` chunks arrived or was sent [s].
    stops : shape (n,)
        Offset in ``data`` just past each chunk.
    breaks : shape (n,)
        Whether something may be missing just before each chunk: lost records, a recorded gap, or
        a resumed recording.
    """

    data: bytes
    t: FloatArray
    stops: IntArray
    breaks: BoolArray

    def __len__(self) -> int:
        """Return the number of chunks."""
        return len(self.t)

    def __repr__(self) -> str:
        """Return one line; the bytes are in ``data``."""
        return in_a_line("Wire", self.t, [f"{len(self.data)} bytes"], "chunks")
