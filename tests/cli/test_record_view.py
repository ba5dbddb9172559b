"""The live table of a recording: what it tells, on terminals of every size."""

import io
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from imu_rig.cli.record_json import json_line, status_json
from imu_rig.cli.record_screen import plain_line, screen, troubles
from imu_rig.recorder.status import DeviceStatus, RecorderStatus

LEFT = DeviceStatus("left shoe", "/dev/a", "live", rate_hz=100.02, packets=4240, age_s=0.01)
RIGHT = DeviceStatus(
    "right shoe with a name that is longer than any table",
    "/dev/b",
    "lost",
    rate_hz=100.0,
    packets=3980,
    lost=120,
    corrupt=14,
    reconnects=2,
    age_s=12.3,
    supply=(("battery", 3.58, "V"),),
    problem="/dev/b has gone (read failed): the device was unplugged or switched off.",
)
WAITING = DeviceStatus("気圧計", "/dev/c", "waiting", problem="There is no port /dev/c.")
STATUS = RecorderStatus(
    path=Path("recordings/2026-11-22_S01/trial_003.imu-trial"),
    state="recording",
    elapsed_s=3742.4,
    recorded_s=3730.0,
    planned_s=7200.0,
    file_bytes=4_210_334,
    disk_free_bytes=118_300_000_000,
    disk_left_s=41 * 86_400.0,
    markers=3,
    devices=(LEFT, RIGHT, WAITING),
)


def drawn(status: RecorderStatus, width: int = 80, height: int = 24) -> str:
    console = Console(file=io.StringIO(), width=width, height=height, force_terminal=True)
    with console.capture() as capture:
        console.print(screen(status, width, height, keys=True, marker="turn"))
    return capture.get()


def plain(text: str) -> list[str]:
    console = Console(file=io.StringIO(), width=400, color_system=None)
    with console.capture() as capture:
        console.print(Text.from_ansi(text.rstrip()))
    return capture.get().splitlines()


def row(status: RecorderStatus, name: str, width: int = 120) -> str:
    return next(line for line in plain(drawn(status, width)) if line.startswith(name))


@pytest.mark.parametrize("width", [30, 60, 80, 120, 200])
@pytest.mark.parametrize("count", [1, 3, 8, 64])
def test_it_fits_every_terminal(width, count):
    devices = tuple(
        replace((RIGHT, LEFT, WAITING)[i % 3], name=f"{i} of many devices") for i in range(count)
    )
    lines = plain(drawn(replace(STATUS, devices=devices), width, 24))
    assert max(map(cell_len, lines)) <= width
    if width >= 80:
        assert len(lines) <= 24
        assert lines[-1].startswith("space: marker")


def test_a_required_device_is_red_until_it_is_heard():
    required, optional = drawn(STATUS), replace(WAITING, required=False)
    assert "\x1b[1;31m気圧計" in required
    assert "\x1b[33m気圧計" in drawn(replace(STATUS, devices=(optional,)))
    assert "\x1b[31mright shoe" in required
    assert "never" in row(STATUS, "気圧計")


def test_the_figures_of_a_device_stand_in_its_row():
    text = row(STATUS, "right shoe")
    for said in ("lost", "120 (2.93 %)", "14", "3.58 V", "12 s"):
        assert said in text
    assert "100" not in text  # the rate of one that sends nothing is none
    assert "100.0" in row(STATUS, "left shoe")


def test_what_is_wrong_is_said_with_whose_it_is():
    text = " ".join(" ".join(plain(drawn(STATUS, 120))).split())
    assert "than any table: /dev/b has gone (read failed)" in text
    assert "気圧計: There is no port /dev/c." in text


def test_a_port_that_is_called_like_its_device_does_not_name_it():
    for problem, said in (
        ("There is no port /dev/waist.", "waist: There is no port /dev/waist."),
        ("waist on /dev/a sends nothing.", "waist on /dev/a sends nothing."),
    ):
        waist = DeviceStatus("waist/accel", "/dev/a", "waiting", problem=problem)
        [(words, _)] = troubles([waist])
        assert words.removeprefix("waist/accel: ") == said.removeprefix("waist: ")
        assert words.startswith("waist")


