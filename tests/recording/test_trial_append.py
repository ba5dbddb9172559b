"""Continuing a trial: nothing sound is cut, numbers and times go on."""

import random

import pytest
from rows_of_trials import CONFIG, DESCRIPTOR, FEW_NOTES, SOURCE, numbers, row, write_trial

from imu_rig.clock import SteppedClock
from imu_rig.errors import InputError
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial

ROWS = 60
NS = 1_000_000_000
DAY_NS = 86_400 * NS


@pytest.fixture
def path(tmp_path):
    return tmp_path / "trial.imu-trial"


def continue_trial(path, count, clock=None):
    """Append rows at the next times of the numbered rows."""
    first = len(numbers(open_trial(path)))
    clock = clock or SteppedClock()
    with TrialWriter.append(path, clock=clock, options=FEW_NOTES) as trial:
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        offset = round(trial.t_s(0) * NS)  # rows carry their time by their number
        for number in range(first, first + count):
            trial.bytes_in(source, number * 10_000_000 - offset, row(number))


def test_a_trial_cut_anywhere_goes_on(path):
    content = write_trial(path, ROWS)
    for cut in random.Random(3).sample(range(600, len(content)), 60):
        path.write_bytes(content[:cut])
        before = open_trial(path)
        kept = len(numbers(before))
        continue_trial(path, 10)
        after = open_trial(path)
        assert numbers(after) == list(range(kept + 10))
        assert not after.damage
        sequence = after.records.sequence.tolist()
        assert sequence == list(range(len(sequence)))
        assert path.read_bytes().startswith(content[: before.records.end[-1]])
        resumed = after.events[-1]
        assert resumed.name == "resumed"
        assert resumed.fields["bytes_cut"] == before.damage.tail_bytes
        assert resumed.fields["ended"] is None
        assert after.ended == "complete"
        breaks = after.wire(SOURCE).breaks
        assert breaks.nonzero()[0].tolist() == ([kept] if kept else [])


def test_damage_in_the_middle_stays_as_it_is(path):
    content = bytearray(write_trial(path, ROWS))
    middle = len(content) // 2
    content[middle : middle + 100] = bytes(100)
    path.write_bytes(content)
    lost = open_trial(path).damage.records_lost
    assert lost
    with TrialWriter.append(path, clock=SteppedClock(), options=FEW_NOTES) as trial:
        trial.event("more")
    found = open_trial(path)
    assert path.read_bytes().startswith(content)
    assert found.damage.records_lost == lost
    assert [event.name for event in found.events] == ["resumed", "more"]


@pytest.mark.parametrize(
    ("passed_ns", "pause_s"),
    [(30 * NS, 29.75), (DAY_NS, 86399.75), (-DAY_NS, 0.0), (0, 0.0)],
    ids=["30 s", "a day", "set back a day", "stood still"],
)
def test_trial_time_goes_on_by_the_wall_clock_and_never_back(path, passed_ns, pause_s):
    clock = SteppedClock(77 * NS)
    options = RecordingOptions(note_s=3600.0, wall_ns=lambda: 1000 * NS)
    trial = TrialWriter.create(path, CONFIG, clock=clock, options=options)
    source = trial.add_source(SOURCE, "test", DESCRIPTOR)
    trial.bytes_in(source, clock.now_ns() + NS // 4, b"last before")
    trial.flush()
    trial.close()

    clock = SteppedClock(5 * NS)  # another boot
    options = RecordingOptions(note_s=3600.0, wall_ns=lambda: 1000 * NS + passed_ns)
    with TrialWriter.append(path, clock=clock, options=options) as trial:
        assert trial.t_s(clock.now_ns()) == pytest.approx(0.25 + pause_s, abs=1e-9)
        assert trial.add_source(SOURCE, "test", DESCRIPTOR) == source
        trial.bytes_in(source, clock.now_ns(), b"first after")
    found = open_trial(path)
    assert found.wire(SOURCE).t.tolist() == pytest.approx([0.25, 0.25 + pause_s])
    assert found.events[0].fields["pause_s"] == pytest.approx(pause_s)
    assert (found.records.time_ns >= 0).all()


def test_the_end_is_the_last_end(path):
    write_trial(path, 3)
    assert open_trial(path).ended == "complete"
    TrialWriter.append(path, clock=SteppedClock(), options=FEW_NOTES).close("interrupted")
    assert open_trial(path).ended == "interrupted"
    trial = TrialWriter.append(path, clock=SteppedClock(), options=FEW_NOTES)
    trial.flush()
    assert open_trial(path).ended is None
    trial.close()
    assert [e.fields["ended"] for e in open_trial(path).events] == ["complete", "interrupted"]


def test_sources_keep_their_numbers_and_their_meaning(path):
    options = FEW_NOTES
    with TrialWriter.create(path, CONFIG, clock=SteppedClock(), options=options) as trial:
        trial.add_source("imu", "imu", {"layout": {"a": 1}, "url": "/dev/ttyUSB0"})
        trial.add_source("baro", "baro", {})
    with TrialWriter.append(path, clock=SteppedClock(), options=options) as trial:
        assert trial.add_source("baro", "baro", {}) == 2
        with pytest.raises(InputError, match="another source named 'imu'"):
            trial.add_source("imu", "imu", {"layout": {"a": 2}, "url": "/dev/ttyUSB0"})
        with pytest.raises(InputError, match="another source named 'imu'"):
            trial.add_source("imu", "servo", {"layout": {"a": 1}})
        assert trial.add_source("imu", "imu", {"layout": {"a": 1}, "url": "/dev/ttyUSB7"}) == 1
        assert trial.add_source("new", "imu", {}) == 3
    found = open_trial(path)
    assert [source.id for source in found.sources.values()] == [1, 2, 3]
    assert found.sources["imu"].descriptor["url"] == "/dev/ttyUSB0"


def test_what_cannot_be_continued_is_told_and_left_alone(path, tmp_path):
    with pytest.raises(InputError, match="cannot be continued"):
        TrialWriter.append(tmp_path / "missing.imu-trial", clock=SteppedClock())
    path.write_bytes(b"not a trial, but somebody's only copy")
    with pytest.raises(InputError, match="not a trial file"):
        TrialWriter.append(path, clock=SteppedClock())
    assert path.read_bytes() == b"not a trial, but somebody's only copy"
    content = write_trial(tmp_path / "whole.imu-trial", 3)
    path.write_bytes(content[:100])
    with pytest.raises(InputError, match="holds no configuration"):
        TrialWriter.append(path, clock=SteppedClock())
    assert path.read_bytes() == content[:100]
