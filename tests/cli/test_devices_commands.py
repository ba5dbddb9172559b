"""`imu-rig devices`, `identify` and `doctor` as their users see them."""

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from firmware_protocols.known import load_protocol
from firmware_protocols.layout import load_layout
from imu_rig.devices import survey
from imu_rig.devices.doctor import disk, examine
from imu_rig.devices.doctor.system import Check
from imu_rig.devices.listening import listen
from imu_rig.devices.maestro import MaestroClient
from imu_rig.devices.ports import SeenPort
from simulators.served_devices import ServedDevices

MPU = load_layout("mpu9150-28")
LAB = replace(load_layout("mpu9150-burst-30"), name="lab", header=b"\xeb\x91")


@pytest.fixture
def served() -> Iterator[ServedDevices]:
    with ServedDevices() as devices:
        yield devices


@pytest.fixture(autouse=True)
def no_ports_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey, "seen_ports", list)


def test_the_list_says_what_speaks_and_how_to_record_it(
    inside: Any, served: ServedDevices, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = partial(MaestroClient, timeout_s=0.1)
    monkeypatch.setattr(survey, "MaestroClient", quick)  # for the one that is mute
    imu, lab = served.add("imu", MPU), served.add("lab", LAB, 400.0)
    mute, jig = served.add("mute", MPU), served.add_servos("jig")
    served.silence("mute")
    ports = [option for url in (imu, lab, mute, jig) for option in ("--port", url)]
    shown = inside("devices", *ports, "--probe", "--seconds", 0.3).stdout
    assert "mpu9150-28: " in shown
    assert f"imu-rig record --device imu={imu},layout=mpu9150-28" in shown
    assert "packets of 30 bytes that begin with EB 91" in shown
    assert f"imu-rig devices identify {lab}" in shown
    assert "Maestro's command port" in shown
    assert "resets boards" in shown


def test_the_list_for_programs(inside: Any, served: ServedDevices) -> None:
    imu = served.add("imu", MPU)
    done = inside("devices", "--port", imu, "--seconds", 0.4, "--json")
    (port,) = json.loads(done.stdout)["ports"]
    assert (port["port"], port["state"], port["layout"]) == (imu, "recognized", "mpu9150-28")
    assert port["streams"][""] == pytest.approx(100.0, rel=0.2)
    assert port["record"].startswith("imu-rig record --device ")


def test_names_from_outside_reach_no_terminal_unread(
    inside: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    nasty = SeenPort("/dev/ttyS97", "clear\x1b[2J\x07\u202e it", 0x0403, 0x6001, "A\x1b[1m")
    monkeypatch.setattr(survey, "seen_ports", lambda: [nasty])
    shown = inside("devices", "--seconds", 0.2).stdout
    assert "FTDI adapter, clear" in shown
    assert not {"\x1b", "\x07", "\u202e"} & set(shown)
    assert "There is no port /dev/ttyS97" in " ".join(shown.split())


def test_a_fast_list_opens_nothing(inside: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    ports = [SeenPort("/dev/ttyS97", "x", 0x0403, 0x6001, "A")]
    monkeypatch.setattr(survey, "seen_ports", lambda: ports)
    assert "may not be opened" in inside("devices", "--fast").stdout
    (port,) = json.loads(inside("devices", "--fast", "--json").stdout)["ports"]
    assert (port["vendor"], port["state"], port["may_open"]) == ("0403", "listed", False)


def test_no_ports_are_told_too(inside: Any) -> None:
    assert "No serial port is there now" in inside("devices").stdout
    assert json.loads(inside("devices", "--json").stdout) == {"ports": []}


def test_a_known_device_is_identified(inside: Any, served: ServedDevices) -> None:
    imu = served.add("imu", MPU)
    shown = inside("devices", "identify", imu, "--seconds", 0.3).stdout
    assert "speaks    mpu9150-28" in shown
    assert "record" in shown


def test_an_unknown_device_gets_a_layout_file_that_reads_it(
    inside: Any, served: ServedDevices, tmp_path: Path
) -> None:
    lab, file = served.add("lab", LAB, 400.0), tmp_path / "my lab's.toml"
    shown = inside("devices", "identify", lab, "--seconds", 0.3, "--write", file).stdout
    assert "crc16-ccitt-false" in shown
    assert "counter u8" in shown
    rows = [line for line in shown.splitlines() if line.strip().startswith("EB 91")]
    assert len(rows) == 10
    drafted = load_protocol(file)
    data = listen(lab, 0.2).data
    assert len(drafted.decoder().feed(data)[""]) >= 0.95 * len(data) / 30 - 2
    before = file.read_bytes()
    again = inside("devices", "identify", lab, "--seconds", 0.5, "--write", file, code=2)
    assert "exists" in again.stderr
    assert file.read_bytes() == before
    known = inside("devices", "identify", lab, "--seconds", 0.15, "--layouts", tmp_path, "--json")
    assert json.loads(known.stdout)["layout"] == str(file)


def test_findings_for_programs(inside: Any, served: ServedDevices) -> None:
    lab = served.add("lab", LAB, 400.0)
    done = inside("devices", "identify", lab, "--seconds", 0.5, "--json")
    (packets,) = json.loads(done.stdout)["packets"]
    assert packets["length"] == 30
    assert packets["rate_hz"] == pytest.approx(400.0, rel=0.1)
    sums = [f for f in packets["findings"] if "checksum" in f["meaning"]]
    assert [(f["first"], f["bytes"], f["sureness"]) for f in sums] == [(28, 2, "sure")]


def test_noise_and_silence_are_failures_with_a_reason(inside: Any, served: ServedDevices) -> None:
    noisy, mute = served.add("noisy", MPU), served.add("mute", MPU)
    served.garbage("noisy")
    served.silence("mute")
    done = inside("devices", "identify", noisy, "--seconds", 0.2, code=4)
    assert "without any packet known" in done.stderr
    done = inside("devices", "identify", mute, "--seconds", 0.15, "--json", code=4)
    told = json.loads(done.stdout)
    assert told["state"] == "silent"
    assert "sends nothing" in told["error"]
    draft = inside("devices", "identify", mute, "-s", 0.15, "--write", "x.toml", code=2)
    assert "No layout file was written" in draft.stderr


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["identify", "/no/such/port"], 3, "There is no port"),
        (["identify", ""], 3, "No port is named"),
        (["identify", "x", "--seconds", "0"], 2, "--seconds"),
        (["--seconds", "nan"], 2, "--seconds"),
        (["identify", "x", "--baud", "3"], 2, "baud"),
        (["--layout", "no-such-layout"], 2, "no such layout file"),
        (["--layouts", "/no/such/folder"], 2, "no folder"),
        (["identify", "x", "--write", "/no/such/folder/x.toml"], 2, "folder"),
    ],
)
def test_wrong_options_are_told(inside: Any, options: list[str], code: int, words: str) -> None:
    assert words in inside("devices", *options, code=code).stderr


