"""The files of one export: all of them whole, or none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from imu_rig.errors import InputError, reason_of
from imu_rig.files import require_new, whole_file

Tell = Callable[[str], None]
"""Takes what is being done, for whoever waits."""

NUMBERS_AT_A_TIME = 300_000
"""Rows times columns that are written at once: a packet may have thousands of numbers."""
WHAT = "an exported file"


@dataclass(frozen=True)
class Place:
    """Where an export goes.

    Attributes
    ----------
    path : Path
        The file, where one holds everything.
    several : bool
        Whether there are several devices, which formats with a file for each tell by name.
    """

    path: Path
    several: bool

    def of(self, key: str) -> Path:
        """Return the file of one device."""
        return self.beside(key) if self.several else self.path

    def beside(self, word: str) -> Path:
        """Return a file beside it with a word more in its name."""
        return self.path.with_name(f"{self.path.stem}_{word}{self.path.suffix}")


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder, unless it is there, and take it away again if the block fails.

    Raises
    ------
    InputError
        It cannot be made.
    """
    there = folder.is_dir()
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"The folder {folder} cannot be made ({reason_of(error)}).") from error
    try:
        yield
    except BaseException:
        if not there:
            with suppress(OSError):  # somebody put something into it meanwhile
                folder.rmdir()
        raise


class Output:
    """Files of one export, as a context: what was written is removed if the block fails.

    Attributes
    ----------
    files : list of Path
        Those written so far.
    tell : callable
        Takes what is being done.
    notes : list of str
        Sentences about what the files do not hold as it was recorded.
    """

    def __init__(self, tell: Tell | None = None) -> None:
        self.files: list[Path] = []
        self.notes: list[str] = []
        self.tell = tell or (lambda _: None)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if error is not None:
            for path in self.files:  # made moments ago, by nobody else
                path.unlink(missing_ok=True)

    def require_new(self, *paths: Path) -> None:
        """Refuse names that are taken before any work is done.

        Raises
        ------
        InputError
        """
        for path in paths:
            require_new(path, what=WHAT)

    @contextmanager
    def open(self, path: Path) -> Iterator[BinaryIO]:
        """Open a new file for writing; see `imu_rig.files.whole_file`."""
        with whole_file(path, what=WHAT) as file:
            yield file
        self.files.append(path)

    def spans(self, device: str, count: int, columns: int) -> Iterator[slice]:
        """Yield the rows of a device in pieces, telling how far it is."""
        step = max(1, NUMBERS_AT_A_TIME // max(1, columns))
        for start in range(0, count, step):
            self.tell(f"exporting {device}, {100 * start // count} %")
            yield slice(start, start + step)
