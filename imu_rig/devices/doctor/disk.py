"""The disk under the folder of the trials: speed, patience, room."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from imu_rig.devices.doctor.system import Check, System
from imu_rig.errors import reason_of
from imu_rig.foreign_text import printable

WRITTEN_BYTES = 8 << 20
PIECE_BYTES = 1 << 16
SYNCS = 8
SYNC_BYTES = 4096

# What a recording of many devices needs, with much to spare.
LEAST_BYTES_PER_S = 2e6
SLOW_SYNC_S, LAZY_SYNC_S = 0.25, 2.0
LITTLE_BYTES, VERY_LITTLE_BYTES = 1 << 30, 100 << 20

NETWORK_SYSTEMS = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "afs", "ceph", "davfs", "fuse.sshfs", "ncpfs"}
)
MEMORY_SYSTEMS = frozenset({"tmpfs", "ramfs"})


@dataclass(frozen=True)
class DiskSpeed:
    """What writing showed: bytes per second, and the usual and longest wait for the disk [s]."""

    bytes_per_s: float
    sync_s: float
    longest_sync_s: float


def existing(folder: Path) -> Path:
    """Return the folder, or the nearest one above it that is there."""
    folder = folder.absolute()
    return next((p for p in (folder, *folder.parents) if p.is_dir()), Path(folder.anchor))


def measure_disk(folder: Path) -> DiskSpeed:
    """Write a file of a few megabytes, wait for the disk several times, and take it away.

    Raises
    ------
    OSError
        If the folder takes no file.
    """
    piece = os.urandom(PIECE_BYTES)
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".imu-rig-doctor-") as file:
        begin = time.monotonic()
        for _ in range(WRITTEN_BYTES // PIECE_BYTES):
            file.write(piece)
        file.flush()
        os.fsync(file.fileno())
        seconds = max(time.monotonic() - begin, 1e-6)
        waits = []
        for _ in range(SYNCS):
            begin = time.monotonic()
            file.write(piece[:SYNC_BYTES])
            file.flush()
            os.fsync(file.fileno())
            waits.append(time.monotonic() - begin)
    return DiskSpeed(WRITTEN_BYTES / seconds, sorted(waits)[SYNCS // 2], max(waits))


def check_disk(system: System, folder: Path) -> list[Check]:
    """Write to the folder of the trials, and look at the room and the kind of its disk."""
    at = existing(folder)
    shown = printable(str(at))
    try:
        speed = measure_disk(at)
    except OSError as error:
        advice = "Free some room." if error.errno == errno.ENOSPC else "Choose another folder: "
        return [
            Check(
                "disk",
                "bad",
                f"{shown} takes no file ({reason_of(error)}): nothing could be recorded there.",
                advice + ("" if error.errno == errno.ENOSPC else "imu-rig record --output FOLDER."),
            )
        ]
    return [judge_speed(speed, shown), *check_room(at, shown), *check_kind(system, at)]


def judge_speed(speed: DiskSpeed, shown: str) -> Check:
    """Say whether a disk is fast enough to record to."""
    found = (
        f"{shown} takes {speed.bytes_per_s / 1e6:.0f} MB/s; a write is safe after "
        f"{_milliseconds(speed.sync_s)} (at worst {_milliseconds(speed.longest_sync_s)})"
    )
    if speed.longest_sync_s > LAZY_SYNC_S:
        return Check(
            "disk",
            "warn",
            f"{found}: a loss of power would take the last seconds of a recording with it.",
            "Record to a disk inside this machine.",
        )
    if speed.bytes_per_s < LEAST_BYTES_PER_S or speed.longest_sync_s > SLOW_SYNC_S:
        return Check(
            "disk",
            "warn",
            f"{found}: slow; enough for a few devices, as memory bridges such waits.",
            "Close what else writes to it, or record to another disk.",
        )
    return Check("disk", "ok", f"{found}.")


def check_room(at: Path, shown: str) -> list[Check]:
    """Look how much fits on the disk."""
    free = shutil.disk_usage(at).free
    room = f"{shown} has room for {free / 1e9:.1f} GB"
    if free < VERY_LITTLE_BYTES:
        return [Check("room", "bad", f"{room}: too little to record.", "Free some room.")]
    if free < LITTLE_BYTES:
        return [Check("room", "warn", f"{room}.", "Free some room before long recordings.")]
    return [Check("room", "ok", f"{room}.")]


def check_kind(system: System, at: Path) -> list[Check]:
    """Look whether the folder is on a disk of this machine."""
    kind = _file_system(system, at)
    if kind in NETWORK_SYSTEMS:
        return [
            Check(
                "disk kind",
                "warn",
                f"the folder is on another machine ({kind}): when the network stalls, so does the "
                "recording.",
                "Record to a disk inside this machine, and copy afterwards.",
            )
        ]
    if kind in MEMORY_SYSTEMS:
        return [
            Check(
                "disk kind",
                "warn",
                f"the folder is in memory ({kind}): what is recorded there is gone when the "
                "machine is switched off.",
                "Record to a disk.",
            )
        ]
    return []


def _file_system(system: System, at: Path) -> str | None:
    """Return the kind of file system of a folder by the longest mount point above it."""
    best: tuple[int, str] | None = None
    for line in (system.text("proc", "mounts") or "").splitlines():
        parts = line.split()
        if len(parts) < 3:
            continue
        point = Path(parts[1].replace("\\040", " "))
        if at.is_relative_to(point) and (best is None or len(point.parts) >= best[0]):
            best = len(point.parts), parts[2]
    return None if best is None else best[1]


def _milliseconds(seconds: float) -> str:
    return f"{1000 * seconds:.1f} ms" if seconds < 0.1 else f"{1000 * seconds:.0f} ms"
