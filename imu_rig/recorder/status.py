"""What a recording tells while it runs, and what is left to say when it has ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

DeviceState = Literal["waiting", "live", "garbled", "silent", "lost"]
"""``waiting``: not heard since the start. ``live``: its packets come. ``garbled``: bytes come, but
no packets. ``silent``: the port is open and nothing comes. ``lost``: the port has gone."""

RecorderState = Literal["starting", "waiting", "recording", "stopping", "ended"]
"""``waiting``: recording already, while a required device has not been heard yet."""


@dataclass(frozen=True)
class DeviceStatus:
    """How one device does, or one of the streams that share its port.

    Attributes
    ----------
    name, port : str
        A stream of several goes by "DEVICE/STREAM".
    state : str
        Of a device with several streams that of the one that is worst off.
    required : bool
    rate_hz : float
        Packets per second by the device's own clock; 0 while none come.
    packets, lost, corrupt, duplicates, restarts : int
        Since the start; see `imu_rig.packet_stream.StreamStats`. Nobody knows of which stream a
        corrupt packet was: it counts for the port, and stands with each of its streams.
    reconnects, gaps : int
        How often its port was opened again; stretches without it that were recorded.
    age_s : float
        Since its last good packet.
    lag_s : float
        How much later than usual its freshest packets arrived.
    stuck : bool
        Whether its last samples are all the same, which no sensor's are.
    faults : tuple of str
        What the device itself says is wrong with it, now.
    fault_counts : tuple of (str, int)
        Every fault that it ever told of, and in how many looks at it, a few a second.
    supply : tuple of (str, float, str)
        Name, value and unit of each field that tells of a battery or supply, where it sends one.
    problem : str or None
        One sentence; None while it is live.
    streams : tuple of DeviceStatus
        How each of several streams does; empty where there is one.
    """

    name: str
    port: str
    state: DeviceState = "waiting"
    required: bool = True
    rate_hz: float = 0.0
    packets: int = 0
    lost: int = 0
    corrupt: int = 0
    duplicates: int = 0
    restarts: int = 0
    reconnects: int = 0
    gaps: int = 0
    age_s: float = 0.0
    lag_s: float = 0.0
    stuck: bool = False
    faults: tuple[str, ...] = ()
    fault_counts: tuple[tuple[str, int], ...] = ()
    supply: tuple[tuple[str, float, str], ...] = ()
    problem: str | None = None
    streams: tuple[DeviceStatus, ...] = ()

    @property
    def rows(self) -> tuple[DeviceStatus, ...]:
        """What has a row of its own in a table: each stream, or the device itself."""
        return self.streams or (self,)

    @property
    def loss(self) -> float:
        """Share of its packets that were lost, 0 to 1."""
        made = self.packets + self.lost
        return self.lost / made if made else 0.0


@dataclass(frozen=True)
class RecorderStatus:
    """How a recording does.

    Attributes
    ----------
    state : str
    path : Path
    elapsed_s : float
        Trial time.
    recorded_s : float
        Time since every required device was heard; what a planned duration counts.
    planned_s : float or None
        Planned duration; None for a recording that goes on until it is stopped.
    file_bytes, synced_bytes : int
        Size of the file, and the part of it that a power cut cannot take.
    disk_free_bytes : int or None
    disk_left_s : float or None
        How long the disk lasts at the present rate.
    queue : float
        Share of the queue in use while the disk is slow, 0 to 1.
    queue_s : float
        How long the queue can take up at the present rate [s].
    unwritten_records : int
        Lost because the queue was full or the disk failed.
    markers : int
    devices : tuple of DeviceStatus
    problem : str or None
        What is wrong with the disk or the jig, in one sentence.
    """

    path: Path
    state: RecorderState = "starting"
    elapsed_s: float = 0.0
    recorded_s: float = 0.0
    planned_s: float | None = None
    file_bytes: int = 0
    synced_bytes: int = 0
    disk_free_bytes: int | None = None
    disk_left_s: float | None = None
    queue: float = 0.0
    queue_s: float = 0.0
    unwritten_records: int = 0
    markers: int = 0
    devices: tuple[DeviceStatus, ...] = field(default_factory=tuple)
    problem: str | None = None

    @property
    def rows(self) -> tuple[DeviceStatus, ...]:
        """Every stream of every device."""
        return tuple(row for device in self.devices for row in device.rows)
