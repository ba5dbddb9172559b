"""What temperature does to a sensor, as values: linear slopes about a reference temperature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Slopes:
    """Change of one kind of parameter per degree, three axes.

    Attributes
    ----------
    value, sigma : shape (3,)
        Estimate and its standard uncertainty.
    offered : shape (3,)
        Axes whose slope the data determine well enough to correct with.
    """

    value: FloatArray
    sigma: FloatArray
    offered: BoolArray

    @property
    def applied(self) -> FloatArray:
        """Slopes (3,) to correct with: zero where none is offered."""
        return np.where(self.offered, self.value, 0.0)


@dataclass(frozen=True, eq=False)
class TemperatureTerm:
    """Linear dependence on temperature: ``(1 + scale dT) K raw - b - bias dT``.

    Attributes
    ----------
    reference_c : float
        Temperature at which K and b hold [degC]; ``dT`` counts from here.
    low_c, high_c : float
        Temperatures that were measured [degC].
    accel_bias : Slopes
        m/s^2 per degree.
    accel_scale : Slopes or None
        1 per degree; None where the poses do not tell it from the bias.
    gyro_bias : Slopes or None
        rad/s per degree; None without a calibrated gyroscope.
    """

    reference_c: float
    low_c: float
    high_c: float
    accel_bias: Slopes
    accel_scale: Slopes | None
    gyro_bias: Slopes | None

    @property
    def is_offered(self) -> bool:
        """Whether any axis has a slope to correct with."""
        every = (self.accel_bias, self.accel_scale, self.gyro_bias)
        return any(bool(slopes.offered.any()) for slopes in every if slopes is not None)


def warmth(temperature: FloatArray, reference_c: float, low_c: float, high_c: float) -> FloatArray:
    """Degrees (n, 1) from the reference, for a line that was measured from ``low_c`` to ``high_c``.

    The line is followed as far beyond its ends as it is long, no further. Sensors that send their
    temperature less often than their samples have not a number between: the last that was sent
    holds until the next, the first also before it. Where none was sent nothing is corrected.
    """
    span = high_c - low_c
    known = _held(temperature, reference_c)
    return np.asarray(np.clip(known, low_c - span, high_c + span) - reference_c)[:, None]


def _held(values: FloatArray, otherwise: float) -> FloatArray:
    """Return each value or the last finite one before it, the first of them before all."""
    finite = np.isfinite(values)
    if not np.any(finite):
        return np.full(len(values), otherwise)
    last = np.maximum.accumulate(np.where(finite, np.arange(len(values)), -1))
    return np.asarray(values[np.where(last < 0, int(np.argmax(finite)), last)])


def at_reference(
    calibrated: FloatArray, b: FloatArray, dT: FloatArray, bias: FloatArray, scale: FloatArray
) -> FloatArray:
    """Correct calibrated readings ``K raw - b`` (n, 3) for temperature.

    Parameters
    ----------
    calibrated : shape (n, 3)
    b : shape (3,)
        Offset of the calibration.
    dT : shape (n, 1)
        Degrees from the reference.
    bias, scale : shape (3,)
        Slopes per degree.
    """
    return np.asarray(calibrated + dT * (scale * (calibrated + b) - bias))
