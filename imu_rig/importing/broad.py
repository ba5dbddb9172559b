"""Trials of BROAD, the Berlin benchmark of orientation estimation, as MATLAB files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import Samples
from imu_rig.errors import InputError
from imu_rig.importing.foreign import ForeignRecording
from imu_rig.importing.matlab_file import (
    MatlabFile,
    read_matrices,
    read_number,
    require_finite,
)
from imu_rig.reference.reference import Reference

NAME = "broad"
_NEEDED = {"imu_acc": 3, "imu_gyr": 3}
_OPTIONAL = {"imu_mag": 3, "opt_quat": 4, "opt_pos": 3, "movement": 1}
_FRAME = (
    "opt_quat turns sensor axes to east, north, up, north being magnetic; NaN where the cameras "
    "lost the sensor"
)
RATES_HZ = (2.0, 20_000.0)
NORM_AGREES = 0.01


def matches(file: MatlabFile) -> bool:
    """Whether it has the matrices of such a trial."""
    return {*_NEEDED, "sampling_rate"} <= set(file.shapes)


def load(file: MatlabFile) -> ForeignRecording:
    """Read a trial, which is always in SI units."""
    path = file.path
    there = _NEEDED | {n: c for n, c in _OPTIONAL.items() if n in file.shapes}
    matrices = read_matrices(file, there)
    rate = read_number(file, "sampling_rate")
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise InputError(f"{path}: its sampling_rate is {rate:g}, which is no rate in Hz")
    for name in ("imu_acc", "imu_gyr", "imu_mag"):
        if name in matrices:
            require_finite(path, name, matrices[name])
    t = np.arange(len(matrices["imu_acc"])) / rate
    values = {"accel": matrices["imu_acc"], "gyro": matrices["imu_gyr"]}
    units = {"accel": "m/s2", "gyro": "rad/s"}
    if "imu_mag" in matrices:
        values["mag"], units["mag"] = matrices["imu_mag"], "uT"
    reference = None
    orientation, position = matrices.get("opt_quat"), matrices.get("opt_pos")
    if orientation is not None:
        _require_unit(path, orientation)
    if orientation is not None or position is not None:
        moving = matrices.get("movement")
        reference = Reference(
            t, position, orientation, None if moving is None else moving != 0, _FRAME
        )
    return ForeignRecording(
        format=NAME,
        files=(path,),
        streams={"imu": Samples(t, t, None, None, values, units)},
        reference=reference,
        notes=("it has no time stamps: samples are taken to be exactly uniform",),
    )


def _require_unit(path: Path, orientation: FloatArray) -> None:
    # Clipped, for a damaged number may be too large to be squared.
    norm = np.linalg.norm(np.clip(orientation, -10.0, 10.0), axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1.0) > NORM_AGREES)
    if len(wrong):
        raise InputError(
            f"{path}: row {wrong[0] + 1} of opt_quat has the norm {norm[wrong[0]]:.4g}, which no "
            "rotation has"
        )
