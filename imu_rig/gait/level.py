"""Where the floor is level: the heights of footfalls decide, stride by stride."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.gait.options import FootOptions

FREE_M = 100.0
"""By which the floor may differ where nothing is said of it [m]: any stairs of a trial."""


def floor_steps(places: FloatArray, options: FootOptions) -> FloatArray:
    """Return by how much the floor under each footfall may differ from that before, (k,) [m].

    Parameters
    ----------
    places : shape (k, 3)
        Of the sensor at the footfalls [m], from a smoother that took no floor for level.
    options : FootOptions
        `level`, `step_m`, `slope` and `floor_walk_m` are used.
    """
    steps = np.full(len(places), options.floor_walk_m)
    if options.level == "auto":
        steps[1:][~level_strides(places, options)] = FREE_M
    steps[:1] = FREE_M
    return steps


def level_strides(places: FloatArray, options: FootOptions) -> BoolArray:
    """Tell of each stride whether it stayed on one floor, shape (k - 1,)."""
    change = np.diff(places, axis=0)
    along = np.hypot(change[:, 0], change[:, 1])
    least = np.maximum(options.step_m, options.slope * along)
    tilted = np.abs(change[:, 2]) >= least
    # A ramp or a stair begins and ends within a stride: those beside are free as well.
    beside = tilted.copy()
    beside[1:] |= tilted[:-1]
    beside[:-1] |= tilted[1:]
    return ~beside
