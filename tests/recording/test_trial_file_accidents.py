"""A file deleted, replaced, shortened or moved while it is recorded: told, and its rows saved."""

import errno
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from rows_of_trials import CONFIG, DESCRIPTOR, SOURCE, numbers, row

from imu_rig.clock import SteppedClock
from imu_rig.errors import StorageError
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial
from imu_rig.recording.storage import OsFileSystem

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="Windows lets nobody touch a file that is open"
)

ROWS = 50


@pytest.fixture
def path(tmp_path):
    folder = tmp_path / "day"
    folder.mkdir()
    return folder / "walk.imu-trial"


class Recording:
    """A trial with some rows, looked at as often as it can be, or only when it is closed."""

    def __init__(self, path, *, watched):
        self.told = threading.Event()
        self.trial = TrialWriter.create(
            path,
            CONFIG,
            clock=SteppedClock(),
            on_error=lambda _: self.told.set(),
            options=RecordingOptions(note_s=3600.0, sync_s=0.002 if watched else 3600.0),
        )
        self._source = self.trial.add_source(SOURCE, "test", DESCRIPTOR)
        self._next = 0
        self.record()

    def record(self):
        for number in range(self._next, self._next + ROWS):
            self.trial.bytes_in(self._source, number * 10_000_000, row(number))
        self._next += ROWS
        assert self.trial.flush()

    def end(self, *, watched):
        """Wait until the accident is noticed, if it is to be noticed before the end; close."""
        if watched:
            assert self.told.wait(10.0)
        self.trial.close()
        return self.trial.error


@pytest.mark.parametrize("watched", [True, False], ids=["meanwhile", "at the end"])
@pytest.mark.parametrize("how", ["deleted", "replaced", "folder deleted"])
def test_a_file_without_a_name_is_saved_under_another(path, how, watched):
    recording = Recording(path, watched=watched)
    if how == "deleted":
        path.unlink()
    elif how == "replaced":
        other = path.with_name("other")
        other.write_bytes(b"of somebody else")
        other.rename(path)
    else:
        shutil.rmtree(path.parent)
    error = recording.end(watched=watched)
    assert isinstance(error, StorageError)
    folder = path.parent if how != "folder deleted" else path.parent.parent
    saved = folder / "walk.saved.imu-trial"
    assert f"{path} was {how}" in str(error) or f"folder of {path} was deleted" in str(error)
    assert f"kept in {saved};" in str(error)
    found = open_trial(saved)
    assert numbers(found) == list(range(ROWS))
    assert not found.damage
    assert found.ended == "storage_failed"
    if how == "replaced":
        assert path.read_bytes() == b"of somebody else"


def test_a_saved_file_overwrites_none(path):
    taken = path.with_name("walk.saved.imu-trial")
    taken.write_bytes(b"saved before")
    recording = Recording(path, watched=True)
    path.unlink()
    assert "walk.saved_2.imu-trial;" in str(recording.end(watched=True))
    assert taken.read_bytes() == b"saved before"
    assert numbers(open_trial(path.with_name("walk.saved_2.imu-trial"))) == list(range(ROWS))


@pytest.mark.parametrize("watched", [True, False], ids=["meanwhile", "at the end"])
@pytest.mark.parametrize("left", [0, 0.5], ids=["to nothing", "to half"])
def test_a_file_cut_short_is_told(path, left, watched):
    recording = Recording(path, watched=watched)
    size = path.stat().st_size
    os.truncate(path, int(left * size))
    if not watched:
        recording.record()
    error = recording.end(watched=watched)
    assert f"{path} was shortened by another program" in str(error)
    assert recording.trial.acknowledged_bytes == path.stat().st_size
    found = open_trial(path)
    assert found.ended == "storage_failed"
    if not watched:
        kept = ROWS - 5  # without a header the first few only tell what the file is
        assert numbers(found)[-kept:] == list(range(2 * ROWS - kept, 2 * ROWS))


def test_a_file_that_is_moved_is_recorded_on_and_found_again(path, tmp_path):
    recording = Recording(path, watched=True)
    moved = tmp_path / "moved.imu-trial"
    path.rename(moved)
    assert not recording.told.wait(0.05)
    recording.record()
    error = recording.end(watched=False)
    assert f"{path} was moved or renamed" in str(error)
    assert "is whole there" in str(error)
    found = open_trial(moved)
    assert numbers(found) == list(range(2 * ROWS))
    assert found.ended == "complete"
    if sys.platform == "linux":
        assert f"to {moved} " in str(error)


