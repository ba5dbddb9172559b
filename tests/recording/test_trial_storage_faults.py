"""Full, failing, slow and untrue disks: what was acknowledged stays, and the rest is counted."""

import errno
import os

import pytest
from failing_storage import (
    BadSyncFileSystem,
    BlockedFileSystem,
    FailingFileSystem,
    SmallFileSystem,
)
from rows_of_trials import CONFIG, DESCRIPTOR, SOURCE, numbers, row
from storage_fault_harness import (
    FIRST_WRITE,
    PROBLEMS,
    failing_syncs,
    failing_writes,
    record_until_failure,
)

from imu_rig.clock import SteppedClock
from imu_rig.errors import StorageError
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial
from imu_rig.recording.format import RECORD_OVERHEAD
from imu_rig.recording.storage import OsFileSystem

WRITES = 200


def create(path, file_system, *, on_error=None, **options):
    return TrialWriter.create(
        path,
        CONFIG,
        clock=SteppedClock(),
        on_error=on_error,
        options=RecordingOptions(note_s=3600.0, file_system=file_system, **options),
    )


@pytest.mark.parametrize(
    ("lasting", "uncut", "step"),
    [(False, False, 5), (True, False, 19), (False, True, 19), (True, True, 40)],
    ids=["once", "for good", "not cut back", "not cut back, for good"],
)
@pytest.mark.parametrize("problem", PROBLEMS)
def test_a_disk_that_fails_at_the_nth_write(tmp_path, problem, lasting, uncut, step):
    which = range(FIRST_WRITE, WRITES + 1, step)
    figures = failing_writes(tmp_path, problem, lasting=lasting, uncut=uncut, which=which)
    assert figures.problems == []
    assert figures.acknowledged > 10 * len(which)
    assert figures.lost == 0


def test_the_failure_is_told_once(tmp_path):
    errors = []
    trial = create(tmp_path / "x.imu-trial", FailingFileSystem(9), on_error=errors.append)
    record_until_failure(trial)
    trial.close()
    assert errors == [trial.error]


def test_a_file_that_cannot_be_cut_back_loses_nothing_and_is_ended(tmp_path):
    """Whole rows of the write that failed may stand there, so what follows has other numbers."""
    for failing in range(3, WRITES + 1, 7):
        path = tmp_path / f"{failing}.imu-trial"
        trial = create(path, FailingFileSystem(failing, errno.EIO, uncut=True), join_s=3600.0)
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        trial.flush()
        handed_in = 0
        while trial.error is None:
            for number in range(handed_in, handed_in + 7):
                trial.bytes_in(source, number * 10_000_000, row(number))
            trial.flush()
            handed_in += 7
        assert trial.unwritten_records == 7
        trial.close()
        assert trial.acknowledged_bytes == path.stat().st_size
        found = open_trial(path)
        assert numbers(found)[: handed_in - 7] == list(range(handed_in - 7))
        assert len(numbers(found)) < handed_in
        assert found.ended == "storage_failed"
        assert found.damage.records_lost
        assert found.damage.bytes_skipped
        assert not found.damage.records_repeated
        path.unlink()


def test_a_disk_that_fails_at_once_leaves_no_file(tmp_path):
    for problem in (errno.ENOSPC, errno.EIO, 0):
        with pytest.raises(StorageError):
            create(tmp_path / "x.imu-trial", FailingFileSystem(1, problem))
        assert list(tmp_path.iterdir()) == []


def test_a_failing_disk_is_raised_at_the_end_of_a_with_block(tmp_path):
    trial = create(tmp_path / "x.imu-trial", FailingFileSystem(2))
    with pytest.raises(StorageError, match=r"is full .* before you go on"), trial:
        trial.event("lost")


def test_what_the_block_raised_comes_before_a_failing_disk(tmp_path):
    trial = create(tmp_path / "x.imu-trial", FailingFileSystem(2))
    trial.event("lost")
    trial.flush()
    assert trial.error is not None
    with pytest.raises(ValueError, match="more important"), trial:
        raise ValueError("more important")


def test_a_trial_goes_on_once_there_is_room_again(tmp_path):
    path = tmp_path / "x.imu-trial"
    trial = create(path, FailingFileSystem(9))
    source = trial.add_source(SOURCE, "test", DESCRIPTOR)
    for number in range(20):
        trial.bytes_in(source, number * 10_000_000, row(number))
        trial.flush()
    trial.close()
    kept = len(numbers(open_trial(path)))
    assert 0 < kept < 20
    with TrialWriter.append(path, clock=SteppedClock()) as more:
        more.add_source(SOURCE, "test", DESCRIPTOR)
    assert len(numbers(open_trial(path))) == kept
    assert open_trial(path).ended == "complete"


def test_a_failing_sync_ends_the_recording(tmp_path):
    path = tmp_path / "x.imu-trial"
    file_system = BadSyncFileSystem()
    trial = create(path, file_system, sync_s=0.001)
    trial.event("kept")
    trial.flush()
    file_system.failing = True
    while trial.error is None:
        trial.event("more")
        trial.flush()
    trial.close()
    assert trial.synced_bytes < trial.acknowledged_bytes
    found = open_trial(path)
    assert found.ended == "storage_failed"
    assert found.events[0].name == "kept"


def test_the_nth_sync_that_fails_ends_the_recording(tmp_path):
    with pytest.raises(StorageError, match="Input/output error"):
        create(tmp_path / "first.imu-trial", BadSyncFileSystem(1))
    assert list(tmp_path.iterdir()) == []
    figures = failing_syncs(tmp_path, [2, 3, 9])
    assert figures.problems == []
    assert figures.trials == 3


