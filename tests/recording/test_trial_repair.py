"""Repair keeps all that is sound, counts what is lost, and leaves the damaged file as it is."""

import json
import os
import random
import struct
from pathlib import Path

import numpy as np
import pytest
from make_golden_devices import golden_devices
from one_record import encode_record
from rows_of_trials import CONFIG, DESCRIPTOR, FEW_NOTES, SOURCE, numbers, write_trial

from imu_rig.clock import SteppedClock
from imu_rig.errors import InputError, StorageError
from imu_rig.recording import TrialWriter, open_trial
from imu_rig.recording import repair as repair_module
from imu_rig.recording.format import FileHeader, Kind
from imu_rig.recording.repair import default_target, repair_trial

ROWS = 300
PAGE = 4096


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return write_trial(tmp_path_factory.mktemp("sound") / "sound.imu-trial", ROWS)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "walk.imu-trial"


def payloads(path):
    """Everything a trial holds but its numbers and what a repair added."""
    trial = open_trial(path)
    content = path.read_bytes()
    records = trial.records
    return [
        (int(kind), int(source), int(t), content[offset : offset + length])
        for kind, source, t, offset, length in zip(
            records.kind,
            records.source,
            records.time_ns,
            records.offset,
            records.length,
            strict=True,
        )
        if not (kind == Kind.GAP and b'"damage"' in content[offset : offset + length])
        and not (kind == Kind.EVENT and b'"repaired"' in content[offset : offset + length])
    ]


def repaired(path, content):
    """Write damaged bytes, repair them and check what holds for every repair."""
    path.write_bytes(content)
    outcome = repair_trial(path)
    assert path.read_bytes() == bytes(content)
    damaged = open_trial(path)
    assert outcome.records == len(damaged.records)
    assert outcome.damage == damaged.damage
    assert outcome.ended == damaged.ended
    if outcome.target is None:
        assert not damaged.damage
        return outcome, damaged
    assert outcome.written
    trial = open_trial(outcome.target)
    assert not trial.damage
    assert trial.ended == (damaged.ended or "interrupted")
    assert trial.created_wall_ns == damaged.created_wall_ns
    kept = payloads(outcome.target)
    assert kept[: len(damaged.records)] == payloads(path)
    assert len(kept) - len(damaged.records) == (damaged.ended is None)
    [event] = [e for e in trial.events if e.name == "repaired"]
    assert event.fields["sha256"] == damaged.sha256
    assert event.fields["records_kept"] == len(damaged.records)
    gaps = [gap for gap in trial.gaps if gap.fields["reason"] == "damage"]
    assert sum(gap.fields["records"] for gap in gaps) == damaged.damage.records_lost
    assert outcome.bytes_dropped == event.fields["bytes_dropped"]
    again = repair_trial(path)
    assert (again.target, again.written) == (outcome.target, False)
    of_repaired = repair_trial(outcome.target)
    assert of_repaired.target is None
    return outcome, trial


def test_a_sound_file_needs_no_repair(path, sound):
    outcome, _ = repaired(path, sound)
    assert (outcome.target, outcome.written) == (None, False)
    assert list(path.parent.iterdir()) == [path]


def test_a_lost_row_is_counted_and_all_others_are_kept(path, sound):
    path.write_bytes(sound)
    whole = open_trial(path)
    row = int(np.flatnonzero(whole.records.kind == Kind.BYTES_IN)[100])
    damaged = bytearray(sound)
    damaged[int(whole.records.offset[row]) + 3] ^= 0x10
    outcome, trial = repaired(path, damaged)
    assert numbers(trial) == [n for n in range(ROWS) if n != 100]
    [gap] = trial.gaps
    assert (gap.t, gap.source) == (0.99, 0)
    assert gap.fields == {"reason": "damage", "records": 1, "until_s": 1.01}
    [loss] = outcome.sources
    size = int(whole.records.length[row])
    assert (loss.name, loss.records, loss.lost_records, loss.lost_bytes) == (SOURCE, 299, 1, size)
    assert outcome.lost_s == pytest.approx(0.02)
    [event] = trial.events
    assert event.fields["lost"] == {SOURCE: {"records": 1, "bytes": size}}
    breaks = open_trial(path).wire(SOURCE).breaks
    np.testing.assert_array_equal(trial.wire(SOURCE).breaks, breaks)
    assert breaks.nonzero()[0].tolist() == [100]


