"""What a calibration found, as values for reports, certificates and tests."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.findings import Finding
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.jig_estimate import JigEstimate, Straightness
from imu_rig.calibration.mag_result import MagResult
from imu_rig.calibration.model import Affine, PhysicalFigures, physical_figures
from imu_rig.calibration.temperature_term import TemperatureTerm

if TYPE_CHECKING:
    from imu_rig.calibration.verification import Verification


@dataclass(frozen=True)
class DeviceInfo:
    """Which sensor was calibrated, and how it was recorded; empty text where nobody said.

    Attributes
    ----------
    name, serial : str
        Of the sensor.
    layout : str
        Layout of the packets of a trial; it says what raw values are scaled by.
    accel_recorded_unit, gyro_recorded_unit, mag_recorded_unit : str
        Units that the numbers of a table are in, as ``16384 LSB/g``.
    """

    name: str = ""
    serial: str = ""
    layout: str = ""
    accel_recorded_unit: str = ""
    gyro_recorded_unit: str = ""
    mag_recorded_unit: str = ""

    @property
    def recorded_units(self) -> str:
        """``accelerometer 16384 LSB/g, gyroscope 131 LSB/(deg/s)``."""
        units = (
            ("accelerometer", self.accel_recorded_unit),
            ("gyroscope", self.gyro_recorded_unit),
            ("magnetometer", self.mag_recorded_unit),
        )
        return ", ".join(f"{sensor} {unit}" for sensor, unit in units if unit)


@dataclass(frozen=True)
class ErrorSummary:
    """Size of a set of errors, in the unit of the errors.

    Attributes
    ----------
    count : int
        How many errors, at least 1.
    rms, median, maximum : float
        Root mean square, median and maximum of the absolute values.
    """

    count: int
    rms: float
    median: float
    maximum: float

    @staticmethod
    def of(errors: FloatArray) -> ErrorSummary | None:
        """Summarize errors (n,) that are finite; None where there is none."""
        size = np.abs(errors[np.isfinite(errors)])
        if not size.size:
            return None
        return ErrorSummary(
            int(size.size),
            float(np.sqrt(np.mean(size**2))),
            float(np.median(size)),
            float(np.max(size)),
        )


@dataclass(frozen=True)
class ErrorStages:
    """One kind of error before calibration, after it, and on data kept out of the fit."""

    before: ErrorSummary | None = None
    after: ErrorSummary | None = None
    held_out: ErrorSummary | None = None


@dataclass(frozen=True, eq=False)
class PoseRow:
    """One still pose.

    Attributes
    ----------
    name : str
        ``"pose 7"``, or the name the protocol gave it.
    t0, t1 : float
        Begin and end of the averaged interval [s], on the time of the block.
    count : int
        Samples averaged.
    direction : shape (3,)
        Unit vector of the calibrated mean specific force, sensor axes ("up").
    before, after : float
        Error of the magnitude of the mean specific force [m/s^2].
    sigma : float or None
        Standard uncertainty of the mean along gravity [m/s^2]: measurement noise alone; None where
        it is not known, as of a pose that was left out of the fit.
    left_out : float or None
        Error of the magnitude when the fit never saw this pose [m/s^2].
    left_out_sigma : float or None
        Predicted standard uncertainty of ``left_out`` [m/s^2]: parameters and noise.
    commanded_deg : tuple of float or None
        Commanded pan, tilt and roll [deg].
    vector_error : shape (3,) or None
        Methods that trust the commanded direction: ``K @ mean - b - g`` [m/s^2].
    """

    name: str
    t0: float
    t1: float
    count: int
    direction: FloatArray
    before: float
    after: float
    sigma: float | None
    left_out: float | None = None
    left_out_sigma: float | None = None
    commanded_deg: tuple[float, float, float] | None = None
    vector_error: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class MoveRow:
    """One move between neighbouring still poses.

    Attributes
    ----------
    start, stop : str
        Names of the poses at its ends.
    angle_rad : float
        Angle of the net rotation by the calibrated gyroscope [rad], at most pi.
    before_rad, after_rad : float
        Angle between the gravity direction that the gyroscope predicts for the end and the
        direction measured there [rad].
    held_out_rad : float or None
        The same when the fit never saw this move [rad].
    sigma_rad : float or None
        Predicted standard uncertainty, per axis, of the residual direction [rad].
    vector_error : shape (3,) or None
        Methods that trust the commanded rotation: ``K @ integral(w) - b T - theta`` [rad].
    """

    start: str
    stop: str
    angle_rad: float
    before_rad: float
    after_rad: float
    held_out_rad: float | None = None
    sigma_rad: float | None = None
    vector_error: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A solved calibration.

    Attributes
    ----------
    method : str
        Name in `imu_rig.calibration.solve.METHODS`.
    device : DeviceInfo
        Which sensor.
    gravity : Gravity
        What the accelerometer was scaled to.
    frame : str
        ``"sensor"`` (accelerometer K upper triangular) or ``"jig"`` (commanded directions).
    accel : Affine
        Accelerometer, m/s^2.
    gyro : Affine or None
        Gyroscope, rad/s, in the accelerometer's output frame; None where nothing turned.
    poses : tuple of PoseRow
        One row per still pose, in time order.
    moves : tuple of MoveRow
        One row per move, in time order.
    accel_errors : ErrorStages
        Magnitude errors over the poses [m/s^2].
    gyro_errors : ErrorStages
        Gravity-direction errors over the moves [rad].
    rate_hz, duration_s : float
        Median sample rate and length of the recording.
    temperature_c : tuple of float or None
        Lowest and highest sensor temperature.
    warnings : tuple of str
        One sentence each; empty when nothing needs attention.
    verification : Verification or None
        Poses and moves kept out of the fit, judged; None where there were none.
    temperature : TemperatureTerm or None
        Linear dependence on temperature, where the recording spans enough of it.
    accel_at_zero : Affine or None
        The accelerometer's slope at zero input, where ``accel`` is the best line over +-1 g.
    straightness : Straightness or None
        Nonlinearity of the accelerometer, where it was estimated.
    jig : JigEstimate or None
        Errors of the jig itself, where they were estimated.
    findings : tuple of Finding
        Faults that the data show, as values; their poses count all that were commanded.
    mag : MagResult or None
        Magnetometer, where there is one that the data determine.
    """

    method: str
    device: DeviceInfo
    gravity: Gravity
    frame: str
    accel: Affine
    gyro: Affine | None
    poses: tuple[PoseRow, ...]
    moves: tuple[MoveRow, ...]
    accel_errors: ErrorStages
    gyro_errors: ErrorStages
    rate_hz: float
    duration_s: float
    temperature_c: tuple[float, float] | None = None
    warnings: tuple[str, ...] = field(default=())
    verification: Verification | None = None
    temperature: TemperatureTerm | None = None
    accel_at_zero: Affine | None = None
    straightness: Straightness | None = None
    jig: JigEstimate | None = None
    findings: tuple[Finding, ...] = ()
    mag: MagResult | None = None

    @property
    def accel_figures(self) -> PhysicalFigures:
        """Scale [%], non-orthogonality [rad] and bias [m/s^2] of the accelerometer."""
        return physical_figures(self.accel)

    @property
    def gyro_figures(self) -> PhysicalFigures | None:
        """Scale [%], cross-axis leans [rad] and bias [rad/s] of the gyroscope."""
        return None if self.gyro is None else physical_figures(self.gyro, self.accel)

    @property
    def mag_figures(self) -> PhysicalFigures | None:
        """Scale [%], leans against the accelerometer's axes [rad] and hard iron [uT]."""
        if self.mag is None:
            return None
        aligned = self.mag.alignment != "none"
        return physical_figures(self.mag.affine, self.accel if aligned else None)

    @property
    def has_accel(self) -> bool:
        """Whether the accelerometer was calibrated; else ``accel`` is a nominal one."""
        return not (self.accel.is_nominal or self.only_magnetometer)

    @property
    def only_magnetometer(self) -> bool:
        """Whether the magnetometer alone was calibrated."""
        return self.method == "magnetometer"
