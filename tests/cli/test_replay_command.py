"""`imu-rig replay` as its users start it, with programs that open its ports."""

import json
import os
import pty
import re
import signal
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from program import PROGRAM

from firmware_protocols.layout import load_layout
from imu_rig.clock import SteppedClock
from imu_rig.devices.ports import open_port
from imu_rig.errors import DeviceLost
from imu_rig.recording import TrialWriter

PATIENCE_S = 20.0
PIECES = [(n * 10_000_000, bytes([n]) * 28) for n in range(20)]


@pytest.fixture(scope="module")
def trial(tmp_path_factory) -> Path:
    """A sensor of a built-in layout, one of an own layout, and a servo controller."""
    path = tmp_path_factory.mktemp("replay") / "walk.imu-trial"
    usual = load_layout("mpu9150-28").to_dict()
    with TrialWriter.create(path, {"kind": "trial"}, clock=SteppedClock()) as writer:
        left = writer.add_source("left \x1b[31m shoe", "imu", {"layout": usual})
        own = writer.add_source("own", "imu", {"layout": {**usual, "name": "own-28"}})
        jig = writer.add_source("jig", "servo", {})
        for t_ns, data in PIECES:
            writer.bytes_in(left, t_ns, data)
            writer.bytes_in(own, t_ns, data[::-1])
        writer.bytes_out(jig, 0, b"\xa1")
        writer.bytes_in(jig, 1000, b"\x00\x00")
    return path


@contextmanager
def replaying(*arguments: object, stdin: int | None = None):
    """Start the program; the end of the block waits for it."""
    process = subprocess.Popen(
        [PROGRAM, "replay", *map(str, arguments)],
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,  # so that what is left after a line is left for `communicate`
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def said(process: subprocess.Popen[bytes]) -> dict:
    """Read a line of JSON."""
    return json.loads(process.stdout.readline())


def read_all(port) -> bytes:
    data = bytearray()
    deadline = time.monotonic() + PATIENCE_S
    try:
        while time.monotonic() < deadline:
            data += port.read(0.05)
    except DeviceLost:
        port.close()
        return bytes(data)
    pytest.fail("the port stayed")


def test_it_serves_every_device_and_says_how_to_record_them(trial, tmp_path):
    with replaying(trial, "--json", "--folder", tmp_path, "--fast") as process:
        told = said(process)
        names = ["left \x1b[31m shoe", "own", "jig"]
        assert list(told["ports"]) == names
        assert told["answering"] == ["jig"]
        assert told["layouts"][names[0]] == "mpu9150-28"
        assert load_layout(told["layouts"]["own"]).name == "own-28"
        command = told["record"]
        assert command[:2] == ["imu-rig", "record"]
        assert f"device 1={told['ports'][names[0]]},layout=mpu9150-28" in command
        assert command[-2:] == ["--maestro", told["ports"]["jig"]]
        ports = [open_port(url) for url in told["ports"].values()]
        assert read_all(ports[0]) == b"".join(data for _, data in PIECES)
        assert read_all(ports[1]) == b"".join(data[::-1] for _, data in PIECES)
        ports[2].close()
        assert said(process)["state"] == "ended"
        assert process.wait(PATIENCE_S) == 0
        assert list(tmp_path.iterdir()) == []


def test_steps_are_driven_by_what_is_typed_and_ctrl_c_ends_it(trial):
    """Nothing foreign reaches the terminal meanwhile."""
    source = ["--source", "own", "--source", "left \x1b[31m shoe"]
    master, slave = pty.openpty()
    try:
        with replaying(trial, "--step", "--tcp", *source, stdin=slave) as process:
            begin = process.stdout.readline() + process.stdout.readline()
            ports = [open_port(url) for url in re.findall(r"socket://\S+", begin.decode())]
            got = bytearray()

            def typed(line: bytes, expected: int) -> None:
                os.write(master, line)
                deadline = time.monotonic() + PATIENCE_S
                while len(got) < expected and time.monotonic() < deadline:
                    got.extend(ports[0].read(0.05))
                assert len(got) == expected

            os.set_blocking(process.stderr.fileno(), False)
            deadline = time.monotonic() + PATIENCE_S
            seen = b""
            while b"every port is open" not in seen and time.monotonic() < deadline:
                seen += process.stderr.read() or b""
                time.sleep(0.01)
            os.set_blocking(process.stderr.fileno(), True)
            typed(b"\n", 28)
            typed(b"\n", 56)
            typed(b"0.05\n", 56 + 5 * 28)
            assert ports[0].read(0.2) == b""
            process.send_signal(signal.SIGINT)
            stdout, stderr = process.communicate(timeout=PATIENCE_S)
            assert process.returncode == 130
            assert b"Traceback" not in stderr
            assert b"\x1b" not in begin + stdout + seen + stderr
            assert b"imu-rig record --device" in stdout
            for port in ports:
                port.close()
    finally:
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--speed", 0], "--speed must be above 0"),
        (["--speed", "nan"], "--speed must be above 0"),
        (["--fast", "--step"], "only one of"),
        (["--source", "right"], "has no source 'right'"),
        (["--longest-silence", -1], "no number of seconds"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(inside, trial, arguments, sentence):
    done = inside("replay", trial, *arguments, code=2)
    assert sentence in done.stderr
    assert done.stderr.count("\n") == 1


def test_an_empty_trial_has_nothing_to_replay(inside, tmp_path):
    path = tmp_path / "empty.imu-trial"
    TrialWriter.create(path, {}, clock=SteppedClock()).close()
    done = inside("replay", path, "--json", code=2)
    assert "nothing to replay" in json.loads(done.stdout)["error"]
