"""The calibration certificate: a versioned JSON file that a later program can trust or refuse."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, ConfigDict, Field, ValidationError, field_validator
from pydantic_core import from_json

import imu_rig
from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.certificate_jig import JigEntry, NonlinearityEntry
from imu_rig.calibration.certificate_magnetometer import MagEntry
from imu_rig.calibration.certificate_parts import (
    ACCEL_BIAS_LIMIT,
    GYRO_BIAS_LIMIT,
    WHOLE,
    AffineEntry,
    DeviceEntry,
    GravityEntry,
    MoveEntry,
    Part,
    PoseEntry,
    RecordingEntry,
    StagesEntry,
    TemperatureEntry,
    TemperatureSpan,
    VerificationEntry,
)
from imu_rig.calibration.noise_model import NoiseModel
from imu_rig.calibration.result import CalibrationResult
from imu_rig.errors import DataError, InputError
from imu_rig.files import read_small, write_whole
from imu_rig.validation import sentence

SCHEMA = "imu-rig/certificate"
VERSION = 2
"""Version that is written. Version 1 is read too: it lacks parts that are optional here."""
MAXIMUM_BYTES = 8_000_000


class Certificate(Part):
    """A calibration with its evidence.

    See Also
    --------
    load_certificate : read and check a file.
    apply_certificate : calibrate a block of samples.
    """

    model_config = ConfigDict(serialize_by_alias=True, populate_by_name=True)

    kind: Literal["imu-rig/certificate"] = Field(default="imu-rig/certificate", alias="schema")
    version: Annotated[Literal[2], WHOLE] = 2
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
    temperature_c: TemperatureSpan | None = None
    warnings: tuple[str, ...] = ()
    recording: RecordingEntry | None = None
    verification: VerificationEntry | None = None
    temperature: TemperatureEntry | None = None
    noise: NoiseModel | None = None
    mag: MagEntry | None = None
    accel_at_zero: AffineEntry | None = None
    nonlinearity: NonlinearityEntry | None = None
    jig: JigEntry | None = None

    @field_validator("version", mode="before")
    @classmethod
    def _upgraded(cls, version: Any) -> Any:
        """Take an older version for the present one, which only adds optional parts."""
        return VERSION if type(version) is int and 1 <= version < VERSION else version

    @field_validator("accel", "accel_at_zero")
    @classmethod
    def _possible_accel(cls, accel: AffineEntry | None) -> AffineEntry | None:
        if accel is not None:
            accel.require_bias_below(ACCEL_BIAS_LIMIT, "m/s^2")
        return accel

    @field_validator("gyro")
    @classmethod
    def _possible_gyro(cls, gyro: AffineEntry | None) -> AffineEntry | None:
        if gyro is not None:
            gyro.require_bias_below(GYRO_BIAS_LIMIT, "rad/s")
        return gyro

    @property
    def has_accel(self) -> bool:
        """Whether the accelerometer was calibrated; else ``accel`` is a nominal one."""
        return not (self.accel.affine().is_nominal or self.method == "magnetometer")

    @property
    def calibrated(self) -> tuple[str, ...]:
        """Short names of the sensors that were calibrated: of ``accel``, ``gyro`` and ``mag``."""
        found = {
            "accel": self.has_accel,
            "gyro": self.gyro is not None,
            "mag": self.mag is not None,
        }
        return tuple(name for name, there in found.items() if there)

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
    noise: NoiseModel | None = None,
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
    noise : NoiseModel, optional
        Noise of the same sensor, from a recording of its own.

    Raises
    ------
    DataError
        A result that no sensor can have, with the reason.
    """
    try:
        return Certificate(
            date=date or datetime.now(UTC).replace(microsecond=0),
            software=f"imu-rig {imu_rig.__version__}",
            method=result.method,
            frame="jig" if result.frame == "jig" else "sensor",
            device=DeviceEntry.of(result.device),
            gravity=GravityEntry.of(result.gravity),
            accel=AffineEntry.of(result.accel),
            gyro=None if result.gyro is None else AffineEntry.of(result.gyro),
            accel_errors=StagesEntry.of(result.accel_errors),
            gyro_errors=StagesEntry.of(result.gyro_errors),
            poses=tuple(PoseEntry.of(pose) for pose in result.poses),
            moves=tuple(MoveEntry.of(move) for move in result.moves),
            rate_hz=result.rate_hz,
            temperature_c=result.temperature_c,
            warnings=result.warnings,
            recording=None if recording is None else RecordingEntry.of(*recording),
            verification=VerificationEntry.of(result.verification),
            temperature=TemperatureEntry.of(result.temperature),
            noise=noise,
            mag=MagEntry.of(result.mag),
            accel_at_zero=(
                None if result.accel_at_zero is None else AffineEntry.of(result.accel_at_zero)
            ),
            nonlinearity=NonlinearityEntry.of(result.straightness),
            jig=JigEntry.of(result.jig),
        )
    except ValidationError as error:
        problem = sentence(error, "a certificate")
        raise DataError(f"no certificate can be made of this calibration: {problem}") from error


def load_certificate(path: Path | str) -> Certificate:
    """Read a certificate and check all of it.

    Raises
    ------
    InputError
        No such file, not a certificate, a newer version, a missing or impossible value.
    """
    source = Path(path)
    return parse_certificate(read_small(source, MAXIMUM_BYTES, what="a certificate"), str(source))


def parse_certificate(data: bytes, source: str) -> Certificate:
    """Check the text of a certificate, whose errors begin with ``source``.

    Raises
    ------
    InputError
        As `load_certificate`.
    """
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
        return Certificate.model_validate_json(data, strict=True)
    except ValidationError as error:
        raise InputError(f"{source}: {sentence(error, 'a certificate')}") from error


def apply_certificate(certificate: Certificate, block: ImuBlock) -> ImuBlock:
    """Calibrate the samples of a block; a sensor the certificate lacks stays as it is.

    Where the certificate has a temperature term and the block temperatures, it is applied.
    """
    term = certificate.temperature if block.temperature is not None else None

    def calibrated(entry: AffineEntry | None, raw: FloatArray, sensor: str) -> FloatArray:
        if entry is None:
            return raw
        affine = entry.affine()
        values: FloatArray = affine.apply(raw)
        if term is None or block.temperature is None:
            return values
        return term.corrected(values, affine.b, block.temperature, sensor)

    mag = block.mag
    if mag is not None and certificate.mag is not None:
        mag = certificate.mag.affine.affine().apply(mag)
    return replace(
        block,
        accel=calibrated(certificate.accel, block.accel, "accel"),
        gyro=calibrated(certificate.gyro, block.gyro, "gyro"),
        mag=mag,
    )
