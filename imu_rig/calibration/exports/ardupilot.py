"""ArduPilot parameters, as a file that Mission Planner and MAVProxy load.

ArduPilot applies ``(raw - OFFS) * SCAL`` to the accelerometer [m/s^2], ``raw - OFFS`` to the
gyroscope [rad/s] and ``M @ (raw + OFS)`` with a symmetric M to the compass [mGauss]: only there
the offset is added.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imu_rig.calibration.exports.autopilot import (
    comments,
    number,
    off_diagonal,
    stored,
    within,
)
from imu_rig.calibration.exports.exported import Exported
from imu_rig.calibration.exports.options import ExportOptions
from imu_rig.calibration.exports.reduced import Reduced
from imu_rig.calibration.exports.source import Source
from imu_rig.calibration.model import AXES
from imu_rig.errors import InputError
from imu_rig.units import FIELD_UNITS

NAME = "ArduPilot"
SLOTS = 3
SCALES = (0.8, 1.2)
OFFSETS = (-3.5, 3.5)
"""ArduPilot takes an accelerometer outside for badly calibrated [m/s^2]."""
NOT_ZERO = 0.001
"""Offset [m/s^2] that stands for 0: all three at 0 would mean "not calibrated"."""
SMALLEST = 5e-7
"""Offsets that are all below count as 0."""


def ardupilot(source: Source, options: ExportOptions) -> Exported:
    """Write a parameter file of lines ``NAME,VALUE``."""
    if not 0 <= options.slot < SLOTS:
        raise InputError(f"{NAME} has sensors 0 to {SLOTS - 1} of a kind, not {options.slot}.")
    kept = stored(source, options, NAME)
    ordinal = "" if options.slot == 0 else str(options.slot + 1)
    rows: list[tuple[str, str]] = []
    notes: list[str] = []
    if "accel" in kept.models:
        accel = kept.models["accel"]
        if np.all(np.abs(accel.offset) < SMALLEST):
            accel = replace(accel, offset=np.array([NOT_ZERO, 0.0, 0.0]))
            notes.append(
                f"All offsets are 0, which {NAME} takes for not calibrated: INS_ACC{ordinal}OFFS_X "
                f"is {NOT_ZERO} m/s^2 instead."
            )
        rows += _accel(accel, ordinal, options.device_ids.get("accel"))
    if "gyro" in kept.models:
        rows += _gyro(kept.models["gyro"], ordinal, options.device_ids.get("gyro"))
        notes.append(
            f"{NAME} measures the gyroscope's offsets anew at each start unless INS_GYR_CAL is 0."
        )
    if "mag" in kept.models:
        rows += _compass(kept.models["mag"], ordinal, options.device_ids.get("mag"))
        notes.append(
            "The compass is calibrated in body axes, after its rotation; COMPASS_SCALE must be 0 "
            "or 1."
        )
    missing = [name for name in kept.models if name not in options.device_ids]
    if missing:
        notes.append(
            f"The file sets no id of {', '.join(missing)}: look that the vehicle has the right "
            "one, or give --device-id."
        )
    lines = comments(source, kept, options, notes)
    lines += [f"{name},{value}" for name, value in rows]
    return Exported("\n".join(lines) + "\n", kept.loss, tuple(notes))


def _accel(model: Reduced, ordinal: str, device_id: int | None) -> list[tuple[str, str]]:
    rows = [] if device_id is None else [(f"INS_ACC{ordinal}_ID", str(device_id))]
    for i, axis in enumerate(AXES):
        name = f"INS_ACC{ordinal}OFFS_{axis.upper()}"
        rows.append((name, number(within(name, float(model.offset[i]), *OFFSETS, NAME))))
    for i, axis in enumerate(AXES):
        name = f"INS_ACC{ordinal}SCAL_{axis.upper()}"
        rows.append((name, number(within(name, float(model.M[i, i]), *SCALES, NAME))))
    return rows


def _gyro(model: Reduced, ordinal: str, device_id: int | None) -> list[tuple[str, str]]:
    rows = [] if device_id is None else [(f"INS_GYR{ordinal}_ID", str(device_id))]
    stem = f"INS_GYR{ordinal}OFFS_" if ordinal else "INS_GYROFFS_"
    return rows + [(f"{stem}{a.upper()}", number(model.offset[i])) for i, a in enumerate(AXES)]


def _compass(model: Reduced, ordinal: str, device_id: int | None) -> list[tuple[str, str]]:
    rows = [] if device_id is None else [(f"COMPASS_DEV_ID{ordinal}", str(device_id))]
    values = {
        "OFS": -model.offset / FIELD_UNITS["mG"],
        "DIA": np.diag(model.M),
        "ODI": np.array(off_diagonal(model.M)),
    }
    for group, vector in values.items():
        rows += [
            (f"COMPASS_{group}{ordinal}_{axis.upper()}", number(float(value)))
            for axis, value in zip(AXES, vector, strict=True)
        ]
    return rows
