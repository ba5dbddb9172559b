"""A recording of another program as a trial file, so that whatever reads trials reads it.

Every stream becomes a source that sends packets: its numbers as they were read, in full precision,
its own times as the device's clock, and a counter that jumps where packets are missing. A packet
arrives when it was measured, so nothing of a transport is made up.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np

from firmware_protocols.fields import MAX_UNIT, Checksum, Field
from firmware_protocols.layout import PacketLayout
from firmware_protocols.packets import encode
from firmware_protocols.rows import RATES_HZ
from imu_rig import __version__
from imu_rig.arrays import AnyArray, FloatArray, IntArray
from imu_rig.blocks import Samples
from imu_rig.clock import NS_PER_S, SteppedClock
from imu_rig.errors import InputError, StorageError, reason_of
from imu_rig.foreign_text import one_line
from imu_rig.importing.foreign import ForeignRecording
from imu_rig.recording.format import IMPORTED_FROM, TRIAL_KIND
from imu_rig.recording.log import RecordingOptions
from imu_rig.recording.storage import FileSystem, OsFileSystem
from imu_rig.recording.writer import TrialWriter

REFERENCE = "reference"
TICK_S = 1e-6
TICK_NS = 1000
CLOCK_WRAPS = 1 << 32
LONGEST_S = 30 * 86_400.0
HEADER = b"\xa5\x5aRV"
CHECKSUM = "crc32"
QUEUED_BYTES = 2 << 20
"""Waiting for the disk before it is waited for."""
ENCODED_ROWS = 4096
LOOKED_AFTER = 256
"""Packets after which the disk is looked after; they take less room than the queue has."""
JITTER_ROWS = 50
"""Rows within which time stamps that run ahead are caught up where nothing is missing."""
GAP_PERIODS = 1.5
LONGEST_NAME = 60


@dataclass(frozen=True)
class Imported:
    """What was written.

    Attributes
    ----------
    path : Path
    packets : dict
        Name of each source to its number of packets.
    missing : dict
        Name of each source to the packets that its counter or clock says are missing.
    duration_s : float
    """

    path: Path
    packets: dict[str, int]
    missing: dict[str, int]
    duration_s: float


def write_trial(
    path: Path | str,
    recording: ForeignRecording,
    *,
    name: str | None = None,
    progress: Callable[[float], None] = lambda share: None,
    wall_ns: Callable[[], int] | None = None,
    file_system: FileSystem | None = None,
) -> Imported:
    """Write a recording as a new trial file; on any failure none is left.

    Parameters
    ----------
    path : Path or str
        The trial file, which must not exist.
    recording : ForeignRecording
    name : str, optional
        What to call its sensor; put before the names of several.
    progress : callable
        Told the part that is done, 0 to 1.
    wall_ns : callable, optional
        Wall clock of the import [ns since 1970 UTC], used where the recording has no start.
    file_system : FileSystem, optional
        What writes.

    Raises
    ------
    InputError
        The file exists, or the recording cannot be one trial.
    StorageError
        The disk is full or fails.
    """
    target = Path(path)
    sources = _sources(recording, name)
    start = min(float(s.samples.t[0]) for s in sources)
    duration = max(float(s.samples.t[-1]) for s in sources) - start
    if not duration <= LONGEST_S:
        raise InputError(
            f"{recording.files[0]} spans {duration:.3g} s by its time stamps, more than a trial "
            "can: check the unit of time"
        )
    total = sum(len(s.samples) for s in sources)
    clock = SteppedClock()
    options = RecordingOptions(
        planned_bytes=sum(len(s.samples) * s.layout.length for s in sources),
        file_system=file_system or OsFileSystem(),
    )
    began_ns = recording.start_utc_ns
    if began_ns is None:
        began_ns = (wall_ns or options.wall_ns)()
    options = _with_wall(options, began_ns, clock)
    config = _config(recording, target, start)
    writer = TrialWriter.create(target, config, clock=clock, options=options)
    try:
        with writer:
            numbers = {
                s.name: writer.add_source(s.name, s.kind, s.descriptor(recording)) for s in sources
            }
            records = merge(*(s.records(start, numbers[s.name]) for s in sources))
            for done, (time_ns, number, packet) in enumerate(records):
                if done % LOOKED_AFTER == 0:
                    clock.sleep((time_ns - clock.now_ns()) / NS_PER_S)
                    _look_after(writer)
                    progress(done / total)
                writer.bytes_in(number, time_ns, packet)
            clock.sleep(duration - clock.now_ns() / NS_PER_S)
        if writer.unwritten_records:
            raise StorageError(f"{target}: not everything could be written; check the disk")
    except BaseException:
        target.unlink(missing_ok=True)
        raise
    return Imported(
        target,
        {s.name: len(s.samples) for s in sources},
        {s.name: int(s.sequence[-1] - s.sequence[0]) + 1 - len(s.samples) for s in sources},
        duration,
    )


@dataclass(frozen=True)
class _Source:
    """A stream with its place in the trial."""

    name: str
    kind: str
    samples: Samples
    layout: PacketLayout
    sequence: IntArray

    def descriptor(self, recording: ForeignRecording) -> dict[str, Any]:
        return {"layout": self.layout.to_dict(), IMPORTED_FROM: recording.format}

    def records(self, start_s: float, number: int) -> Iterator[tuple[int, int, bytes]]:
        """Yield the arrival [ns] of every packet, the number of the source, and its bytes.

        One packet to a record: if several arrived together, those that do so late would make the
        clock fit state an uncertainty of its times that they do not have.
        """
        ticks = np.rint((self.samples.t - start_s) / TICK_S).astype(np.int64)
        size = self.layout.length
        for first in range(0, len(ticks), ENCODED_ROWS):
            rows = slice(first, first + ENCODED_ROWS)
            columns: dict[str, AnyArray] = {
                "seq": self.sequence[rows] % CLOCK_WRAPS,
                "time_us": ticks[rows] % CLOCK_WRAPS,
            }
            columns |= {name: numbers[rows] for name, numbers in self.samples.values.items()}
            data = encode(self.layout, columns)
            for i, time_ns in enumerate((ticks[rows] * TICK_NS).tolist()):
                yield time_ns, number, data[i * size : (i + 1) * size]


def _look_after(writer: TrialWriter) -> None:
    """Wait for the disk where much is queued, and give up where it has failed."""
    if writer.queued_bytes > QUEUED_BYTES:
        writer.flush()
    if writer.error is not None:
        raise writer.error


def _sources(recording: ForeignRecording, name: str | None) -> list[_Source]:
    if not recording.streams:
        raise InputError(f"{recording.files[0]} holds no samples")
    sources = []
    alone = len(recording.streams) == 1
    for stream, samples in recording.streams.items():
        wanted = stream if name is None else name if alone else f"{name}-{stream}"
        kind = "imu" if samples.is_inertial else next(iter(samples.values), "sensor")
        sources.append(_source(one_line(wanted, LONGEST_NAME) or "sensor", kind, samples))
    if recording.reference is not None:
        truth = recording.reference
        values: dict[str, FloatArray] = {}
        units: dict[str, str] = {}
        if truth.position is not None:
            values["position"], units["position"] = truth.position, "m"
        if truth.orientation is not None:
            values["orientation"], units["orientation"] = truth.orientation, ""
        if truth.moving is not None:
            values["moving"], units["moving"] = truth.moving.astype(np.float64), ""
        samples = Samples(truth.t, truth.t, truth.t, None, values, units)
        sources.append(_source(REFERENCE, REFERENCE, samples))
    names = [s.name for s in sources]
    if len(set(names)) < len(names):
        raise InputError(
            f"{recording.files[0]}: two of its sensors would be named alike ({', '.join(names)}): "
            "give another --name"
        )
    return sources


def _source(name: str, kind: str, samples: Samples) -> _Source:
    if len(samples) == 0:
        raise InputError(f"the sensor {name!r} has no samples")
    steps = np.diff(samples.t)
    fields = [Field("seq", "u32"), Field("time_us", "u32", unit="us")]
    for field, numbers in samples.values.items():
        count = 1 if numbers.ndim == 1 else numbers.shape[1]
        unit = samples.units.get(field, "")[:MAX_UNIT]
        fields.append(Field(field, "f64", count, unit=unit if unit.isprintable() else ""))
    rate_hz = 1.0 / float(np.median(steps)) if len(steps) else 0.0
    layout = PacketLayout(
        name="imported",
        title="Samples read from a file of another program",
        byte_order="little",
        header=HEADER,
        fields=tuple(fields),
        checksum=Checksum(CHECKSUM),
        counter="seq",
        clock="time_us",
        clock_tick_s=TICK_S,
        rate_hz=rate_hz if RATES_HZ[0] <= rate_hz <= RATES_HZ[1] else None,
    )
    counter = samples.counter
    return _Source(name, kind, samples, layout, counted(samples.t) if counter is None else counter)


def counted(t: FloatArray) -> IntArray:
    """Return numbers for samples by their times, so that a gap in time is one in the numbers.

    A stamp that comes late by more than 1.5 periods is a gap only if those after it stay late:
    stamps that jitter catch up again.

    Parameters
    ----------
    t : shape (n,)
        Times, increasing.

    Returns
    -------
    shape (n,), int64
        From 0 on.
    """
    steps = np.diff(t)
    if not len(steps):
        return np.zeros(len(t), np.int64)
    period = float(np.median(steps))
    ahead = t / period - np.arange(len(t))
    increments = np.ones(len(steps), np.int64)
    for gap in np.flatnonzero(steps > GAP_PERIODS * period).tolist():
        before = ahead[max(0, gap + 1 - JITTER_ROWS) : gap + 1].max()
        after = ahead[gap + 1 : gap + 1 + JITTER_ROWS].min()
        increments[gap] += max(0, int(np.rint(after - before)))
    return np.concatenate(([0], np.cumsum(increments)))


def _config(recording: ForeignRecording, target: Path, start_s: float) -> dict[str, Any]:
    reference = recording.reference
    return {
        "kind": TRIAL_KIND,
        "trial": one_line(target.stem),
        "note": "",
        "imu_rig": __version__,
        "origin": {
            "format": recording.format,
            "files": [
                {"name": one_line(file.name), "sha256": file_digest(file)}
                for file in recording.files
            ],
            "notes": [one_line(note) for note in recording.notes],
            "reference_frame": None if reference is None else one_line(reference.frame),
            "start_known": recording.start_utc_ns is not None,
            "time_zero_s": start_s,
        },
    }


def file_digest(file: Path) -> str:
    """Return the SHA-256 of a file.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{file} could not be read: {reason_of(error)}") from error


def _with_wall(options: RecordingOptions, began_ns: int, clock: SteppedClock) -> RecordingOptions:
    """Let the wall clock of the trial be that of the recording."""
    return replace(options, wall_ns=lambda: began_ns + clock.now_ns())
