"""Sessions from outside: signals, kills, resuming, hardware served by another process."""

import contextlib
import json
import os
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from program import PROGRAM

from imu_rig.cli.hardware import Hardware
from imu_rig.clock import SystemClock
from imu_rig.recording.reader import open_trial
from imu_rig.session.history import read_session
from simulators.rig import RigConfig, SimulatedRig

PROTOCOL = """
name = "tiny"
hold_s = 0.8
steps = [{ tilt = 30 }, { tilt = -30 }, { roll = 60, tilt = 0 }, { tilt = 40 }, { tilt = 0 }]
"""

SHORTEST = """
name = "shortest"
hold_s = 0.5
steps = [{ tilt = 20 }, { roll = 20, tilt = 0 }, { tilt = 20 }]
"""

METHOD = "paper-diagonal"  # the only one that so few poses are enough for


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(PROTOCOL)
    return path


def start_session(folder: Path, protocol: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [
            *(PROGRAM, "calibrate", "--simulate", "--speed", "3", "--method", METHOD),
            *("--protocol", protocol, "--output", folder),
        ],
        env={**os.environ, "TMPDIR": str(protocol.parent)},  # a killed one cannot clean up
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_poses(trial: Path, count: int) -> None:
    deadline = time.monotonic() + 40
    while time.monotonic() < deadline:
        if trial.exists() and trial.stat().st_size > 1000:
            poses = [e for e in open_trial(trial).events if e.name == "pose"]
            if len(poses) >= count:
                return
        time.sleep(0.1)
    pytest.fail(f"no {count} poses in {trial}")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_parks_closes_and_says_how_to_go_on(
    imu_rig: Any, tmp_path: Path, protocol: Path, name: str
) -> None:
    folder = tmp_path / "out"
    trial = folder / "session.imu-trial"
    process = start_session(folder, protocol)
    wait_for_poses(trial, 1)
    process.send_signal(getattr(signal, name))
    begin = time.monotonic()
    stdout, stderr = process.communicate(timeout=20)
    assert time.monotonic() - begin < 10
    assert process.returncode == 130, stderr
    assert name in stderr
    assert f"--resume {trial} --simulate --seed 1 --speed 3 --method {METHOD}" in stderr
    assert "Traceback" not in stderr
    assert stdout == ""
    opened = open_trial(trial)
    assert opened.ended == "interrupted"
    assert [e.name for e in opened.events].count("parked") >= 2
    assert not (folder / "certificate.json").exists()


def test_the_words_to_go_on_by_keep_what_the_hardware_needs() -> None:
    assert Hardware(simulate=True, seed=2, speed=8.0).options == "--simulate --seed 2 --speed 8"
    assert Hardware(simulate=True).options == "--simulate --seed 1"
    real = Hardware("a", "b", speed=8.0)
    assert real.options == "--imu a --maestro b"
    unusual = replace(real, baud=9600, maestro_device=3, maestro_crc=True)
    assert unusual.options == f"{real.options} --baud 9600 --maestro-device 3 --maestro-crc"


def test_a_terminal_that_takes_no_text_holds_up_nothing(
    tmp_path: Path, protocol: Path, imu_rig: Any
) -> None:
    folder = tmp_path / "out"
    reader, writer = os.pipe()
    try:
        os.set_blocking(writer, False)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(writer, bytes(65536))
        os.set_blocking(writer, True)
        process = subprocess.Popen(
            [
                *(PROGRAM, "calibrate", "--simulate", "--speed", "4", "--method", METHOD),
                *("--protocol", protocol, "--output", folder),
            ],
            stdout=subprocess.DEVNULL,
            stderr=writer,
        )
        wait_for_poses(folder / "session.imu-trial", 5)
        deadline = time.monotonic() + 20
        while open_trial(folder / "session.imu-trial").ended is None:
            assert time.monotonic() < deadline
            time.sleep(0.1)
    finally:
        os.close(reader)
        os.close(writer)
        process.wait(timeout=30)
    assert open_trial(folder / "session.imu-trial").ended == "complete"


def test_a_killed_session_is_readable_and_goes_on(
    imu_rig: Any, tmp_path: Path, protocol: Path
) -> None:
    folder = tmp_path / "out"
    trial = folder / "session.imu-trial"
    process = start_session(folder, protocol)
    wait_for_poses(trial, 2)
    process.kill()
    process.communicate()
    opened = open_trial(trial)
    assert opened.ended is None
    kept = read_session(opened).finished
    assert kept >= {0, 1}
    imu_rig("calibrate", "--simulate", "--speed", 5, "--method", METHOD, "--resume", trial)
    record = read_session(open_trial(trial))
    assert record.finished == {0, 1, 2, 3, 4}
    assert open_trial(trial).ended == "complete"
    assert (folder / "certificate.json").is_file()
    assert "complete" in imu_rig("calibrate", "--simulate", "--resume", trial, code=2).stderr


def test_another_sensor_does_not_go_on_with_a_session(
    imu_rig: Any, tmp_path: Path, protocol: Path
) -> None:
    folder = tmp_path / "out"
    trial = folder / "session.imu-trial"
    process = start_session(folder, protocol)
    wait_for_poses(trial, 2)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)
    arguments = ["calibrate", "--simulate", "--seed", 3, "--speed", 5, "--method", METHOD]
    refused = imu_rig(*arguments, "--resume", trial, code=6)
    assert "another sensor" in refused.stderr
    assert "begin a new session" in refused.stderr
    assert "--resume" not in refused.stderr
    kept = read_session(open_trial(trial))
    assert kept.finished < {0, 1, 2, 3, 4}
    mixed = imu_rig(*arguments, "--resume", trial, "--name", "other", code=2)
    assert "--name" in mixed.stderr


