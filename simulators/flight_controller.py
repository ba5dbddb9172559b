"""A flight controller as a host sees it over MAVLink: PX4's way or ArduPilot's.

It sends its heartbeat each second and messages of its IMU at the rates that it was asked for, and
answers requests and questions about parameters. Axes on the wire are forward, right, down. The
whole numbers of SCALED_IMU and RAW_IMU are cut off, not rounded, as both firmwares do it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from firmware_protocols.mavlink_frames import Contents, MavlinkFrameDecoder, read_contents
from firmware_protocols.mavlink_messages import (
    CHECKS,
    COMMAND_LONG,
    HEARTBEAT,
    PARAM_REQUEST_READ,
    REQUEST_DATA_STREAM,
)
from firmware_protocols.protocol import Packets
from firmware_protocols.unconfirmed import ICM20602_BIAS_DPS, ICM20602_BIAS_MG, ICM20602_CROSS_AXIS
from firmware_protocols.variable_framing import FramedBytes
from imu_rig.arrays import FloatArray
from imu_rig.mavlink_dialect import mavlink, mavlink_1, packed, sender
from imu_rig.units import DEG, FIELD_UNITS, MILLI_G, STANDARD_GRAVITY
from simulators.budget import Budget
from simulators.encoders import Encoder, MadeSamples
from simulators.imu_kinds import ImuKind
from simulators.inertial_sensor import SensorRange, SensorRanges
from simulators.models import FirmwareModel, SensorModel

START_HZ = 100.0
LEAST_SAMPLE_HZ = 50.0
"""The sensor is looked at so often, however slow the messages are."""
MOST_HZ = 400.0
"""What the main loop of the firmware can do."""

FRONT_RIGHT_DOWN = np.array((1.0, -1.0, -1.0))
INT16 = 32767

Autopilot = Literal["px4", "ardupilot"]
_NUMBERS = {"px4": mavlink.MAV_AUTOPILOT_PX4, "ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA}
_CAPABILITIES = {
    "px4": mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2,
    "ardupilot": mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2,
}
_RAW_SENSORS = ("RAW_IMU", "SCALED_IMU", "SCALED_PRESSURE")
"""What the old way of asking starts."""

PARAMETERS: Mapping[str, Mapping[str, int | float]] = {
    "px4": {
        "CAL_ACC0_ID": 1310988,
        "CAL_ACC0_PRIO": 50,
        **{f"CAL_ACC0_{axis}OFF": 0.0 for axis in "XYZ"},
        **{f"CAL_ACC0_{axis}SCALE": 1.0 for axis in "XYZ"},
        "CAL_GYRO0_ID": 1310988,
        **{f"CAL_GYRO0_{axis}OFF": 0.0 for axis in "XYZ"},
        "CAL_MAG0_ID": 396809,
        "CAL_MAG0_ROT": -1,
        **{f"CAL_MAG0_{axis}OFF": 0.0 for axis in "XYZ"},
        **{f"CAL_MAG0_{axis}SCALE": 1.0 for axis in "XYZ"},
        "SENS_BOARD_ROT": 0,
    },
    "ardupilot": {
        "INS_ACC_ID": 2753028,
        **{f"INS_ACCOFFS_{axis}": 0.001 for axis in "XYZ"},
        **{f"INS_ACCSCAL_{axis}": 1.0 for axis in "XYZ"},
        **{f"INS_GYROFFS_{axis}": 0.004 for axis in "XYZ"},
        "COMPASS_DEV_ID": 97539,
        **{f"COMPASS_OFS_{axis}": 0.0 for axis in "XYZ"},
        "AHRS_ORIENTATION": 0,
    },
}
"""Some of those that each firmware has; whole numbers here are whole numbers there.

