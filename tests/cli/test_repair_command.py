"""`imu-rig repair`: what it says, to a person and to a program, and what it leaves alone."""

import json
from pathlib import Path

import pytest

from imu_rig.recording.reader import open_trial

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