def test_a_file_that_was_cut_off_is_given_an_end(path, sound):
    outcome, trial = repaired(path, sound[: len(sound) // 2])
    assert outcome.ended is None
    assert trial.ended == "interrupted"
    assert outcome.damage.tail_bytes == outcome.bytes_dropped > 0
    assert [loss.lost_records for loss in outcome.sources] == [None]
    found = numbers(trial)
    assert found == list(range(len(found)))
    [(_, end)] = trial._objects(Kind.END)
    assert end["records"] == len(trial.records) - 1
    assert end["bytes"] == int(trial.records.offset[-1]) - 24
    assert end["sources"] == {
        SOURCE: {"records_in": len(found), "bytes_in": len(trial.wire(SOURCE).data)}
    }


def test_damage_of_all_kinds(path, sound):
    chosen = random.Random(5)
    for _ in range(40):
        content = bytearray(sound[: len(sound) - chosen.choice([0, 0, 1, 500, 5000])])
        for _ in range(chosen.randrange(4)):
            place = chosen.randrange(1000, len(content))  # beyond what describes the rows
            length = chosen.choice([1, 1, 30, 700])
            content[place : place + length] = chosen.choice([bytes(length), os.urandom(length)])
        if chosen.random() < 0.3:
            content[chosen.randrange(32)] ^= 1
        if chosen.random() < 0.4:
            pages = [bytes(content[at : at + PAGE]) for at in range(0, len(content), PAGE)]
            tail = pages[-3:]
            chosen.shuffle(tail)
            content = bytearray(b"".join(pages[:-3] + tail))
        if chosen.random() < 0.3:
            content += content[-900:]
        outcome, trial = repaired(path, content)
        assert numbers(trial) == numbers(open_trial(path))
        if outcome.target:
            outcome.target.unlink()


def test_the_rows_of_a_repaired_trial_are_those_of_the_damaged_one(path):
    content = bytearray(golden_devices())
    content[len(content) // 3] ^= 1
    content[len(content) // 2 : len(content) // 2 + 600] = bytes(600)
    _, trial = repaired(path, content)
    damaged = open_trial(path)
    assert trial.sensors == damaged.sensors
    for name in trial.sensors:
        before, after = damaged.samples(name), trial.samples(name)
        np.testing.assert_array_equal(before.t, after.t)
        np.testing.assert_array_equal(before.counter, after.counter)
        for field, values in before.values.items():
            np.testing.assert_array_equal(values, after.values[field])
        assert [(m.samples, m.reason) for m in damaged.missing(name)] == [
            (m.samples, m.reason) for m in trial.missing(name)
        ]
    reasons = {m.reason for name in trial.sensors for m in trial.missing(name)}
    assert "lost in the file" in reasons


def test_a_continued_trial_is_repaired_with_all_its_parts(path, sound):
    path.write_bytes(sound[: len(sound) // 2])
    with TrialWriter.append(path, clock=SteppedClock(), options=FEW_NOTES) as more:
        more.bytes_in(more.add_source(SOURCE, "test", DESCRIPTOR), 0, b"more")
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 1
    outcome, trial = repaired(path, content)
    assert trial.ended == "complete"
    assert [event.name for event in trial.events] == ["resumed", "repaired"]
    # the end counts what came after the interruption only, so it says nothing of the loss
    assert [loss.lost_records for loss in outcome.sources] == [None]


def test_a_trial_that_was_being_continued_is_given_an_end(path, sound):
    path.write_bytes(sound)
    with TrialWriter.append(path, clock=SteppedClock(), options=FEW_NOTES):
        content = path.read_bytes()
    outcome, trial = repaired(path, content)
    assert outcome.ended is None
    assert trial.ended == "interrupted"


def test_a_file_with_nothing_but_a_header(path):
    _, trial = repaired(path, FileHeader(b"file id.", 5).encode())
    assert trial.records.kind.tolist() == [Kind.EVENT, Kind.END]


def test_records_of_another_program_are_kept_as_they_are(path):
    header = FileHeader(b"file id.", 5)
    other = [
        (Kind.END, 0, -(2**63), b"[1, 2]"),
        (Kind.EVENT, 0, 2**63 - 1, b"\xff"),
        (Kind.SOURCE, 3, 7, json.dumps({"name": "\x1b[2J", "kind": 1}).encode()),
        (Kind.BYTES_IN, 3, 0, b"x"),
        (Kind.BYTES_IN, 9, 0, b"y"),
        (200, 255, 0, b""),
        (Kind.END, 0, 0, json.dumps({"reason": None, "sources": {"\x1b[2J": [1]}}).encode()),
    ]
    content = [header.encode()]
    for number, (kind, source, time_ns, payload) in enumerate(other):
        content.append(encode_record(header.seed, kind, source, 2 * number, time_ns, payload))
    outcome, _ = repaired(path, b"".join(content))
    assert outcome.damage.records_lost == len(other) - 1
    assert [loss.name for loss in outcome.sources] == ["\x1b[2J", "source-9"]


def test_what_stands_at_the_target_is_never_overwritten(path, sound):
    path.write_bytes(sound[:-3])
    target = default_target(path)
    target.write_bytes(b"precious")
    with pytest.raises(InputError, match="holds something else") as caught:
        repair_trial(path)
    assert str(target) in str(caught.value)
    assert target.read_bytes() == b"precious"
    other = path.with_name("other.imu-trial")
    assert repair_trial(path, other).target == other
    assert other.read_bytes()[:8] == sound[:8]


def test_the_damaged_file_cannot_be_the_target(path, sound):
    path.write_bytes(sound[:-3])
    link = path.with_name("link.imu-trial")
    link.symlink_to(path)
    for target in (path, link):
        with pytest.raises(InputError, match="is never altered"):
            repair_trial(path, target)
    assert path.read_bytes() == sound[:-3]


def test_a_file_that_is_being_written_is_left_alone(path):
    with TrialWriter.create(path, CONFIG, clock=SteppedClock(), options=FEW_NOTES) as trial:
        trial.flush()
        with pytest.raises(InputError, match="written by another program"):
            repair_trial(path)
    assert repair_trial(path).target is None


def test_no_recording_goes_on_while_a_file_is_repaired(path, sound, monkeypatch):
    path.write_bytes(sound[:-3])
    whole_file = repair_module.whole_file

    def look(*arguments, **options):
        with pytest.raises(InputError, match="written by another program"):
            TrialWriter.append(path, clock=SteppedClock(), options=FEW_NOTES)
        return whole_file(*arguments, **options)

    monkeypatch.setattr(repair_module, "whole_file", look)
    assert repair_trial(path).written


def test_a_full_disk_leaves_nothing_behind(path, sound, monkeypatch):
    path.write_bytes(sound[:-3])
    monkeypatch.setattr(repair_module.OsFileSystem, "free_bytes", lambda *_: 100)
    with pytest.raises(StorageError, match="left"):
        repair_trial(path)
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path: None, "there is no such file"),
        (Path.mkdir, "is a folder"),
        (os.mkfifo, "is a pipe or a device"),
        (lambda path: path.write_bytes(b""), "is empty"),
        (lambda path: path.write_bytes(b"no trial" * 50), "is not a trial file"),
        (lambda path: path.write_bytes(struct.pack("<8s", b"\x89IMU\r\n\x1a\n")), "both copies"),
    ],
)
def test_what_is_no_trial_is_refused_by_name(path, make, said):
    make(path)
    with pytest.raises(InputError, match=said) as caught:
        repair_trial(path)
    assert str(path) in str(caught.value)


def test_the_progress_goes_from_nothing_to_all(path, sound):
    path.write_bytes(sound[:-3])
    told = []
    repair_trial(path, progress=lambda what, share: told.append((what, share)))
    assert all(0 < share <= 1 for _, share in told)
    assert len({what for what, _ in told}) == 3
    assert told[-1][1] == 1.0
