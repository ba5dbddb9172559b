"""A simulated Xsens MTi: its states, the messages it answers, and the measurements it sends.

From power-up it says WakeUp, and goes to its Config state if it hears WakeUpAck within half a
second; otherwise it sends its Configuration and measures. What it was told to send survives
power-down. The first generation (mark 3) knows the legacy format only and answers what it does not
know with error 4; later ones (mark 4) know MTData2 as well, and the legacy format when told so.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from firmware_protocols.fields import LayoutError
from firmware_protocols.unconfirmed import (
    XSENS_LEGACY_AXES,
    XSENS_LEGACY_MATRIX_BY_COLUMNS,
    XSENS_MTI_NOISE,
    XSENS_MTI_RANGE,
    XSENS_UT_PER_UNIT,
)
from firmware_protocols.xsens import PERIOD_HZ, PERIODS, TICK_S
from firmware_protocols.xsens_data import (
    ITEMS,
    MOST_HZ,
    NED,
    NWU,
    Item,
    item_of,
    legacy_parts,
    write_numbers,
)
from firmware_protocols.xsens_frames import (
    Message,
    Mid,
    answer_to,
    encode_message,
    find_messages,
)
from imu_rig import rotation
from imu_rig.arrays import AnyArray, FloatArray, IntArray
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.budget import Budget
from simulators.encoders import Encoder, MadeSamples
from simulators.imu_kinds import ImuKind
from simulators.inertial_sensor import SensorRange, SensorRanges
from simulators.models import FirmwareModel, SensorModel
from simulators.mti_attitude import Attitude

WAKE_S = 0.5
"""How long it waits for WakeUpAck."""

EVERY_SAMPLE = 0xFFFF
FASTEST_HZ = 400
MAX_OUTPUTS = 32
DEFAULT_HZ = 100

INVALID_PERIOD, INVALID_MESSAGE, INVALID_PARAMETER = 0x03, 0x04, 0x21

Generation = Literal["mark3", "mark4"]
State = Literal["waking", "config", "measurement"]


@dataclass
class Memory:
    """What survives power-down.

    Attributes
    ----------
    outputs : list of (int, int)
        Identifier and rate [Hz] of each item of MTData2; none for the legacy format.
    mode, settings, period, skip : int
        Of the legacy format. The factory's: orientation as quaternion with a sample counter, 100
        times a second.
    baud : int
        Number of the baud rate.
    """

    outputs: list[tuple[int, int]] = field(default_factory=list)
    mode: int = 0x0004
    settings: int = 0x00000001
    period: int = 1152
    skip: int = 0
    baud: int = 0x02


class MtiUnit:
    """One MTi; an `simulators.encoders.Encoder`.

    Parameters
    ----------
    generation : str
        "mark3" or "mark4".
    memory : Memory, optional
        What it was told before; otherwise as it leaves the factory.
    accel_limit, gyro_limit : float
        Full scale [m/s2, rad/s], beyond which it says that it clips.

    Attributes
    ----------
    state : str
        "waking", "config" or "measurement".
    """

    def __init__(
        self,
        generation: Generation,
        memory: Memory | None = None,
        *,
        accel_limit: float = 50.0,
        gyro_limit: float = 300.0 * DEG,
    ) -> None:
        self.generation = generation
        self.memory = memory or Memory()
        self.state: State = "measurement"
        self.device_id = 0x00300001 if generation == "mark3" else 0x03700001
        self._limits = (accel_limit, gyro_limit)
        self._wake_until_s = 0.0
        self._heard = b""
        self._latest = b""
        self._attitude = Attitude()

    @property
    def sample_hz(self) -> float:
        """Samples per second."""
        rates = [rate for _, rate in self.memory.outputs if rate != EVERY_SAMPLE]
        if self.memory.outputs:
            return float(max(rates, default=DEFAULT_HZ))
        return PERIOD_HZ / self.memory.period

    def boot(self, now_s: float) -> bytes:
        """Say WakeUp."""
        self.state = "waking"
        self._wake_until_s = now_s + WAKE_S
        self._heard = b""
        self._attitude = Attitude()
        return encode_message(Mid.WAKE_UP)

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Answer what the host says."""
        messages, decided = find_messages(self._heard + data)
        self._heard = (self._heard + data)[decided:]
        return b"".join(self._answer(message, now_s) for message in messages)

    def encode(self, samples: MadeSamples) -> list[bytes]:
        """Return what leaves with each sample."""
        turned = self._attitude.follow(
            samples.readings.accel,
            samples.readings.gyro,
            samples.readings.mag,
            1.0 / self.sample_hz,
        )
        if self.state == "config":
            return [b""] * len(samples)
        whole = self._outputs(samples, turned) if self.memory.outputs else None
        frames = whole or self._legacy(samples, turned)
        sent = []
        for moment, frame in zip(samples.t.tolist(), frames, strict=True):
            lead = b""
            if self.state == "waking":
                if moment < self._wake_until_s:
                    sent.append(b"")
                    continue
                self.state = "measurement"
                lead = encode_message(Mid.CONFIGURATION, self._configuration())
            sent.append(lead + frame)
        return sent

    # What it hears -----------------------------------------------------------------------------

    def _answer(self, message: Message, now_s: float) -> bytes:
        if message.mid == Mid.WAKE_UP_ACK:
            if self.state == "waking" and now_s <= self._wake_until_s:
                self.state = "config"
            return b""
        if message.mid == Mid.GO_TO_CONFIG:
            self.state = "config"
            return encode_message(answer_to(message.mid))
        if message.mid == Mid.RESET:
            return encode_message(answer_to(message.mid)) + self.boot(now_s)
        if message.mid == Mid.REQ_DATA:
            return self._latest if self.state == "measurement" else _error(INVALID_MESSAGE)
        handler = self._handlers().get(message.mid)
        if handler is None or self.state != "config":
            return _error(INVALID_MESSAGE)
        return handler(message)

    def _handlers(self) -> dict[int, Callable[[Message], bytes]]:
        """Return what answers each message of the Config state."""
        known: dict[int, Callable[[Message], bytes]] = {
            Mid.GO_TO_MEASUREMENT: self._measure,
            Mid.REQ_DID: self._says(struct.pack(">I", self.device_id)),
            Mid.REQ_CONFIGURATION: self._says(self._configuration()),
            Mid.REQ_PRODUCT_CODE: self._says(
                b"MTi-28A53G35" if self.generation == "mark3" else b"MTi-300-2A5G4"
            ),
            Mid.REQ_FIRMWARE: self._says(bytes((1, 8, 2))),
            Mid.SET_PERIOD: self._number("period", ">H", _is_period, INVALID_PERIOD),
            Mid.SET_BAUD_RATE: self._number("baud", ">B", lambda baud: True, INVALID_PARAMETER),
            Mid.SET_OUTPUT_MODE: self._number("mode", ">H", self._has_mode, INVALID_PARAMETER),
            Mid.SET_OUTPUT_SETTINGS: self._number(
                "settings", ">I", self._has_settings, INVALID_PARAMETER
            ),
            Mid.SET_OUTPUT_SKIP_FACTOR: self._number(
                "skip", ">H", lambda skip: True, INVALID_PARAMETER
            ),
        }
        if self.generation == "mark4":
            known[Mid.SET_OUTPUT_CONFIGURATION] = self._set_outputs
        return known

    def _measure(self, message: Message) -> bytes:
        self.state = "measurement"
        return encode_message(answer_to(message.mid))

    def _says(self, data: bytes) -> Callable[[Message], bytes]:
        return lambda message: encode_message(answer_to(message.mid), data)

    def _number(
        self, name: str, code: str, fits: Callable[[int], bool], error: int
    ) -> Callable[[Message], bytes]:
        """Return what asks for or sets one number of the memory."""

        def answer(message: Message) -> bytes:
            if not message.data:
                data = struct.pack(code, getattr(self.memory, name))
                return encode_message(answer_to(message.mid), data)
            if len(message.data) != struct.calcsize(code):
                return _error(INVALID_PARAMETER)
            (number,) = struct.unpack(code, message.data)
            if not fits(number):
                return _error(error)
            setattr(self.memory, name, number)
            return encode_message(answer_to(message.mid))

        return answer

    def _has_mode(self, mode: int) -> bool:
        return _is_legacy(mode, 0)

    def _has_settings(self, settings: int) -> bool:
        return _is_legacy(self.memory.mode, settings)

    def _set_outputs(self, message: Message) -> bytes:
        """Set or tell the items of MTData2; one of 0000 changes to the legacy format."""
        data = message.data
        if len(data) % 4 or len(data) > 4 * MAX_OUTPUTS:
            return _error(INVALID_PARAMETER)
        if data:
            asked = [struct.unpack_from(">HH", data, at) for at in range(0, len(data), 4)]
            self.memory.outputs = [
                (identifier, _possible(identifier, rate))
                for identifier, rate in asked
                if item_of(identifier) is not None
            ]
        told = b"".join(struct.pack(">HH", *entry) for entry in self.memory.outputs)
        return encode_message(answer_to(message.mid), told or bytes(4))

    def _configuration(self) -> bytes:
        memory = self.memory
        length = 0 if memory.outputs else _data_bytes(memory.mode, memory.settings)
        head = struct.pack(">IHH", self.device_id, memory.period, memory.skip)
        tail = struct.pack(">HIHHI", 1, self.device_id, length, memory.mode, memory.settings)
        return head + bytes(88) + tail + bytes(8)

    # What it sends -----------------------------------------------------------------------------

    def _outputs(self, samples: MadeSamples, turned: FloatArray) -> list[bytes]:
        """Return an MTData2 message for every sample."""
        parts: list[tuple[int, IntArray | FloatArray, list[bytes]]] = []
        fastest = self.sample_hz
        for identifier, rate in self.memory.outputs:
            every = 1 if rate == EVERY_SAMPLE else max(1, round(fastest / rate))
            head = struct.pack(">H", identifier)
            data = [
                head + bytes([len(row)]) + row for row in self._item(identifier, samples, turned)
            ]
            parts.append((every, samples.counter, data))
        frames = []
        for place, counter in enumerate(samples.counter.tolist()):
            items = [data[place] for every, _, data in parts if counter % every == 0]
            frames.append(encode_message(Mid.MT_DATA2, b"".join(items)))
        return frames

    def _legacy(self, samples: MadeSamples, turned: FloatArray) -> list[bytes]:
        """Return an MTData message for every sample that is not skipped."""
        memory = self.memory
        number_format = memory.settings >> 8 & 0x3
        columns = []
        for part in legacy_parts(memory.mode, memory.settings):
            values = self._values(part.field, samples, turned)
            if part.code != "f":
                whole = np.atleast_2d(values.T).T.astype(np.int64) % (1 << 8 * _bytes(part.code))
                columns.append(_rows(whole.astype(part.code)))
                continue
            if part.field == "quaternion":
                shown = (4, 3, 9)[memory.settings >> 2 & 0x3]
                axes = NED if memory.settings >> 31 else XSENS_LEGACY_AXES
                values = _shown(turned, axes, shown, by_columns=XSENS_LEGACY_MATRIX_BY_COLUMNS)
            columns.append(_rows(write_numbers(np.atleast_2d(values.T).T, number_format)))
        frames = []
        for place, counter in enumerate(samples.counter.tolist()):
            data = b"".join(column[place] for column in columns)
            self._latest = encode_message(Mid.MT_DATA, data)
            sends = memory.skip != 0xFFFF and counter % (memory.skip + 1) == 0
            frames.append(self._latest if sends else b"")
        return frames

    def _item(self, identifier: int, samples: MadeSamples, turned: FloatArray) -> list[bytes]:
        item: Item = ITEMS[identifier & 0xFFF0]
        if item.field == "quaternion":
            values = _shown(turned, identifier & 0xC, item.count)
        else:
            values = self._values(item.field, samples, turned)
            if item.earth:
                values = _earth(values, identifier & 0xC)
        values = np.atleast_2d(values.T).T
        if item.code == "utc":
            return [bytes(12)] * len(samples)  # it has no receiver, and so no date
        if item.code != "f":
            whole = np.rint(values).astype(np.int64) % (1 << 8 * _bytes(item.code))
            return _rows(whole.astype(item.code))
        return _rows(write_numbers(values, identifier & 0x3))

    def _values(self, name: str, samples: MadeSamples, turned: FloatArray) -> FloatArray:
        """Return what a field says of each sample, as the unit sends it."""
        readings, period_s = samples.readings, 1.0 / self.sample_hz
        match name:
            case "counter":
                return samples.counter.astype(np.float64)
            case "time":
                return np.rint(samples.device_s / TICK_S)
            case "temperature":
                return readings.temperature
            case "accel" | "accel_hr":
                return readings.accel
            case "gyro" | "gyro_hr":
                return readings.gyro
            case "mag":
                return readings.mag / XSENS_UT_PER_UNIT
            case "quaternion":
                return turned
            case "pressure":
                return samples.pressure
            case "delta_v":
                return readings.accel * period_s
            case "delta_q":
                return rotation.from_rotation_vector(readings.gyro * period_s)
            case "free_accel":
                return rotation.rotate(turned, readings.accel) - [0.0, 0.0, STANDARD_GRAVITY]
            case "status":
                return self._status(samples).astype(np.float64)
            case "temperature_counts" | "aux1" | "aux2":
                return np.zeros(len(samples))
            case _:
                return np.zeros((len(samples), 3))

    def _status(self, samples: MadeSamples) -> IntArray:
        """Self-test passed, filter valid, and every axis that clips."""
        status = np.full(len(samples), 0x3, dtype=np.int64)
        triads = (samples.readings.accel, samples.readings.gyro)
        for part, (triad, limit) in enumerate(zip(triads, self._limits, strict=True)):
            for axis in range(3):
                clips = np.abs(triad[:, axis]) >= limit * (1.0 - 1e-9)
                status |= clips.astype(np.int64) << (8 + 3 * part + axis)
        return np.where(status > 0x3, status | 1 << 19, status)


