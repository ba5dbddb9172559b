"""Kill a recorder with SIGKILL at random moments and count what is missing afterwards.

``python tests/recording/kill_harness.py --kills 300`` prints the figures and ends with 1 if an
acknowledged record is missing or any row is wrong.
"""

import argparse
import json
import os
import random
import select
import signal
import struct
import sys
import tempfile
import time
from pathlib import Path

from rows_of_trials import CONFIG, DESCRIPTOR, SOURCE, row

from imu_rig.clock import SystemClock
from imu_rig.errors import ImuRigError
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial

REPORT = struct.Struct("<Q")  # acknowledged records so far
PACED_S = 0.001
LONGEST_LIFE_S = 0.25
ROWS_AFTER = 20


def record_until_killed(path: Path, pipe: int, paced: bool) -> None:
    clock = SystemClock()
    options = RecordingOptions(note_s=0.02, sync_s=0.05, queue_bytes=1 << 16)
    trial = TrialWriter.create(path, CONFIG, clock=clock, options=options)
    source = trial.add_source(SOURCE, "test", DESCRIPTOR)
    number = told = 0
    while True:
        # An unpaced recorder waits for room, so that no row is left out and all can be compared.
        if paced or trial.queued_bytes < options.queue_bytes // 2:
            trial.bytes_in(source, clock.now_ns(), row(number))
            number += 1
        if (acknowledged := trial.written_records) != told:
            os.write(pipe, REPORT.pack(acknowledged))
            told = acknowledged
        if paced:
            time.sleep(PACED_S)


def killed_recording(path: Path, paced: bool, life_s: float) -> int:
    """Record for ``life_s`` after the first acknowledgement; return the last one reported."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reading)
            record_until_killed(path, writing, paced)
        finally:
            os._exit(1)
    os.close(writing)
    reports = bytearray(os.read(reading, 1 << 16))
    end = time.monotonic() + life_s
    while (left := end - time.monotonic()) > 0:
        if select.select([reading], [], [], left)[0]:
            reports += os.read(reading, 1 << 16)
    os.kill(child, signal.SIGKILL)
    while part := os.read(reading, 1 << 16):
        reports += part
    os.close(reading)
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        raise RuntimeError("the recorder ended by itself")
    whole = len(reports) // REPORT.size * REPORT.size
    return int(REPORT.unpack_from(reports, whole - REPORT.size)[0])


def check(path: Path, acknowledged: int) -> tuple[int, list[str]]:
    """Return how many rows the file holds and what is wrong with it."""
    problems = []
    trial = open_trial(path)
    if len(trial.records) < acknowledged:
        problems.append(f"{acknowledged - len(trial.records)} acknowledged records lost")
    if trial.damage.records_lost or trial.damage.bytes_skipped or trial.damage.records_repeated:
        problems.append(f"damage: {trial.damage}")
    if trial.ended is not None:
        problems.append(f"ended as {trial.ended}")
    # A very early kill may come before the source is announced; then there are no rows either.
    wire = trial.wire(SOURCE) if SOURCE in trial.sources else None
    count = 0 if wire is None else len(wire)
    if wire is not None and wire.data != b"".join(map(row, range(count))):
        problems.append("wrong rows")

    with TrialWriter.append(path, clock=SystemClock()) as more:
        source = more.add_source(SOURCE, "test", DESCRIPTOR)
        for number in range(count, count + ROWS_AFTER):
            more.bytes_in(source, SystemClock().now_ns(), row(number))
    trial = open_trial(path)
    if trial.wire(SOURCE).data != b"".join(map(row, range(count + ROWS_AFTER))):
        problems.append("wrong rows after the trial was continued")
    if trial.damage or trial.ended != "complete":
        problems.append(f"continued trial: {trial.ended}, damage {trial.damage}")
    return count, problems


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=int(os.environ.get("IMU_RIG_KILLS", "20")))
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    moments = random.Random(arguments.seed)
    figures = {"kills": 0, "acknowledged_records": 0, "rows": 0, "torn_ends": 0, "bad": 0}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(arguments.kills):
            path = Path(folder) / f"{number}.imu-trial"
            paced = number % 2 == 0
            acknowledged = killed_recording(path, paced, moments.uniform(0, LONGEST_LIFE_S))
            count = torn = 0
            try:
                torn = open_trial(path).damage.tail_bytes
                count, problems = check(path, acknowledged)
            except ImuRigError as error:
                problems = [f"cannot be opened or continued: {error}"]
            for problem in problems:
                print(f"kill {number}, paced {paced}: {problem}", file=sys.stderr)
            figures["kills"] += 1
            figures["acknowledged_records"] += acknowledged
            figures["rows"] += count
            figures["torn_ends"] += bool(torn)
            figures["bad"] += bool(problems)
            path.unlink()
    print(json.dumps(figures))
    return 1 if figures["bad"] else 0


if __name__ == "__main__":
    sys.exit(main())
