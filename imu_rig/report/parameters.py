"""The calibration's parameters in human units, with uncertainty and, in simulation, the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.model import Affine, PhysicalFigures, physical_figures
from imu_rig.calibration.result import CalibrationResult
from imu_rig.report.facts import Truth
from imu_rig.units import DEG, MILLI_G

MILLIRADIAN = 1e-3
FIXED_BELOW = 1e-12
"""A standard uncertainty below this belongs to what a convention or the method fixed."""
NORMAL_95 = 1.96
"""From the standard uncertainty of many readings to half the width of a 95 % interval."""


@dataclass(frozen=True)
class Parameter:
    """One parameter in the unit of its group.

    Attributes
    ----------
    name : str
        Axis, or two axes of which the first senses toward the second.
    value, uncertainty : float
        Estimate and its standard uncertainty; 0 where the value is fixed, not estimated.
    half_width : float
        Half the width of the 95 % interval.
    truth : float or None
        The true value, where a simulation knows it.
    """

    name: str
    value: float
    uncertainty: float
    half_width: float
    truth: float | None = None

    @property
    def is_fixed(self) -> bool:
        """Whether the value was set, not estimated."""
        return not self.uncertainty > 0.0

    @property
    def error_in_uncertainties(self) -> float | None:
        """Error over standard uncertainty; None without a truth or for a fixed value."""
        if self.truth is None or self.is_fixed:
            return None
        return (self.value - self.truth) / self.uncertainty

    @property
    def holds_truth(self) -> bool | None:
        """Whether the 95 % interval contains the truth."""
        if self.truth is None or self.is_fixed:
            return None
        return abs(self.value - self.truth) <= self.half_width


@dataclass(frozen=True)
class ParameterGroup:
    """Parameters of one kind and unit."""

    name: str
    unit: str
    parameters: tuple[Parameter, ...]

    @property
    def largest_uncertainty(self) -> float:
        """Largest standard uncertainty of the group; 0 where all are fixed."""
        return max(parameter.uncertainty for parameter in self.parameters)


@dataclass(frozen=True)
class Sensor:
    """All parameters of the accelerometer or the gyroscope: scale, directions, bias."""

    name: str
    scale: ParameterGroup
    directions: ParameterGroup
    bias: ParameterGroup

    @property
    def groups(self) -> tuple[ParameterGroup, ...]:
        """The groups in the order of every table and figure."""
        return (self.scale, self.directions, self.bias)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters in that order."""
        return tuple(p for group in self.groups for p in group.parameters)


def sensors(result: CalibrationResult, truth: Truth | None = None) -> tuple[Sensor, ...]:
    """Return the accelerometer and the gyroscope, as far as they were calibrated.

    Estimates and truth are compared as figures of the sensor itself, in which the frame of
    either K has no part; a gyroscope's axes count relative to those of its accelerometer.
    """
    if result.only_magnetometer:
        return ()
    found = []
    if result.has_accel:
        true_accel = None if truth is None else physical_figures(truth.accel)
        found.append(accelerometer(result.accel, true_accel))
    if result.gyro is not None and result.gyro_figures is not None:
        true_gyro = (
            None
            if truth is None or truth.gyro is None
            else physical_figures(truth.gyro, truth.accel)
        )
        found.append(
            _sensor(
                "Gyroscope", result.gyro, result.gyro_figures, true_gyro,
                (DEG, "deg/s"),
            )
        )  # fmt: skip
    return tuple(found)


def accelerometer(affine: Affine, truth: PhysicalFigures | None = None) -> Sensor:
    """Return the parameters of an accelerometer, beside the true ones where known."""
    kind = (MILLI_G, "mg")
    return _sensor("Accelerometer", affine, physical_figures(affine), truth, kind)


def magnetometer_sensor(result: CalibrationResult) -> Sensor | None:
    """Return the magnetometer, whose axes count relative to those of its accelerometer."""
    if result.mag is None or result.mag_figures is None:
        return None
    kind = (1.0, "µT")
    return _sensor("Magnetometer", result.mag.affine, result.mag_figures, None, kind)


def _sensor(
    name: str,
    affine: Affine,
    figures: PhysicalFigures,
    truth: PhysicalFigures | None,
    kind: tuple[float, str],
) -> Sensor:
    bias_unit, bias_unit_name = kind
    arrows = [f"{name[0]} → {name[1]}" for name in figures.cross_names]
    factor = affine.coverage_factor
    true: tuple[FloatArray | None, ...] = (None, None, None)
    if truth is not None:
        true = (truth.scale_percent, truth.cross_rad, truth.bias)

    def group(
        title: str,
        unit: str,
        names: Sequence[str],
        scale: float,
        value: FloatArray,
        uncertainty: FloatArray,
        true: FloatArray | None,
    ) -> ParameterGroup:
        kind = (title, unit, scale)
        return parameter_group(kind, names, value, uncertainty, true, factor=factor)

    return Sensor(
        name,
        group(
            "Scale error", "%", "xyz", 1.0,
            figures.scale_percent, figures.scale_percent_u, true[0],
        ),
        group(
            figures.angles.capitalize(), "mrad", arrows, MILLIRADIAN,
            figures.cross_rad, figures.cross_rad_u, true[1],
        ),
        group(
            "Bias", bias_unit_name, "xyz", bias_unit,
            figures.bias, figures.bias_u, true[2],
        ),
    )  # fmt: skip


def parameter_group(
    kind: tuple[str, str, float],
    names: Sequence[str],
    value: Sequence[float] | FloatArray,
    uncertainty: Sequence[float] | FloatArray,
    truth: Sequence[float | None] | FloatArray | None = None,
    *,
    factor: float = NORMAL_95,
) -> ParameterGroup:
    """Make a group of its title, unit and the unit's size; SI values and standard uncertainties.

    ``factor`` is that from standard uncertainty to half the width of the 95 % interval.
    """
    title, unit, scale = kind
    sigma = np.asarray(uncertainty, dtype=float)
    sigma = np.where(sigma < FIXED_BELOW, 0.0, sigma) / scale
    true = [None] * len(names) if truth is None else [*truth]
    return ParameterGroup(
        title,
        unit,
        tuple(
            Parameter(
                name=label,
                value=float(value[i] / scale),
                uncertainty=float(sigma[i]),
                half_width=float(factor * sigma[i]),
                truth=None if known is None else float(known / scale),
            )
            for i, (label, known) in enumerate(zip(names, true, strict=True))
        ),
    )


@dataclass(frozen=True)
class TruthComparison:
    """How well the stated uncertainties cover the truth."""

    compared: int
    inside: int
    rms: float


def compare_with_truth(found: tuple[Sensor, ...]) -> TruthComparison | None:
    """Count intervals that hold the truth; None where no truth is known."""
    judged = [p for sensor in found for p in sensor.parameters if p.holds_truth is not None]
    if not judged:
        return None
    ratios = [p.error_in_uncertainties or 0.0 for p in judged]
    return TruthComparison(
        compared=len(judged),
        inside=sum(bool(p.holds_truth) for p in judged),
        rms=math.sqrt(sum(r * r for r in ratios) / len(ratios)),
    )
