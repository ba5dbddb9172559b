"""`imu-rig info` on recorded trials: the golden file of several devices, and files made here."""

import json
from pathlib import Path

import pytest

from firmware_protocols.layout import load_layout
from imu_rig.clock import SteppedClock
from imu_rig.recording.log import RecordingOptions
from imu_rig.recording.writer import TrialWriter
from simulators.device_packets import DevicePackets

GOLDEN = Path(__file__).parents[1] / "data" / "golden-devices-v1.imu-trial"
LAYOUT = load_layout("mpu9150-28")
HOSTILE = "\x1b]0;owned\x07\x1b[2J"


def test_the_golden_trial_is_told_to_a_person(inside):
    text = inside("info", GOLDEN).stdout
    for said in ("P07", "morning", "walk 3", "2026-09-21 14:13:20.000 UTC", "complete"):
        assert said in text
    rows = {line[:10]: line for line in text.splitlines() if "100.00" in line}
    assert "60 (20.00 %)" in rows["right shoe"]
    assert "(" not in rows["left shoe "]
    assert "right shoe was missing once" in text
    assert "unplugged" in text
    assert "turn 90 °" in text
    assert max(map(len, text.partition("started")[2].splitlines())) <= 80


def test_the_golden_trial_is_told_to_a_program(inside):
    facts = json.loads(inside("info", GOLDEN, "--json").stdout)
    assert facts["start_utc"] == "2026-09-21T14:13:20.000Z"
    assert [m["label"] for m in facts["markers"]] == ["turn 90 °", "turn 210 °"]
    right = facts["devices"]["right shoe"]
    assert (right["packets"], right["lost"], right["loss"]) == (240, 60, 0.2)
    assert right["rate_hz"] == pytest.approx(100.0, abs=0.1)
    (missing,) = right["missing"]
    assert (missing["samples"], missing["reason"]) == (60, "unplugged")
    assert facts["devices"]["left shoe"]["certificate"] == "007"


def test_long_lists_are_shortened_and_whole_as_json(inside, tmp_path):
    path = tmp_path / "long.imu-trial"
    clock = SteppedClock()
    packets = DevicePackets(LAYOUT, 100.0, 1)
    with TrialWriter.create(path, {"kind": "trial"}, clock=clock) as trial:
        source = trial.add_source("imu", "imu", {"layout": LAYOUT.to_dict()})
        for number in range(40):  # every fifth tenth of a second is missing
            clock.advance(0.1)
            if number % 5 != 4:
                trial.bytes_in(source, clock.now_ns(), packets.make(10 * number, 10))
            trial.event("marker", label=f"marker {number}")
    text = inside("info", path).stdout
    assert "imu was missing 7 times; the 6 longest:" in text
    assert "... and 1 more" in text
    assert "... and 28 more" in text
    facts = json.loads(inside("info", path, "--json").stdout)
    assert len(facts["markers"]) == 40
    assert [m["samples"] for m in facts["devices"]["imu"]["missing"]] == [10] * 7


def test_nothing_of_a_file_reaches_the_terminal_as_it_is(inside, tmp_path):
    path = tmp_path / "hostile.imu-trial"
    clock = SteppedClock()
    config = {"kind": "trial", "subject": HOSTILE, "note": 7, "imu_rig": [HOSTILE]}
    with TrialWriter.create(path, config, clock=clock) as trial:
        layout = {**LAYOUT.to_dict(), "name": HOSTILE, "title": HOSTILE}
        odd = {
            "layout": layout,
            "url": [HOSTILE],
            "required": HOSTILE,
            "certificate": {"device": 1},
        }
        source = trial.add_source(HOSTILE, HOSTILE, odd)
        trial.bytes_in(source, clock.now_ns(), DevicePackets(LAYOUT, 100.0, 1).make(0, 50))
        trial.add_source("no layout", HOSTILE, {"layout": {"fields": HOSTILE}})
        trial.add_source("servo", HOSTILE, {})
        trial.gap(source, clock.now_ns(), HOSTILE)
        trial.device_statistics(source, {"corrupt": HOSTILE, "reconnects": [HOSTILE]})
        trial.event("marker", label=HOSTILE)
        clock.advance(1.0)
        trial.close(HOSTILE)
    done = inside("info", path)
    assert not set(done.stdout + done.stderr) & {"\x1b", "\x07"}
    assert "no layout" in done.stdout
    assert max(map(len, done.stdout.splitlines())) < 200
    json.loads(inside("info", path, "--json").stdout)


def test_several_files_are_told_and_one_that_is_none_holds_up_no_other(inside, tmp_path):
    missing = tmp_path / "no.imu-trial"
    done = inside("info", GOLDEN, missing, GOLDEN, code=2)
    assert done.stdout.count("right shoe was missing once") == 2
    assert done.stderr.count("\n") == 1
    assert str(missing) in done.stderr
    lines = inside("info", GOLDEN, missing, GOLDEN, "--json", code=2).stdout.splitlines()
    told = [json.loads(line) for line in lines]
    assert [Path(each["file"]) for each in told] == [GOLDEN, missing, GOLDEN]
    assert told[1]["exit_code"] == 2


@pytest.mark.parametrize(
    ("origin", "said"),
    [
        ({"format": "ngimu", "files": [{"name": "a.csv"}], "notes": ["left"]}, "a.csv"),
        ({"format": HOSTILE, "files": [HOSTILE, {"name": HOSTILE}], "notes": HOSTILE}, "owned"),
        ({"files": {"name": 1}, "notes": [{}]}, "imported"),
    ],
)
def test_an_imported_trial_says_from_what(inside, tmp_path, origin, said):
    path = tmp_path / "imported.imu-trial"
    TrialWriter.create(path, {"kind": "trial", "origin": origin}, clock=SteppedClock()).close()
    text = inside("info", path).stdout
    assert said in text
    assert "imported" in text
    assert not set(text) & {"\x1b", "\x07"}
    json.loads(inside("info", path, "--json").stdout)


def test_the_end_of_a_file_that_is_being_written_is_not_called_damage(inside, tmp_path):
    path = tmp_path / "growing.imu-trial"
    seldom = RecordingOptions(note_s=3600.0)  # nothing more is written behind the half record
    with TrialWriter.create(path, {"kind": "trial"}, clock=SteppedClock(), options=seldom) as trial:
        source = trial.add_source("imu", "imu", {"layout": LAYOUT.to_dict()})
        trial.bytes_in(source, 0, DevicePackets(LAYOUT, 100.0, 1).make(0, 50))
        assert trial.flush()
        with path.open("ab") as file:
            file.write(b"half a record")
        text = inside("info", path).stdout
        done = inside("export", path, "-o", tmp_path / "x.csv")
    assert "damage                    none" in text
    assert "it is being recorded" in text
    assert "it is being recorded" in done.stderr
    assert "damaged" not in done.stderr


def test_a_trial_in_which_nothing_came_is_told(inside, tmp_path):
    path = tmp_path / "empty.imu-trial"
    with TrialWriter.create(path, {"kind": "trial"}, clock=SteppedClock()) as trial:
        trial.add_source("imu", "imu", {"layout": LAYOUT.to_dict()})
    text = inside("info", path).stdout
    assert "0 markers" in text
    assert [line.split()[1] for line in text.splitlines() if line.startswith("imu ")] == ["0"]
