"""Small files: read within bounds, written whole or not at all."""

from __future__ import annotations

import os
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from imu_rig.errors import InputError, StorageError, reason_of
from imu_rig.foreign_text import one_line

MOST_DOTS = 32  # in one line of TOML; a key of thousands of parts keeps its reader busy for ever


def read_small(path: Path | str, most_bytes: int, *, what: str) -> bytes:
    """Read an ordinary file that may not be large.

    Raises
    ------
    InputError
        No such file, a folder or device in its place, or a larger one; ``what`` names it in the
        sentence: "a jig file".
    """
    source = Path(path)
    try:
        if not source.is_file():
            found = "this is no ordinary file" if source.exists() else "there is no such file"
            raise InputError(f"{source}: {found} to read {what} from.")
        with source.open("rb") as file:
            data = file.read(most_bytes + 1)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{source}: {what} cannot be read from it ({reason_of(error)})."
        ) from error
    if len(data) > most_bytes:
        raise InputError(f"{source} is too large for {what}, which has at most {most_bytes} bytes.")
    return data


def parse_toml(data: bytes, source: str) -> dict[str, Any]:
    """Parse TOML that nobody vouches for.

    Raises
    ------
    InputError
        Naming ``source``, if it is not TOML or made to keep its reader busy.
    """
    if any(line.count(b".") > MOST_DOTS for line in data.split(b"\n")):
        raise InputError(f"{source} has a line with more than {MOST_DOTS} dots.")
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source}: not a TOML file ({one_line(str(error))}).") from error


def write_whole(path: Path | str, data: bytes, *, what: str, overwrite: bool = False) -> None:
    """Write a small file; see `whole_file`."""
    with whole_file(path, what=what, overwrite=overwrite) as file:
        file.write(data)


def require_new(target: Path, *, what: str, overwrite: bool = False) -> None:
    """Refuse a name that `whole_file` would refuse, before there is anything to write.

    Raises
    ------
    InputError
        The file exists, or its folder does not.
    """
    try:
        if "\0" in str(target):
            raise InputError(f"a name with a NUL character cannot be {what}'s")
        if os.path.lexists(target) and not overwrite:
            raise InputError(
                f"{target} exists and {what} is never overwritten; choose another name"
            )
        if target.is_dir() and not target.is_symlink():
            raise InputError(f"{target} is a folder; name a file for {what}")
        if not target.parent.is_dir():
            raise InputError(f"{target.parent} is not a folder; make it before saving {what} there")
    except (OSError, ValueError) as error:
        raise InputError(f"{target} is no name for {what} ({reason_of(error)})") from error


@contextmanager
def whole_file(path: Path | str, *, what: str, overwrite: bool = False) -> Iterator[BinaryIO]:
    """Write a file beside its place, sync it, and move it there when the block has ended well.

    A symbolic link is replaced, never followed.

    Parameters
    ----------
    path : Path or str
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
    require_new(target, what=what, overwrite=overwrite)
    try:
        handle, name = tempfile.mkstemp(prefix=".imu-rig-", dir=target.parent)
        temporary = Path(name)
        try:
            with os.fdopen(handle, "wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            temporary.chmod(0o644)
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
        _sync_folder(target.parent)
    except OSError as error:
        raise StorageError(f"{target} could not be written: {reason_of(error)}") from error


def _sync_folder(folder: Path) -> None:
    """Make a new name in a folder outlive a power cut, where the system can."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
