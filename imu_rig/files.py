"""Writing a small file whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from imu_rig.errors import InputError, StorageError


def write_whole(path: Path | str, data: bytes, *, what: str, overwrite: bool = False) -> None:
    """Write a file beside its place, sync it, and move it there.

    A symbolic link is replaced, never followed.

    Parameters
    ----------
    path : Path or str
    data : bytes
    what : str
        What it is, for sentences: "a certificate".
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    InputError
        The file exists, or its folder does not.
    StorageError
        The disk is full or fails; nothing is left then.
    """
    target = Path(path)
    if os.path.lexists(target) and not overwrite:
        raise InputError(
            f"{target} exists and {what} is never overwritten unasked; choose another name"
        )
    if target.is_dir() and not target.is_symlink():
        raise InputError(f"{target} is a folder; name a file for {what}")
    if not target.parent.is_dir():
        raise InputError(f"{target.parent} is not a folder; make it before saving {what} there")
    try:
        _replace(target, data)
    except OSError as error:
        raise StorageError(f"{target} could not be written: {error.strerror}") from error


def _replace(target: Path, data: bytes) -> None:
    handle, name = tempfile.mkstemp(prefix=".imu-rig-", dir=target.parent)
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
    if os.name == "posix":
        folder = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
