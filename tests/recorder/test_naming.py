"""Names of trial files: safe on every system, inside their folder, never one that is taken."""

import contextlib
import errno
import itertools
import os
from datetime import date
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from imu_rig.errors import InputError, NameTaken, StorageError
from imu_rig.recorder.naming import (
    LONGEST_PART_BYTES,
    free_paths,
    make_folder,
    safe_part,
    session_part,
)
from imu_rig.recording.storage import create_for_append

DAY = date(2026, 3, 1)
WINDOWS_DEVICES = ("CON", "nul", "Com1", "LPT9", "aux.txt", "PRN.", "COM¹")
FORBIDDEN_ON_WINDOWS = set('<>:"/\\|?*')


@given(st.text(max_size=300))
def test_any_words_make_one_plain_name_unless_refused(words):
    name = None
    with contextlib.suppress(InputError):
        name = safe_part(words, "session")
    assume(name is not None)
    assert Path(name).name == name
    assert name not in (".", "..")
    assert name.isprintable()
    assert not FORBIDDEN_ON_WINDOWS & set(name)
    assert name[0] not in ".-~ "
    assert name[-1] not in ". "
    assert len(name.encode()) <= LONGEST_PART_BYTES + 1


@given(
    st.sampled_from(["../../etc", "/etc/passwd", "a/../..", "..\\..\\x", "C:\\x", "~/x", "a\0b"])
)
def test_no_name_leaves_its_folder(words):
    folder = Path("/somewhere/recordings")
    path = folder / safe_part(words, "session")
    assert Path(os.path.normpath(path)).parent == folder


@pytest.mark.parametrize("words", WINDOWS_DEVICES)
def test_a_device_name_of_windows_is_changed(words):
    name = safe_part(words, "session")
    stem = name.split(".")[0].upper()
    assert stem not in {"CON", "PRN", "AUX", "NUL"}
    assert not (stem[:3] in {"COM", "LPT"} and len(stem) == 4)


@pytest.mark.parametrize("words", ["", "...", "///", " . ", "\x1b", "-_-", "\u202e"])
def test_words_with_nothing_to_keep_are_refused(words):
    with pytest.raises(InputError, match="letter or a digit"):
        safe_part(words, "session")


def test_letters_of_every_script_stay():
    assert safe_part("Žofie 歩行 – č. 2", "session") == "Žofie_歩行_–_č._2"
    assert safe_part("e\u0301tude", "session") == "\u00e9tude"  # one form on every system


def test_a_session_is_named_by_itself_or_by_day_and_subject():
    assert session_part("gait lab", "S01", DAY) == "gait_lab"
    assert session_part("", "S01", DAY) == "2026-03-01_S01"
    assert session_part(" ", "", DAY) == "2026-03-01"


def test_numbers_go_on_after_the_highest_of_any_file(tmp_path):
    for name in ("walk_001.imu-trial", "walk_007.csv", "Walk_003", "walk_old", "walking_050.x"):
        (tmp_path / name).touch()
    assert next(free_paths(tmp_path, "walk")).name == "walk_008.imu-trial"
    assert next(free_paths(tmp_path, "")).name == "trial_001.imu-trial"
    assert next(free_paths(tmp_path, "wal(k")).name == "wal(k_001.imu-trial"


def test_two_recorders_never_take_the_same_name(tmp_path):
    first, second = free_paths(tmp_path, "walk"), free_paths(tmp_path, "walk")
    taken = next(first)
    assert next(second) == taken
    os.close(create_for_append(taken))
    with pytest.raises(NameTaken):
        create_for_append(taken)
    os.close(create_for_append(next(second)))
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "walk_001.imu-trial",
        "walk_002.imu-trial",
    ]


def test_numbers_end(tmp_path):
    (tmp_path / "walk_99998.imu-trial").touch()
    paths = free_paths(tmp_path, "walk")
    assert next(paths).name == "walk_99999.imu-trial"
    with pytest.raises(InputError, match="no number left"):
        next(paths)
    (tmp_path / "walk_999999999.imu-trial").touch()
    with pytest.raises(InputError, match="no number left"):
        list(itertools.islice(free_paths(tmp_path, "walk"), 1))


def test_a_file_in_place_of_the_folder_is_told(tmp_path):
    (tmp_path / "taken").touch()
    for output in (tmp_path, tmp_path / "taken"):
        with pytest.raises(InputError, match=r"taken is no folder.*--output"):
            make_folder(output, "taken")


@pytest.mark.parametrize(
    ("number", "kind"),
    [(errno.EROFS, InputError), (errno.EACCES, InputError), (errno.ENOSPC, StorageError)],
)
def test_a_folder_that_cannot_be_made_is_told(tmp_path, monkeypatch, number, kind):
    def refuse(*arguments, **options):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(kind, match=f"{os.strerror(number)}.*--output"):
        make_folder(tmp_path, "session")


def test_a_name_no_system_takes_is_told(tmp_path):
    for output in (tmp_path / ("x" * 300), tmp_path / "a\0b"):
        with pytest.raises(InputError, match="--output"):
            make_folder(output, "session")
