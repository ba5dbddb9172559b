"""`imu-rig monitor` with simulated devices on real ports, and its screen on every terminal."""

import io
import json
import re
from dataclasses import replace

import pytest
from rich.cells import cell_len
from rich.console import Console
from rich.text import Text
from terminal import Terminal

from imu_rig.cli import view
from imu_rig.cli.monitor_screen import plain_line, plain_table, screen
from imu_rig.clock import SystemClock
from imu_rig.errors import StorageError
from imu_rig.monitor.quantities import Quantity
from imu_rig.monitor.status import MonitorStatus
from imu_rig.recorder.status import DeviceStatus
from simulators.served_devices import ServedDevices

ACCEL, GYRO = Quantity("accel", "g", 1.0, 3), Quantity("gyro", "deg/s", 1.0, 3)
LEFT = DeviceStatus("left shoe", "/dev/a", "live", rate_hz=100.0, packets=420, lag_s=0.004)
FOOT = DeviceStatus("receiver/foot", "/dev/b", "live", rate_hz=50.0, packets=300)
WAIST = DeviceStatus(
    "receiver/waist",
    "/dev/b",
    "silent",
    packets=100,
    lost=7,
    corrupt=3,
    problem="receiver/waist sends nothing any more while foot of the same port goes on.",
)
SICK = DeviceStatus(
    "\x1b[31madis", "/dev/c", "live", rate_hz=273.07, faults=("sensor over range", "supply low")
)
STUCK = DeviceStatus("気圧計", "/dev/d", "live", rate_hz=10.0, packets=50, stuck=True)
STATUS = MonitorStatus(
    72.4,
    None,
    (LEFT, replace(FOOT, name="receiver", streams=(FOOT, WAIST)), SICK, STUCK),
    {"left shoe": ((ACCEL, (0.012, -0.034, float("nan"))), (GYRO, (0.1, -1000.2, 12.0)))},
)


def drawn(status, width, height):
    console = Console(file=io.StringIO(), width=width, height=height, force_terminal=True)
    with console.capture() as capture:
        console.print(screen(status, width, height))
    flat = Console(file=io.StringIO(), width=400, color_system=None)
    with flat.capture() as plain:
        flat.print(Text.from_ansi(capture.get().rstrip()))
    return plain.get().splitlines()


def test_losses_are_told_in_the_narrowest_window():
    lines = drawn(STATUS, 40, 24)
    assert max(map(cell_len, lines)) <= 40
    assert any(re.search(r"^receiver.* silent .* 7 \(6\.54 %\)$", line) for line in lines)


def test_numbers_without_sense_stay_short():
    mad = {"left shoe": ((ACCEL, (3e38, -3e38, float("inf"))),)}
    assert "+3e+38  -3e+38       – g" in "\n".join(plain_table(replace(STATUS, readings=mad)))


@pytest.mark.parametrize("width", [60, 80, 100, 120])
@pytest.mark.parametrize("height", [12, 24, 50])
def test_the_screen_fits_and_tells_what_is_wrong_first(width, height):
    lines = drawn(STATUS, width, height)
    assert len(lines) <= height
    assert max(map(cell_len, lines)) <= width
    text = "\n".join(lines)
    assert "without receiver/waist" in text
    row = next(line for line in lines if line.startswith("receiver/waist"))
    assert "silent" in row
    if height >= 24:
        assert re.search(r"left shoe +live +100\.0 +0 ", text)
        assert "! sensor over range, supply low" in text
        assert re.search(r"気圧計 +stuck", text)
    if height == 50:
        assert "+0.012  -0.034       – g" in text
        assert "-1000.2" in text


def test_many_devices_leave_room_and_those_in_trouble_are_shown():
    many = tuple(replace(LEFT, name=f"shoe {number}") for number in range(40))
    gone = replace(LEFT, name="the lost one", state="lost", problem="/dev/x has gone.")
    lines = drawn(MonitorStatus(1.0, None, (*many, gone), {}), 80, 24)
    assert len(lines) <= 24
    assert any(line.startswith("the lost one") for line in lines)
    assert any("more, " in line and "of them live" in line for line in lines)


def test_a_log_names_what_is_not_well():
    line = plain_line(STATUS)
    assert "receiver/waist silent" in line
    assert "気圧計 stuck" in line
    assert "sensor over range" in line
    assert "\x1b" not in line + "".join(plain_table(STATUS))


