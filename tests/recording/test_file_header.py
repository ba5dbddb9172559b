"""Files whose header is gone: what the records tell of it."""

import numpy as np
import pytest
from rows_of_trials import CONFIG, DESCRIPTOR, SOURCE, numbers, row

from imu_rig.clock import SteppedClock
from imu_rig.errors import InputError
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial
from imu_rig.recording.format import HEADER_SIZE
from imu_rig.recording.repair import repair_trial

CREATED_NS = 1_700_000_000_000_000_000


@pytest.fixture
def trial_file(tmp_path):
    path = tmp_path / "walk.imu-trial"
    options = RecordingOptions(note_s=3600.0, wall_ns=lambda: CREATED_NS)
    with TrialWriter.create(path, CONFIG, clock=SteppedClock(), options=options) as trial:
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        for number in range(60):
            trial.bytes_in(source, number * 10_000_000, row(number))
    return path


@pytest.mark.parametrize("fill", [b"\x00", b"\xff", b"\xd3\x91"])
def test_a_file_without_its_header_still_gives_every_record(trial_file, fill):
    whole = open_trial(trial_file)
    data = trial_file.read_bytes()
    trial_file.write_bytes((fill * HEADER_SIZE)[:HEADER_SIZE] + data[HEADER_SIZE:])
    found = open_trial(trial_file)
    assert numbers(found) == numbers(whole) == list(range(60))
    assert len(found.records) == len(whole.records)
    assert found.header.seed == whole.header.seed
    assert found.header.created_wall_ns == CREATED_NS
    assert str(found.damage) == "header damaged"


def test_a_lost_first_block_costs_what_stood_in_it(trial_file):
    data = trial_file.read_bytes()
    trial_file.write_bytes(bytes(1024) + data[1024:])
    found = open_trial(trial_file)
    kept = numbers(found)
    assert kept == list(range(kept[0], 60))
    assert 0 < kept[0] < 30
    assert found.damage.records_lost > 0


def test_repair_gives_such_a_file_a_header_again(trial_file, tmp_path):
    data = trial_file.read_bytes()
    trial_file.write_bytes(bytes(HEADER_SIZE) + data[HEADER_SIZE:])
    repaired = tmp_path / "repaired.imu-trial"
    repair_trial(trial_file, repaired)
    found = open_trial(repaired)
    assert numbers(found) == list(range(60))
    assert not found.header.damaged


def test_nothing_is_found_in_what_is_no_trial(tmp_path):
    noise = np.random.default_rng(5).integers(0, 256, 3 << 20, np.uint8)
    for name, data in {
        "noise": noise.tobytes(),
        "zeros": bytes(1 << 20),
        "syncs": b"\xd3\x91" * (1 << 20),
        "one head": bytes(64) + b"\xd3\x91" + bytes(26),
    }.items():
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"not a trial file|begins with zeros"):
            open_trial(path)