Both correct next to nothing: what reaches the host is what the simulated sensor reads. ArduPilot
takes offsets of exactly 0 for no calibration and measures those of the gyroscope at each start.
"""


@dataclass(frozen=True)
class FlightControllerModel:
    """How a flight controller is set up.

    Attributes
    ----------
    autopilot : str
        "px4" or "ardupilot".
    rates : mapping
        Messages per second as it starts, by name. What is not among them can be asked for.
    cannot : tuple of str
        Messages that it does not know how to send.
    refusal : int
        MAV_RESULT with which it answers a request for one of those.
    version : int
        Of MAVLink. One of version 1 does not hear version 2.
    key : bytes or None
        Of 32 bytes: it signs what it sends.
    system, component : int
    waits : bool
        Whether it keeps silent until it has heard something, as PX4 does on USB.
    """

    autopilot: Autopilot
    rates: Mapping[str, float] = field(default_factory=dict)
    cannot: tuple[str, ...] = ()
    refusal: int = mavlink.MAV_RESULT_FAILED
    version: int = 2
    key: bytes | None = None
    system: int = 1
    component: int = mavlink.MAV_COMP_ID_AUTOPILOT1
    waits: bool = False


class FlightController:
    """The firmware; see :class:`simulators.encoders.Encoder`.

    Parameters
    ----------
    model : FlightControllerModel
    """

    def __init__(self, model: FlightControllerModel) -> None:
        self.model = model
        self.parameters = dict(PARAMETERS[model.autopilot])
        self._dialect = mavlink if model.version == 2 else mavlink_1()
        self._writers: dict[str, Callable[[_Sample], tuple[Any, ...]]] = {
            "HEARTBEAT": self._heartbeat,
            "HIGHRES_IMU": self._highres_imu,
            "SCALED_IMU": self._scaled_imu,
            "SCALED_IMU2": self._scaled_imu,
            "SCALED_IMU3": self._scaled_imu,
            "RAW_IMU": self._raw_imu,
            "SCALED_PRESSURE": self._scaled_pressure,
            "ATTITUDE": self._attitude,
        }
        self._start()

    def _start(self) -> None:
        model = self.model
        self.rates = {"HEARTBEAT": 1.0, **model.rates}
        self._due: dict[str, float] = {}
        self._awake = not model.waits
        self._ear = _Ear()
        self._voice = sender(model.system, model.component, version=model.version)
        if model.key is not None:
            self._voice.signing.secret_key = model.key
            self._voice.signing.sign_outgoing = True
            self._voice.signing.timestamp = 1

    @property
    def sample_hz(self) -> float:
        """As often as the most frequent message."""
        return max(LEAST_SAMPLE_HZ, *self.rates.values())

    def boot(self, now_s: float) -> bytes:
        """Start; what was asked for is forgotten."""
        del now_s
        self._start()
        return b""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Do what a ground station asks for."""
        del now_s
        answer = b""
        for name, version, row in self._ear.hear(data):
            if version > self.model.version:
                continue
            self._awake = True
            if name == COMMAND_LONG.name and self._is_for_us(row):
                answer += self._command(int(row["command"]), row["param"].tolist())
            elif name == REQUEST_DATA_STREAM.name and self._is_for_us(row):
                self._data_stream(row)
            elif name == PARAM_REQUEST_READ.name and self._is_for_us(row):
                answer += self._parameter(bytes(row["param_id"]), int(row["param_index"]))
        return answer

    def encode(self, samples: MadeSamples) -> list[bytes]:
        """Return for every sample the messages that are due with it."""
        if not self._awake:
            return [b""] * len(samples)
        return [self._frames(sample) for sample in _each(samples)]

    def _frames(self, sample: _Sample) -> bytes:
        sent = b""
        for name, rate_hz in self.rates.items():
            due_s = self._due.get(name, sample.device_s)
            if rate_hz > 0 and sample.device_s >= due_s - 1e-6:
                periods = math.floor((sample.device_s - due_s) * rate_hz + 1e-3) + 1
                self._due[name] = due_s + periods / rate_hz
                sent += self._say(name, *self._writers[name](sample))
        return sent

    def _say(self, name: str, *fields: Any) -> bytes:
        message = getattr(self._dialect, f"MAVLink_{name.lower()}_message")(*fields)
        return packed(self._voice, message)

    def _is_for_us(self, row: np.void) -> bool:
        model = self.model
        return row["target_system"] in (0, model.system) and row["target_component"] in (
            0,
            model.component,
        )

    def _command(self, command: int, parameters: list[float]) -> bytes:
        result, extra = mavlink.MAV_RESULT_UNSUPPORTED, b""
        if command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            result = self._set_interval(parameters[0], parameters[1])
        elif command == mavlink.MAV_CMD_REQUEST_MESSAGE and parameters[0] == _AUTOPILOT_VERSION:
            result = mavlink.MAV_RESULT_ACCEPTED
            zeros = [0] * 8
            capabilities = _CAPABILITIES[self.model.autopilot]
            extra = self._say(
                "autopilot_version", capabilities, 0, 0, 0, 0, zeros, zeros, zeros, 0, 0, 0
            )
        return self._say("command_ack", command, result) + extra

    def _set_interval(self, number: float, interval_us: float) -> int:
        name = _NAMES.get(number)
        if name not in self._writers or name in self.model.cannot:
            return self.model.refusal
        if not (math.isfinite(interval_us) and (interval_us == -1 or interval_us >= 0)):
            return int(mavlink.MAV_RESULT_DENIED)
        self._set_rate(name, 0.0 if interval_us == -1 else 1e6 / max(interval_us, 1e6 / MOST_HZ))
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _set_rate(self, name: str, rate_hz: float) -> None:
        if self.rates.get(name) != rate_hz:
            self.rates[name] = rate_hz
            self._due.pop(name, None)

    def _data_stream(self, row: np.void) -> None:
        if self.model.autopilot != "ardupilot":  # PX4 has forgotten this way
            return
        if row["req_stream_id"] in (
            mavlink.MAV_DATA_STREAM_ALL,
            mavlink.MAV_DATA_STREAM_RAW_SENSORS,
        ):
            rate_hz = min(float(row["req_message_rate"]), MOST_HZ) if row["start_stop"] else 0.0
            for name in _RAW_SENSORS:
                if name not in self.model.cannot:
                    self._set_rate(name, rate_hz)

    def _parameter(self, param_id: bytes, index: int) -> bytes:
        names = list(self.parameters)
        name = param_id.rstrip(b"\0").decode("ascii", "replace")
        if 0 <= index < len(names):
            name = names[index]
        if name not in self.parameters:
            return b""
        value = self.parameters[name]
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        sent = float(value)
        if isinstance(value, int):
            kind = mavlink.MAV_PARAM_TYPE_INT32
            if self.model.autopilot == "px4":
                sent = float(np.array(value, "<i4").view("<f4"))
        return self._say("param_value", name.encode(), sent, kind, len(names), names.index(name))

    def _heartbeat(self, sample: _Sample) -> tuple[Any, ...]:
        del sample
        kind, autopilot = mavlink.MAV_TYPE_QUADROTOR, _NUMBERS[self.model.autopilot]
        return kind, autopilot, 0, 0, mavlink.MAV_STATE_STANDBY, 3

    def _highres_imu(self, sample: _Sample) -> tuple[Any, ...]:
        updated = sum(1 << bit for bit in (*range(10), 11, 12))
        return (
            sample.time_us,
            *sample.accel,
            *sample.gyro,
            *(value / FIELD_UNITS["gauss"] for value in sample.mag),
            sample.pressure / 100.0,
            0.0,
            0.0,
            sample.temperature,
            updated,
        )

    def _scaled_imu(self, sample: _Sample) -> tuple[Any, ...]:
        numbers = sample.time_us // 1000 % 2**32, *sample.whole()
        return numbers if self.model.version == 1 else (*numbers, sample.hundredths)

    def _raw_imu(self, sample: _Sample) -> tuple[Any, ...]:
        numbers = sample.time_us, *sample.whole()
        return numbers if self.model.version == 1 else (*numbers, 0, sample.hundredths)

    def _scaled_pressure(self, sample: _Sample) -> tuple[Any, ...]:
        boot_ms = sample.time_us // 1000 % 2**32
        return boot_ms, sample.pressure / 100.0, 0.0, sample.air_hundredths

    def _attitude(self, sample: _Sample) -> tuple[Any, ...]:
        x, y, z = (-value for value in sample.accel)
        roll, pitch = math.atan2(y, z), math.atan2(-x, math.hypot(y, z))
        return sample.time_us // 1000 % 2**32, roll, pitch, 0.0, *sample.gyro


