"""Refuses readings that no sensor gives: not numbers, beyond any range, an axis that is dead."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import BoolArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError

LARGEST = {"accelerometer": (1e6, "m/s^2"), "gyroscope": (1e6, "rad/s")}
"""Beyond any sensor's range in any unit, counts included; wrong units are told apart later."""
DEAD_S = 1.0
"""Noise never repeats a reading for so long."""
ALIVE = 0.5
"""Share of samples that repeat the one before, below which a recording is not merely coarse."""


def refuse_impossible_readings(block: ImuBlock) -> None:
    """Refuse what is no measurement.

    Raises
    ------
    DataError
        Values that are not numbers, or beyond any sensor's range, with where they are.
    """
    for name, values in (("accelerometer", block.accel), ("gyroscope", block.gyro)):
        bad: BoolArray = np.any(~np.isfinite(values), axis=1)
        if bad.any():
            raise DataError(
                f"the {name} has {int(bad.sum())} readings that are not numbers, first at "
                f"{_when(block, bad)}: take those samples out of the recording, or record again"
            )
        limit, unit = LARGEST[name]
        far: BoolArray = np.any(np.abs(values) > limit, axis=1)
        if far.any():
            raise DataError(
                f"the {name} reads {np.abs(values).max():.3g} {unit} at {_when(block, far)}, "
                "beyond the range of any such sensor: its unit is wrong or the sample is garbage"
            )


def refuse_dead_axes(block: ImuBlock) -> None:
    """Refuse an axis that stands still while others are alive, or copies another one.

    A sensor that is absent, all its readings the same, is none; one that hangs as a whole for a
    while is dealt with elsewhere.

    Raises
    ------
    DataError
        Naming the axis, and when it was dead.
    """
    if len(block) < 2:
        return
    both = np.concatenate((block.accel, block.gyro), axis=1)
    repeats = both[1:] == both[:-1]
    if repeats.mean(axis=0).min() > ALIVE:
        return
    hung = repeats.all(axis=1)
    for name, first in (("accelerometer", 0), ("gyroscope", 3)):
        values = both[:, first : first + 3]
        if not np.any(np.ptp(values, axis=0) > 0):
            continue
        for axis in range(3):
            start, stop = _longest(repeats[:, first + axis] & ~hung)
            begin, end = float(block.t[start]), float(block.t[stop])
            held, reach = float(values[start, axis]), values[:, axis]
            # At its range limit it is saturated, which is another matter.
            limited = held != 0.0 and held in (reach.min(), reach.max())
            if end - begin > DEAD_S and not limited:
                raise DataError(
                    f"axis {'xyz'[axis]} of the {name} repeats one value from {begin:.1f} to "
                    f"{end:.1f} s while others vary: that axis is dead or its connection broke; "
                    "mend it and record again"
                )
        for one, two in ((0, 1), (0, 2), (1, 2)):
            if np.array_equal(values[:, one], values[:, two]):
                raise DataError(
                    f"axes {'xyz'[one]} and {'xyz'[two]} of the {name} are the same numbers: give "
                    "each axis its own column"
                )


def _longest(same: BoolArray) -> tuple[int, int]:
    """First and last row of the longest run in which rows repeat the one before."""
    edges = np.diff(np.concatenate(([0], same.astype(np.int8), [0])))
    start, stop = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not len(start):
        return 0, 0
    i = int(np.argmax(stop - start))
    return int(start[i]), int(stop[i])


def _when(block: ImuBlock, rows: BoolArray) -> str:
    first = int(np.argmax(rows))
    return f"sample {first + 1} ({block.t[first]:.2f} s)"
