"""What a simulated rig is made of, as values: servos, jig, sensor, firmware, servo controller.

The defaults are one plausible hobby rig; :mod:`simulators.budget` draws others. Angles are in
degrees and times in seconds where the name says so, everything else is in SI units.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Vector2 = tuple[float, float]
Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]

NotNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]

IDENTITY: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO: Vector3 = (0.0, 0.0, 0.0)
ZERO_MATRIX: Matrix3 = (ZERO, ZERO, ZERO)

MaestroMode = Literal["uart-detect", "usb-dual-port", "usb-chained"]
"""Serial modes of a Maestro; from the factory it is "uart-detect", deaf on its command port."""


class Model(BaseModel):
    """Base of the values: frozen, finite, and without unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ServoModel(Model):
    """One axis of the jig: which pulse means which angle, and how wrong that is.

    Attributes
    ----------
    channel : int
        Channel of the Maestro that the servo is plugged into.
    angle_deg, pulse_us : (float, float)
        Two angles of the jig's axis and the pulse widths that command them.
    gain_error, zero_deg : float
        The axis turns ``(1 + gain_error)`` times the commanded angle, plus ``zero_deg``.
    sine_deg, sine_phase_deg : float
        Once-per-turn error of the potentiometer or gear.
    repeatability_deg : float
        Standard deviation of an error drawn anew at every stop.
    dead_band_us : float
        Full width of the band in which a change of the pulse moves nothing.
    backlash_deg : float
        Play of the gears at the axis.
    speed_dps, acceleration_dps2 : float
        What the motor can do, at the axis.
    bandwidth_hz : float
        Of the critically damped approach to the target.
    ring_hz, ring_tau_s : float
        Free vibration of the structure on the axis and its decay time; 0 Hz is rigid.
    start_deg : float
        Where the axis stands, limp, before the first pulse.
    """

    channel: Annotated[int, Field(ge=0, le=23)]
    angle_deg: Vector2
    pulse_us: Vector2
    gain_error: float = 0.0
    zero_deg: float = 0.0
    sine_deg: float = 0.3
    sine_phase_deg: float = 40.0
    repeatability_deg: NotNegative = 0.5
    dead_band_us: NotNegative = 8.0
    backlash_deg: NotNegative = 1.0
    speed_dps: Positive = 130.0
    acceleration_dps2: Positive = 6000.0
    bandwidth_hz: Positive = 6.0
    ring_hz: NotNegative = 9.0
    ring_tau_s: Positive = 0.1
    start_deg: float = 0.0


def _pan() -> ServoModel:
    return ServoModel(
        channel=0,
        angle_deg=(-180.0, 180.0),
        pulse_us=(1265.0, 1735.0),
        gain_error=0.02,
        zero_deg=2.0,
    )


def _tilt() -> ServoModel:
    return ServoModel(
        channel=1,
        angle_deg=(-90.0, 90.0),
        pulse_us=(900.0, 1950.0),
        gain_error=-0.02,
        zero_deg=-2.0,
        sine_phase_deg=100.0,
        speed_dps=300.0,
        acceleration_dps2=12000.0,
    )


def _roll() -> ServoModel:
    return ServoModel(
        channel=2,
        angle_deg=(-190.0, 190.0),
        pulse_us=(1200.0, 1800.0),
        gain_error=0.02,
        zero_deg=2.0,
        sine_phase_deg=-70.0,
        speed_dps=108.0,
    )


class JigModel(Model):
    """The three axes, how square they are to one another, and where the sensor sits.

    Attitude body to navigation: ``B Rz(pan) Rx(a) Ry(tilt) Rx(-a) Rz(b) Rx(roll) Rz(-b) M W`` with
    the base ``B``, the skews ``a`` and ``b``, the mounting ``M`` and the wobble ``W``.

    Attributes
    ----------
    pan, tilt, roll : ServoModel
    base_tilt_deg : (float, float)
        Rotation vector of the base about the level x and y axes.
    tilt_skew_deg, roll_skew_deg : float
        ``a``: tilt axis off the pan axis' normal; ``b``: roll axis off the tilt axis' normal.
    mounting_deg : (float, float, float)
        Rotation vector of the sensor on the roll axis.
    wobble_deg : float
        Standard deviation per axis of a small rotation drawn anew at every pose.
    lever_arm_m : (float, float, float)
        From the point where the axes meet to the sensor, in sensor axes.
    vibration_mg, vibration_hz, vibration_share :
        Amplitude, range of frequencies, and the share of the poses in which the servos buzz.
    """

    pan: ServoModel = Field(default_factory=_pan)
    tilt: ServoModel = Field(default_factory=_tilt)
    roll: ServoModel = Field(default_factory=_roll)
    base_tilt_deg: Vector2 = (0.8, -0.6)
    tilt_skew_deg: float = 1.0
    roll_skew_deg: float = -1.0
    mounting_deg: Vector3 = (2.0, -1.5, 1.7)
    wobble_deg: NotNegative = 0.1
    lever_arm_m: Vector3 = (0.02, -0.01, 0.03)
    vibration_mg: NotNegative = 2.0
    vibration_hz: Vector2 = (15.0, 45.0)
    vibration_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5


