"""`imu-rig record` with simulated devices on real ports: what is kept, told and refused."""

import contextlib
import io
import json
import os
import re
import shutil
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from firmware_protocols.layout import load_layout
from imu_rig.cli.keys import Keys
from imu_rig.cli.record_setup import Options, device_from, duration_s, setup_from
from imu_rig.cli.record_summary import Times, shortfalls, summary_lines, times_of
from imu_rig.cli.unheld import last_words
from imu_rig.clock import SteppedClock
from imu_rig.errors import InputError
from imu_rig.recorder.engine import RecordingOutcome
from imu_rig.recorder.setup import load_setup
from imu_rig.recorder.status import DeviceStatus
from imu_rig.recording.latency import Latency
from imu_rig.recording.reader import open_trial
from imu_rig.recording.writer import TrialWriter
from imu_rig.stopping import StopRequest
from simulators.device_packets import DevicePackets
from simulators.served_devices import ServedDevices

SETUP = """
subject = "S01"
trial = "walk"
duration_s = 120

[[devices]]
name = "left shoe"
port = "/dev/ttyUSB0"

[[devices]]
name = "barometer"
port = "/dev/ttyUSB1"
layout = "baro-16"
baud = 9600
required = false
"""


@pytest.fixture
def lines(monkeypatch):
    """Feed lines to standard input, which is no terminal."""
    read, write = os.pipe()
    with os.fdopen(read) as stdin, os.fdopen(write, "w") as writer:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield writer