def test_what_was_typed_comes_back_without_escapes(inside: Any) -> None:
    assert "\x1b" not in inside("devices", "identify", "/no/a\x1b[31mb", code=3).stderr


def test_bad_files_of_a_folder_are_told_and_left(inside: Any, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("name = 3\x1b")
    done = inside("devices", "--layouts", tmp_path)
    assert "not looked for" in done.stderr
    assert "\x1b" not in done.stderr


# --- doctor ---------------------------------------------------------------------------------------


def test_the_doctor_looks_and_says(
    inside: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk, "WRITTEN_BYTES", 1 << 16)
    done = inside("doctor", "--output", tmp_path, "--json", code=_doctors_code(inside, tmp_path))
    told = json.loads(done.stdout)
    assert told["state"] in ("ok", "warn", "bad")
    assert {"Python", "disk", "clock"} <= {check["about"] for check in told["checks"]}
    assert list(tmp_path.iterdir()) == []


def _doctors_code(inside: Any, folder: Path) -> int:
    """What this machine deserves: 9 only if something is bad."""
    return 9 if any(c.state == "bad" for c in examine.examine(folder)) else 0


@pytest.mark.parametrize(("state", "code"), [("ok", 0), ("warn", 0), ("bad", 9)])
def test_the_exit_code_is_that_of_the_worst(
    inside: Any, monkeypatch: pytest.MonkeyPatch, state: str, code: int
) -> None:
    checks = [
        Check("port", state, "it is so\x1b[2J.", "Do this:", ("sudo " + "long " * 40 + "command",)),  # type: ignore[arg-type]
        Check("disk", "ok", "fine."),
    ]
    monkeypatch.setattr(examine, "examine", lambda *_, **__: checks)
    shown = inside("doctor", code=code).stdout
    assert "sudo " + "long " * 40 + "command" in shown  # commands are never broken
    assert "\x1b" not in shown
    assert json.loads(inside("doctor", "--json", code=code).stdout)["state"] == state