_NAMES: dict[float, str] = {
    number: message.msgname for number, message in mavlink.mavlink_map.items() if number in CHECKS
}
_AUTOPILOT_VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION


class _Ear(MavlinkFrameDecoder):
    """Hears what a ground station says."""

    def __init__(self) -> None:
        super().__init__()
        self._heard: list[tuple[int, str, int, np.void]] = []

    def _read(self, frames: FramedBytes) -> dict[str, Packets]:
        messages = (HEARTBEAT, COMMAND_LONG, REQUEST_DATA_STREAM, PARAM_REQUEST_READ)
        found: list[tuple[int, str, int, np.void]] = []
        for name, contents in read_contents(frames, messages).items():
            found += _rows(name, contents)
        self._heard += sorted(found, key=lambda entry: entry[0])
        return {}

    def hear(self, data: bytes) -> list[tuple[str, int, np.void]]:
        """Return name, version and content of each message that these bytes complete."""
        self.feed(data)
        heard, self._heard = self._heard, []
        return [(name, version, row) for _, name, version, row in heard]


def _rows(name: str, contents: Contents) -> Iterator[tuple[int, str, int, np.void]]:
    for place, row in enumerate(contents.payload):
        yield int(contents.index[place]), name, int(contents.version[place]), row


@dataclass(frozen=True)
class _Sample:
    """One sample in SI units on the vehicle's axes."""

    device_s: float
    accel: list[float]
    gyro: list[float]
    mag: list[float]
    temperature: float
    pressure: float
    air_c: float

    @property
    def time_us(self) -> int:
        return math.floor(self.device_s * 1e6 + 0.5)

    @property
    def hundredths(self) -> int:
        """Temperature in 0.01 degC; 0 would mean that there is none."""
        return round(100.0 * self.temperature) or 1

    @property
    def air_hundredths(self) -> int:
        return round(100.0 * self.air_c)

    def whole(self) -> list[int]:
        """Return mg, mrad/s and mgauss without what is behind the point."""
        values = [
            *(value / MILLI_G for value in self.accel),
            *(1e3 * value for value in self.gyro),
            *(value / FIELD_UNITS["mG"] for value in self.mag),
        ]
        return [max(-INT16 - 1, min(INT16, math.trunc(value))) for value in values]