def files_in(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def test_two_devices_are_recorded_and_told_to_programs(inside, tmp_path, lines):
    lines.write("start\n\n\x1b[31mred\x1b[0m\nno line end")
    lines.flush()
    done = inside(
        *("record", "--simulate", 2, "--duration", 1.1, "--json", "--wait", 20),
        *("--subject", "S/01", "--trial", "../walk", "--note", "slow"),
        cwd=tmp_path,
    )
    *statuses, last = [json.loads(line) for line in done.stdout.splitlines()]
    assert statuses
    assert all(len(line["status"]["devices"]) == 2 for line in statuses)
    result = last["result"]
    assert result["complete"]
    assert result["exit_code"] == 0
    path = tmp_path / result["path"]
    assert path.parent.name.endswith("_S-01")
    assert path.name == "walk_001.imu-trial"
    trial = open_trial(path)
    assert trial.config["subject"] == "S/01"
    assert trial.config["note"] == "slow"
    assert trial.ended == "complete"
    # the end of the input ends nothing, and half a line is not yet one
    assert [m.label for m in trial.markers] == ["start", "marker 2", "[31mred [0m"]
    for device in result["devices"]:
        assert device["lost"] == 0
        assert len(trial.samples(device["name"]).t) == device["packets"] > 100


def test_lines_that_come_at_once_are_markers_of_that_moment(monkeypatch):
    """More of them than a file should hold are left out, and counted."""
    read, write = os.pipe()
    marks, said = [], []
    with os.fdopen(read) as stdin, os.fdopen(write, "w") as writer:
        monkeypatch.setattr(sys, "stdin", stdin)
        monkeypatch.setattr("imu_rig.cli.keys.MOST_AT_ONCE", 3000)
        monkeypatch.setattr("imu_rig.cli.keys.MOST_PER_S", 0)
        with Keys(lambda label: marks.append(time.monotonic()), pytest.fail, said.append):
            writer.write("step\n" * 3004)
            writer.close()
            deadline = time.monotonic() + 30
            while len(marks) < 3000 and time.monotonic() < deadline:
                time.sleep(0.01)
            time.sleep(0.05)
    assert len(marks) == 3000
    assert "3004" not in said[0]
    assert said[1].startswith("4 markers were not recorded")


def test_last_words_do_not_wait_for_a_reader_that_has_stopped():
    read, write = os.pipe()
    os.set_blocking(write, False)
    with os.fdopen(read, "rb") as reader, os.fdopen(write, "w") as stream:
        with contextlib.suppress(BlockingIOError):
            while os.write(write, bytes(65536)):
                pass
        os.set_blocking(write, True)
        assert not last_words(stream, ["result"], 0.05)
        data = b""
        while not data.endswith(b"result\n"):
            data += reader.read1(65536)
        assert last_words(stream, ["more"])


class Gone(io.StringIO):
    """A stream whose reader has gone."""

    def write(self, text: str) -> int:
        raise BrokenPipeError


def test_a_trial_never_takes_the_name_of_another_and_needs_no_reader(inside, tmp_path, monkeypatch):
    arguments = ("record", "--simulate", 1, "--duration", 0.2, "--session", "s")
    inside(*arguments, cwd=tmp_path)
    monkeypatch.setattr(
        "imu_rig.cli.record.last_words", lambda stream, lines: last_words(Gone(), lines)
    )
    inside(*arguments, cwd=tmp_path)
    assert files_in(tmp_path / "recordings") == ["s/trial_001.imu-trial", "s/trial_002.imu-trial"]


def unplug_after(served: ServedDevices, name: str, packets: int) -> None:
    deadline = time.monotonic() + 30
    while served.sent(name) < packets and time.monotonic() < deadline:
        time.sleep(0.02)
    served.unplug(name)


def test_a_device_that_vanished_makes_the_recording_incomplete(inside, tmp_path):
    with ServedDevices() as served:
        left = served.add("left", "mpu9150-28", seed=1)
        right = served.add("right", "mpu9150-28", seed=2)
        pull = threading.Thread(target=unplug_after, args=(served, "right", 80))
        pull.start()
        done = inside(
            *("record", "--device", f"left={left}", "-d", f"right={right}", "--duration", 2),
            *("--output", tmp_path),
            code=8,
        )
        pull.join()
    assert "right was lost at the end" in done.stderr
    assert "left" not in done.stderr.split("imu-rig: ")[-1]
    (file,) = tmp_path.rglob("*.imu-trial")
    trial = open_trial(file)
    assert trial.ended == "complete"
    assert [m.reason for m in trial.missing("right")] == ["unplugged"]
    assert trial.missing("left") == []
    assert "imu-rig info" in done.stdout
    assert done.stdout.count("± ") == 2  # both were heard, so both have a time


def test_a_port_that_is_missing_is_told_and_leaves_nothing(inside, tmp_path):
    port = tmp_path / "no-port"
    done = inside("record", "-d", port, "--wait", 0.3, "--output", tmp_path / "out", code=3)
    assert f"There is no port {port}" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_device_that_sends_garbage_is_told_with_what_to_check(inside, tmp_path):
    with ServedDevices() as served:
        url = served.add("noisy", "mpu9150-28")
        served.garbage("noisy")
        done = inside("record", "-d", f"noisy={url}", "--wait", 1.8, "--output", tmp_path, code=4)
    assert "noisy" in done.stderr
    assert "layout" in done.stderr
    (file,) = tmp_path.rglob("*.imu-trial")  # what came is kept all the same
    assert f"kept in {file}" in done.stderr
    assert len(open_trial(file).wire("noisy").data) > 1000


def test_a_full_disk_is_told_before_anything_begins(inside, tmp_path, monkeypatch):
    full = shutil.disk_usage(tmp_path)._replace(free=50_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: full)
    done = inside("record", "--simulate", 1, "--output", tmp_path / "out", code=5)
    assert "50 MB left" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "Nothing to record"),
        (["--simulate", "17"], "1 to 16"),
        (["--simulate", "1", "-d", "/dev/x"], "either --simulate"),
        (["-d", "/dev/x", "--layout", "nonsense"], "nonsense"),
        (["-d", "/dev/x", "--certificate", "no.json"], "no.json"),
        (["-d", "/dev/x", "--max-loss", "101"], "--max-loss"),
        (["-d", "/dev/x", "--wait", "nan"], "--wait"),
        (["-d", "/dev/x", "--session", "///"], "letter or a digit"),
        (["-d", "/dev/x", "--output", ""], "An empty name"),
        (["-d", "/dev/x", "--output", "file"], "file is no folder"),
        (["-d", "/dev/x", "--output", "x" * 300], "name another --output"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(inside, tmp_path, arguments, said):
    (tmp_path / "file").touch()
    done = inside("record", *arguments, code=2, cwd=tmp_path)
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (Options(devices=["a=/dev/x", "b=/dev/x"]), "the port /dev/x is there twice"),
        (Options(devices=["a=/dev/x", "a=/dev/y"]), "names 'a' twice"),
        (Options(devices=["a=/dev/x,speed=3"]), "'speed=3' is not understood"),
        (Options(devices=["a="]), "has no port"),
        (Options(devices=["=/dev/x"]), "has no name"),
        (Options(devices=["a=/dev/x,baud=fast"]), "baud"),
        (Options(devices=["jig=/dev/x"]), "kept for the jig"),
        (Options(devices=["/dev/x"], jig="paper-jig"), "--maestro"),
        (Options(devices=["/dev/x", "/dev/y"], certificate=Path("c.json")), "there are 2"),
        (Options(devices=["/dev/x"], duration="soon"), "no duration"),
        (Options(devices=["/dev/x"], duration="0"), "between 0 s and 30 days"),
        (Options(devices=["/dev/x"], subject="x" * 300), "subject"),
        (Options(devices=["/dev/x"], setup=Path("no.toml")), "no.toml"),
    ],
)
def test_options_that_contradict_themselves_are_told(options, said):
    with pytest.raises(InputError) as refused:
        setup_from(options)
    assert said in str(refused.value)
    assert str(refused.value).isprintable()


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("60", 60),
        ("1.5", 1.5),
        ("90 s", 90),
        ("2min", 120),
        ("2 minutes", 120),
        ("1h30min", 5400),
        ("1 h 30 min 5 s", 5405),
        ("2:30", 150),
        ("1:02:03", 3723),
    ],
)
def test_durations_as_people_write_them(text, seconds):
    assert duration_s(text) == seconds


