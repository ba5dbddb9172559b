"""How noisy a sensor is, as a versioned JSON file that filters read their parameters from."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AwareDatetime, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import from_json

from imu_rig.arrays import FloatArray
from imu_rig.calibration.certificate_parts import (
    WHOLE,
    DeviceEntry,
    Part,
    RecordingEntry,
    TemperatureSpan,
)
from imu_rig.errors import InputError
from imu_rig.files import read_small, write_whole
from imu_rig.validation import sentence

SCHEMA = "imu-rig/noise"
VERSION = 1
MAXIMUM_BYTES = 1_000_000

CoefficientName = Literal["quantization", "white", "instability", "walk", "ramp"]


class NoiseCoefficient(Part):
    """One coefficient of one axis; without a value where the record does not determine it.

    Attributes
    ----------
    value, standard_uncertainty : float or None
    low, high : float
        95 % interval; of what is not determined, from 0 to what it is at most.
    """

    value: float | None = Field(default=None, gt=0)
    standard_uncertainty: float | None = Field(default=None, gt=0)
    low: float = Field(ge=0)
    high: float = Field(ge=0)

    @model_validator(mode="after")
    def _in_order(self) -> NoiseCoefficient:
        if (self.value is None) != (self.standard_uncertainty is None):
            raise ValueError("a value and its uncertainty belong together")
        if self.low > self.high:
            raise ValueError("the interval ends below its beginning")
        return self


class AxisNoise(Part):
    """Noise of one axis; "unit" is m/s^2, rad/s or uT.

    Attributes
    ----------
    white : unit/sqrt(Hz)
        Density of white noise: angle or velocity random walk after integration.
    instability : unit
        Flicker noise: the smallest Allan deviation it allows is 0.664 times this.
    walk : unit/sqrt(s)
        Random walk of the bias: rate random walk.
    quantization : unit s
        Of sensors that add up: visible at the shortest averaging times alone.
    ramp : unit/s
        Steady drift, as while the sensor warms up.
    floor : unit
        Smallest Allan deviation of the record.
    floor_s : float
        Averaging time of ``floor`` [s].
    correlation_time_s : float or None
        Of the first-order Gauss-Markov process whose Allan deviation peaks where the sensor's is
        smallest; None where the bias instability is not determined.
    """

    white: NoiseCoefficient
    instability: NoiseCoefficient
    walk: NoiseCoefficient
    quantization: NoiseCoefficient
    ramp: NoiseCoefficient
    floor: float = Field(gt=0)
    floor_s: float = Field(gt=0)
    correlation_time_s: float | None = Field(default=None, gt=0)


class SensorNoise(Part):
    """Noise of the three axes of one sensor."""

    x: AxisNoise
    y: AxisNoise
    z: AxisNoise

    def __iter__(self) -> Iterator[AxisNoise]:  # type: ignore[override]
        """Go through the axes."""
        return iter((self.x, self.y, self.z))

    def values(self, name: CoefficientName) -> FloatArray:
        """Values (3,) of a coefficient; NaN where the record does not determine it."""
        found = [getattr(axis, name).value for axis in self]
        return np.array([np.nan if value is None else value for value in found])

    def upper_bounds(self, name: CoefficientName) -> FloatArray:
        """Upper ends (3,) of the 95 % intervals: safe where `values` are not determined."""
        return np.array([getattr(axis, name).high for axis in self])


class NoiseModel(Part):
    """Noise of a sensor at rest, SI units; what filters take their parameters from.

    See Also
    --------
    load_noise_model : read and check a file.
    imu_rig.calibration.noise.analyse_noise : find it from a recording.
    """

    model_config = ConfigDict(serialize_by_alias=True, populate_by_name=True)

    kind: Literal["imu-rig/noise"] = Field(default="imu-rig/noise", alias="schema")
    version: Annotated[Literal[1], WHOLE] = 1
    date: AwareDatetime
    software: str
    device: DeviceEntry
    rate_hz: float = Field(gt=0)
    duration_s: float = Field(gt=0)
    accel: SensorNoise | None = None
    gyro: SensorNoise | None = None
    mag: SensorNoise | None = None
    temperature_c: TemperatureSpan | None = None
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
        write_whole(path, text, what="a noise model", overwrite=overwrite)


def load_noise_model(path: Path | str) -> NoiseModel:
    """Read a noise model and check all of it.

    Raises
    ------
    InputError
        No such file, not a noise model, a newer version, a missing or impossible value.
    """
    source = Path(path)
    data = read_small(source, MAXIMUM_BYTES, what="a noise model")
    try:
        content: Any = from_json(data, allow_inf_nan=True)
    except ValueError as error:
        raise InputError(f"{source} is not a noise model: it is not JSON ({error}).") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError(f'{source} is not a noise model: its "schema" is not "{SCHEMA}".')
    version = content.get("version")
    if isinstance(version, int) and version > VERSION:
        raise InputError(
            f"{source} is a noise model of version {version}; this imu-rig reads up to version "
            f"{VERSION}, so upgrade imu-rig."
        )
    try:
        return NoiseModel.model_validate_json(data, strict=True)
    except ValidationError as error:
        raise InputError(f"{source}: {sentence(error, 'a noise model')}.") from error