def _each(samples: MadeSamples) -> Iterator[_Sample]:
    readings = samples.readings

    def columns(values: FloatArray) -> list[list[float]]:
        turned: list[list[float]] = (np.nan_to_num(values) * FRONT_RIGHT_DOWN).tolist()
        return turned

    for device_s, accel, gyro, mag, temperature, pressure, air_c in zip(
        samples.device_s.tolist(),
        columns(readings.accel),
        columns(readings.gyro),
        columns(readings.mag),
        readings.temperature.tolist(),
        samples.pressure.tolist(),
        samples.air_c.tolist(),
        strict=True,
    ):
        yield _Sample(device_s, accel, gyro, mag, temperature, pressure, air_c)


_FULL_ACCEL, _FULL_GYRO, _FULL_MAG = 16.0 * STANDARD_GRAVITY, 2000.0 * DEG, 1600.0

_SENSOR = SensorModel(
    accel_gain=((1.006, 0.004, -0.005), (-0.003, 0.994, 0.006), (0.005, -0.004, 1.008)),
    accel_offset=(0.15, -0.11, 0.24),
    gyro_gain=((0.995, -0.004, 0.003), (0.005, 1.007, -0.004), (-0.003, 0.005, 1.004)),
    gyro_offset=(0.010, -0.008, 0.006),
    mag_offset=(18.0, -12.0, 9.0),
    accel_noise_ug=100.0,
    gyro_noise_dps=0.004,
    mag_noise_ut=0.3,
    accel_walk_mg=0.1,
    gyro_walk_dps=0.02,
    accel_offset_mg_per_c=0.5,
    gyro_offset_dps_per_c=0.01,
)
"""Noise as the data sheet of the ICM-20602 states it: 100 ug and 4 mdps per root hertz."""