def test_a_stream_has_a_row_and_its_faults_and_stuck_sensor_a_sentence():
    foot = replace(LEFT, name="receiver/foot", faults=("supply low",), stuck=True)
    waist = replace(LEFT, name="receiver/waist", state="silent")
    whole = replace(LEFT, name="receiver", state="silent", streams=(foot, waist))
    status = replace(STATUS, devices=(whole,))
    text = " ".join(" ".join(plain(drawn(status, 120))).split())
    assert "RECORDING without receiver/waist" in text
    assert "receiver/foot live" in text
    assert "receiver/waist silent" in text
    assert "receiver/foot reports: supply low." in text
    assert "its sensor is stuck" in text
    assert "receiver/foot: supply low" in plain_line(status)
    told = json.loads(json_line("status", status_json(status)))["status"]["devices"][0]
    assert [s["name"] for s in told["streams"]] == ["receiver/foot", "receiver/waist"]
    assert told["supply"] == told["streams"][0]["supply"] == {}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"disk_left_s": 200.0, "planned_s": None}, "almost full"),
        ({"disk_left_s": 3000.0}, "full before the planned end"),
        ({"queue": 0.63, "queue_s": 45.0}, "queue 63 % of 45 s"),
        ({"unwritten_records": 12}, "12 not written"),
        ({"problem": "The jig is stuck."}, "! The jig is stuck."),
        ({"state": "waiting"}, "WAITING for 1 device "),
        ({}, "RECORDING without right shoe"),
        ({"devices": (replace(RIGHT, required=False),)}, "RECORDING 1:02:22"),
        ({}, "1:02:22 with all devices 1:02:10 of 2:00:00"),
        ({"markers": 3}, "markers 3 last: turn"),
    ],
)
def test_the_trial_and_the_disk_are_told(changes, said):
    text = " ".join(" ".join(plain(drawn(replace(STATUS, **changes), 100))).split())
    assert said in text


def test_nothing_of_a_name_reaches_the_terminal_as_it_is():
    bad = replace(LEFT, name="\x1b]0;owned\x07[bold]x", problem="\x1b[2J[red]")
    status = replace(STATUS, devices=(replace(bad, state="lost"),), path=Path("\x1b[2J.x"))
    text = drawn(status)
    assert "\x07" not in text
    assert "\x1b[2J" not in text
    assert "\x1b]" not in text
    assert "[bold]x" in text
    assert plain_line(status).isprintable()


def test_devices_that_are_not_live_find_room_first():
    many = tuple(replace(LEFT, name=f"device {i}") for i in range(40))
    text = "\n".join(plain(drawn(replace(STATUS, devices=(*many, RIGHT, WAITING)))))
    assert "right shoe" in text
    assert "気圧計" in text
    assert "more, " in text


def test_a_line_for_a_log_and_values_for_a_program():
    line = plain_line(STATUS)
    assert line.startswith("1:02:22 recording; 1 of 3 live, 100 packets/s, 120 lost; 4.2 MB;")
    assert line.endswith(" lost, 気圧計 waiting")
    values = status_json(STATUS)
    assert values["devices"][1]["supply"] == {"battery": [3.58, "V"]}
    assert values["devices"][1]["loss"] == pytest.approx(120 / 4100)


def test_a_reading_that_is_no_number_is_null_for_a_program():
    flat = replace(RIGHT, supply=(("battery", math.nan, "V"),))
    line = json_line("status", status_json(replace(STATUS, disk_left_s=math.inf, devices=(flat,))))
    status = json.loads(line, parse_constant=pytest.fail)["status"]
    assert status["devices"][0]["supply"] == {"battery": [None, "V"]}
    assert status["disk_left_s"] is None
