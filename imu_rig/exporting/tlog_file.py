"""Trials as a MAVLink telemetry log: what MAVExplorer, QGroundControl and pymavlink read.

A frame of MAVLink 2 after the wall clock [us] as eight bytes, the highest first, for every sample
of an inertial sensor or barometer, in order of time. The two lowest bits of that time name a link
and are 0; HIGHRES_IMU has the time to the microsecond in itself.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import AnyArray, FloatArray, IntArray
from imu_rig.errors import DataError, InputError
from imu_rig.exporting.device_data import DeviceData, TrialData, inertial_fields, temperature
from imu_rig.exporting.output import Output, Place
from imu_rig.mavlink_dialect import mavlink, packed, sender

SYSTEM = 1
FIRST_COMPONENT = mavlink.MAV_COMP_ID_USER1
"""Component of the first device; the others follow."""
MOST_DEVICES = 64
HPA = {"Pa": 0.01, "hPa": 1.0, "mbar": 1.0, "kPa": 10.0, "bar": 1000.0}
UT_PER_GAUSS = 100.0
TEXT_BYTES = 50
LINK_BITS = 3
NUMBERS = 15
"""In a message of an inertial sensor."""
_UPDATED = {"accel": 0x7, "gyro": 0x38, "mag": 0x1C0, "pressure": 0x200, "temperature": 0x1000}


@dataclass(frozen=True, eq=False)
class _Stream:
    """Frames that are made when their time [us since 1970] comes."""

    utc_us: IntArray
    frame: Callable[[int], bytes]


def write_tlog(data: TrialData, place: Place, output: Output) -> None:
    """Write all devices to one file.

    Raises
    ------
    InputError
        If the file exists, nothing in the trial has a message, or a time lies before 1970.
    StorageError
        If the disk is full or fails.
    """
    output.require_new(place.path)
    if len(data.names) > MOST_DEVICES:
        raise InputError(f"A tlog takes {MOST_DEVICES} devices: choose some with --sensor.")
    streams, texts = [], [(round(m.dated_ns / 1000), 0, m.label) for m in data.markers]
    for number, device in enumerate(data):
        stream = _stream(device, number, output)
        if stream is None:
            data.leave_out(device.source)
        else:
            streams.append(stream)
            state = f"calibrated {', '.join(device.calibrated)}" if device.calibrated else "raw"
            component = FIRST_COMPONENT + number
            text = f"id {number}, component {component}: {device.name}, {state}"
            begin = stream.utc_us.min(initial=round(device.dated_start_ns / 1000))
            texts.append((int(begin), component, text))
    if not streams:
        raise DataError(
            f"{data.trial.path}: no device measures what MAVLink has a message for "
            "(acceleration, angular rate or pressure); export it as csv or mcap."
        )
    streams.insert(0, _text_stream(sorted(texts)))
    with output.open(place.path) as file:
        for utc_us, frame in _in_order(streams, output):
            file.write(struct.pack(">Q", utc_us & ~LINK_BITS) + frame)


def _in_order(streams: list[_Stream], output: Output) -> Iterator[tuple[int, bytes]]:
    times = np.concatenate([stream.utc_us for stream in streams])
    if times.min() < 0:
        raise InputError(
            "Times in this trial lie before 1970, and a tlog has no such times: export it as "
            "csv, whose column t_s does not need that clock."
        )
    firsts = np.cumsum([0, *(len(stream.utc_us) for stream in streams)])
    order = np.argsort(times, kind="stable")
    for span in output.spans("all devices", len(order), NUMBERS):
        chosen = order[span]
        which = np.searchsorted(firsts, chosen, side="right") - 1
        places = zip(
            times[chosen].tolist(), which.tolist(), (chosen - firsts[which]).tolist(), strict=True
        )
        for utc_us, stream, row in places:
            yield utc_us, streams[stream].frame(row)


def _stream(device: DeviceData, number: int, output: Output) -> _Stream | None:
    samples, inertial = device.samples, inertial_fields(device.samples)
    pressure, celsius = _pressure_hpa(device), temperature(samples)
    is_inertial = samples.is_inertial and len(inertial) > 0
    held = set(inertial) if is_inertial else set()
    if pressure is not None:
        held.add("pressure")
    if celsius is not None and held:
        held.add("temperature")
    if not held:
        output.notes.append(f"{device.name}: MAVLink has no message for it; left out.")
    elif left_out := [name for name in device.fields if name not in held]:
        output.notes.append(
            f"{device.name}: MAVLink has no place for {', '.join(left_out)}; left out."
        )
    voice = sender(SYSTEM, FIRST_COMPONENT + number)
    if is_inertial:
        columns = {name: samples.values[name] for name in inertial}
        return _imu_stream(voice, number, device, columns, pressure, celsius)
    if pressure is not None:
        return _pressure_stream(voice, device, pressure, celsius)
    return None


def _imu_stream(
    voice: mavlink.MAVLink,
    number: int,
    device: DeviceData,
    measured: dict[str, FloatArray],
    pressure: FloatArray | None,
    celsius: FloatArray | None,
) -> _Stream:
    """HIGHRES_IMU; what the sensor does not measure is NaN and not among the updated fields."""
    count, utc_us = len(device), device.dated_us
    numbers = np.full((count, 13), np.nan, np.float32)
    with np.errstate(over="ignore"):  # no number of a sensor; it becomes infinite
        for place, name in enumerate(("accel", "gyro", "mag")):
            if name in measured:
                factor = 1.0 / UT_PER_GAUSS if name == "mag" else 1.0
                numbers[:, 3 * place : 3 * place + 3] = measured[name] * factor
        if pressure is not None:
            numbers[:, 9] = pressure
        if celsius is not None:
            numbers[:, 12] = celsius
    there = [*measured, *(["pressure"] if pressure is not None else [])]
    there += ["temperature"] if celsius is not None else []
    updated = sum(_UPDATED[name] for name in there)

    def frame(row: int) -> bytes:
        message = mavlink.MAVLink_highres_imu_message(
            int(utc_us[row]), *numbers[row].tolist(), updated, number
        )
        return packed(voice, message)

    return _Stream(utc_us, frame)


def _pressure_stream(
    voice: mavlink.MAVLink, device: DeviceData, pressure: FloatArray, celsius: FloatArray | None
) -> _Stream:
    """SCALED_PRESSURE, with the trial time [ms] as the time since the start."""
    boot_ms = np.rint(device.t_us / 1000).astype(np.int64).clip(0) & 0xFFFFFFFF
    with np.errstate(over="ignore"):
        hpa = pressure.astype(np.float32)
    hundredths: AnyArray = np.zeros(len(device), np.int64)
    if celsius is not None:
        hundredths = np.rint(np.nan_to_num(celsius * 100.0).clip(-32768, 32767)).astype(np.int64)

    def frame(row: int) -> bytes:
        message = mavlink.MAVLink_scaled_pressure_message(
            int(boot_ms[row]), float(hpa[row]), 0.0, int(hundredths[row])
        )
        return packed(voice, message)

    return _Stream(device.dated_us, frame)


def _text_stream(texts: list[tuple[int, int, str]]) -> _Stream:
    """STATUSTEXT, one message for each text or, where it is long, for each piece of it."""
    voices: dict[int, mavlink.MAVLink] = {}
    times, frames = [], []
    for number, (utc_us, component, text) in enumerate(texts):
        voice = voices.setdefault(
            component, sender(SYSTEM, component or mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
        )
        pieces = _pieces(text)
        text_id = number % 0xFFFF + 1 if len(pieces) > 1 else 0
        for place, piece in enumerate(pieces):
            times.append(utc_us)
            message = mavlink.MAVLink_statustext_message(
                mavlink.MAV_SEVERITY_INFO, piece, text_id, place
            )
            frames.append(packed(voice, message))
    return _Stream(np.array(times, np.int64), frames.__getitem__)


def _pieces(text: str) -> list[bytes]:
    """Cut a text between letters into what messages hold."""
    pieces = [b""]
    for letter in text:
        data = letter.encode()
        if len(pieces[-1]) + len(data) > TEXT_BYTES:
            pieces.append(b"")
        pieces[-1] += data
    return pieces


def _pressure_hpa(device: DeviceData) -> FloatArray | None:
    factor = HPA.get(device.samples.units.get("pressure", ""))
    values = device.samples.values.get("pressure")
    if factor is None or values is None or values.ndim != 1:
        return None
    return values * factor