@pytest.mark.parametrize("text", ["", "two", "5 5", "1h30", "-3", "1:75", "1e3", "inf", "3 d", "s"])
def test_other_durations_are_refused(text):
    with pytest.raises(InputError, match="no duration"):
        duration_s(text)


def test_a_device_is_a_port_or_a_name_and_a_port():
    plain = device_from("/dev/ttyUSB0")
    assert (plain.name, plain.port, plain.required) == ("imu", "/dev/ttyUSB0", True)
    assert device_from("COM5", {"imu", "imu2"}).name == "imu3"
    assert device_from("rfc2217://host:1?x=1").port == "rfc2217://host:1?x=1"
    assert device_from("/dev/a=b").port == "/dev/a=b"
    named = device_from(
        "left shoe = socket://127.0.0.1:5000, layout=baro-16, baud=9600, optional, "
        "certificate=c.json"
    )
    assert named.name == "left shoe"
    assert named.port == "socket://127.0.0.1:5000"
    assert (named.layout, named.baud, named.required) == ("baro-16", 9600, False)
    assert named.certificate == Path("c.json")
    several = device_from(
        "r=/dev/ttyUSB0,layout=two-imu,baud=460800,optional=waist,certificate.foot=f.json,"
        "certificate.waist=w.json"
    )
    assert (several.layout, several.baud, several.required) == ("two-imu", 460_800, True)
    assert several.optional_streams == ("waist",)
    assert several.certificates == {"foot": Path("f.json"), "waist": Path("w.json")}
    assert set(several.protocol().streams) == {"foot", "waist"}


def test_options_replace_and_add_to_a_setup_file(tmp_path):
    file = tmp_path / "setup.toml"
    file.write_text(SETUP)
    setup = setup_from(
        Options(
            setup=file,
            devices=["left shoe=/dev/ttyUSB7", "/dev/ttyUSB8"],
            layout="mpu9150-burst-30",
            subject="S02",
            duration="3min",
            maestro="/dev/ttyACM0",
        )
    )
    assert [(d.name, d.port, d.layout) for d in setup.devices] == [
        ("left shoe", "/dev/ttyUSB7", "mpu9150-burst-30"),
        ("barometer", "/dev/ttyUSB1", "baro-16"),
        ("imu", "/dev/ttyUSB8", "mpu9150-burst-30"),
    ]
    assert (setup.subject, setup.trial, setup.duration_s) == ("S02", "walk", 180.0)
    assert setup.jig is not None
    assert setup.jig.maestro == "/dev/ttyACM0"


GOOD = DeviceStatus("left", "/dev/a", "live", packets=990, lost=10)
OUTCOME = RecordingOutcome(
    path=Path("x"),
    reason="complete",
    elapsed_s=10.0,
    recorded_s=10.0,
    file_bytes=1000,
    unwritten_records=0,
    markers=0,
    devices=(GOOD,),
    latency=Latency(1000, 0.001, 0.002, 0.003),
)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, []),
        ({"lost": 60}, ["left lost 60"]),
        ({"state": "silent"}, ["left was silent at the end"]),
        ({"packets": 0, "lost": 0, "state": "waiting"}, ["left was never heard"]),
        ({"packets": 0, "lost": 0, "state": "waiting", "required": False}, []),
        ({"lost": 60, "state": "lost"}, ["left was lost", "left lost 60"]),
    ],
)
def test_what_a_recording_falls_short_of(changes, said):
    outcome = replace(OUTCOME, devices=(replace(GOOD, **changes),))
    found = shortfalls(outcome, 0.05)
    assert len(found) == len(said)
    assert all(sentence.startswith(start) for sentence, start in zip(found, said, strict=True))


