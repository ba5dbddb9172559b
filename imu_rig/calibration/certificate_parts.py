"""The parts of a certificate: one frozen model each, all units SI.

A part that a later version adds is optional in `Certificate`, with None for "not measured", so
that every older file stays readable.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)

from imu_rig.arrays import FloatArray
from imu_rig.calibration.gravity import PLAUSIBLE, Gravity
from imu_rig.calibration.model import Affine
from imu_rig.calibration.result import (
    DeviceInfo,
    ErrorStages,
    ErrorSummary,
    MoveRow,
    PoseRow,
)
from imu_rig.calibration.temperature_term import (
    Slopes,
    TemperatureTerm,
    at_reference,
    warmth,
)
from imu_rig.calibration.verification import CheckRow, Limits, Verification

GAIN_LIMITS = (0.2, 5.0)
"""Gains of a nominally scaled sensor lie inside; anything else is a wrong unit or a wrong file."""
ACCEL_BIAS_LIMIT = 20.0
"""No accelerometer that is nominally scaled reads more than this at zero input [m/s^2]."""
GYRO_BIAS_LIMIT = 2.0
"""No gyroscope that is nominally scaled reads more than this at rest [rad/s]."""
ACCEL_SLOPE_LIMIT = 2.0
"""No accelerometer's zero changes more than this [m/s^2] with one degree."""
GYRO_SLOPE_LIMIT = 0.2
"""No gyroscope's zero changes more than this [rad/s] with one degree."""
SCALE_SLOPE_LIMIT = 0.1
"""No sensor's scale changes by a larger share of itself with one degree."""
NEGATIVE_CORRELATION = -1e-6
"""Smallest eigenvalue of a correlation matrix that rounding explains."""

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Sigma = Annotated[float, Field(ge=0)]
Sigmas = tuple[Sigma, Sigma, Sigma]
CovarianceRow = Annotated[tuple[float, ...], Field(min_length=12, max_length=12)]


