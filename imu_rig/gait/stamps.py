"""Time stamps that a clock repeated."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.gait.footfalls import runs


def spread_repeats(t: FloatArray) -> FloatArray:
    """Return times [s], shape (n,), with samples of one stamp spread over the time they took.

    Samples that arrive together get the stamp of the last of them, and those of a clock that hangs
    that of the first; the longer interval beside them tells which, and is divided among them.
    Stamps that differ are left alone.
    """
    same = np.diff(t) == 0.0
    if not same.any():
        return t
    first, last = runs(same)
    spread = t.copy()
    for a, b in zip(first, last + 1, strict=True):  # t[a] = ... = t[b]
        number = b - a + 1
        before = t[a] - t[a - 1] if a > 0 else 0.0
        after = t[b + 1] - t[b] if b + 1 < len(t) else 0.0
        if after > before:
            spread[a : b + 1] = t[a] + after * np.arange(number) / number
        else:
            spread[a : b + 1] = t[a] - before * (number - 1 - np.arange(number)) / number
    return spread
