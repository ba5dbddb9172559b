"""Trials of numbered rows, so that a test can tell a lost row from a wrong one."""

import functools
import struct
import zlib
from pathlib import Path

from imu_rig.clock import SteppedClock
from imu_rig.recording import RecordingOptions, Trial, TrialWriter

CONFIG = {"kind": "test", "note": "Größe °"}
DESCRIPTOR = {"what": "numbered rows"}
SOURCE = "rows"
FEW_NOTES = RecordingOptions(note_s=3600.0, sync_s=3600.0)


@functools.cache
def row(number: int) -> bytes:
    """A row that carries its own number, 12 to 51 bytes long."""
    body = struct.pack("<Q", number) + bytes([number % 251]) * (number % 40)
    return body + struct.pack("<I", zlib.crc32(body))


def rows(count: int, first: int = 0) -> bytes:
    return b"".join(row(number) for number in range(first, first + count))


def numbers(trial: Trial) -> list[int]:
    """Numbers of the rows in a trial; fails if any row is not as it was written."""
    wire = trial.wire(SOURCE)
    found = []
    start = 0
    for t, stop in zip(wire.t.tolist(), wire.stops.tolist(), strict=True):
        chunk = wire.data[start:stop]
        number = struct.unpack_from("<Q", chunk)[0]
        assert chunk == row(number), f"wrong row at byte {start}"
        assert t == number / 100
        found.append(number)
        start = stop
    assert found == sorted(found)
    return found


def write_trial(path: Path, count: int) -> bytes:
    """Write a trial of ``count`` rows, 0.01 s apart, and return the file."""
    clock = SteppedClock()
    with TrialWriter.create(path, CONFIG, clock=clock, options=FEW_NOTES) as trial:
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        for number in range(count):
            trial.bytes_in(source, number * 10_000_000, row(number))
        trial.flush()
    return path.read_bytes()
