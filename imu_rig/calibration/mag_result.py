"""What the calibration of a magnetometer found, as values for reports, certificates and tests."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from imu_rig.arrays import FloatArray
from imu_rig.calibration.model import Affine

Alignment = Literal["none", "dip", "attitudes"]
"""What told the magnetometer's axes from the accelerometer's: nothing, the field's constant angle
to gravity, or the field's constant direction over known attitudes."""


@dataclass(frozen=True, eq=False)
class MagPoints:
    """Evidence for figures: the readings, or an even choice of ``k`` of them.

    Attributes
    ----------
    t : shape (k,)
        Time [s], on the time of the block.
    direction : shape (k, 3)
        Unit vector of the calibrated field, in the axes of K.
    before, after, left_out : shape (k,)
        Magnitude over its mean, or over the field, less 1: raw, calibrated, and calibrated by a
        fit that never saw the reading.
    """

    t: FloatArray
    direction: FloatArray
    before: FloatArray
    after: FloatArray
    left_out: FloatArray


@dataclass(frozen=True, eq=False)
class MagResult:
    """A calibrated magnetometer.

    Attributes
    ----------
    affine : Affine
        ``calibrated = K @ raw - b`` [uT], in the axes of the calibrated accelerometer unless
        ``alignment`` is ``"none"``; then K is symmetric.
    alignment : str
        One of `Alignment`.
    field_ut : float
        Magnitude that the calibrated field has.
    field_known : bool
        Whether that was given; otherwise K's mean gain is taken as 1, and the scale of calibrated
        readings is as uncertain as the sensor's own.
    dip_rad, dip_u : float or None
        Angle of the field below the horizontal and its standard uncertainty.
    alignment_u : float or None
        Largest standard uncertainty of the rotation between the two sensors [rad].
    direction_u : float or None
        Standard uncertainty per axis of the direction of a calibrated reading [rad], root mean
        square over all directions; None without alignment.
    from_stills : bool
        Whether ``count`` counts still poses, or single samples.
    count : int
        Readings that the fit rests on.
    before_percent, residual_percent, left_out_percent : float
        Root mean square error of the magnitude: raw, calibrated, and left out of the fit [%].
    points : MagPoints
        The readings themselves.
    warnings : tuple of str
        One sentence each.
    notes : tuple of str
        What the figures mean and what they cannot show, one sentence each.
    """

    affine: Affine
    alignment: Alignment
    field_ut: float
    field_known: bool
    dip_rad: float | None
    dip_u: float | None
    alignment_u: float | None
    direction_u: float | None
    from_stills: bool
    count: int
    before_percent: float
    residual_percent: float
    left_out_percent: float
    points: MagPoints
    warnings: tuple[str, ...] = field(default=())
    notes: tuple[str, ...] = field(default=())
