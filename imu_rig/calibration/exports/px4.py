"""PX4 parameters, as a file that QGroundControl loads.

PX4 applies ``(raw - OFF) * SCALE`` to the accelerometer [m/s^2], ``raw - OFF`` to the gyroscope
[rad/s] and ``M @ (raw - OFF)`` with a symmetric M to the magnetometer [gauss].
"""

from __future__ import annotations

from imu_rig.calibration.exports.autopilot import (
    comments,
    number,
    off_diagonal,
    stored,
    within,
)
from imu_rig.calibration.exports.exported import Exported
from imu_rig.calibration.exports.options import ExportOptions
from imu_rig.calibration.exports.source import Source
from imu_rig.calibration.model import AXES
from imu_rig.errors import InputError
from imu_rig.units import FIELD_UNITS

NAME = "PX4"
SLOTS = 4
SCALES = (0.1, 3.0)
"""PX4 refuses a scale outside."""
INT32, REAL32 = 6, 9
"""MAV_PARAM_TYPE of the two kinds of parameters."""
GROUPS = {"accel": "ACC", "gyro": "GYRO", "mag": "MAG"}


def px4(source: Source, options: ExportOptions) -> Exported:
    """Write a QGroundControl ``.params`` file: vehicle, component, name, value, type by tabs."""
    if not 0 <= options.slot < SLOTS:
        raise InputError(f"{NAME} has sensors 0 to {SLOTS - 1} of a kind, not {options.slot}.")
    kept = stored(source, options, NAME)
    rows: list[tuple[str, str, int]] = []
    missing = [name for name in kept.models if name not in options.device_ids]
    for sensor, model in kept.models.items():
        prefix = f"CAL_{GROUPS[sensor]}{options.slot}_"
        if sensor in options.device_ids:
            rows.append((f"{prefix}ID", str(options.device_ids[sensor]), INT32))
        unit = FIELD_UNITS["gauss"] if sensor == "mag" else 1.0
        for i, axis in enumerate(AXES):
            name = f"{prefix}{axis.upper()}OFF"
            rows.append((name, number(model.offset[i] / unit), REAL32))
        if sensor == "gyro":
            continue
        for i, axis in enumerate(AXES):
            name = f"{prefix}{axis.upper()}SCALE"
            value = within(name, float(model.M[i, i]), *SCALES, NAME)
            rows.append((name, number(value), REAL32))
        if sensor == "mag":
            others = zip(AXES, off_diagonal(model.M), strict=True)
            rows += [(f"{prefix}{a.upper()}ODIAG", number(v), REAL32) for a, v in others]
    notes = []
    if missing:
        ids = ", ".join(f"CAL_{GROUPS[name]}{options.slot}_ID" for name in missing)
        notes.append(
            f"{NAME} ignores a set whose id is not that of the sensor: look that the vehicle has "
            f"the right {ids}, or give --device-id."
        )
    lines = ["# Onboard parameters for Vehicle 1", "#", "# Stack: PX4 Pro", "#"]
    lines += comments(source, kept, options, notes)
    lines += ["#", "# Vehicle-Id Component-Id Name Value Type"]
    lines += [f"1\t1\t{name}\t{value}\t{kind}" for name, value, kind in rows]
    return Exported("\n".join(lines) + "\n", kept.loss, tuple(notes))