def test_json_lines_end_with_the_result(inside, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(view, "JSON_LINE_S", 0.3)
    done = inside("monitor", "--simulate", "two-imu", "--seconds", 0.8, "--json")
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert {next(iter(line)) for line in lines[:-1]} == {"status"}
    result = lines[-1]["result"]
    assert result["exit_code"] == 0
    foot, waist = result["devices"][0]["streams"]
    assert (foot["name"], waist["name"]) == ("two-imu/foot", "two-imu/waist")
    assert foot["packets"] > 10
    accel = result["readings"]["two-imu/foot"]["accel"]
    assert accel["unit"] == "g"
    assert len(accel["value"]) == 3
    assert list(tmp_path.iterdir()) == []


def test_a_picture_is_saved_without_a_screen_and_never_over_another(inside, tmp_path):
    picture = tmp_path / "now.png"
    told = inside("monitor", "--simulate", 1, "--seconds", 0.5, "--save", picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(picture) in told.stdout
    assert "never overwritten" in inside("monitor", "-d", "x", "--save", picture, code=2).stderr


def test_what_came_is_told_and_drawn_also_where_something_is_missing(inside, tmp_path):
    picture = tmp_path / "now.png"
    with ServedDevices(SystemClock()) as served:
        port = served.add("receiver", "two-imu")
        served.silence("receiver", stream="waist")
        options = ("-d", f"receiver={port},layout=two-imu", "-t", 1.5, "--save", picture, "--json")
        done = inside("monitor", *options, code=4)
    result = json.loads(done.stdout.splitlines()[-1])["result"]
    assert (result["exit_code"], result["picture"]) == (4, str(picture))
    foot, waist = result["devices"][0]["streams"]
    assert foot["packets"] > 0 == waist["packets"]
    assert foot["supply"] == {}
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "receiver/waist" in done.stderr


def test_a_picture_that_cannot_be_written_takes_no_figures(inside, tmp_path, monkeypatch):
    def full(*args, **more):
        raise StorageError("the disk is full")

    monkeypatch.setattr("imu_rig.files.write_whole", full)
    done = inside("monitor", "--simulate", 1, "-t", 0.4, "--save", tmp_path / "a.png", code=5)
    assert "live" in done.stdout
    assert "the disk is full" in done.stderr


@pytest.mark.parametrize(
    ("options", "code", "named"),
    [
        ([], 2, "Nothing to watch"),
        (["--simulate", "1", "--save", "a.txt"], 2, ".png"),
        (["--simulate", "1", "--save", "/none/a.png"], 2, "/none"),
        (["--simulate", "1", "--seconds", "-1"], 2, "--seconds"),
        (["--simulate", "1", "--window", "0"], 2, "--window"),
        (["--simulate", "0"], 2, "1 to 16"),
        (["--simulate", "none-such"], 2, "none-such"),
        (["--simulate", "1", "-d", "/dev/x"], 2, "not both"),
        (["-d", "left=/dev/none,layout=none"], 2, "'left'"),
        (["-d", "left=/dev/none", "--seconds", "0.2"], 3, "/dev/none"),
    ],
)
def test_what_cannot_be_watched_is_refused(inside, options, code, named):
    assert named in inside("monitor", *options, code=code).stderr


def test_a_protocol_that_nobody_simulates_is_refused(inside, tmp_path):
    file = tmp_path / "odd.toml"
    file.write_text(
        'name = "odd"\ntitle = "Odd"\nkind = "mavlink"\nmessage = "HIGHRES_IMU"\nrate_hz = 50.0\n'
    )
    told = inside("monitor", "--simulate", file, "--seconds", 0.1, code=2).stderr
    assert "no simulated device speaks odd" in told


def test_a_plot_without_a_screen_is_refused(inside, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    told = inside("monitor", "--simulate", "1", "--plot", code=2).stderr
    assert "--save FILE.png" in told


def test_ctrl_c_ends_it_cleanly_on_a_terminal(tmp_path):
    watched = Terminal("monitor", "--simulate", 1, cwd=tmp_path)
    try:
        watched.read_until("live")
        while watched.process.poll() is None:  # some press it until they see that it has ended
            watched.press("\x03")
            watched.read(0.03)
        assert watched.wait() == 0
    finally:
        watched.close()
    assert "Traceback" not in watched.text
