"""What the measurement messages of an Xsens MTi hold: MTData2 items, and the legacy MTData.

An MTData2 message is a row of items: identifier (2 bytes), size (1), data. The lower four bits of
an identifier say in which format its numbers are (bits 1:0) and, of what is relative to the earth,
in which axes (bits 3:2). An MTData message says nothing of itself: what it holds follows from the
output mode and the output settings that the unit was given.

Numbers come as 64-bit floating point, which holds every format exactly. Orientations, however they
are sent, come as quaternions that turn the sensor's axes into east, north, up.

Sources: Xsens MT Low Level Communication Protocol Documentation (MT0101P); MT0100P; packets
recorded from an MTi-300; ethz-asl/ethzasl_xsens_driver.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from firmware_protocols.fields import Field, LayoutError
from firmware_protocols.unconfirmed import (
    XSENS_EULER_ORDER,
    XSENS_FRACTION_FIRST,
    XSENS_LEGACY_AXES,
    XSENS_LEGACY_MATRIX_BY_COLUMNS,
    XSENS_TEMPERATURE_HZ,
    XSENS_UT_PER_UNIT,
)
from firmware_protocols.xsens_frames import error_words

Bytes = npt.NDArray[np.uint8]
FloatArray = npt.NDArray[np.float64]

FLOAT32, FIXED_12_20, FIXED_16_32, FLOAT64 = range(4)
NUMBER_BYTES = (4, 4, 6, 8)
"""Bytes of one number in each format."""

ENU, NED, NWU = 0x0, 0x4, 0x8
"""Axes of the earth: east north up, north east down, north west up."""

PACKET_COUNTER, SAMPLE_TIME_FINE = 0x1020, 0x1060
STATUS_BYTE, STATUS_WORD = 0xE010, 0xE020

_HALF = 0.5**0.5
_TO_ENU = {
    NED: np.array([0.0, _HALF, _HALF, 0.0]),  # half a turn about north-east
    NWU: np.array([_HALF, 0.0, 0.0, _HALF]),  # a quarter turn about up
}


@dataclass(frozen=True)
class Item:
    """What one kind of data is.

    Attributes
    ----------
    field : str
        Name of the row's field that takes it.
    count : int
        Numbers in it.
    code : str
        "f" for numbers in any of the four formats, "utc" for a date and time, otherwise a numpy
        type.
    earth : bool
        Whether it is relative to the axes of the earth.
    """

    field: str
    count: int
    code: str = "f"
    earth: bool = False


ITEMS = {
    0x0810: Item("temperature", 1),
    PACKET_COUNTER: Item("counter", 1, ">u2"),
    0x1010: Item("utc", 1, "utc"),
    SAMPLE_TIME_FINE: Item("time", 1, ">u4"),
    0x2010: Item("quaternion", 4, earth=True),
    0x2020: Item("quaternion", 9, earth=True),
    0x2030: Item("quaternion", 3, earth=True),
    0x3010: Item("pressure", 1, ">u4"),
    0x4010: Item("delta_v", 3),
    0x4020: Item("accel", 3),
    0x4030: Item("free_accel", 3, earth=True),
    0x4040: Item("accel_hr", 3),
    0x8020: Item("gyro", 3),
    0x8030: Item("delta_q", 4),
    0x8040: Item("gyro_hr", 3),
    0xC020: Item("mag", 3),
    STATUS_BYTE: Item("status", 1, "u1"),
    STATUS_WORD: Item("status", 1, ">u4"),
}
"""The items that are read, by their identifier without its lower four bits."""

MOST_HZ = {0x0810: XSENS_TEMPERATURE_HZ, 0x3010: 50, 0xC020: 100}
"""What comes less often than the rest, whatever is asked for: temperature, pressure, field."""

STATUS_FLAGS = (("self_test_passed", 0), ("filter_valid", 1), ("gnss_fix", 2))
STATUS_WORD_FLAGS = (*STATUS_FLAGS, ("sync_in", 21), ("sync_out", 22))
ALARMING_ERRORS = {0x1E: 1, 0x28: 2}
"""Errors that a unit reports of itself while it measures, and their bits of the alarms.