def _error(number: int) -> bytes:
    return encode_message(Mid.ERROR, bytes([number]))


def _is_period(period: int) -> bool:
    return period in PERIODS


def _is_legacy(mode: int, settings: int) -> bool:
    try:
        legacy_parts(mode, settings)
    except LayoutError:
        return False
    return True


def _data_bytes(mode: int, settings: int) -> int:
    last = legacy_parts(mode, settings)[-1]
    return last.offset + last.size


def _possible(identifier: int, rate: int) -> int:
    if rate == EVERY_SAMPLE or identifier & 0xF000 in (0x1000, 0xE000):
        return EVERY_SAMPLE
    return max(1, min(rate, MOST_HZ.get(identifier & 0xFFF0, FASTEST_HZ)))


def _bytes(code: str) -> int:
    return np.dtype(code).itemsize


def _rows(table: AnyArray) -> list[bytes]:
    return [row.tobytes() for row in table]


def _shown(turned: FloatArray, axes: int, numbers: int, *, by_columns: bool = False) -> FloatArray:
    """Return orientations in some axes of the earth as quaternions, Euler angles or matrices."""
    half = 0.5**0.5
    if axes == NED:
        turned = rotation.multiply(np.array([0.0, half, half, 0.0]), turned)
    elif axes == NWU:
        turned = rotation.multiply(np.array([half, 0.0, 0.0, -half]), turned)
    if numbers == 4:
        return turned
    matrices = rotation.to_matrix(turned)
    if numbers == 9:
        if by_columns:
            matrices = matrices.transpose(0, 2, 1)
        return matrices.reshape(-1, 9)
    roll = np.arctan2(matrices[:, 2, 1], matrices[:, 2, 2])
    pitch = -np.arcsin(np.clip(matrices[:, 2, 0], -1.0, 1.0))
    yaw = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    angles: FloatArray = np.degrees(np.stack([roll, pitch, yaw], axis=1))
    return angles


