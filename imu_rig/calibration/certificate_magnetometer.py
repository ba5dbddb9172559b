"""The part of a certificate that holds the magnetometer."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from imu_rig.calibration.certificate_parts import AffineEntry, Part
from imu_rig.calibration.mag_result import Alignment, MagResult

MAG_BIAS_LIMIT = 5000.0
"""No magnetometer of the class can read more than this [uT]."""


class MagEntry(Part):
    """A magnetometer: ``calibrated = K @ raw - b`` [uT], and how well that is known.

    Angles in radian. ``alignment`` says what told its axes from the accelerometer's; with
    ``"none"`` the K is symmetric and the readings are not in the accelerometer's axes. Where
    ``field_known`` is false, the mean gain was taken as 1.
    """

    raw_unit: Literal["uT"] = "uT"
    affine: AffineEntry
    alignment: Alignment
    field_ut: float = Field(gt=0)
    field_known: bool
    dip: float | None = None
    dip_standard_uncertainty: float | None = Field(default=None, ge=0)
    alignment_standard_uncertainty: float | None = Field(default=None, ge=0)
    direction_standard_uncertainty: float | None = Field(default=None, ge=0)
    from_stills: bool
    count: int = Field(ge=1)
    before_percent: float = Field(ge=0)
    residual_percent: float = Field(ge=0)
    left_out_percent: float = Field(ge=0)
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _possible(self) -> MagEntry:
        self.affine.require_bias_below(MAG_BIAS_LIMIT, "uT")
        if self.alignment != "none" and self.alignment_standard_uncertainty is None:
            raise ValueError("it states an alignment without its uncertainty")
        return self

    @staticmethod
    def of(mag: MagResult | None) -> MagEntry | None:
        """Take over a magnetometer of a result, if there is one."""
        if mag is None:
            return None
        return MagEntry(
            affine=AffineEntry.of(mag.affine),
            alignment=mag.alignment,
            field_ut=mag.field_ut,
            field_known=mag.field_known,
            dip=mag.dip_rad,
            dip_standard_uncertainty=mag.dip_u,
            alignment_standard_uncertainty=mag.alignment_u,
            direction_standard_uncertainty=mag.direction_u,
            from_stills=mag.from_stills,
            count=mag.count,
            before_percent=mag.before_percent,
            residual_percent=mag.residual_percent,
            left_out_percent=mag.left_out_percent,
            notes=mag.notes,
        )
