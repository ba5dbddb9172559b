"""Trials of pyshoe, the Toronto set of foot-mounted recordings, as MATLAB files."""

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
    require_finite,
    require_increasing,
)
from imu_rig.reference.reference import Reference

NAME = "pyshoe"
ACCEL_COLUMNS, GYRO_COLUMNS = slice(0, 3), slice(3, 6)
TO_RIGHT_HANDED = np.array([1.0, -1.0, 1.0])
FARTHEST_M = 1e6
RATES_HZ = (2.0, 20_000.0)
_FRAME = (
    "position of the foot, z up; the file states it in a left-handed frame, here its y is turned, "
    "which makes it right-handed; heading and origin have no tie to the sensor's"
)


def matches(file: MatlabFile) -> bool:
    """Whether it has the matrices of such a trial."""
    return {"imu", "ts"} <= set(file.shapes)


def load(file: MatlabFile) -> ForeignRecording:
    """Read a trial, which is always in SI units."""
    path = file.path
    truth = {"gt": 3} if "gt" in file.shapes else {}
    matrices = read_matrices(file, {"imu": 6, "ts": 1} | truth)
    imu, t = matrices["imu"], matrices["ts"]
    require_finite(path, "imu", imu)
    require_finite(path, "ts", t)
    require_increasing(path, "ts", t)
    rate = 1.0 / float(np.median(np.diff(t)))
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise InputError(f"{path}: by ts the rate is {rate:.3g} Hz: ts must be in seconds")
    accel = imu[:, ACCEL_COLUMNS].copy()
    t = t - t[0]
    values = {"accel": accel, "gyro": imu[:, GYRO_COLUMNS].copy()}
    samples = Samples(t, t, t, None, values, {"accel": "m/s2", "gyro": "rad/s"})
    notes = [f"the sensor's own axes are kept: {_upright(accel[:, 2])}"]
    reference = None
    if truth:
        _require_metres(path, matrices["gt"])
        reference = Reference(t, position=matrices["gt"] * TO_RIGHT_HANDED, frame=_FRAME)
        notes.append("gt is left-handed in the file; its y is turned, so that it is right-handed")
    if any(name.startswith("zv_") for name in file.shapes):
        notes.append("zv_* are left out: their thresholds were tuned on the truth")
    return ForeignRecording(
        format=NAME,
        files=(path,),
        streams={"foot": samples},
        reference=reference,
        notes=tuple(notes),
    )


def _require_metres(path: Path, position: FloatArray) -> None:
    far = np.flatnonzero(np.any(np.abs(position) > FARTHEST_M, axis=1))
    if len(far):
        raise InputError(f"{path}: row {far[0] + 1} of gt lies farther away than anybody walks")


def _upright(z: FloatArray) -> str:
    mean = float(z.mean())
    way = "down" if mean < 0 else "up"
    return f"z points {way} on the whole (it reads {mean:+.1f} m/s2 on average)"
