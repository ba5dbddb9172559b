"""Readings that no sensor can give, refused before any arithmetic overflows."""

from __future__ import annotations

import numpy as np

from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError

LARGEST = 1e7
"""No sensor reads more, in SI units; squares of much larger numbers overflow."""


def require_readings(block: ImuBlock) -> None:
    """Refuse samples with which no figure can be worked out.

    Raises
    ------
    DataError
        No samples, values that are not numbers, or larger ones than any accelerometer or gyroscope
        reads. A magnetometer is judged where it is calibrated: it is never in the others' way.
    """
    if not len(block):
        raise DataError("the recording holds no samples, so record the sensor at rest first")
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
