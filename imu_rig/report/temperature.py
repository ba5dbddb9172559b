"""Temperature in a calibration report: what a degree changes, where the recording tells it."""

from __future__ import annotations

from imu_rig.calibration.result import CalibrationResult
from imu_rig.calibration.temperature_term import Slopes
from imu_rig.report.numbers import decimals_for, fixed
from imu_rig.report.page import Html, element, section, table
from imu_rig.units import DEG, MILLI_G


def temperature_section(result: CalibrationResult) -> Html:
    """Return the section, or nothing where no term was determined."""
    term = result.temperature
    if term is None:
        return Html("")
    kinds: tuple[tuple[str, Slopes | None, float], ...] = (
        ("Accelerometer bias [mg/°C]", term.accel_bias, MILLI_G),
        ("Accelerometer scale [%/°C]", term.accel_scale, 0.01),
        ("Gyroscope bias [(deg/s)/°C]", term.gyro_bias, DEG),
    )
    rows = [
        (name, *(_slope(slopes, i, unit) for i in range(3)))
        for name, slopes, unit in kinds
        if slopes is not None
    ]
    applied = (
        "Slopes marked ✓ are determined well enough; the certificate corrects with them."
        if term.is_offered
        else "None is determined well enough to correct with."
    )
    return section(
        "Temperature",
        element(
            "p",
            f"The recording spans {fixed(term.low_c, 1)} to {fixed(term.high_c, 1)} °C. K and b "
            f"hold at {fixed(term.reference_c, 1)} °C. {applied}",
        ),
        table(("Change per degree", "x", "y", "z"), rows),
        element("p", "With standard uncertainties.", class_="note"),
    )


def _slope(slopes: Slopes, axis: int, unit: float) -> str:
    value, sigma = float(slopes.value[axis]) / unit, float(slopes.sigma[axis]) / unit
    decimals = decimals_for(sigma)
    mark = " ✓" if slopes.offered[axis] else ""
    return f"{fixed(value, decimals, sign=True)} ± {fixed(sigma, decimals)}{mark}"
