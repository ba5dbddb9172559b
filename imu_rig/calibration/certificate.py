"""The calibration certificate: a versioned JSON file that a later program can trust or refuse."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AwareDatetime,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import from_json

import imu_rig
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.model import Affine
from imu_rig.calibration.result import CalibrationResult, ErrorStages, ErrorSummary
from imu_rig.errors import InputError
from imu_rig.files import read_small, write_whole

SCHEMA = "imu-rig/certificate"
VERSION = 1
MAXIMUM_BYTES = 8_000_000
SINGULAR_CONDITION = 1e4

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
CovarianceRow = Annotated[tuple[float, ...], Field(min_length=12, max_length=12)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class DeviceEntry(_Part):
    """Which sensor the certificate belongs to, and how its raw values were scaled."""

    name: str = ""
    serial: str = ""
    layout: str = ""
    accel_raw_unit: Literal["m/s^2"] = "m/s^2"
    gyro_raw_unit: Literal["rad/s"] = "rad/s"


class GravityEntry(_Part):
    """Gravity the accelerometer is scaled to [m/s^2] and where the figure comes from."""

    value: float = Field(gt=9.0, lt=11.0)
    source: str
    known: bool


class AffineEntry(_Part):
    """One sensor: ``calibrated = K @ raw - b``."""

    K: Matrix
    b: Vector
    covariance: Annotated[tuple[CovarianceRow, ...], Field(min_length=12, max_length=12)]
    K_standard_uncertainty: Matrix
    b_standard_uncertainty: Vector
    degrees_of_freedom: float | None = Field(default=None, gt=0)

    @field_validator("K")
    @classmethod
    def _invertible(cls, K: Matrix) -> Matrix:
        if not np.linalg.cond(np.array(K)) < SINGULAR_CONDITION:
            raise ValueError("is singular: it cannot be a sensor's gain matrix")
        return K

    @model_validator(mode="after")
    def _covariance_is_one(self) -> AffineEntry:
        covariance = np.array(self.covariance)
        largest = float(np.max(np.abs(covariance)))
        if np.max(np.abs(covariance - covariance.T)) > 1e-6 * largest:
            raise ValueError("covariance is not symmetric")
        if np.min(np.diag(covariance)) < 0:
            raise ValueError("covariance has a negative variance")
        return self

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


class SummaryEntry(_Part):
    """Size of a set of errors, SI."""

    count: int = Field(ge=1)
    rms: float = Field(ge=0)
    median: float = Field(ge=0)
    maximum: float = Field(ge=0)


class StagesEntry(_Part):
    """Errors before, after, and on data kept out of the fit, SI."""

    before: SummaryEntry | None = None
    after: SummaryEntry | None = None
    held_out: SummaryEntry | None = None


class PoseEntry(_Part):
    """One still pose; errors of the gravity magnitude [m/s^2]."""

    name: str
    commanded_deg: Vector | None = None
    direction: Vector
    before: float
    after: float
    sigma: float
    left_out: float | None = None
    left_out_sigma: float | None = None


class MoveEntry(_Part):
    """One move; angle turned and gravity-direction errors [rad]."""

    start: str
    stop: str
    angle: float
    before: float
    after: float
    held_out: float | None = None


class RecordingEntry(_Part):
    """The recording that the calibration was solved from."""

    file: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Certificate(_Part):
    """A calibration with its evidence.

    See Also
    --------
    load_certificate : read and check a file.
    apply_certificate : calibrate a block of samples.
    """

    model_config = ConfigDict(serialize_by_alias=True, populate_by_name=True)

    kind: Literal["imu-rig/certificate"] = Field(default="imu-rig/certificate", alias="schema")
    version: Literal[1] = 1
    date: AwareDatetime
    software: str
    method: str
    frame: Literal["sensor", "jig"] = "sensor"
    device: DeviceEntry
    gravity: GravityEntry
    accel: AffineEntry
    gyro: AffineEntry | None = None
    accel_errors: StagesEntry
    gyro_errors: StagesEntry
    poses: tuple[PoseEntry, ...] = ()
    moves: tuple[MoveEntry, ...] = ()
    rate_hz: float = Field(gt=0)
    temperature_c: tuple[float, float] | None = None
    warnings: tuple[str, ...] = ()
    recording: RecordingEntry | None = None

    def save(self, path: Path | str, *, overwrite: bool = False) -> None:
        """Write the file whole or not at all; an existing one is kept unless ``overwrite``.

        Raises
        ------
        InputError
            The file exists, or its directory does not.
        StorageError
            The disk is full or fails.
        """
        text = self.model_dump_json(indent=1).encode() + b"\n"
        write_whole(path, text, what="a certificate", overwrite=overwrite)


def certificate_of(
    result: CalibrationResult,
    *,
    date: datetime | None = None,
    recording: tuple[str, str] | None = None,
) -> Certificate:
    """Make the certificate of a result.

    Parameters
    ----------
    result : CalibrationResult
        What a solver returned.
    date : datetime, optional
        With time zone; now, in UTC, by default.
    recording : (str, str), optional
        File name and SHA-256 (hexadecimal) of the recording it was solved from.
    """
    return Certificate(
        date=date or datetime.now(UTC).replace(microsecond=0),
        software=f"imu-rig {imu_rig.__version__}",
        method=result.method,
        frame="jig" if result.frame == "jig" else "sensor",
        device=DeviceEntry(
            name=_plain(result.device.name),
            serial=_plain(result.device.serial),
            layout=result.device.layout,
        ),
        gravity=GravityEntry(
            value=result.gravity.value, source=result.gravity.source, known=result.gravity.known
        ),
        accel=AffineEntry.of(result.accel),
        gyro=None if result.gyro is None else AffineEntry.of(result.gyro),
        accel_errors=_stages(result.accel_errors),
        gyro_errors=_stages(result.gyro_errors),
        poses=tuple(
            PoseEntry(
                name=pose.name,
                commanded_deg=pose.commanded_deg,
                direction=pose.direction.tolist(),
                before=pose.before,
                after=pose.after,
                sigma=pose.sigma,
                left_out=pose.left_out,
                left_out_sigma=pose.left_out_sigma,
            )
            for pose in result.poses
        ),
        moves=tuple(
            MoveEntry(
                start=move.start,
                stop=move.stop,
                angle=move.angle_rad,
                before=move.before_rad,
                after=move.after_rad,
                held_out=move.held_out_rad,
            )
            for move in result.moves
        ),
        rate_hz=result.rate_hz,
        temperature_c=result.temperature_c,
        warnings=result.warnings,
        recording=(
            None
            if recording is None
            else RecordingEntry(file=_plain(Path(recording[0]).name), sha256=recording[1])
        ),
    )


def _plain(name: str) -> str:
    """Replace what UTF-8 cannot hold, as in file names of another encoding."""
    return name.encode("utf-8", "replace").decode()


def load_certificate(path: Path | str) -> Certificate:
    """Read a certificate and check all of it.

    Raises
    ------
    InputError
        No such file, not a certificate, a newer version, a missing or impossible value.
    """
    source = Path(path)
    data = read_small(source, MAXIMUM_BYTES, what="a certificate")
    try:
        content: Any = from_json(data, allow_inf_nan=True)
    except ValueError as error:
        raise InputError(f"{source} is not a certificate: it is not JSON ({error})") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError(f'{source} is not a certificate: its "schema" is not "{SCHEMA}"')
    version = content.get("version")
    if isinstance(version, int) and version > VERSION:
        raise InputError(
            f"{source} is a certificate of version {version}; this imu-rig reads up to version "
            f"{VERSION}, so upgrade imu-rig"
        )
    try:
        return Certificate.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "content"
        reason = first["msg"].removeprefix("Value error, ")
        raise InputError(f"{source}: the certificate's {field}: {reason}") from error


def apply_certificate(certificate: Certificate, block: ImuBlock) -> ImuBlock:
    """Calibrate the samples of a block; a sensor the certificate lacks stays as it is."""
    gyro = block.gyro if certificate.gyro is None else certificate.gyro.affine().apply(block.gyro)
    return replace(block, accel=certificate.accel.affine().apply(block.accel), gyro=gyro)


def _stages(errors: ErrorStages) -> StagesEntry:
    def entry(summary: ErrorSummary | None) -> SummaryEntry | None:
        if summary is None:
            return None
        return SummaryEntry(
            count=summary.count,
            rms=summary.rms,
            median=summary.median,
            maximum=summary.maximum,
        )

    return StagesEntry(
        before=entry(errors.before), after=entry(errors.after), held_out=entry(errors.held_out)
    )