def _earth(vectors: FloatArray, axes: int) -> FloatArray:
    """Return vectors in east, north, up in other axes of the earth."""
    east, north, up = vectors.T
    if axes == NED:
        return np.stack([north, east, -up], axis=1)
    if axes == NWU:
        return np.stack([north, -east, up], axis=1)
    return vectors


# Kinds ----------------------------------------------------------------------------------------


def _ranges(name: str) -> SensorRanges:
    full = XSENS_MTI_RANGE[name]
    return SensorRanges(
        accel=SensorRange(0.0, -full["accel"], full["accel"]),
        gyro=SensorRange(0.0, -full["gyro_dps"] * DEG, full["gyro_dps"] * DEG),
        mag=SensorRange(),
    )


def _sensor(name: str) -> SensorModel:
    noise = XSENS_MTI_NOISE[name]
    return SensorModel(
        accel_gain=(
            (1.0012, 0.0006, -0.0008),
            (-0.0004, 0.9991, 0.0007),
            (0.0009, -0.0005, 1.0008),
        ),
        accel_offset=(0.018, -0.012, 0.021),
        gyro_gain=((0.9990, -0.0007, 0.0004), (0.0008, 1.0011, -0.0005), (-0.0006, 0.0009, 1.0006)),
        gyro_offset=(0.0024, -0.0031, 0.0017),
        mag_gain=((1.008, 0.002, -0.001), (0.002, 0.994, 0.003), (-0.001, 0.003, 1.003)),
        mag_offset=(1.5, -0.9, 1.1),
        accel_noise_ug=noise["accel_ug"],
        gyro_noise_dps=noise["gyro_dps"],
        mag_noise_ut=noise["mag_ut"],
        accel_walk_mg=0.05,
        gyro_walk_dps=0.01,
        accel_offset_mg_per_c=0.02,
        accel_gain_percent_per_c=0.001,
        gyro_offset_dps_per_c=0.002,
    )


