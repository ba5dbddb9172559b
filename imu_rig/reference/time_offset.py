"""The time offset between two clocks, from two paths of one motion."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.reference.handedness import check_hands

COARSE_S = 0.05
"""Two paths of one foot agree best within a tenth of a swing (0.4 s) of the right offset."""
FINER, ROUNDS = 5.0, 4
MOST_PLACES = 600
LEAST_SHARE = 0.3
"""An offset at which less of the reference is left fits too easily, and is not tried."""


def find_time_offset(
    t: FloatArray, position: FloatArray, times: FloatArray, places: FloatArray, within_s: float
) -> tuple[float, bool]:
    """Return what to add to ``times`` [s] so that the path fits best, and whether that is a bound.

    Each offset is tried with whatever signs of the reference fit best: the offset of a left-handed
    reference would else be where its error is least, not where the feet move together.

    Parameters
    ----------
    t, position : shape (n,), (n, 3)
        Path [s, m].
    times, places : shape (m,), (m, 3)
        Reference [s, m] without gaps.
    within_s : float
        Offsets of up to so much are tried [s].
    """
    every = max(1, len(times) // MOST_PLACES)
    some, where = times[::every], places[::every]

    def misfit(offset: float) -> float:
        at = some + offset
        inside = (at >= t[0]) & (at <= t[-1])
        if np.count_nonzero(inside) < max(LEAST_SHARE * len(some), 3):
            return float("inf")
        path = np.column_stack([np.interp(at[inside], t, column) for column in position.T])
        fit = check_hands(path, where[inside])
        return float(np.hypot(min(fit.as_given, fit.mirrored), min(fit.upright, fit.upside_down)))

    count = int(np.ceil(within_s / COARSE_S))
    step = within_s / max(count, 1)
    tried = step * np.arange(-count, count + 1)
    best = float(tried[int(np.argmin([misfit(o) for o in tried]))])
    at_edge = abs(best) > within_s - 0.5 * step
    for _ in range(ROUNDS):
        step /= FINER
        near = best + step * np.arange(-FINER, FINER + 1)
        near = near[np.abs(near) <= within_s]
        best = float(near[int(np.argmin([misfit(o) for o in near]))])
    return best, at_edge
