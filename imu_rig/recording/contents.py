"""What a trial file holds, as its readers hand it out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from imu_rig.arrays import BoolArray, FloatArray, IntArray


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
class ClockPairs:
    """The trial's time next to two other clocks, one row every few seconds.

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
