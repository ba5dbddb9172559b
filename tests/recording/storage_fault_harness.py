"""Let the disk fail at each of the first writes in turn, and count acknowledged rows that are gone.

``python tests/recording/storage_fault_harness.py`` tries every write up to the 200th with a full
disk, an I/O error and a write that takes half, for once and for good, with a file that can be cut
back and one that cannot, and every sync up to the 20th; it ends with 1 if anything is lost.
"""

from __future__ import annotations

import argparse
import errno
import json
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from failing_storage import BadSyncFileSystem, FailingFileSystem
from rows_of_trials import CONFIG, DESCRIPTOR, SOURCE, numbers, row

from imu_rig.clock import SteppedClock
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial
from imu_rig.recording.storage import OsFileSystem

FIRST_WRITE = 2  # the one before it makes the file, and leaves none when it fails
PROBLEMS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "short write": 0}
ENDS = {"ENOSPC": "disk_full", "EIO": "storage_failed", "short write": "disk_full"}


@dataclass
class Figures:
    """What became of the trials of one kind of fault."""

    fault: str
    trials: int = 0
    acknowledged: int = 0
    lost: int = 0
    ended: dict[str, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def require(self, holds: bool, what: str) -> None:
        if not holds:
            self.problems.append(what)


def create(path: Path, file_system: OsFileSystem, **options: object) -> TrialWriter:
    values = {"note_s": 3600.0, "file_system": file_system, **options}
    return TrialWriter.create(
        path, CONFIG, clock=SteppedClock(), options=RecordingOptions(**values)
    )


def record_until_failure(trial: TrialWriter) -> tuple[int, int]:
    """Hand in rows until the disk fails; return how many were, and records acknowledged."""
    source = trial.add_source(SOURCE, "test", DESCRIPTOR)
    trial.flush()
    handed_in = 0
    while trial.error is None:
        trial.bytes_in(source, handed_in * 10_000_000, row(handed_in))
        trial.flush()
        handed_in += 1
    acknowledged = trial.written_records
    trial.bytes_in(source, 0, b"too late")
    trial.close()
    return handed_in, acknowledged


def check(path: Path, handed_in: int, acknowledged: int, figures: Figures, what: str) -> None:
    """Every row but the one that failed was acknowledged, and must be there."""
    found = open_trial(path)
    rows = numbers(found) if SOURCE in found.sources and handed_in else []
    kept = rows[: max(0, handed_in - 1)]
    figures.trials += 1
    figures.acknowledged += max(0, handed_in - 1)
    figures.lost += max(0, handed_in - 1) - len(kept)
    figures.ended[str(found.ended)] = figures.ended.get(str(found.ended), 0) + 1
    figures.require(len(found.records) >= acknowledged, f"{what}: records lost")
    figures.require(kept == list(range(handed_in - 1)), f"{what}: rows lost")


def failing_writes(
    folder: Path, problem: str, *, lasting: bool, uncut: bool, which: Iterable[int]
) -> Figures:
    said = f"{problem}{' for good' if lasting else ''}{', not cut back' if uncut else ''}"
    figures = Figures(said)
    for failing in which:
        path = folder / f"{failing}.imu-trial"
        file_system = FailingFileSystem(failing, PROBLEMS[problem], lasting, uncut)
        trial = create(path, file_system)
        handed_in, acknowledged = record_until_failure(trial)
        what = f"{said}, write {failing}"
        check(path, handed_in, acknowledged, figures, what)
        found = open_trial(path)
        figures.require(str(path) in str(trial.error), f"{what}: said {trial.error}")
        figures.require(trial.unwritten_records >= 1, f"{what}: nothing counted as unwritten")
        figures.require(found.ended == (None if lasting else ENDS[problem]), f"{what}: no end")
        if not uncut:
            figures.require(not found.damage, f"{what}: {found.damage}")
            figures.require(path.stat().st_size == trial.acknowledged_bytes, f"{what}: a rest")
        path.unlink()
    return figures


def failing_syncs(folder: Path, which: Iterable[int]) -> Figures:
    figures = Figures("EIO at a sync")
    for failing in which:
        path = folder / f"{failing}.imu-trial"
        trial = create(path, BadSyncFileSystem(failing), sync_s=0.0005)
        handed_in, acknowledged = record_until_failure(trial)
        what = f"sync {failing}"
        check(path, handed_in, acknowledged, figures, what)
        figures.require(open_trial(path).ended == "storage_failed", f"{what}: no end")
        said = f"the first {trial.synced_bytes} bytes are safe"
        figures.require(said in str(trial.error), f"{what}: said {trial.error}")
        path.unlink()
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--writes", type=int, default=200)
    parser.add_argument("--syncs", type=int, default=20)
    arguments = parser.parse_args()
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        which = range(FIRST_WRITE, arguments.writes + 1)
        for problem in PROBLEMS:
            for lasting in (False, True):
                for uncut in (False, True):
                    figures = failing_writes(
                        Path(folder), problem, lasting=lasting, uncut=uncut, which=which
                    )
                    bad += _tell(figures)
        bad += _tell(failing_syncs(Path(folder), range(2, arguments.syncs + 1)))
    return 1 if bad else 0


def _tell(figures: Figures) -> int:
    told = {key: value for key, value in vars(figures).items() if key != "problems"}
    print(json.dumps({**told, "bad": len(figures.problems)}), flush=True)
    for problem in figures.problems[:10]:
        print(problem, file=sys.stderr)
    return len(figures.problems)


if __name__ == "__main__":
    sys.exit(main())
