"""Whole numbers in the bytes of floats: PX4's way, ArduPilot's way, and telling them apart."""

import math
import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from imu_rig.devices.mavlink_parameters import (
    ARDUPILOT,
    PX4,
    REAL32,
    Parameter,
    decode,
    encode,
    encoding_of,
)

INT32 = 6
RANGES = {1: (0, 255), 2: (-128, 127), 3: (0, 65535), 4: (-32768, 32767), 5: (0, 2**32 - 1)}
RANGES[INT32] = (-(2**31), 2**31 - 1)


def test_the_number_of_a_sensor_read_the_wrong_way():
    wire = encode(1310988, INT32, "bytewise")
    assert struct.unpack("<f", wire)[0] == pytest.approx(1.84e-39, rel=2e-3)
    assert decode(wire, INT32, "bytewise") == 1310988
    assert struct.unpack("<i", wire)[0] == 1310988
    sentence = Parameter("CAL_ACC0_ID", wire, INT32).contradiction("cast")
    assert sentence == (
        "CAL_ACC0_ID reads 1.84e-39 as a float (ArduPilot's way) and 1310988 by its bytes (PX4's "
        "way): it must be the latter."
    )
    assert Parameter("CAL_ACC0_ID", wire, INT32).contradiction("bytewise") is None


def test_minus_one_is_not_a_number_the_wrong_way():
    wire = encode(-1, INT32, "bytewise")
    assert wire == b"\xff\xff\xff\xff"
    assert math.isnan(struct.unpack("<f", wire)[0])
    assert math.isnan(decode(wire, INT32, "cast"))
    assert decode(wire, INT32, "bytewise") == -1
    assert "nan" in Parameter("CAL_MAG0_ROT", wire, INT32).contradiction("cast")


def test_a_cast_number_is_recognized_where_bytes_are_expected():
    wire = encode(1310988, INT32, "cast")
    assert struct.unpack("<f", wire)[0] == 1310988.0
    sentence = Parameter("COMPASS_DEV_ID", wire, INT32).contradiction("bytewise")
    assert "1310988 as a float (ArduPilot's way): it must be the latter" in sentence
    assert Parameter("COMPASS_DEV_ID", wire, INT32).contradiction("cast") is None


@pytest.mark.parametrize("pattern", [0x7F800001, 0x7FBFFFFF, 0xFF800001])
def test_patterns_that_floats_of_python_change_are_kept(pattern):
    """As floats they are signalling NaNs, which a conversion turns into quiet ones."""
    signed = struct.unpack("<i", struct.pack("<I", pattern))[0]
    assert decode(encode(signed, INT32, "bytewise"), INT32, "bytewise") == signed
    assert int.from_bytes(encode(signed, INT32, "bytewise"), "little") == pattern


@given(data=st.data(), kind=st.sampled_from(sorted(RANGES)))
def test_bytewise_is_exact_over_the_whole_range(data, kind):
    value = data.draw(st.integers(*RANGES[kind]))
    assert decode(encode(value, kind, "bytewise"), kind, "bytewise") == value


@given(value=st.integers(-(2**24), 2**24), kind=st.sampled_from([INT32]))
@example(2**24, INT32)
def test_cast_is_exact_as_far_as_a_float_goes(value, kind):
    assert decode(encode(value, kind, "cast"), kind, "cast") == value
    with pytest.raises(ValueError, match="a float of four bytes has not"):
        encode(2**24 + 1, kind, "cast")


@given(value=st.integers(-(2**23) + 1, 2**23 - 1).filter(bool))
def test_no_number_of_up_to_23_bits_is_mistaken(value):
    """Every device number, choice and count is one."""
    for encoding, other in (("bytewise", "cast"), ("cast", "bytewise")):
        parameter = Parameter("CAL_ACC0_ID", encode(value, INT32, encoding), INT32)
        assert parameter.contradiction(encoding) is None
        assert parameter.contradiction(other) is not None
        assert parameter.value(encoding) == value


@given(value=st.floats(width=32))
def test_real_numbers_are_the_same_either_way(value):
    for encoding in ("bytewise", "cast"):
        wire = encode(value, REAL32, encoding)
        back = decode(wire, REAL32, encoding)
        assert back == value or math.isnan(value)
        assert Parameter("CAL_ACC0_XOFF", wire, REAL32).contradiction(encoding) is None


def test_capabilities_decide_and_else_the_kind_of_autopilot():
    assert encoding_of(PX4) == "bytewise"
    assert encoding_of(ARDUPILOT) == "cast"
    assert encoding_of(PX4, 131_072) == "cast"
    assert encoding_of(ARDUPILOT, 16) == "bytewise"
    assert encoding_of(ARDUPILOT, 131_072 | 16) == "cast"  # both say nothing
    assert encoding_of(0) is None
    assert encoding_of(None, 0) is None


def test_what_does_not_fit_is_refused():
    for value, kind, words in (
        (300, 1, "beyond the range"),
        (1.5, INT32, "no whole number"),
        (1.0, 10, "does not fit into four bytes"),
        (math.inf, INT32, "inf is no whole number"),
        (math.nan, INT32, "nan is no whole number"),
        (1e300, INT32, "beyond the range"),
        (1e300, REAL32, "beyond the range of a float"),
        (10**400, REAL32, "beyond the range of a float"),
    ):
        with pytest.raises(ValueError, match=words):
            encode(value, kind, "cast")
