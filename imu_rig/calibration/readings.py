"""Refuses readings that no sensor gives: not numbers, beyond any range, an axis that is dead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imu_rig.arrays import BoolArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError

LARGEST = 1e7
"""No sensor reads more, in SI units; squares of much larger numbers overflow."""
DEAD_S = 1.0
"""Noise never repeats a reading for so long."""
COARSE, COARSE_DEAD_S = 0.3, 20.0
"""An axis that repeats this share of its readings even while it is alive has less noise than
counts, and shows nothing while it rests or while another axis turns: for less than so long."""
ALIVE = 0.5
"""Share of samples that repeat the one before, below which a recording is not merely coarse."""


def require_readings(block: ImuBlock) -> ImuBlock:
    """Refuse samples with which no figure can be worked out, and return the others.

    Returns
    -------
    ImuBlock
        The block; a gyroscope that the device does not have, all of whose readings are NaN, reads
        zero in it, which shows nothing.

    Raises
    ------
    DataError
        No samples, no accelerometer, values that are not numbers, or larger ones than any
        accelerometer or gyroscope reads. A magnetometer is judged where it is calibrated: it is
        never in the others' way.
    """
    if not len(block):
        raise DataError("the recording holds no samples, so record the sensor at rest first")
    if np.all(np.isnan(block.accel)):
        raise DataError(
            "the recording holds no accelerometer, and gravity is what all else is measured by: "
            "record its readings too"
        )
    if np.all(np.isnan(block.gyro)):
        block = replace(block, gyro=np.zeros_like(block.gyro))
    if not (np.all(np.isfinite(block.accel)) and np.all(np.isfinite(block.gyro))):
        raise DataError(
            "the recording holds values that are not numbers: cut out their rows, or record anew"
        )
    for title, values, unit in (
        ("accelerometer", block.accel, "m/s^2"),
        ("gyroscope", block.gyro, "rad/s"),
    ):
        largest = float(np.max(np.abs(values)))
        if largest > LARGEST:
            raise DataError(
                f"the {title} reads up to {largest:.3g} {unit}, which no sensor does: its unit is "
                "wrong, or rows are damaged and must be cut out"
            )
    return block


def refuse_dead_axes(block: ImuBlock) -> None:
    """Refuse an axis that stands still while others are alive, or copies another one.

    A sensor that is absent, all its readings the same, is none; one that hangs as a whole for a
    while is dealt with elsewhere, and one with less noise than a count stands still at rest.

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
            elsewhere = np.delete(repeats[:, first + axis], np.arange(start, stop))
            coarse = len(elsewhere) > 0 and float(np.mean(elsewhere)) > COARSE
            if end - begin > (COARSE_DEAD_S if coarse else DEAD_S) and not limited:
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
