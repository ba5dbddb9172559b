"""The magnetometer's lines in a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imu_rig.units import DEG

if TYPE_CHECKING:
    from imu_rig.calibration.mag_result import MagResult

ERROR_WIDTH = 33
"""Of the labels of errors."""


def magnetometer_errors(mag: MagResult) -> str:
    """Return the line of the errors of the field's magnitude."""
    return (
        f"  {'magnetic field, rms [%]':{ERROR_WIDTH}}{mag.before_percent:.3f} raw   "
        f"{mag.residual_percent:.3f} fitted   {mag.left_out_percent:.3f} left out"
    )


def magnetometer_lines(mag: MagResult) -> list[str]:
    """Lines that tell the field that was found, and how well the axes are known."""
    stated = "stated" if mag.field_known else "by a mean gain of 1"
    lines = [f"  magnetic field {mag.field_ut:.2f} uT ({stated}), from {counted_readings(mag)}"]
    if mag.dip_rad is not None and mag.dip_u is not None:
        sense = "below" if mag.dip_rad >= 0 else "above"
        lines.append(
            f"  it points {abs(mag.dip_rad) / DEG:.2f} deg {sense} the horizontal "
            f"(std. unc. {mag.dip_u / DEG:.2f})"
        )
    if mag.alignment_u is not None and mag.direction_u is not None:
        lines += [
            f"  std. unc. of its axes against the accelerometer's {mag.alignment_u / DEG:.2f} deg,",
            f"  of the direction of a calibrated reading {mag.direction_u / DEG:.2f} deg",
        ]
    return lines


def counted_readings(mag: MagResult) -> str:
    """Name what the magnetometer was calibrated from."""
    return f"{mag.count} {'still poses' if mag.from_stills else 'samples'}"
