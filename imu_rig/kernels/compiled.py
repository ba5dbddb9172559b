"""How inner loops are compiled: once, kept on disk, and with the types of plain functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function when it is first called; later processes load what the first one made.

    Divisions by zero give infinities and NaN as in numpy, and other threads run meanwhile.
    """
    make = njit(cache=True, nogil=True, error_model="numpy")
    return cast(Callable[P, R], make(function))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small function into whatever calls it; products may be fused with sums.

    Compiled functions may call it, Python may not. It is kept on disk with its callers only; numba
    does not notice when it changes and they do not: remove ``__pycache__`` after such a change.
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
