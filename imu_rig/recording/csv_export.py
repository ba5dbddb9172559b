"""Samples as CSV: one row per sample, units in the header, gaps left as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imu_rig.blocks import ImuBlock
from imu_rig.files import whole_file

ROWS_AT_A_TIME = 20_000


def write_csv(path: Path, block: ImuBlock) -> None:
    """Write ``block`` to a new file.

    Raises
    ------
    InputError
        If the file exists or its folder does not.
    StorageError
        If the disk is full or fails; no file is left then.
    """
    names = ["t_s", "accel_x_mps2", "accel_y_mps2", "accel_z_mps2"]
    names += ["gyro_x_radps", "gyro_y_radps", "gyro_z_radps"]
    columns = [block.t[:, None], block.accel, block.gyro]
    formats = ["%.6f"] + ["%.7g"] * 6
    if block.mag is not None:
        names += ["mag_x_uT", "mag_y_uT", "mag_z_uT"]
        columns.append(block.mag)
        formats += ["%.6g"] * 3
    if block.temperature is not None:
        names.append("temperature_degC")
        columns.append(block.temperature[:, None])
        formats.append("%.2f")
    if block.counter is not None:
        names.append("counter")
        columns.append(block.counter[:, None].astype(float))
        formats.append("%d")
    with whole_file(path, what="an exported table") as file:
        file.write((",".join(names) + "\n").encode())
        for start in range(0, len(block), ROWS_AT_A_TIME):
            rows = slice(start, start + ROWS_AT_A_TIME)
            part = np.concatenate([column[rows] for column in columns], axis=1)
            np.savetxt(file, part, fmt=formats, delimiter=",")
