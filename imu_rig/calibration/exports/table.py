"""A table of every parameter: name, value, unit, standard uncertainty."""

from __future__ import annotations

from imu_rig.calibration.exports.exported import Exported
from imu_rig.calibration.exports.options import ExportOptions
from imu_rig.calibration.exports.source import UNITS, Source
from imu_rig.calibration.model import AXES, physical_figures

HEADER = "parameter,value,unit,standard_uncertainty"


def table(source: Source, options: ExportOptions) -> Exported:
    """Write CSV; a standard uncertainty of 0 belongs to what a convention fixed.

    A row ``accel_calibrated`` or ``gyro_calibrated`` of 0 stands for a sensor without rows.
    """
    rows: list[tuple[str, float, str, float | None]] = []
    if source.has_accel:
        rows.append(("gravity", source.gravity, "m/s^2", None))
    for sensor in ("accel", "gyro"):
        if sensor not in source.sensors:
            rows.append((f"{sensor}_calibrated", 0.0, "1", None))
    for sensor, model in source.sensors.items():
        unit = UNITS[sensor]
        for i, a in enumerate(AXES):
            for j, c in enumerate(AXES):
                rows.append((f"{sensor}_K_{a}{c}", model.K[i, j], "1", model.K_uncertainty[i, j]))
        for i, a in enumerate(AXES):
            rows.append((f"{sensor}_b_{a}", model.b[i], unit, model.b_uncertainty[i]))
        own = sensor == "accel" or (sensor == "mag" and not source.mag_aligned)
        found = physical_figures(model, None if own else source.accel)
        angles = found.angles.replace("-", "_")
        columns = (
            ("scale_error", AXES, found.scale_percent, "%", found.scale_percent_u),
            (angles, found.cross_names, found.cross_rad, "rad", found.cross_rad_u),
            ("bias", AXES, found.bias, unit, found.bias_u),
        )
        for name, labels, values, of, sigmas in columns:
            for label, value, sigma in zip(labels, values, sigmas, strict=True):
                rows.append((f"{sensor}_{name}_{label}", value, of, sigma))
    lines = [HEADER]
    for name, value, unit, sigma in rows:
        u = "" if sigma is None else repr(float(sigma))
        lines.append(f"{name},{float(value) + 0.0!r},{unit},{u}")
    return Exported("\n".join(lines) + "\n")
