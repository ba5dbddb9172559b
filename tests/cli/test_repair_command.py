"""`imu-rig repair`: what it says, to a person and to a program, and what it leaves alone."""

import json
from pathlib import Path

import pytest

from imu_rig.clock import SteppedClock
from imu_rig.recording import TrialWriter, open_trial

GOLDEN = Path(__file__).parents[1] / "data" / "golden-devices-v1.imu-trial"


@pytest.fixture
def damaged(tmp_path):
    """A trial of which one packet of the left shoe and the end are gone."""
    content = bytearray(GOLDEN.read_bytes())
    records = open_trial(GOLDEN).records
    row = int(((records.kind == 3) & (records.source == 1)).nonzero()[0][50])
    content[int(records.offset[row]) + 5] ^= 1
    path = tmp_path / "walk.imu-trial"
    path.write_bytes(content[: int(records.end[-2]) + 9])
    return path


def test_a_person_is_told_what_was_kept_and_lost(inside, damaged):
    before = damaged.read_bytes()
    text = inside("repair", damaged).stdout
    for said in (
        "1 record lost",
        "9 bytes of a torn end",
        "lost  1 record, within 0.0",
        "given one: interrupted",
        "left shoe: 299 records kept; by its own numbers 1 packet lost",
        "right shoe: 240 records kept; by its own numbers 0 packets lost",
        "walk.repaired.imu-trial",
    ):
        assert said in text
    target = damaged.with_name("walk.repaired.imu-trial")
    content = target.read_bytes()
    assert "holds exactly this already" in inside("repair", damaged).stdout
    assert "nothing to repair" in inside("repair", target).stdout
    assert (damaged.read_bytes(), target.read_bytes()) == (before, content)
    assert sorted(damaged.parent.iterdir()) == [damaged, target]


def test_a_program_is_told_in_json(inside, damaged, tmp_path):
    target = tmp_path / "saved.imu-trial"
    facts = json.loads(inside("repair", damaged, "-o", target, "--json").stdout)
    assert (facts["repaired"], facts["written"]) == (str(target), True)
    assert (facts["records_lost"], facts["ended"]) == (1, None)
    assert facts["records_kept"] == len(open_trial(damaged).records)
    assert facts["sources"]["left shoe"]["packets_lost"] == 1
    facts = json.loads(inside("repair", GOLDEN, "--json").stdout)
    assert (facts["repaired"], facts["written"], facts["ended"]) == (None, False, "complete")


def test_the_original_is_refused_as_the_new_file(inside, damaged):
    before = damaged.read_bytes()
    result = inside("repair", damaged, "-o", damaged, code=2)
    assert "never altered" in result.stderr
    assert damaged.read_bytes() == before


def test_info_tells_of_the_damage_and_of_the_way_out(inside, damaged):
    text = inside("info", damaged).stdout
    assert "no end record" in text
    assert "1 record lost" in text
    assert f"imu-rig repair {damaged} saves what is sound" in text
    damage = json.loads(inside("info", damaged, "--json").stdout)["damage"]
    assert (damage["records lost"], damage["bytes of a torn end"]) == (1, 9)
    inside("repair", damaged, "--quiet")
    text = inside("info", damaged.with_name("walk.repaired.imu-trial")).stdout
    assert "imu-rig repair" not in text
    assert "interrupted" in text


def test_what_is_still_being_recorded_is_not_called_cut_off(inside, tmp_path):
    path = tmp_path / "walk.imu-trial"
    with TrialWriter.create(path, {"kind": "trial"}, clock=SteppedClock()) as trial:
        trial.flush()
        assert "it is being recorded" in inside("info", path).stdout
        assert "written by another program" in inside("repair", path, code=2).stderr
    assert "complete" in inside("info", path).stdout