_BUDGET = Budget(
    scale=0.003,
    cross_axis=0.002,
    accel_bias_mg=(3.0, 3.0, 3.0),
    gyro_bias_dps=0.3,
    soft_iron=0.02,
    hard_iron_ut=3.0,
)
"""They come calibrated: what is left is what ageing and a hard knock may have done."""

_CABLE = FirmwareModel(burst_s=(0.001, 0.016), latency_s=0.002)
"""A converter to USB that hands on what has come every 16 ms."""


def _maker(
    name: str, generation: Generation
) -> Callable[[FirmwareModel, np.random.Generator], Encoder]:
    full = XSENS_MTI_RANGE[name]

    def make(model: FirmwareModel, rng: np.random.Generator) -> Encoder:
        del model, rng
        return MtiUnit(generation, accel_limit=full["accel"], gyro_limit=full["gyro_dps"] * DEG)

    return make


XSENS_MTI = ImuKind(
    name="xsens-mti",
    title="Xsens MTi (10 and 100 series and later): +-5 g, +-450 deg/s",
    protocol="xsens-mti",
    output_hz=100.0,
    ranges=_ranges("xsens-mti"),
    encoder=_maker("xsens-mti", "mark4"),
    budget=_BUDGET,
    sensor=_sensor("xsens-mti"),
    firmware=_CABLE,
)

XSENS_MTI_LEGACY = ImuKind(
    name="xsens-mti-legacy",
    title="Xsens MTi (first generation): +-5 g, +-300 deg/s",
    protocol="xsens-mti-legacy",
    output_hz=100.0,
    ranges=_ranges("xsens-mti-legacy"),
    encoder=_maker("xsens-mti-legacy", "mark3"),
    budget=_BUDGET,
    sensor=_sensor("xsens-mti-legacy"),
    firmware=_CABLE,
)
