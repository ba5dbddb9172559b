"""A simulated walk as a trial file, as if a recorder had heard its devices."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from heapq import merge
from pathlib import Path
from typing import Any

from firmware_protocols.known import load_protocol
from imu_rig import __version__
from imu_rig.clock import NS_PER_S, SteppedClock
from imu_rig.devices.conversation import conversation_for
from imu_rig.errors import DeviceError, StorageError
from imu_rig.foreign_text import one_line
from imu_rig.recording.format import TRIAL_KIND
from imu_rig.recording.log import RecordingOptions
from imu_rig.recording.writer import TrialWriter
from simulators.walker.record import Desk, DeviceRecord

QUEUED_BYTES = 2 << 20
"""Waiting for the disk before it is waited for."""
LOOKED_AFTER = 256
"""Records after which the disk is looked after."""

MUST_BE_ASKED = ("xsens-mti",)
"""Kinds of protocols whose devices do not send by themselves what is wanted."""

LONGEST_TALK_S = 30.0


def introduce(desk: Desk) -> None:
    """Say to a device before the walk what has to be said.

    Raises
    ------
    DeviceError
        If it refuses.
    """
    protocol = load_protocol(desk.protocol)
    if protocol.to_dict().get("kind") not in MUST_BE_ASKED:
        return
    conversation = conversation_for(protocol)
    if conversation is None:
        return

    def hear(timeout_s: float) -> bytes:
        if desk.now_s > LONGEST_TALK_S:
            raise DeviceError(f"{desk.device.name} was not ready after {LONGEST_TALK_S:.0f} s.")
        return desk.hear(timeout_s)

    conversation.begin(desk.write, hear)


def write_walk(path: Path, title: str, records: Mapping[str, DeviceRecord]) -> None:
    """Write what devices sent into a new trial file; on any failure none is left.

    Raises
    ------
    InputError
        The file exists.
    StorageError
        The disk is full or fails.
    """
    begin_s = min(
        [t for record in records.values() for t, _ in (*record.chunks, *record.said)], default=0.0
    )
    clock = SteppedClock()
    options = RecordingOptions(
        planned_bytes=sum(len(data) for r in records.values() for _, data in r.chunks)
    )
    config = {
        "kind": TRIAL_KIND,
        "trial": one_line(path.stem),
        "note": one_line(title),
        "imu_rig": __version__,
    }
    writer = TrialWriter.create(path, config, clock=clock, options=options)
    try:
        with writer:
            streams = [
                _events(record, writer.add_source(name, *_source(record)), begin_s)
                for name, record in records.items()
            ]
            for done, (t_ns, number, _, incoming, data) in enumerate(merge(*streams)):
                if done % LOOKED_AFTER == 0:
                    clock.sleep((t_ns - clock.now_ns()) / NS_PER_S)
                    _look_after(writer)
                (writer.bytes_in if incoming else writer.bytes_out)(number, t_ns, data)
        if writer.unwritten_records:
            raise StorageError(f"{path}: not everything could be written; check the disk")
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def _source(record: DeviceRecord) -> tuple[str, dict[str, Any]]:
    protocol = load_protocol(record.protocol)
    kind = "imu" if protocol.inertial_streams else "sensor"
    return kind, {"layout": protocol.to_dict(), "url": "simulated", "required": True}


def _events(
    record: DeviceRecord, number: int, begin_s: float
) -> Iterator[tuple[int, int, int, bool, bytes]]:
    """Yield time [ns], source, a running number, whether it came in, and the bytes."""
    events = [(t, True, data) for t, data in record.chunks]
    events += [(t, False, data) for t, data in record.said]
    events.sort(key=lambda event: event[0])
    for running, (t, incoming, data) in enumerate(events):
        yield round((t - begin_s) * NS_PER_S), number, running, incoming, data


def _look_after(writer: TrialWriter) -> None:
    """Wait for the disk where much is queued, and give up where it has failed."""
    if writer.queued_bytes > QUEUED_BYTES:
        writer.flush()
    if writer.error is not None:
        raise writer.error