The other errors answer what it was told: they belong to the conversation with it.
"""

CLIPPED = tuple(
    (f"the {part} clips on {axis}", 8 + 3 * place + number)
    for place, part in enumerate(("accelerometer", "gyroscope", "magnetometer"))
    for number, axis in enumerate("xyz")
)
"""Bits of the status word for a sensor that is beyond its range, in words."""

ALARMS = (
    ("its self-test has not passed", 0),
    *((f"reports {error_words(bytes([error]))}", bit) for error, bit in ALARMING_ERRORS.items()),
)
"""Bits of the field that holds what is no measurement but tells that something is wrong."""

FIELDS = {
    field.name: field
    for field in (
        Field("counter", "u16"),
        Field("time", "u32"),
        Field("accel", "f64", count=3, unit="m/s2"),
        Field("gyro", "f64", count=3, unit="rad/s"),
        Field("mag", "f64", count=3, unit="uT", counts_per_unit=1.0 / XSENS_UT_PER_UNIT),
        Field("temperature", "f64", unit="degC"),
        Field("quaternion", "f64", count=4),
        Field("pressure", "f64", unit="Pa"),
        Field("utc", "f64", unit="s"),
        Field("delta_v", "f64", count=3, unit="m/s"),
        Field("delta_q", "f64", count=4),
        Field("free_accel", "f64", count=3, unit="m/s2"),
        Field("accel_hr", "f64", count=3, unit="m/s2"),
        Field("gyro_hr", "f64", count=3, unit="rad/s"),
        Field("position", "f64", count=3),
        Field("velocity", "f64", count=3, unit="m/s"),
        Field("aux1", "u16"),
        Field("aux2", "u16"),
        Field("accel_counts", "u16", count=3),
        Field("gyro_counts", "u16", count=3),
        Field("mag_counts", "u16", count=3),
        Field("temperature_counts", "u16"),
        Field("status", "u32", flags=STATUS_WORD_FLAGS, faults=CLIPPED),
        Field("alarms", "u8", faults=ALARMS),
    )
}
"""Every field that a row may have, in the order of the row.

