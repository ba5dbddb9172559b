"""What the MTi's messages hold: number formats, axes of the earth, output modes and settings."""

import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocols.fields import LayoutError
from firmware_protocols.xsens_data import (
    FIXED_12_20,
    FIXED_16_32,
    FLOAT32,
    FLOAT64,
    ITEMS,
    as_quaternions,
    find_items,
    item_of,
    legacy_parts,
    read_item,
    read_numbers,
    size_of,
    write_numbers,
)

FINE = {"allow_nan": False, "allow_infinity": False}
IN_RANGE = {
    FLOAT32: st.floats(width=32, **FINE),
    FIXED_12_20: st.integers(-(2**31), 2**31 - 1).map(lambda n: n / 2**20),
    FIXED_16_32: st.integers(-(2**47), 2**47 - 1).map(lambda n: n / 2**32),
    FLOAT64: st.floats(**FINE),
}
UNIT = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)


def raw(text):
    return np.frombuffer(bytes.fromhex(text), np.uint8)[np.newaxis]


def matrix(q):
    """Rotation matrix of a quaternion, by rotating the axes one by one."""
    w, v = q[0], np.array(q[1:])
    return np.stack(
        [(w * w - v @ v) * e + 2 * (v @ e) * v + 2 * w * np.cross(v, e) for e in np.eye(3)],
        axis=1,
    )


@pytest.mark.parametrize(
    ("number_format", "text", "value"),
    [
        (FLOAT32, "411CF5C3", 9.81),
        (FIXED_12_20, "009CF5C3", 9.81),
        (FIXED_12_20, "FFF00000", -1.0),
        (FIXED_16_32, "80000000 0009", 9.5),
        (FIXED_16_32, "00000001 FFFF", -1.0 + 2.0**-32),
        (FLOAT64, "40239EB851EB851F", 9.81),
    ],
)
def test_numbers_in_each_format(number_format, text, value):
    assert read_numbers(raw(text), number_format)[0, 0] == pytest.approx(value, abs=1e-6)
    exact = read_numbers(raw(text), number_format)
    assert write_numbers(exact, number_format).tobytes() == bytes.fromhex(text)


@pytest.mark.parametrize("number_format", IN_RANGE)
def test_every_number_survives_the_way_there_and_back(number_format):
    @settings(max_examples=20)
    @given(st.lists(IN_RANGE[number_format], min_size=3, max_size=3))
    def way(numbers):
        sent = write_numbers(np.array([numbers]), number_format)
        assert read_numbers(sent, number_format)[0].tolist() == numbers

    way()


@pytest.mark.parametrize("number_format", [FIXED_12_20, FIXED_16_32])
def test_fixed_point_stays_at_the_end_of_its_range(number_format):
    sent = write_numbers(np.array([[1e9, -1e9]]), number_format)
    high, low = read_numbers(sent, number_format)[0]
    limit = {FIXED_12_20: 2.0**11, FIXED_16_32: 2.0**15}[number_format]
    assert limit - 1e-5 < high < limit
    assert low == -limit


@settings(max_examples=20)
@given(st.binary(max_size=80))
def test_items_of_any_bytes_are_found_or_the_message_is_refused(data):
    items = find_items(data)
    if items is None:
        return
    sent = b"".join(
        struct.pack(">HB", identifier, size) + data[at : at + size]
        for identifier, at, size in items
    )
    assert sent == data


def test_items_that_lie_about_their_size_spoil_the_message():
    assert find_items(bytes.fromhex("1020 02 1234")) == [(0x1020, 3, 2)]
    for lying in ("1020 03 1234", "1020 01 1234", "1020 02 1234 10", "1020 02 1234 1060"):
        assert find_items(bytes.fromhex(lying)) is None
    assert find_items(b"") == []