def test_a_folder_reached_by_a_link_is_no_accident(path, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(path.parent, target_is_directory=True)
    recording = Recording(link / path.name, watched=True)
    assert not recording.told.wait(0.05)
    assert recording.end(watched=False) is None
    assert open_trial(path).ended == "complete"


# --- full disks -----------------------------------------------------------------------------


class FullDisk(OsFileSystem):
    """A disk with room for ``room`` more bytes, which counts what is held back."""

    def __init__(self, room):
        self.room = room

    def write(self, descriptor, data):
        taken = data[: self.room]
        if not taken:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.room -= len(taken)
        return super().write(descriptor, taken)

    def ftruncate(self, descriptor, size):
        self.room += os.fstat(descriptor).st_size - size
        super().ftruncate(descriptor, size)

    def hold_room(self, folder, size):
        self.room -= size

        def give_back():
            self.room += size

        return give_back


def options(file_system, **more):
    return RecordingOptions(note_s=3600.0, reserve_bytes=0, file_system=file_system, **more)


@pytest.mark.parametrize("room", range(90_000, 90_100, 9))
def test_a_full_disk_has_kept_room_for_the_end(path, room):
    """Whatever little is left when a row finds no room, the end needs more than a row."""
    disk = FullDisk(room)
    trial = TrialWriter.create(path, CONFIG, clock=SteppedClock(), options=options(disk))
    source = trial.add_source(SOURCE, "test", DESCRIPTOR)
    while trial.error is None:
        trial.bytes_in(source, 0, bytes(20))
        trial.flush()
    trial.close()
    found = open_trial(path)
    assert found.ended == "disk_full"
    assert not found.damage


def test_a_write_that_takes_a_part_is_continued(path):
    class Reluctant(OsFileSystem):
        """Takes two thirds of every write but that of a rest."""

        rest = 0

        def write(self, descriptor, data):
            part = len(data) if len(data) == self.rest else 1 + len(data) // 3 * 2
            self.rest = len(data) - part
            return super().write(descriptor, data[:part])

    trial = TrialWriter.create(path, CONFIG, clock=SteppedClock(), options=options(Reluctant()))
    source = trial.add_source(SOURCE, "test", DESCRIPTOR)
    for number in range(ROWS):
        trial.bytes_in(source, number * 10_000_000, row(number))
        trial.flush()
    trial.close()
    assert trial.error is None
    assert numbers(open_trial(path)) == list(range(ROWS))


RECORD_UNTIL_IT_FAILS = f"""
import resource, sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parent)!r})
from rows_of_trials import CONFIG, DESCRIPTOR, SOURCE, row
from imu_rig.clock import SteppedClock
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial
limit, path = int(sys.argv[1]), Path(sys.argv[2]) / "walk.imu-trial"
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
options = RecordingOptions(note_s=3600.0, reserve_bytes=0)
trial = TrialWriter.create(path, CONFIG, clock=SteppedClock(), options=options)
source = trial.add_source(SOURCE, "test", DESCRIPTOR)
number = 0
while trial.error is None:
    trial.bytes_in(source, number * 10_000_000, row(number))
    trial.flush()
    number += 1
trial.close()
found = open_trial(path)
print(found.ended, bool(found.damage), trial.error)
"""


def test_a_real_disk_that_fills_up_gets_its_end(tmp_path):
    """A disk in memory, in a mount namespace of its own."""
    inside = 'mount -t tmpfs -o size=200k imu-rig "$1" && exec "$2" -c "$3" 0 "$1"'
    alone = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
    if (
        shutil.which("unshare") is None
        or subprocess.run(
            [*alone, 'mount -t tmpfs imu-rig "$1"', "sh", tmp_path],
            capture_output=True,
            check=False,
        ).returncode
    ):
        pytest.skip("this system lets nobody mount a disk in memory")
    told = subprocess.run(
        [*alone, inside, "sh", tmp_path, sys.executable, RECORD_UNTIL_IT_FAILS],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert told.startswith("disk_full False The disk of ")
    assert "is full (No space left" in told


def test_a_file_as_large_as_its_user_may_make_it_is_named_as_that(tmp_path):
    told = subprocess.run(
        [sys.executable, "-c", RECORD_UNTIL_IT_FAILS, str(100_000), tmp_path],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert "walk.imu-trial has reached the largest size that its disk or its user's limit" in told
    assert "is full" not in told
    assert " False " in told