def test_hardware_served_by_another_process(tmp_path: Path, imu_rig: Any) -> None:
    protocol = tmp_path / "shortest.toml"  # such hardware is as slow as life
    protocol.write_text(SHORTEST)
    server = subprocess.Popen(
        [PROGRAM, "simulate", "rig", "--tcp", "--json"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert server.stdout is not None
        ports = json.loads(server.stdout.readline())
        folder = tmp_path / "out"
        done = imu_rig(
            *("calibrate", "--imu", ports["imu"], "--maestro", ports["maestro"]),
            *("--protocol", protocol, "--method", METHOD, "--output", folder, "--json"),
        )
        assert json.loads(done.stdout)["certificate"]["method"] == METHOD
        assert open_trial(folder / "session.imu-trial").ended == "complete"
    finally:
        server.send_signal(signal.SIGINT)
        assert server.wait(timeout=10) == 0
        server.stdout.close()


def test_a_maestro_as_it_comes_from_the_factory_is_recognized(imu_rig: Any, tmp_path: Path) -> None:
    config = RigConfig.random(1).model_copy(update={"maestro_mode": "uart-detect"})
    with SimulatedRig(config, clock=SystemClock()) as rig:
        done = imu_rig(
            *("calibrate", "--imu", rig.imu_url, "--maestro", rig.maestro_url),
            *("--output", tmp_path / "out"),
            code=4,
        )
    assert "USB Dual Port" in done.stderr
    assert "Maestro Control Center" in done.stderr


def test_ports_mixed_up_and_another_layout_are_recognized(imu_rig: Any, tmp_path: Path) -> None:
    with SimulatedRig(RigConfig.random(1), clock=SystemClock()) as rig:
        swapped = imu_rig(
            *("calibrate", "--imu", rig.maestro_url, "--maestro", rig.imu_url),
            *("--output", tmp_path / "swapped"),
            code=4,
        )
        assert rig.imu_url in swapped.stderr
        other = imu_rig(
            *("calibrate", "--imu", rig.imu_url, "--maestro", rig.maestro_url),
            *("--layout", "mpu9150-burst-30", "--output", tmp_path / "other"),
            code=6,
        )
    assert "mpu9150-28" in other.stderr


def test_a_port_in_use_is_named(imu_rig: Any, tmp_path: Path, protocol: Path) -> None:
    with SimulatedRig(RigConfig.random(1), clock=SystemClock()) as rig:
        arguments = ["calibrate", "--imu", rig.imu_url, "--maestro", rig.maestro_url]
        first = subprocess.Popen(
            [
                *(PROGRAM, *arguments, "--protocol", protocol, "--method", METHOD),
                *("--output", tmp_path / "first"),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            wait_for_poses(tmp_path / "first" / "session.imu-trial", 1)
            second = imu_rig(*arguments, "--output", tmp_path / "second", code=3)
            assert rig.maestro_url in second.stderr
        finally:
            first.send_signal(signal.SIGINT)
            first.wait(timeout=20)


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may open any port"
)
def test_a_forbidden_port_names_the_group(imu_rig: Any, tmp_path: Path) -> None:
    with SimulatedRig(RigConfig.random(1), clock=SystemClock()) as rig:
        target = Path(rig.maestro_url).resolve()
        target.chmod(0)
        done = imu_rig(
            *("calibrate", "--imu", rig.imu_url, "--maestro", rig.maestro_url),
            *("--output", tmp_path / "out"),
            code=3,
        )
    assert "permission" in done.stderr.lower()