def test_a_disk_that_was_too_slow_and_a_jig_not_parked_are_told():
    found = shortfalls(replace(OUTCOME, unwritten_records=7, problem="The jig ..."), 0.05)
    assert ["7 records" in found[0], found[1]] == [True, "The jig ..."]


def test_times_that_cannot_be_right_make_a_recording_incomplete():
    times = Times({"left": 0.0004}, {"left": "the clocks disagree"})
    assert shortfalls(OUTCOME, 0.05, times) == ["left: the clocks disagree."]


@pytest.mark.parametrize(("seconds", "said"), [(4, "its times are known to"), (40, "disagree by")])
def test_a_clock_that_is_wrong_by_half_is_told_after_any_length(tmp_path, seconds, said):
    path, clock = tmp_path / "half.imu-trial", SteppedClock()
    layout = load_layout("mpu9150-28")
    packets = DevicePackets(layout, 100.0, 1)
    with TrialWriter.create(path, {"kind": "trial"}, clock=clock) as trial:
        source = trial.add_source("left", "imu", {"layout": layout.to_dict()})
        for number in range(10 * seconds):
            clock.advance(0.1)  # and 0.05 s by the device's clock
            trial.bytes_in(source, clock.now_ns(), packets.make(5 * number, 5))
    times = times_of(replace(OUTCOME, path=path), StopRequest())
    (sentence,) = shortfalls(OUTCOME, 0.05, times)
    assert said in sentence
    hurried = StopRequest()
    hurried.make("Stopped by SIGTERM.", brief=True)
    assert times_of(replace(OUTCOME, path=path), hurried) == Times()


def test_the_summary_fits_a_terminal_and_says_who_was_missing():
    """It does with long names, losses in all, and without having read the times."""
    name = "a right shoe with a name that is long"
    gone = replace(GOOD, name=name, state="lost", packets=10_000_000, lost=9_000_000, gaps=999)
    outcome = replace(OUTCOME, devices=(GOOD, gone))
    for times in (Times(), Times({"left": 4.04e-4, name: 0.0999})):
        lines = summary_lines(outcome, times)
        assert max(map(len, lines)) <= 80
        assert any(line.endswith(": lost at the end") for line in lines)
    assert lines[4].endswith(" ± 0.40 ms")


def test_streams_are_told_one_by_one_and_what_a_device_reported_too():
    foot = replace(GOOD, name="receiver/foot", lost=0)
    waist = replace(GOOD, name="receiver/waist", lost=60, fault_counts=(("supply \x1b[31mlow", 3),))
    whole = replace(GOOD, name="receiver", lost=60, streams=(foot, waist))
    outcome = replace(OUTCOME, devices=(whole,))
    lines = summary_lines(outcome)
    assert [line.split()[0] for line in lines[4:6]] == ["receiver/foot", "receiver/waist"]
    assert any("receiver/waist reported: supply" in line for line in lines)
    assert "\x1b" not in "".join(lines)
    assert [s.split(" lost")[0] for s in shortfalls(outcome, 0.05)] == ["receiver/waist"]


def test_a_port_that_is_not_there_is_told_once_however_many_streams_it_has():
    streams = tuple(
        DeviceStatus(f"receiver/{name}", "/dev/r", "waiting", problem="There is no port /dev/r.")
        for name in ("foot", "waist")
    )
    whole = DeviceStatus(
        "receiver", "/dev/r", "waiting", problem="There is no port /dev/r.", streams=streams
    )
    found = shortfalls(replace(OUTCOME, devices=(whole,)), 0.05)
    assert found == ["receiver was never heard: There is no port /dev/r."]


def test_the_example_of_a_setup_file_is_one(inside, tmp_path):
    example = Path(__file__).parents[2] / "jig_scripts" / "trials" / "two-shoes.toml"
    setup = load_setup(example)
    assert [d.name for d in setup.devices] == ["left shoe", "right shoe", "barometer"]
    assert [d.required for d in setup.devices] == [True, True, False]
    assert all(d.protocol().longest for d in setup.devices)
    whole = tmp_path / "whole.toml"  # what is only suggested there can be used too
    lines = example.read_text().splitlines()
    suggested = [line[2:] if re.match(r"# (\[|\w+ = )", line) else line for line in lines]
    whole.write_text("\n".join(suggested))
    setup = load_setup(whole)
    assert setup.devices[0].certificate == tmp_path / "left.json"
    assert setup.duration_s == 120.0
    assert setup.jig is not None
    done = inside("record", "--setup", example, "--wait", 0.1, "--output", tmp_path / "o", code=3)
    assert "A50285BI" in done.stderr