class SensorModel(Model):
    """An inertial sensor: gains, offsets, noise and drift; by default an MPU-9150's.

    The truth is in the form of a calibration: the physical quantity is ``gain @ raw - offset``,
    where raw is the reading in nominal SI units, once warm and without noise.

    Attributes
    ----------
    accel_gain, gyro_gain, mag_gain : 3 x 3
    accel_offset : m/s^2
    gyro_offset : rad/s
    mag_offset : uT
        Hard iron; the soft iron is in ``mag_gain``. In the accelerometer's axes.
    accel_noise_ug, gyro_noise_dps : float
        White noise per root hertz as data sheets state it, one-sided: the converter averages over
        each sample interval, so one sample has this times the root of half the sample rate.
    mag_noise_ut : float
        Standard deviation of one sample.
    accel_walk_mg, gyro_walk_dps : float
        Standard deviation of the random walk of the offset after 600 s.
    accel_quadratic, accel_cubic : three numbers
        Nonlinearity: share of 1 g by which the axis errs at 1 g.
    g_sensitivity : 3 x 3
        Rate that specific force feigns [deg/s per g].
    warm_up_c, warm_up_tau_s : float
        How far, and how fast, the sensor warms up after power-up.
    powered_s : float
        How long it has been on when the world starts; a restart does not cool it.
    accel_offset_mg_per_c, accel_gain_percent_per_c, gyro_offset_dps_per_c : float
        What each degree below the final temperature changes, alike on the three axes.
    ambient_c : float
    quantized : bool
        Whether readings are whole counts within the range of the converter.
    """

    accel_gain: Matrix3 = ((1.021, 0.006, -0.011), (-0.009, 0.984, 0.008), (0.012, -0.007, 1.015))
    accel_offset: Vector3 = (0.31, -0.24, 0.52)
    gyro_gain: Matrix3 = ((0.982, -0.008, 0.005), (0.010, 1.019, -0.006), (-0.007, 0.009, 1.012))
    gyro_offset: Vector3 = (0.031, -0.045, 0.022)
    mag_gain: Matrix3 = ((1.05, 0.02, -0.01), (0.02, 0.96, 0.03), (-0.01, 0.03, 1.02))
    mag_offset: Vector3 = (25.0, -18.0, 31.0)
    accel_noise_ug: NotNegative = 400.0
    gyro_noise_dps: NotNegative = 0.005
    mag_noise_ut: NotNegative = 0.3
    accel_walk_mg: NotNegative = 0.1
    gyro_walk_dps: NotNegative = 0.1
    accel_quadratic: Vector3 = ZERO
    accel_cubic: Vector3 = ZERO
    g_sensitivity: Matrix3 = ZERO_MATRIX
    warm_up_c: float = 3.0
    warm_up_tau_s: Positive = 300.0
    powered_s: NotNegative = 1200.0
    accel_offset_mg_per_c: float = 0.3
    accel_gain_percent_per_c: float = 0.01
    gyro_offset_dps_per_c: float = 0.02
    ambient_c: float = 25.0
    quantized: bool = True

    @classmethod
    def exact(cls, *, quantized: bool) -> SensorModel:
        """Return a sensor without errors, noise and drift."""
        return cls(
            accel_gain=IDENTITY,
            accel_offset=ZERO,
            gyro_gain=IDENTITY,
            gyro_offset=ZERO,
            mag_gain=IDENTITY,
            mag_offset=ZERO,
            accel_noise_ug=0.0,
            gyro_noise_dps=0.0,
            mag_noise_ut=0.0,
            accel_walk_mg=0.0,
            gyro_walk_dps=0.0,
            warm_up_c=0.0,
            quantized=quantized,
        )


class FirmwareModel(Model):
    """The microcontroller that samples the sensor and sends packets to the host.

    Attributes
    ----------
    layout : str or dict
        Name of a built-in packet layout, the path of a layout file, or a layout as plain data,
        for kinds of IMU that send any layout.
    rate_hz : float or None
        Samples per second of the device's clock; None takes the layout's, or 100. Kinds whose
        rate is their own affair ignore it.
    skew_ppm : float
        How much faster than true the device's clock runs.
    clock_offset_s : float
        What the device's clock shows when the rig starts; 0 after a restart.
    burst_s : (float, float)
        Shortest and longest time between two deliveries of the radio; (0, 0) sends at once.
    latency_s : float
        Shortest way from sample to host.
    """

    layout: str | dict[str, Any] = "mpu9150-28"
    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    skew_ppm: float = 30.0
    clock_offset_s: NotNegative = 1234.5
    burst_s: tuple[NotNegative, NotNegative] = (0.02, 0.1)
    latency_s: NotNegative = 0.004


class MaestroModel(Model):
    """Settings stored on the servo controller.

    The pulse limits are those of a board set up for the jig; the factory's 992 to 2000 us would
    cut the tilt axis short.
    """

    channels: Literal[6, 12, 18, 24] = 12
    device: Annotated[int, Field(ge=0, le=127)] = 12
    crc: bool = False
    mini_ssc_offset: Annotated[int, Field(ge=0, le=254)] = 0
    timeout_s: NotNegative = 0.0
    home: Literal["off", "ignore"] = "off"
    min_us: Positive = 800.0
    max_us: Positive = 2208.0
