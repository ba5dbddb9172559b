"""Names of trial files: from a lab's own words, safe on every system, never one that is taken."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Iterator
from datetime import date
from pathlib import Path

from imu_rig.errors import InputError, StorageError, reason_of
from imu_rig.foreign_text import one_line
from imu_rig.recording.format import SUFFIX
from imu_rig.recording.storage import DISK_FULL

DEFAULT_TRIAL = "trial"
LONGEST_PART_BYTES = 100
"""Of a folder's or file's name; every file system takes 140, and the number comes on top."""
MOST_TRIALS = 99_999

_FORBIDDEN = re.compile(r'[\x00-\x1f\x7f/\\:*?"<>|]+')
_RESERVED = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9¹²³])(\.|$)", re.IGNORECASE)


def safe_part(words: str, what: str) -> str:
    """Make one folder's or file's name of words: never a path, on no system a special name.

    Letters of every script stay. Blanks become ``_``; what a system forbids becomes ``-``.

    Parameters
    ----------
    words : str
    what : str
        Names them in the sentence: "session".

    Raises
    ------
    InputError
        If nothing is left of them.
    """
    text = unicodedata.normalize("NFC", words)
    text = "".join(c if c.isprintable() or c.isspace() else "-" for c in text)
    text = _FORBIDDEN.sub("-", "_".join(text.split()))
    # a leading dot hides a file, a leading minus looks like an option, Windows drops trailing dots
    text = _shortened(text.lstrip("._-~ ")).rstrip("._- ")
    if not text:
        raise InputError(
            f"The {what} {one_line(words, 60)!r} has nothing that a file's name may begin with: "
            "take one with a letter or a digit."
        )
    return f"_{text}" if _RESERVED.match(text) else text


def session_part(session: str, subject: str, today: date) -> str:
    """Name of a session's folder: the session's own, or the day and the subject."""
    if session.strip():
        return safe_part(session, "session")
    return "_".join(
        [today.isoformat(), *([safe_part(subject, "subject")] if subject.strip() else [])]
    )


def make_folder(output: Path, part: str) -> Path:
    """Make the folder of a session, if it is not there yet.

    Raises
    ------
    InputError
        If it cannot be: forbidden, a file in its place.
    StorageError
        If the disk is full or fails.
    """
    folder = output / part
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        full = isinstance(error, OSError) and error.errno in DISK_FULL
        in_place = next((p for p in (folder, *folder.parents) if os.path.lexists(p)), folder)
        if not full and not in_place.is_dir():
            raise InputError(
                f"{in_place} is no folder, so no trial can be kept in {folder}: name another "
                "--output."
            ) from error
        kind = StorageError if full else InputError
        raise kind(
            f"The folder {folder} cannot be made ({reason_of(error)}): name another --output."
        ) from error
    return folder


def free_paths(folder: Path, trial: str) -> Iterator[Path]:
    """Yield names for a trial that nothing in the folder has, lowest number first.

    A number is not used again while any file of it is there, such as an export. Whoever creates
    the file must refuse one that exists and take the next name then: another recorder may have
    been faster.

    Raises
    ------
    InputError
        If the folder cannot be read, or is full of such names.
    """
    stem = safe_part(trial, "trial") if trial.strip() else DEFAULT_TRIAL
    taken = re.compile(re.escape(stem) + r"_(\d{1,9})(?!\d)", re.IGNORECASE)
    try:
        found = [taken.match(unicodedata.normalize("NFC", path.name)) for path in folder.iterdir()]
    except OSError as error:
        raise InputError(f"The folder {folder} cannot be read ({reason_of(error)}).") from error
    first = 1 + max((int(match[1]) for match in found if match), default=0)
    for number in range(first, MOST_TRIALS + 1):
        yield folder / f"{stem}_{number:03d}{SUFFIX}"
    raise InputError(
        f"{folder} has no number left for another trial {stem!r}: name another --trial or "
        "--session."
    )


def _shortened(text: str) -> str:
    """Cut to what every file system takes, between letters."""
    return text.encode()[:LONGEST_PART_BYTES].decode(errors="ignore")
