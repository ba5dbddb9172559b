"""What a check found, and the machine it looks at.

Everything that is read of the system goes through `System`, so that the checks can be tried on a
machine that does not exist.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

try:
    import grp
    import pwd
except ImportError:  # not a POSIX system
    grp = None  # type: ignore[assignment]
    pwd = None  # type: ignore[assignment]

State = Literal["ok", "warn", "bad"]
"""Well; works, but worse than it could; will not work."""

MAX_TEXT_BYTES = 1 << 16


@dataclass(frozen=True)
class Check:
    """One finding.

    Attributes
    ----------
    about : str
        What was looked at, in a word or two.
    state : "ok", "warn" or "bad"
    found : str
        What it is like, in a sentence.
    advice : str
        What to do; empty where there is nothing to do.
    commands : tuple of str
        To be copied into a terminal.
    """

    about: str
    state: State
    found: str
    advice: str = ""
    commands: tuple[str, ...] = ()


@dataclass(frozen=True)
class Owner:
    """To whom a file belongs and what it allows; `mode` as of `os.stat`."""

    uid: int
    gid: int
    mode: int


def _owner(path: Path) -> Owner:
    of = path.stat()
    return Owner(of.st_uid, of.st_gid, of.st_mode)


def _may_use(path: Path) -> bool:
    return os.access(path, os.R_OK | os.W_OK)


@dataclass(frozen=True)
class System:
    """A machine, and who uses it.

    Attributes
    ----------
    root : Path
        Where its /dev, /etc, /proc, /sys and /usr are.
    platform : str
        As `sys.platform`.
    user : str
        Name of the user.
    uid : int
    groups : frozenset of int
        Groups of this process: those of the log-in.
    owner, may_use : callable
        Of a file: to whom it belongs; whether this process may read and write it.
    which : callable
        Where a program is; None if it is not installed.
    environment : mapping
    """

    root: Path = Path("/")
    platform: str = sys.platform
    user: str = ""
    uid: int = 0
    groups: frozenset[int] = frozenset()
    owner: Callable[[Path], Owner] = _owner
    may_use: Callable[[Path], bool] = _may_use
    which: Callable[[str], str | None] = shutil.which
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)

    @staticmethod
    def here() -> System:
        """Return the machine that this runs on."""
        if grp is None or pwd is None:
            return System(user=os.environ.get("USERNAME", ""))
        uid = os.getuid()
        try:
            user = pwd.getpwuid(uid).pw_name
        except KeyError:  # as in a container
            user = os.environ.get("USER", str(uid))
        return System(user=user, uid=uid, groups=frozenset({os.getgid(), *os.getgroups()}))

    def path(self, *parts: str) -> Path:
        """Return a path below the root."""
        return self.root.joinpath(*parts)

    def shown(self, path: Path) -> str:
        """Return a path as it is called on that machine."""
        return "/" + path.relative_to(self.root).as_posix()

    def text(self, *parts: str) -> str | None:
        """Return what a small file holds, without blanks around; None if it cannot be read."""
        try:
            with self.path(*parts).open("rb") as file:
                return file.read(MAX_TEXT_BYTES).decode("utf-8", "replace").strip()
        except (OSError, ValueError):
            return None

    def files(self, folder: str, pattern: str) -> list[Path]:
        """Return the files of a folder that match, sorted."""
        try:
            return sorted(self.path(folder).glob(pattern))
        except OSError:
            return []

    def group_name(self, gid: int) -> str | None:
        """Return the name of a group."""
        for name, number, _ in self._groups_listed():
            if number == gid:
                return name
        if self.root == Path("/") and grp is not None:  # of a directory service
            try:
                return grp.getgrgid(gid).gr_name
            except KeyError:
                return None
        return None

    def has_group(self, name: str) -> bool:
        """Return whether there is a group of that name."""
        return any(listed == name for listed, _, _ in self._groups_listed())

    def is_member(self, name: str) -> bool:
        """Return whether the user belongs to a group, from the next log-in on at least."""
        return any(n == name and self.user in who for n, _, who in self._groups_listed())

    def _groups_listed(self) -> list[tuple[str, int, list[str]]]:
        listed = []
        for line in (self.text("etc", "group") or "").splitlines():
            parts = line.split(":")
            if len(parts) == 4 and parts[2].isdecimal():
                listed.append((parts[0], int(parts[2]), parts[3].split(",")))
        return listed

    def processes(self) -> list[tuple[int, str]]:
        """Return number and name of every process that can be seen."""
        found = []
        for folder in self.files("proc", "[0-9]*"):
            name = self.text("proc", folder.name, "comm")
            if name is not None and folder.name.isdecimal():
                found.append((int(folder.name), name))
        return found