``alarms`` is made of the status, in which a bit says that all is well, and of Error messages.
"""


def item_of(identifier: int) -> Item | None:
    """Return what an identifier means; None for an unknown one, or a format that there is not."""
    item = ITEMS.get(identifier & 0xFFF0)
    if item is None or (item.code != "f" and identifier & 0xF):
        return None
    if identifier & 0xC == 0xC or (identifier & 0xC and not item.earth):
        return None
    return item


def size_of(identifier: int) -> int:
    """Return the bytes that the data of a known identifier take."""
    item = ITEMS[identifier & 0xFFF0]
    if item.code == "utc":
        return _UTC.itemsize
    if item.code != "f":
        return item.count * np.dtype(item.code).itemsize
    return item.count * NUMBER_BYTES[identifier & 0x3]


def find_items(data: bytes) -> list[tuple[int, int, int]] | None:
    """Return identifier, offset of the data and size of each item of an MTData2 message.

    None for a message whose items do not end where it ends.
    """
    items = []
    at = 0
    while at + 3 <= len(data):
        size = data[at + 2]
        items.append((data[at] << 8 | data[at + 1], at + 3, size))
        at += 3 + size
    return items if at == len(data) else None


def read_numbers(raw: Bytes, number_format: int) -> FloatArray:
    """Return the numbers in bytes of shape (n, m) as an array of shape (n, count)."""
    raw = np.ascontiguousarray(raw)
    if number_format == FIXED_12_20:
        return raw.view(">i4") / 2.0**20
    if number_format == FIXED_16_32:
        parts = raw.view(_FIXED_16_32)
        return parts["whole"] + parts["fraction"] / 2.0**32
    with np.errstate(invalid="ignore"):  # bytes may be those of a NaN that signals
        return raw.view(">f4" if number_format == FLOAT32 else ">f8").astype(np.float64)


def write_numbers(numbers: FloatArray, number_format: int) -> Bytes:
    """Return the bytes of numbers of shape (n, count), rounded and limited to the format."""
    if number_format == FIXED_12_20:
        counts = np.rint(np.clip(numbers * 2.0**20, -(2.0**31), 2.0**31 - 1))
        sent = counts.astype(">i4")
    elif number_format == FIXED_16_32:
        wide = np.rint(np.clip(numbers, -(2.0**15), 2.0**15 - 2.0**-32) * 2.0**32).astype(np.int64)
        sent = np.empty(numbers.shape, _FIXED_16_32)
        sent["whole"], sent["fraction"] = wide >> 32, wide & 0xFFFFFFFF
    else:
        with np.errstate(over="ignore"):
            sent = numbers.astype(">f4" if number_format == FLOAT32 else ">f8")
    size = numbers.shape[1] * NUMBER_BYTES[number_format]
    return np.ascontiguousarray(sent).view(np.uint8).reshape(len(numbers), size)


_FIXED_16_32 = np.dtype(
    [("fraction", ">u4"), ("whole", ">i2")]
    if XSENS_FRACTION_FIRST
    else [("whole", ">i2"), ("fraction", ">u4")]
)


_UTC = np.dtype(
    [
        ("nanosecond", ">u4"),
        ("year", ">u2"),
        *((name, "u1") for name in ("month", "day", "hour", "minute", "second", "flags")),
    ]
)


def read_item(identifier: int, raw: Bytes) -> FloatArray:
    """Return what an item says, as the row's field takes it.

    Parameters
    ----------
    identifier : int
        A known one.
    raw : shape (n, size), uint8

    Returns
    -------
    shape (n,) or (n, count)
        Magnetic field in the unit's own unit; what is relative to the earth in east, north, up.
    """
    item = ITEMS[identifier & 0xFFF0]
    if item.code == "utc":
        return _utc(raw)
    if item.code != "f":
        whole: FloatArray = np.ascontiguousarray(raw).view(item.code)[:, 0].astype(np.float64)
        return whole
    numbers = read_numbers(raw, identifier & 0x3)
    if item.field == "quaternion":
        return to_enu(as_quaternions(numbers), identifier & 0xC)
    if item.earth:
        return _vectors_to_enu(numbers, identifier & 0xC)
    return numbers[:, 0] if item.count == 1 else numbers


def _utc(raw: Bytes) -> FloatArray:
    """Return seconds since 1970, shape (n,); NaN where there is no such date and time."""
    parts = np.ascontiguousarray(raw).view(_UTC)[:, 0]
    year, month, day = (parts[name].astype(np.int64) for name in ("year", "month", "day"))
    months = (year - 1970) * 12 + month - 1
    days = months.astype("M8[M]").astype("M8[D]").astype(np.int64) + day - 1
    seconds: FloatArray = 86_400.0 * days + parts["nanosecond"] / 1e9
    for name, factor in (("hour", 3600.0), ("minute", 60.0), ("second", 1.0)):
        seconds += factor * parts[name]
    exists = (
        (month >= 1)
        & (month <= 12)
        & (day >= 1)
        & (day <= 31)
        & (parts["hour"] < 24)
        & (parts["minute"] < 60)
        & (parts["second"] <= 60)
        & (parts["nanosecond"] < 1e9)
    )
    return np.where(exists, seconds, np.nan)


def as_quaternions(numbers: FloatArray, *, by_columns: bool = False) -> FloatArray:
    """Return orientations as quaternions, shape (n, 4), by how many numbers each has.

    Four are a quaternion, w first; three are roll, pitch and yaw [deg]; nine a matrix. What is
    no rotation comes out as NaN or as whatever its numbers make of it.
    """
    with np.errstate(all="ignore"):
        if numbers.shape[1] == 3:
            return _of_euler(numbers)
        if numbers.shape[1] == 9:
            matrices = numbers.reshape(-1, 3, 3)
            return _of_matrices(matrices.transpose(0, 2, 1) if by_columns else matrices)
    return numbers


def to_enu(quaternions: FloatArray, axes: int) -> FloatArray:
    """Return orientations in some axes of the earth, shape (n, 4), in east, north, up."""
    turn = _TO_ENU.get(axes)
    if turn is None:
        return quaternions
    with np.errstate(all="ignore"):  # bytes may be no rotation at all
        return _product(turn, quaternions)


def _vectors_to_enu(vectors: FloatArray, axes: int) -> FloatArray:
    x, y, z = vectors.T
    if axes == NED:
        return np.stack([y, x, -z], axis=1)
    if axes == NWU:
        return np.stack([-y, x, z], axis=1)
    return vectors


def _product(p: FloatArray, q: FloatArray) -> FloatArray:
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def _of_euler(degrees: FloatArray) -> FloatArray:
    """Turn about x by the roll, then about y by the pitch, then about z by the yaw."""
    half = np.radians(degrees) / 2.0
    turns = {}
    for place, axis in enumerate("xyz"):
        turn = np.zeros((len(degrees), 4))
        turn[:, 0] = np.cos(half[:, place])
        turn[:, 1 + place] = np.sin(half[:, place])
        turns[axis] = turn
    last, middle, first = (turns[axis] for axis in XSENS_EULER_ORDER)
    return _product(_product(last, middle), first)


def _of_matrices(matrices: FloatArray) -> FloatArray:
    """Return the quaternions of rotation matrices by their greatest component, for exactness."""
    xx, yy, zz = (matrices[:, k, k] for k in range(3))
    squares = np.stack([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz], 1)
    wx = matrices[:, 2, 1] - matrices[:, 1, 2]
    wy = matrices[:, 0, 2] - matrices[:, 2, 0]
    wz = matrices[:, 1, 0] - matrices[:, 0, 1]
    xy = matrices[:, 1, 0] + matrices[:, 0, 1]
    xz = matrices[:, 0, 2] + matrices[:, 2, 0]
    yz = matrices[:, 2, 1] + matrices[:, 1, 2]
    products = np.stack(
        [
            np.stack([squares[:, 0], wx, wy, wz], 1),
            np.stack([wx, squares[:, 1], xy, xz], 1),
            np.stack([wy, xy, squares[:, 2], yz], 1),
            np.stack([wz, xz, yz, squares[:, 3]], 1),
        ],
        1,
    )
    row = np.arange(len(matrices))
    greatest = np.argmax(squares, axis=1)
    chosen: FloatArray = products[row, greatest]
    chosen /= 2.0 * np.sqrt(squares[row, greatest])[:, np.newaxis]
    return chosen


# Legacy MTData --------------------------------------------------------------------------------

TEMPERATURE_BIT, CALIBRATED_BIT, ORIENTATION_BIT, AUX_BIT = 0, 1, 2, 3
POSITION_BIT, VELOCITY_BIT, STATUS_BIT, RAW_BIT = 4, 5, 11, 14
_MODES = (0, 1, 2, 3, 4, 5, 11, 14)


@dataclass(frozen=True)
class Part:
    """Where a field is in the data of an MTData message.

    Attributes
    ----------
    field : str
    offset, size : int
        In bytes.
    code : str
        "f" or a numpy type, as of :class:`Item`.
    """

    field: str
    offset: int
    size: int
    code: str = "f"


def legacy_parts(mode: int, settings: int) -> tuple[Part, ...]:
    """Return what an MTData message holds.

    Parameters
    ----------
    mode, settings : int
        Output mode (16 bits) and output settings (32 bits), as the unit was given them.

    Raises
    ------
    LayoutError
        For a mode or settings that no MTi has, or that leave the message empty.
    """
    _check_legacy(mode, settings)
    number = NUMBER_BYTES[settings >> 8 & 0x3]
    listed: list[tuple[str, int, str]] = []
    if mode >> RAW_BIT & 1:
        listed += [(f"{part}_counts", 6, ">u2") for part in ("accel", "gyro", "mag")]
        listed += [("temperature_counts", 2, ">u2")]
    if mode >> TEMPERATURE_BIT & 1:
        listed += [("temperature", number, "f")]
    if mode >> CALIBRATED_BIT & 1:
        names = ("accel", "gyro", "mag")
        listed += [
            (name, 3 * number, "f")
            for place, name in enumerate(names)
            if not settings >> (4 + place) & 1
        ]
    if mode >> ORIENTATION_BIT & 1:
        listed += [("quaternion", (4, 3, 9)[settings >> 2 & 0x3] * number, "f")]
    if mode >> AUX_BIT & 1:
        listed += [
            (f"aux{place + 1}", 2, ">u2") for place in range(2) if not settings >> (10 + place) & 1
        ]
    if mode >> POSITION_BIT & 1:
        listed += [("position", 3 * number, "f")]
    if mode >> VELOCITY_BIT & 1:
        listed += [("velocity", 3 * number, "f")]
    if mode >> STATUS_BIT & 1:
        listed += [("status", 1, "u1")]
    if not listed:
        raise LayoutError(
            f"output_settings {settings:#010x} switch off all that output_mode {mode:#06x} asks "
            "for: take less of it away (bits 4 to 6 calibrated data, 10 and 11 analog inputs)."
        )
    if settings & 0x3 == 1:
        listed += [("counter", 2, ">u2")]
    parts = []
    offset = 0
    for field, size, code in listed:
        parts.append(Part(field, offset, size, code))
        offset += size
    return tuple(parts)


def _check_legacy(mode: int, settings: int) -> None:
    if not 0 <= mode <= 0xFFFF:
        raise LayoutError("output_mode must be 0 to 0xFFFF.")
    if any(mode >> b & 1 for b in range(16) if b not in _MODES):
        raise LayoutError(
            f"output_mode {mode:#06x} has bits that are not known: take those of temperature (0), "
            "calibrated data (1), orientation (2), analog inputs (3), position (4), velocity (5), "
            "status (11) and raw counts (14)."
        )
    if not mode:
        raise LayoutError("output_mode 0 asks for no data at all; 7 asks for all that calibrates.")
    if mode >> RAW_BIT & 1 and mode != 1 << RAW_BIT:
        raise LayoutError(f"output_mode {mode:#06x} asks for raw counts (14) and more; take one.")
    if not 0 <= settings <= 0xFFFFFFFF:
        raise LayoutError("output_settings must be 0 to 0xFFFFFFFF.")
    if settings & 0x3 > 1:
        raise LayoutError("output_settings: bits 1:0 must be 0, or 1 for a sample counter.")
    if settings >> 2 & 0x3 == 3:
        raise LayoutError(
            "output_settings: bits 3:2 must be 0 for quaternions, 1 for Euler angles or 2 for "
            "matrices."
        )


def read_part(part: Part, raw: Bytes, settings: int) -> FloatArray:
    """Return what a part of MTData messages says, as the row's field takes it.

    Parameters
    ----------
    part : Part
    raw : shape (n, size), uint8
    settings : int
        Output settings.

    Returns
    -------
    shape (n,) or (n, count)
    """
    if part.code != "f":
        whole = np.ascontiguousarray(raw).view(part.code).astype(np.float64)
        return whole[:, 0] if whole.shape[1] == 1 else whole
    numbers = read_numbers(raw, settings >> 8 & 0x3)
    if part.field == "quaternion":
        turned = as_quaternions(numbers, by_columns=XSENS_LEGACY_MATRIX_BY_COLUMNS)
        return to_enu(turned, NED if settings >> 31 else XSENS_LEGACY_AXES)
    return numbers[:, 0] if numbers.shape[1] == 1 else numbers


def fields_of(names: Sequence[str], *, status_word: bool) -> tuple[Field, ...]:
    """Return the fields of a row that has these, in the order of the row."""
    fields = [field for name, field in FIELDS.items() if name in names]
    if not status_word:
        byte = Field("status", "u32", flags=STATUS_FLAGS)
        fields = [byte if field.name == "status" else field for field in fields]
    return tuple(fields)
