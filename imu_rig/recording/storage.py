"""What a recording asks of the file system, in one place so that a test can make it fail."""

import errno
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import BinaryIO, Protocol

from imu_rig.errors import InputError, NameTaken, StorageError

if sys.platform != "win32":
    import fcntl

_O_BINARY = getattr(os, "O_BINARY", 0)  # Windows would otherwise translate line ends
_READ_BYTES = 1 << 20
DISK_FULL = (errno.ENOSPC, errno.EDQUOT)


def read_exactly(file: BinaryIO | FileIO, size: int, path: Path) -> bytes:
    """Read bytes that a file is known to have, with as few calls as the system allows.

    Raises
    ------
    InputError
        If it has become shorter meanwhile.
    """
    parts = []
    while size:
        part = file.read(size)
        if not part:
            raise InputError(f"{path} became shorter while it was read; open it again.")
        parts.append(part)
        size -= len(part)
    return parts[0] if len(parts) == 1 else b"".join(parts)


class FileSystem(Protocol):
    """The calls that a recording depends on; each may raise OSError."""

    def write(self, descriptor: int, data: bytes) -> int:
        """Append ``data``; return how many bytes were taken."""
        ...

    def fdatasync(self, descriptor: int) -> None:
        """Wait until what was written is on the disk."""
        ...

    def ftruncate(self, descriptor: int, size: int) -> None:
        """Cut the file to ``size`` bytes."""
        ...

    def free_bytes(self, folder: Path) -> int:
        """Return what the user can still write to the disk of ``folder``."""
        ...

    def hold_room(self, folder: Path, size: int) -> Callable[[], None]:
        """Take up ``size`` bytes of the disk of ``folder``; return what gives them back."""
        ...


class OsFileSystem:
    """The machine's file system."""

    def write(self, descriptor: int, data: bytes) -> int:
        """Append ``data`` with one system call."""
        return os.write(descriptor, data)

    def fdatasync(self, descriptor: int) -> None:
        """Wait for the disk; where there is no fdatasync, fsync does more than is needed."""
        if sys.platform in ("win32", "darwin"):
            os.fsync(descriptor)
        else:
            os.fdatasync(descriptor)

    def ftruncate(self, descriptor: int, size: int) -> None:
        """Cut the file."""
        os.ftruncate(descriptor, size)

    def free_bytes(self, folder: Path) -> int:
        """Return the free space."""
        return shutil.disk_usage(folder).free

    def hold_room(self, folder: Path, size: int) -> Callable[[], None]:
        """Fill a file without a name, which a killed program does not leave behind."""
        file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115  (closed by its user)
        try:
            file.write(b"\xff" * size)
        except OSError:
            file.close()
            raise
        return file.close


def create_for_append(path: Path) -> int:
    """Create a file that must not exist yet and return its locked descriptor.

    Raises
    ------
    InputError
        If it exists already (then a `NameTaken`), or its folder is missing or forbidden.
    StorageError
        If the disk refuses.
    """
    try:
        descriptor = os.open(
            path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND | _O_BINARY, 0o666
        )
    except FileExistsError as error:
        raise NameTaken(
            f"{path} exists already and a trial file is never overwritten; choose another name."
        ) from error
    except OSError as error:
        raise _refused(path, "be created", error) from error
    return _locked(descriptor, path)


def open_for_append(path: Path) -> int:
    """Open an existing file and return its locked descriptor.

    Raises
    ------
    InputError
        If it is missing or forbidden, or another program is writing it.
    StorageError
        If the disk refuses.
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_APPEND | _O_BINARY)
    except OSError as error:
        raise _refused(path, "be continued", error) from error
    return _locked(descriptor, path)


@contextmanager
def open_undisturbed(path: Path) -> Iterator[BinaryIO]:
    """Open a trial file for reading that nobody may continue meanwhile.

    Raises
    ------
    InputError
        If it cannot be read, or another program is writing it.
    """
    require_file(path)
    try:
        file = path.open("rb", buffering=_READ_BYTES)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}).") from error
    with file:
        _lock(file.fileno(), path, shared=True)
        yield file


def is_being_written(path: Path) -> bool:
    """Whether a recorder has the file open (False where the system has no locks)."""
    try:
        with open_undisturbed(path):
            return False
    except InputError:
        return True


def require_file(path: Path) -> None:
    """Refuse what is no file, before it is opened: a pipe would make its reader wait for ever.

    Raises
    ------
    InputError
        If there is nothing of that name, or a folder, a pipe or a device.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        raise InputError(f"{path} cannot be read (there is no such file).") from error
    except (OSError, ValueError) as error:
        problem = getattr(error, "strerror", None) or "no file has a NUL character in its name"
        raise InputError(f"{path} cannot be read ({problem}).") from error
    if stat.S_ISDIR(mode):
        raise InputError(f"{path} cannot be read (it is a folder); name a file in it.")
    if not stat.S_ISREG(mode):
        raise InputError(f"{path} cannot be read (it is a pipe or a device); name a file.")


def sync_folder(folder: Path) -> None:
    """Make the name of a new file survive a power cut.

    Raises
    ------
    StorageError
        If the disk fails.
    """
    if sys.platform == "win32":  # a folder cannot be opened there; the file's own sync must do
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise StorageError(
            f"The folder {folder} cannot be written to disk ({error.strerror}); "
            "record to another disk."
        ) from error


def require_space(path: Path, needed_bytes: int, file_system: FileSystem) -> None:
    """Refuse to start a recording that the disk cannot hold.

    Raises
    ------
    StorageError
        If the disk of ``path`` has less than ``needed_bytes`` left.
    """
    try:
        free = file_system.free_bytes(path.parent)
    except OSError as error:
        raise _refused(path, "be created", error) from error
    if free < needed_bytes:
        raise StorageError(
            f"The disk of {path} has {free / 1e6:.0f} MB left and this recording needs "
            f"{needed_bytes / 1e6:.0f} MB; free some space or record to another disk."
        )


def _refused(path: Path, what: str, error: OSError) -> InputError | StorageError:
    if error.errno in (*DISK_FULL, errno.EIO):
        return StorageError(
            f"{path} cannot {what} ({error.strerror}); free some space or record to another disk."
        )
    if isinstance(error, FileNotFoundError) and not path.parent.is_dir():
        return InputError(f"{path} cannot {what}: the folder {path.parent} does not exist.")
    return InputError(f"{path} cannot {what} ({error.strerror}).")


def _locked(descriptor: int, path: Path) -> int:
    try:
        _lock(descriptor, path)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _lock(descriptor: int, path: Path, *, shared: bool = False) -> None:
    if sys.platform == "win32":
        return
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(
            f"{path} is being written by another program; stop that one first."
        ) from error
    except OSError as error:  # some network disks have no locks; go on without
        if error.errno not in (errno.ENOTSUP, errno.ENOSYS, errno.ENOLCK):
            raise _refused(path, "be locked", error) from error