def test_sizes_follow_from_identifier_and_format():
    assert size_of(0x1020) == 2
    assert [size_of(0x4020 | number_format) for number_format in range(4)] == [12, 12, 18, 24]
    assert size_of(0x2023) == 72
    known = [identifier for identifier in range(1 << 16) if item_of(identifier) is not None]
    assert {identifier & 0xFFF0 for identifier in known} == set(ITEMS)
    for strange in (0x102F, 0x4024, 0x201C, 0x1234, 0x0000, 0xFFFF):
        assert item_of(strange) is None


@settings(max_examples=20)
@given(UNIT)
def test_orientations_are_the_same_however_they_are_sent(q):
    q = np.array(q) / np.linalg.norm(q)
    R = matrix(q)
    pitch = np.degrees(np.arcsin(np.clip(-R[2, 0], -1, 1)))
    roll = np.degrees(np.arctan2(R[2, 1], R[2, 2]))
    yaw = np.degrees(np.arctan2(R[1, 0], R[0, 0]))
    for numbers, columns in (
        (q, False),
        (R.ravel(), False),
        (R.T.ravel(), True),
        (np.array([roll, pitch, yaw]), False),
    ):
        if len(numbers) == 3 and abs(pitch) > 89.9:
            continue  # roll and yaw are one there
        found = as_quaternions(numbers[np.newaxis], by_columns=columns)[0]
        assert matrix(found) == pytest.approx(R, abs=1e-6)


@settings(max_examples=20)
@given(UNIT)
def test_axes_of_the_earth_become_east_north_up(q):
    q = np.array(q) / np.linalg.norm(q)
    in_other_axes = {
        0x0: np.eye(3),
        0x4: np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]),  # north, east, down
        0x8: np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),  # north, west, up
    }
    for axes, other_from_enu in in_other_axes.items():
        sent = write_numbers((other_from_enu @ matrix(q)).reshape(1, 9), FLOAT64)
        found = read_item(0x2023 | axes, sent)[0]
        assert matrix(found) == pytest.approx(matrix(q), abs=1e-9)
        force = write_numbers((other_from_enu @ [1.0, 2.0, 3.0])[np.newaxis], FLOAT64)
        assert read_item(0x4033 | axes, force)[0].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("mode", "settings_", "fields", "size"),
    [
        (0x0006, 0x00000001, "accel gyro mag quaternion counter", 54),
        (0x0007, 0x00000001, "temperature accel gyro mag quaternion counter", 58),
        (0x0002, 0x00000000, "accel gyro mag", 36),
        (0x0002, 0x00000020, "accel mag", 24),
        (0x0002, 0x00000301, "accel gyro mag counter", 74),
        (0x0004, 0x00000005, "quaternion counter", 14),
        (0x0004, 0x00000009, "quaternion counter", 38),
        (0x0004, 0x80000001, "quaternion counter", 18),
        (0x0808, 0x00000001, "aux1 aux2 status counter", 7),
        (0x0808, 0x00000401, "aux2 status counter", 5),
        (0x0030, 0x00000001, "position velocity counter", 26),
        (0x0002, 0x00000100, "accel gyro mag", 36),
        (0x0002, 0x00000200, "accel gyro mag", 54),
        (
            0x4000,
            0x00000001,
            "accel_counts gyro_counts mag_counts temperature_counts counter",
            22,
        ),
    ],
)
def test_what_a_legacy_message_holds(mode, settings_, fields, size):
    parts = legacy_parts(mode, settings_)
    assert [part.field for part in parts] == fields.split()
    assert parts[-1].offset + parts[-1].size == size
    assert all(a.offset + a.size == b.offset for a, b in pairwise(parts))


@pytest.mark.parametrize(
    ("mode", "settings_", "word"),
    [
        (0, 0, "no data"),
        (0x0040, 0, "0x0040"),
        (0x10006, 0, "0 to 0xFFFF"),
        (0x4002, 0, "raw"),
        (2, 1 << 32, "0xFFFFFFFF"),
        (2, 2, "counter"),
        (4, 0xC, "matrices"),
    ],
)
def test_modes_that_no_unit_has_are_refused(mode, settings_, word):
    with pytest.raises(LayoutError, match=word):
        legacy_parts(mode, settings_)