def _in_order(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise ValueError("its lower end comes first")
    return span


def _whole(version: Any) -> Any:
    if isinstance(version, bool | float):
        raise ValueError("a version is a whole number")
    return version


TemperatureSpan = Annotated[tuple[float, float], AfterValidator(_in_order)]
"""Lowest and highest temperature [degC]."""
WHOLE = BeforeValidator(_whole)
"""Refuses numbers that only equal a version, such as 2.0 or true."""


class Part(BaseModel):
    """What every part has in common: frozen, finite, no unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class DeviceEntry(Part):
    """Which sensor the certificate belongs to, and how its raw values were scaled.

    K expects the raw units; the recorded units are those of a table's numbers before they were
    scaled to raw ones, and a layout stands for those of a trial.
    """

    name: str = ""
    serial: str = ""
    layout: str = ""
    accel_raw_unit: Literal["m/s^2"] = "m/s^2"
    gyro_raw_unit: Literal["rad/s"] = "rad/s"
    accel_recorded_unit: str = ""
    gyro_recorded_unit: str = ""
    mag_recorded_unit: str = ""

    @staticmethod
    def of(device: DeviceInfo) -> DeviceEntry:
        """Take over what is known of the sensor."""
        return DeviceEntry(
            name=storable(device.name),
            serial=storable(device.serial),
            layout=device.layout,
            accel_recorded_unit=storable(device.accel_recorded_unit),
            gyro_recorded_unit=storable(device.gyro_recorded_unit),
            mag_recorded_unit=storable(device.mag_recorded_unit),
        )

    def device(self) -> DeviceInfo:
        """Return the value of the calibration room."""
        return DeviceInfo(
            self.name,
            self.serial,
            self.layout,
            self.accel_recorded_unit,
            self.gyro_recorded_unit,
            self.mag_recorded_unit,
        )


class GravityEntry(Part):
    """Gravity the accelerometer is scaled to [m/s^2] and where the figure comes from."""

    value: float = Field(ge=PLAUSIBLE[0], le=PLAUSIBLE[1])
    source: str
    known: bool

    @staticmethod
    def of(gravity: Gravity) -> GravityEntry:
        """Take over the gravity of a result."""
        return GravityEntry(value=gravity.value, source=gravity.source, known=gravity.known)

    def gravity(self) -> Gravity:
        """Return the value of the calibration room, with its sentence."""
        return Gravity(self.value, self.source, self.known)


class AffineEntry(Part):
    """One sensor: ``calibrated = K @ raw - b``."""

    K: Matrix
    b: Vector
    covariance: Annotated[tuple[CovarianceRow, ...], Field(min_length=12, max_length=12)]
    K_standard_uncertainty: Matrix
    b_standard_uncertainty: Vector
    degrees_of_freedom: float | None = Field(default=None, gt=0)

    @field_validator("K")
    @classmethod
    def _possible_gain(cls, K: Matrix) -> Matrix:
        low, high = GAIN_LIMITS
        matrix = np.array(K)
        if np.max(np.abs(matrix)) < high:  # beyond it the singular values may overflow
            gains = np.linalg.svd(matrix, compute_uv=False)
            if low < np.min(gains) and np.max(gains) < high:
                if np.linalg.det(matrix) < 0:
                    raise ValueError("it mirrors its input, so an axis has the wrong sign")
                return K
        raise ValueError(f"no scaled sensor has such gains; they lie between {low:g} and {high:g}")

    @model_validator(mode="after")
    def _one_covariance(self) -> AffineEntry:
        covariance = np.array(self.covariance)
        with np.errstate(over="ignore"):
            asymmetry = np.max(np.abs(covariance - covariance.T))
        if asymmetry > 1e-6 * np.max(np.abs(covariance)):
            raise ValueError("its covariance is not symmetric")
        variance = np.diag(covariance)
        if np.min(variance) < 0:
            raise ValueError("its covariance has a negative variance")
        sigma = np.sqrt(variance)
        scale = np.where(sigma > 0, sigma, 1.0)
        correlation = covariance / np.outer(scale, scale)
        if np.min(np.linalg.eigvalsh(correlation)) < NEGATIVE_CORRELATION * len(variance):
            raise ValueError("its covariance is negative in some direction")
        stated = np.concatenate(
            (np.ravel(self.K_standard_uncertainty), self.b_standard_uncertainty)
        )
        if not np.allclose(stated, sigma, rtol=1e-6, atol=1e-15):
            raise ValueError("its standard uncertainties are not those of its covariance")
        return self

    def require_bias_below(self, limit: float, unit: str) -> None:
        """Refuse an offset that no sensor of its kind has.

        Raises
        ------
        ValueError
            Naming the offset and the limit.
        """
        largest = float(np.max(np.abs(self.b)))
        if largest > limit:
            raise ValueError(
                f"its offset b of {largest:.3g} {unit} is beyond what a sensor has ({limit:g})"
            )

    @staticmethod
    def of(affine: Affine) -> AffineEntry:
        """Take over a model of the calibration room."""
        return AffineEntry(
            K=affine.K.tolist(),
            b=affine.b.tolist(),
            covariance=affine.covariance.tolist(),
            K_standard_uncertainty=affine.K_uncertainty.tolist(),
            b_standard_uncertainty=affine.b_uncertainty.tolist(),
            degrees_of_freedom=affine.dof if np.isfinite(affine.dof) else None,
        )

    def affine(self) -> Affine:
        """Return the model of the calibration room."""
        dof = float("inf") if self.degrees_of_freedom is None else self.degrees_of_freedom
        return Affine(np.array(self.K), np.array(self.b), np.array(self.covariance), dof)


class SummaryEntry(Part):
    """Size of a set of errors, SI."""

    count: int = Field(ge=1)
    rms: float = Field(ge=0)
    median: float = Field(ge=0)
    maximum: float = Field(ge=0)

    @staticmethod
    def of(summary: ErrorSummary | None) -> SummaryEntry | None:
        """Take over a summary, if there is one."""
        if summary is None:
            return None
        return SummaryEntry(
            count=summary.count,
            rms=summary.rms,
            median=summary.median,
            maximum=summary.maximum,
        )


class StagesEntry(Part):
    """Errors before, after, and on data kept out of the fit, SI."""

    before: SummaryEntry | None = None
    after: SummaryEntry | None = None
    held_out: SummaryEntry | None = None

    @staticmethod
    def of(errors: ErrorStages) -> StagesEntry:
        """Take over the stages of a result."""
        return StagesEntry(
            before=SummaryEntry.of(errors.before),
            after=SummaryEntry.of(errors.after),
            held_out=SummaryEntry.of(errors.held_out),
        )


class PoseEntry(Part):
    """One still pose; errors of the gravity magnitude [m/s^2].

    ``sigma`` is None for a pose that the fit left out.
    """

    name: str
    commanded_deg: Vector | None = None
    direction: Vector
    before: float
    after: float
    sigma: Sigma | None = None
    left_out: float | None = None
    left_out_sigma: Sigma | None = None

    @staticmethod
    def of(pose: PoseRow) -> PoseEntry:
        """Take over a pose of a result."""
        return PoseEntry(
            name=pose.name,
            commanded_deg=pose.commanded_deg,
            direction=pose.direction.tolist(),
            before=pose.before,
            after=pose.after,
            sigma=pose.sigma,
            left_out=pose.left_out,
            left_out_sigma=pose.left_out_sigma,
        )


class MoveEntry(Part):
    """One move; angle turned and gravity-direction errors [rad]."""

    start: str
    stop: str
    angle: float
    before: float
    after: float
    held_out: float | None = None

    @staticmethod
    def of(move: MoveRow) -> MoveEntry:
        """Take over a move of a result."""
        return MoveEntry(
            start=move.start,
            stop=move.stop,
            angle=move.angle_rad,
            before=move.before_rad,
            after=move.after_rad,
            held_out=move.held_out_rad,
        )


class CheckEntry(Part):
    """One check that the fit never saw: gravity's magnitude [m/s^2] or direction [rad]."""

    kind: Literal["pose", "move"]
    name: str
    error: float | None = None
    sigma: Sigma | None = None
    sigmas: float | None = None
    noise: Sigma | None = None
    limit: float = Field(gt=0)
    sigma_limit: float = Field(gt=0)
    void: str = ""

    @staticmethod
    def of(row: CheckRow) -> CheckEntry:
        """Take over a check of a verification."""
        return CheckEntry(
            kind=row.kind,
            name=row.name,
            error=row.error,
            sigma=row.sigma,
            sigmas=row.sigmas,
            noise=row.noise,
            limit=row.limit,
            sigma_limit=row.sigma_limit,
            void=row.void,
        )


class VerificationEntry(Part):
    """Checks kept out of the fit, judged against limits [m/s^2, rad, standard deviations]."""

    state: Literal["passed", "failed", "not verified"]
    accel_limit: float = Field(gt=0)
    turn_limit: float = Field(gt=0)
    sigma_limit: float = Field(gt=0)
    checks: tuple[CheckEntry, ...] = ()

    @staticmethod
    def of(verification: Verification | None) -> VerificationEntry | None:
        """Take over a verification, if there is one."""
        if verification is None:
            return None
        return VerificationEntry(
            state=verification.state,
            accel_limit=verification.limits.accel,
            turn_limit=verification.limits.turn,
            sigma_limit=verification.limits.sigma,
            checks=tuple(CheckEntry.of(row) for row in verification.rows),
        )

    def verification(self, *, has_gyro: bool) -> Verification:
        """Return the value of the calibration room, with its sentences."""
        limits = Limits(self.accel_limit, self.turn_limit, self.sigma_limit)
        rows = tuple(CheckRow(**check.model_dump()) for check in self.checks)
        return Verification(rows, limits, has_gyro)


class SlopesEntry(Part):
    """Change per degree of three axes; a value of 0 where the data do not determine one."""

    value: Vector
    standard_uncertainty: Sigmas

    @staticmethod
    def of(slopes: Slopes | None) -> SlopesEntry | None:
        """Take over slopes, if there are any."""
        if slopes is None:
            return None
        return SlopesEntry(
            value=slopes.applied.tolist(), standard_uncertainty=slopes.sigma.tolist()
        )


class TemperatureEntry(Part):
    """Linear dependence on temperature: ``(1 + scale dT) K raw - b - bias dT``.

    ``dT`` counts from ``reference_c``, at which K and b hold; from ``low_c`` to ``high_c`` it was
    measured [degC]. Slopes in m/s^2, 1 and rad/s per degree.
    """

    reference_c: float
    low_c: float
    high_c: float
    accel_bias: SlopesEntry
    accel_scale: SlopesEntry | None = None
    gyro_bias: SlopesEntry | None = None

    @model_validator(mode="after")
    def _in_order(self) -> TemperatureEntry:
        if not self.low_c <= self.reference_c <= self.high_c:
            raise ValueError("the reference temperature lies outside those that were measured")
        for slopes, limit in (
            (self.accel_bias, ACCEL_SLOPE_LIMIT),
            (self.accel_scale, SCALE_SLOPE_LIMIT),
            (self.gyro_bias, GYRO_SLOPE_LIMIT),
        ):
            if slopes is not None and max(map(abs, slopes.value)) > limit:
                raise ValueError(f"no sensor changes by more than {limit:g} per degree")
        return self

    @staticmethod
    def of(term: TemperatureTerm | None) -> TemperatureEntry | None:
        """Take over a term that has something to correct with."""
        if term is None or not term.is_offered:
            return None
        bias = SlopesEntry.of(term.accel_bias)
        assert bias is not None
        return TemperatureEntry(
            reference_c=term.reference_c,
            low_c=term.low_c,
            high_c=term.high_c,
            accel_bias=bias,
            accel_scale=SlopesEntry.of(term.accel_scale),
            gyro_bias=SlopesEntry.of(term.gyro_bias),
        )

    def corrected(
        self, calibrated: FloatArray, b: FloatArray, temperature: FloatArray, sensor: str
    ) -> FloatArray:
        """Correct calibrated readings (n, 3) of "accel" or "gyro" at temperatures (n,) [degC]."""
        slopes = self.accel_bias if sensor == "accel" else self.gyro_bias
        scale = self.accel_scale if sensor == "accel" else None
        return at_reference(
            calibrated,
            b,
            warmth(temperature, self.reference_c, self.low_c, self.high_c),
            np.zeros(3) if slopes is None else np.array(slopes.value),
            np.zeros(3) if scale is None else np.array(scale.value),
        )


class RecordingEntry(Part):
    """The recording that the calibration was solved from."""

    file: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")

    @staticmethod
    def of(file: str, sha256: str) -> RecordingEntry:
        """Name a recording; its folder is nobody else's business."""
        return RecordingEntry(file=storable(Path(file).name), sha256=sha256)


def storable(text: str) -> str:
    """Replace what UTF-8 cannot hold, as in file names of another encoding."""
    return text.encode("utf-8", "replace").decode()
