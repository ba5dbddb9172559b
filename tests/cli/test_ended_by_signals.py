"""A command that is ended from outside leaves no half file behind."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

GOLDEN = Path(__file__).resolve().parent.parent / "data" / "golden-devices-v1.imu-trial"
HELD = """
import sys, time
from imu_rig.cli.main import run
from imu_rig.exporting import csv_file

def held(*_):
    print("writing", flush=True)
    time.sleep(30)

csv_file._rows = held
sys.argv[1:] = ["export", sys.argv[1], "--to", "csv"]
run()
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_an_export_that_is_ended_leaves_nothing(tmp_path, number):
    trial = shutil.copy(GOLDEN, tmp_path)
    program = subprocess.Popen(
        [sys.executable, "-c", HELD, trial], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert program.stdout.readline() == b"writing\n"
    assert list(tmp_path.glob(".imu-rig-*"))
    program.send_signal(number)
    _, said = program.communicate(timeout=20)
    assert program.returncode == (130 if number == signal.SIGINT else 128 + number)
    assert b"Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == [GOLDEN.name]


def test_what_whoever_started_it_wants_to_outlive_stays_ignored():
    shown = "import signal; from imu_rig.cli.signals import leave_on_signals as leave; leave();"
    shown += "print(signal.getsignal(signal.SIGHUP) == signal.SIG_IGN)"
    asked = ["nohup", sys.executable, "-c", shown]
    done = subprocess.run(asked, capture_output=True, text=True, timeout=20)
    assert "True" in done.stdout
