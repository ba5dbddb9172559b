"""File systems that fail when told to."""

import errno
import os
import threading
from dataclasses import dataclass, field
from pathlib import Path

from imu_rig.recording.storage import OsFileSystem


@dataclass
class FailingFileSystem(OsFileSystem):
    """Fails its ``failing``-th write, counted from 1, and with ``lasting`` all that follow.

    ``problem`` is the error number of the failing write; 0 makes it take half of the bytes, and
    the write of the rest says that the disk is full. With ``uncut`` the file cannot be cut back
    afterwards either.
    """

    failing: int
    problem: int = errno.ENOSPC
    lasting: bool = False
    uncut: bool = False
    count: int = field(default=0, init=False)
    rest_refused: bool = field(default=False, init=False)

    def write(self, descriptor: int, data: bytes) -> int:
        if self.rest_refused:
            self.rest_refused = False
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.count += 1
        if self.count == self.failing or (self.lasting and self.count > self.failing):
            taken = os.write(descriptor, data[: len(data) // 2])
            if self.problem:
                raise OSError(self.problem, os.strerror(self.problem))
            self.rest_refused = True
            return taken
        return super().write(descriptor, data)

    def ftruncate(self, descriptor: int, size: int) -> None:
        if self.uncut:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        super().ftruncate(descriptor, size)

    def fdatasync(self, descriptor: int) -> None:
        """Nothing here depends on the real disk's patience."""


class BlockedFileSystem(OsFileSystem):
    """A disk that does not answer until ``released``; with ``syncs_only`` it takes all the same."""

    def __init__(self, *, syncs_only: bool = False) -> None:
        self.released = threading.Event()
        self.released.set()
        self.blocked = threading.Event()
        self.syncs_only = syncs_only

    def write(self, descriptor: int, data: bytes) -> int:
        if not self.syncs_only:
            self._answer()
        return super().write(descriptor, data)

    def fdatasync(self, descriptor: int) -> None:
        if self.syncs_only:
            self._answer()

    def _answer(self) -> None:
        if not self.released.is_set():
            self.blocked.set()
            self.released.wait()


class BadSyncFileSystem(OsFileSystem):
    """A disk that takes everything and then reports that it could not keep it.

    It does so when told to by ``failing``, or at sync number ``failing_at``, counted from 1.
    """

    failing = False

    def __init__(self, failing_at: int = 0) -> None:
        self.failing_at = failing_at
        self.count = 0

    def fdatasync(self, descriptor: int) -> None:
        self.count += 1
        if self.failing or self.count == self.failing_at:
            raise OSError(errno.EIO, os.strerror(errno.EIO))


class SmallFileSystem(OsFileSystem):
    """A disk with little room left."""

    def free_bytes(self, folder: Path) -> int:
        return 30_000_000