_BUDGET = Budget(
    scale=0.01,
    cross_axis=ICM20602_CROSS_AXIS,
    accel_bias_mg=ICM20602_BIAS_MG,
    gyro_bias_dps=ICM20602_BIAS_DPS,
    hard_iron_ut=30.0,
)

_USB = FirmwareModel(burst_s=(0.001, 0.005), latency_s=0.001)


def _maker(
    autopilot: Autopilot, message: str, *, cannot: tuple[str, ...] = (), version: int = 2
) -> Callable[[FirmwareModel, np.random.Generator], Encoder]:
    rates = {message: START_HZ, "SCALED_PRESSURE": 10.0, "ATTITUDE": 10.0}

    def make(model: FirmwareModel, rng: np.random.Generator) -> Encoder:
        del model, rng
        return FlightController(FlightControllerModel(autopilot, rates, cannot, version=version))

    return make


MAVLINK_HIGHRES = ImuKind(
    name="mavlink-highres",
    title="Pixhawk with PX4, HIGHRES_IMU over MAVLink: +-16 g, +-2000 deg/s",
    protocol="mavlink-highres",
    output_hz=START_HZ,
    ranges=SensorRanges(
        accel=SensorRange(0.0, -_FULL_ACCEL, _FULL_ACCEL),
        gyro=SensorRange(0.0, -_FULL_GYRO, _FULL_GYRO),
        mag=SensorRange(0.0, -_FULL_MAG, _FULL_MAG),
    ),
    encoder=_maker("px4", "HIGHRES_IMU"),
    budget=_BUDGET,
    sensor=_SENSOR,
    firmware=_USB,
)

MAVLINK_SCALED = ImuKind(
    name="mavlink-scaled",
    title="Pixhawk with ArduPilot, SCALED_IMU over MAVLink in steps of 1 mg and 1 mrad/s",
    protocol="mavlink-scaled",
    output_hz=START_HZ,
    ranges=SensorRanges(
        accel=SensorRange(MILLI_G, -16_000.0, 16_000.0, cuts_off=True),
        gyro=SensorRange(1e-3, -INT16, INT16, cuts_off=True),
        mag=SensorRange(FIELD_UNITS["mG"], -16_000.0, 16_000.0, cuts_off=True),
    ),
    encoder=_maker("ardupilot", "SCALED_IMU", cannot=("HIGHRES_IMU",)),
    budget=_BUDGET,
    sensor=_SENSOR,
    firmware=_USB,
    encoder_rounds=True,
)

MAVLINK_RAW = replace(
    MAVLINK_SCALED,
    name="mavlink-raw",
    title="Old flight controller with ArduPilot, RAW_IMU over MAVLink 1",
    protocol="mavlink-raw",
    encoder=_maker("ardupilot", "RAW_IMU", cannot=("HIGHRES_IMU", "SCALED_IMU"), version=1),
)
