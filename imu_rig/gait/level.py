"""Where the floor is level: the heights of footfalls decide, stride by stride."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.gait.options import FootOptions

FREE_M = 100.0
"""By which the floor may differ where nothing is said of it [m]: any stairs of a trial."""


def floor_steps(heights: FloatArray, options: FootOptions) -> FloatArray:
    """Return by how much the floor under each footfall may differ from that before, (k,) [m].

    Parameters
    ----------
    heights : shape (k,)
        Of the sensor at the footfalls [m], from a smoother that took no floor for level.
    options : FootOptions
        `level`, `step_m` and `floor_walk_m` are used.
    """
    steps = np.full(len(heights), options.floor_walk_m)
    if options.level == "auto":
        steps[1:][~level_strides(heights, options.step_m)] = FREE_M
    steps[:1] = FREE_M
    return steps


def level_strides(heights: FloatArray, step_m: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Tell of each stride whether it stayed on one floor, shape (k - 1,)."""
    return np.abs(np.diff(heights)) < step_m
