"""How long exports of a trial take, and how much memory: one table for all formats.

``python tests/benchmarks/export_speed.py`` writes one hour of a 400 Hz sensor (1.44 million
packets, synthetic) and exports it in every format, each in a program of its own; with
``--minutes 3`` it is over in a minute. Times are processor time of that program, its start and
reading the trial included.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from trial_speed import RATE_HZ, packets_of, write_trial

from imu_rig.exporting.formats import FORMATS

EXPORT = "import sys; from imu_rig.cli.main import run; sys.argv[0] = 'imu-rig'; run()"


def exported(trial: Path, to: str) -> tuple[float, int, int]:
    """Return processor time [s], size of the file and largest memory of an export [bytes]."""
    target = trial.with_suffix(FORMATS[to].suffix)
    program = subprocess.Popen(
        [sys.executable, "-c", EXPORT, "export", trial, "-o", target, "--to", to],
        stdout=subprocess.DEVNULL,
    )
    _, status, used = os.wait4(program.pid, 0)
    program.returncode = os.waitstatus_to_exitcode(status)
    if program.returncode:
        raise SystemExit(f"exporting to {to} ended with {program.returncode}")
    size = target.stat().st_size
    target.unlink()
    return used.ru_utime + used.ru_stime, size, used.ru_maxrss * 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="of a 400 Hz sensor (60)")
    minutes = parser.parse_args().minutes
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / "hour.imu-trial"
        number = round(minutes * 60 * RATE_HZ)
        write_trial(trial, packets_of(1, number))
        print(f"{number} samples")
        print(f"{'':8}{'s':>8}{'samples/s':>12}{'file MB':>10}{'memory MB':>11}")
        for to in FORMATS:
            spent_s, size, memory = exported(trial, to)
            print(
                f"{to:8}{spent_s:8.1f}{number / spent_s:12,.0f}"
                f"{size / 1e6:10.1f}{memory / 1e6:11.0f}"
            )


if __name__ == "__main__":
    main()