def test_a_slow_disk_is_waited_for_by_the_queue_alone(tmp_path):
    """The disk answers only after the caller is through, so a caller that waits never ends."""
    path = tmp_path / "x.imu-trial"
    file_system = BlockedFileSystem()
    queue_bytes = 50_000
    with create(path, file_system, queue_bytes=queue_bytes) as trial:
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        other = trial.add_source("other", "test", DESCRIPTOR)
        assert trial.flush()
        file_system.released.clear()
        fits = 0
        size = 0
        while size + RECORD_OVERHEAD + len(row(fits)) <= queue_bytes:
            size += RECORD_OVERHEAD + len(row(fits))
            trial.bytes_in(source, fits * 10_000_000, row(fits))
            fits += 1
        assert trial.unwritten_records == 0
        assert trial.queued_bytes == size
        for number in range(fits, fits + 500):
            trial.bytes_in(source, number * 10_000_000, row(number))
        trial.bytes_in(other, 0, b"x" * queue_bytes)
        assert trial.unwritten_records == 501
        trial.event("an event still finds room")
        file_system.blocked.wait()
        file_system.released.set()
        assert trial.flush()
        assert trial.error is None
        after = fits + 500
        trial.bytes_in(source, after * 10_000_000, row(after))
    found = open_trial(path)
    assert numbers(found) == [*range(fits), after]
    assert not found.damage
    gaps = {gap.source: gap for gap in found.gaps}
    assert gaps[source].t == fits / 100
    assert gaps[source].fields == {
        "reason": "queue full",
        "records": 500,
        "bytes": sum(len(row(n)) for n in range(fits, fits + 500)),
        "until_s": (fits + 499) / 100,
    }
    assert gaps[other].fields["records"] == 1
    assert found.wire(SOURCE).breaks.nonzero()[0].tolist() == [fits]
    assert found.events[0].name == "an event still finds room"


@pytest.mark.parametrize("stall_s", [0.5, 5.0, 30.0])
def test_nothing_is_lost_while_the_disk_stalls_for_less_than_the_queue_lasts(tmp_path, stall_s):
    """Four sensors of 28 bytes at 400 Hz and a barometer; the queue is stated to last 45 s."""
    path = tmp_path / "x.imu-trial"
    file_system = BlockedFileSystem()
    rates_hz = {"a": 400, "b": 400, "c": 400, "d": 400, "height": 50}
    sizes = {"height": 16}
    with create(path, file_system) as trial:
        sources = {name: trial.add_source(name, "test", DESCRIPTOR) for name in rates_hz}
        assert trial.flush()
        file_system.released.clear()
        for name, rate_hz in rates_hz.items():
            for number in range(round(rate_hz * stall_s)):
                data = number.to_bytes(sizes.get(name, 28), "little")
                trial.bytes_in(sources[name], round(number / rate_hz * 1e9), data)
        assert trial.unwritten_records == 0
        file_system.blocked.wait()
        file_system.released.set()
    found = open_trial(path)
    assert not found.damage
    assert found.gaps == []
    for name, rate_hz in rates_hz.items():
        size = sizes.get(name, 28)
        sent = [number.to_bytes(size, "little") for number in range(round(rate_hz * stall_s))]
        assert found.wire(name).data == b"".join(sent)


def test_a_sync_that_takes_long_holds_up_no_write(tmp_path):
    path = tmp_path / "x.imu-trial"
    file_system = BlockedFileSystem(syncs_only=True)
    with create(path, file_system, sync_s=0.001) as trial:
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        file_system.released.clear()
        file_system.blocked.wait()
        for number in range(50):
            trial.bytes_in(source, number * 10_000_000, row(number))
        assert trial.flush()
        assert numbers(open_trial(path)) == list(range(50))
        assert trial.synced_bytes < trial.acknowledged_bytes
        file_system.released.set()
    assert trial.synced_bytes == trial.acknowledged_bytes


def test_a_disk_that_never_answers_does_not_hold_up_the_end(tmp_path):
    path = tmp_path / "x.imu-trial"
    file_system = BlockedFileSystem()
    trial = create(path, file_system, close_s=0.05)
    file_system.released.clear()
    trial.event("never written")
    trial.close()
    assert "has not answered" in str(trial.error)
    file_system.released.set()


def test_a_recording_that_cannot_fit_does_not_start(tmp_path):
    path = tmp_path / "x.imu-trial"
    with pytest.raises(StorageError, match="has 30 MB left and this recording needs 100 MB"):
        create(path, SmallFileSystem())
    with pytest.raises(StorageError, match="needs 31 MB"):
        create(path, SmallFileSystem(), reserve_bytes=1_000_000, planned_bytes=15_000_000)
    assert not path.exists()
    create(path, SmallFileSystem(), reserve_bytes=1_000_000, planned_bytes=14_000_000).close()
    with pytest.raises(StorageError, match="has 30 MB left"):
        TrialWriter.append(
            path, clock=SteppedClock(), options=RecordingOptions(file_system=SmallFileSystem())
        )


class NearlyFullFileSystem(OsFileSystem):
    """A disk with room for ``room`` more bytes once it is ``filling``."""

    filling = False
    room = 400

    def write(self, descriptor, data):
        if not self.filling:
            return super().write(descriptor, data)
        if len(data) > self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.room -= len(data)
        return super().write(descriptor, data)


def test_a_full_disk_with_a_little_room_still_gets_the_end(tmp_path):
    disk = NearlyFullFileSystem()
    path = tmp_path / "walk.imu-trial"
    writer = create(path, disk)
    source = writer.add_source(SOURCE, "x" * 600, DESCRIPTOR)  # describing it takes more than that
    assert writer.flush()
    disk.filling = True
    writer.bytes_in(source, 0, bytes(1000))
    writer.close()
    assert open_trial(path).ended == "disk_full"
