"""How inner loops are compiled: once, kept on disk, and with the types of plain functions."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numba import njit
from numba.core import caching

P = ParamSpec("P")
R = TypeVar("R")


class _State:
    """What is going on: compilations begun and not yet done, and functions that nothing keeps."""

    compiling = 0
    unkept = 0


def compiling() -> bool:
    """Tell whether something is being compiled right now."""
    return _State.compiling > 0


def kept() -> bool:
    """Tell whether what is compiled is kept for later processes."""
    return _State.unkept == 0


@cache
def room_digest(folder: Path) -> str:
    """Return a digest of all source files of a folder."""
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(folder.glob("*.py")):
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


_Kept: Any = caching.FunctionCache


class RoomCache(_Kept):  # type: ignore[misc]
    """What numba keeps on disk of a function, as long as no file beside its own changes.

    numba itself looks at the function's file only, but others are compiled into it. A cache that
    cannot be read or written costs time and nothing else.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        room = Path(function.__code__.co_filename).parent
        index: Any = caching.IndexDataCacheFile
        self._cache_file = index(self._cache_path, self._impl.filename_base, room_digest(room))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what an earlier process compiled, None if there is nothing."""
        try:
            found = super().load_overload(sig, target_context)
        except Exception:  # whatever a file that was cut short makes of unpickling
            found = None
            with suppress(OSError):
                self.flush()
        if found is None:
            _State.compiling += 1
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled."""
        _State.compiling -= 1
        try:
            super().save_overload(sig, data)
        except OSError:
            _State.unkept += 1


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function when it is first called; later processes load what the first one made.

    Divisions by zero give infinities and NaN as in numpy, and other threads run meanwhile. Where no
    folder can be written to, every process compiles for itself.
    """
    dispatcher: Any = njit(nogil=True, error_model="numpy")(function)
    try:
        dispatcher._cache = RoomCache(function)
    except (RuntimeError, OSError):  # no folder, or no source files
        _State.unkept += 1
    return cast(Callable[P, R], dispatcher)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small function into whatever calls it; products may be fused with sums.

    Compiled functions may call it, Python may not. It is kept on disk with its callers only.
    """
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",
        "forceinline": True,
        "fastmath": {"contract"},
        # what Python would call takes a third of the time of compiling
        "no_cpython_wrapper": True,
        "no_cfunc_wrapper": True,
    }
    make = njit(**options)
    return cast(Callable[P, R], make(function))


def as_variable(number: int) -> int:
    """Return an index for a module's constant that numba takes for any number.

    A function called with plain constants is compiled once for each of their values, which takes
    longer than all else; what the compiler proper makes of it is the same.
    """
    return cast(Any, np.intp(number))  # type: ignore[no-any-return]
