"""Noise coefficients in the units of data sheets, as rows of text for tables and terminals."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.calibration.noise_model import (
    CoefficientName,
    NoiseCoefficient,
    NoiseModel,
    SensorNoise,
)
from imu_rig.report.numbers import decimals_for, duration, fixed, significant
from imu_rig.units import DEG, STANDARD_GRAVITY

MICRO_G = 1e-6 * STANDARD_GRAVITY
HOUR = 3600.0
ROOT_HOUR = 60.0
NANOTESLA = 1e-3


@dataclass(frozen=True)
class FieldUnit:
    """A coefficient as data sheets state it: divide the SI value by ``factor``."""

    name: str
    coefficient: CoefficientName
    unit: str
    factor: float


@dataclass(frozen=True)
class SensorUnits:
    """Title, unit of the Allan deviation and units of the coefficients of one sensor."""

    title: str
    unit: str
    factor: float
    rows: tuple[FieldUnit, ...]


UNITS = {
    "accel": SensorUnits(
        "Accelerometer",
        "µg",
        MICRO_G,
        (
            FieldUnit("White noise", "white", "µg/√Hz", MICRO_G),
            FieldUnit("Velocity random walk", "white", "m/s/√h", 1.0 / ROOT_HOUR),
            FieldUnit("Bias instability", "instability", "µg", MICRO_G),
            FieldUnit("Random walk of the bias", "walk", "µg/√h", MICRO_G / ROOT_HOUR),
            FieldUnit("Quantization", "quantization", "mm/s", 1e-3),
            FieldUnit("Steady drift", "ramp", "µg/h", MICRO_G / HOUR),
        ),
    ),
    "gyro": SensorUnits(
        "Gyroscope",
        "deg/h",
        DEG / HOUR,
        (
            FieldUnit("White noise", "white", "deg/s/√Hz", DEG),
            FieldUnit("Angle random walk", "white", "deg/√h", DEG / ROOT_HOUR),
            FieldUnit("Bias instability", "instability", "deg/h", DEG / HOUR),
            FieldUnit("Rate random walk", "walk", "deg/h/√h", DEG / HOUR / ROOT_HOUR),
            FieldUnit("Quantization", "quantization", "deg", DEG),
            FieldUnit("Steady drift", "ramp", "deg/h/h", DEG / HOUR**2),
        ),
    ),
    "mag": SensorUnits(
        "Magnetometer",
        "nT",
        NANOTESLA,
        (
            FieldUnit("White noise", "white", "nT/√Hz", NANOTESLA),
            FieldUnit("Bias instability", "instability", "nT", NANOTESLA),
            FieldUnit("Random walk of the bias", "walk", "nT/√h", NANOTESLA / ROOT_HOUR),
            FieldUnit("Quantization", "quantization", "nT s", NANOTESLA),
            FieldUnit("Steady drift", "ramp", "nT/h", NANOTESLA / HOUR),
        ),
    ),
}


def noise_sensors(model: NoiseModel) -> tuple[tuple[SensorUnits, SensorNoise], ...]:
    """Return the sensors that the model knows, in their order."""
    found: dict[str, SensorNoise | None] = {
        "accel": model.accel,
        "gyro": model.gyro,
        "mag": model.mag,
    }
    return tuple((UNITS[name], noise) for name, noise in found.items() if noise is not None)


def noise_rows(units: SensorUnits, noise: SensorNoise) -> list[tuple[str, str, str, str]]:
    """Rows of a name with its unit and a text for each axis.

    Quantization and drift have a row only where they are seen.
    """
    rows = []
    for row in units.rows:
        found: list[NoiseCoefficient] = [getattr(axis, row.coefficient) for axis in noise]
        if row.coefficient in ("quantization", "ramp") and all(c.value is None for c in found):
            continue
        x, y, z = (_estimate(coefficient, row.factor) for coefficient in found)
        rows.append((f"{row.name} [{row.unit}]", x, y, z))
    x, y, z = (significant(axis.floor / units.factor) for axis in noise)
    rows.append((f"Smallest Allan deviation [{units.unit}]", x, y, z))
    x, y, z = (duration_of(axis.floor_s) for axis in noise)
    rows.append(("  at an averaging time of", x, y, z))
    return rows


def duration_of(seconds: float) -> str:
    """Return an averaging time: three digits below two minutes."""
    return f"{significant(seconds)} s" if seconds < 120.0 else duration(seconds)


def _estimate(coefficient: NoiseCoefficient, factor: float) -> str:
    if coefficient.value is None or coefficient.standard_uncertainty is None:
        return f"< {significant(coefficient.high / factor, 2)}"
    sigma = coefficient.standard_uncertainty / factor
    decimals = decimals_for(sigma)
    return f"{fixed(coefficient.value / factor, decimals)} ± {fixed(sigma, decimals)}"
