"""What people and programs do to a file while it is being recorded, and how its content is saved.

A system that lets a file be deleted while it is open keeps its content until it is closed, and no
write to it fails. So a recorder has to look whether its file still has its name and its size. On
Windows nobody can delete or shorten a file that is open.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Literal

from imu_rig.errors import ImuRigError, NameTaken, StorageError, reason_of
from imu_rig.recording.storage import create_for_append

_COPY_BYTES = 1 << 20
_HELD_NAMES = (".nfs", ".fuse_hidden")  # that network disks give a deleted file until it is closed


@dataclass(frozen=True)
class Accident:
    """What happened to an open file.

    Attributes
    ----------
    kind : str
        "deleted": it has no name any more; "shortened": bytes are gone; "moved": it has another
        name, and what is written still goes to it.
    sentence : str
        The same, without an end.
    """

    kind: Literal["deleted", "shortened", "moved"]
    sentence: str


def find_accident(descriptor: int, path: Path, size: int) -> Accident | None:
    """Return what happened to a file that was made as ``path``; None while all is well.

    Parameters
    ----------
    descriptor : int
        The open file.
    path : path
        Its name.
    size : int
        What it holds at least [bytes].
    """
    if sys.platform == "win32":
        return None
    during = "while it was being recorded"
    state = os.fstat(descriptor)
    if state.st_size < size:
        return Accident("shortened", f"{path} was shortened by another program {during}")
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        found = None
    except OSError:  # the disk does not answer: a write or a sync will tell
        return None
    if found is not None and os.path.samestat(found, state):
        return None
    now = _name_of(descriptor)
    if now is not None and now == path.resolve():
        return None  # a network disk without lasting file numbers
    if state.st_nlink == 0 or (now is not None and now.name.startswith(_HELD_NAMES)):
        if found is not None:
            return Accident("deleted", f"{path} was replaced by another file {during}")
        if not path.parent.is_dir():
            return Accident("deleted", f"The folder of {path} was deleted {during}")
        return Accident("deleted", f"{path} was deleted {during}")
    where = "another place" if now is None else str(now)
    return Accident("moved", f"{path} was moved or renamed to {where} {during}")


class SavedCopy:
    """A copy of an open file that has no name any more.

    Parameters
    ----------
    descriptor : int
        The file, open for reading too.
    path : path
        What its name was. The copy is ``<stem>.saved<suffix>`` beside it, or where its folder was,
        or in the folder for temporary files; nothing is overwritten.

    Attributes
    ----------
    path : Path

    Raises
    ------
    StorageError
        If there is no place for it.
    """

    def __init__(self, descriptor: int, path: Path) -> None:
        self._from = descriptor
        self._copied = 0
        self._to, self.path = _create_beside(path)
        try:
            self.catch_up()
        except OSError as error:
            os.close(self._to)
            self.path.unlink(missing_ok=True)
            raise StorageError(f"{self.path} cannot be written ({reason_of(error)})") from error

    def catch_up(self) -> None:
        """Copy what was written since, and wait for the disk."""
        if sys.platform == "win32":
            return
        while data := os.pread(self._from, _COPY_BYTES, self._copied):
            view = memoryview(data)
            while view:
                taken = os.write(self._to, view)
                self._copied += taken
                view = view[taken:]
        os.fsync(self._to)

    def close(self) -> None:
        """Copy the rest, as far as there is room, and close the copy, not the file itself."""
        with contextlib.suppress(OSError):
            self.catch_up()
        os.close(self._to)


def _name_of(descriptor: int) -> Path | None:
    """Return the name that an open file has now; None where the system does not tell."""
    try:
        name = Path(f"/proc/self/fd/{descriptor}").readlink()
        same = os.path.samestat(name.stat(), os.fstat(descriptor))
    except OSError:
        return None
    return name if same else None


def _create_beside(path: Path) -> tuple[int, Path]:
    problem = ""
    beside = path.absolute().parent
    for folder in (beside, *beside.parents, Path(tempfile.gettempdir())):
        for number in count(1):
            again = "" if number == 1 else f"_{number}"
            name = folder / f"{path.stem}.saved{again}{path.suffix}"
            try:
                return create_for_append(name), name
            except NameTaken:
                continue
            except ImuRigError as error:
                problem = problem or str(error)
                break
    raise StorageError(problem)
