"""Numbers in the low bits, named bits above them, and scales that another field selects."""

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocols.decoder import StreamDecoder
from firmware_protocols.known import protocol_from_dict
from firmware_protocols.layout import Checksum, Field, LayoutError, PacketLayout
from firmware_protocols.packets import counts, encode, flag, quantize, values


def layout(*fields, **more):
    return PacketLayout(
        name="bits",
        title="",
        byte_order="big",
        header=b"\xa5",
        fields=fields,
        checksum=Checksum("sum8"),
        **more,
    )


WORDS = layout(
    Field("range", "u8"),
    Field(
        "gyro",
        "i16",
        3,
        unit="deg/s",
        low_bits=14,
        flags=(("fresh", 15),),
        faults=(("error flag", 14),),
        scale_by="range",
        scales=((4, 20.0), (2, 40.0), (1, 80.0)),
    ),
    Field("supply", "u16", low_bits=12),
    Field("wide", "i24", low_bits=20, flags=(("top", 23),)),
)


def decoded(data, of=WORDS):
    return StreamDecoder(of).feed(data).rows


@given(
    st.lists(st.integers(-8192, 8191), min_size=3, max_size=3),
    st.booleans(),
    st.integers(0, 4095),
    st.integers(-(2**19), 2**19 - 1),
    st.booleans(),
)
def test_numbers_and_flags_come_back(gyro, fresh, supply, wide, top):
    rows = decoded(
        encode(
            WORDS,
            {
                "range": 4,
                "gyro": np.array([gyro]),
                "fresh": fresh,
                "supply": supply,
                "wide": wide,
                "top": np.array([top]),
            },
        )
    )
    assert counts(WORDS, rows, "gyro").tolist() == [gyro]
    assert flag(WORDS, rows, "gyro", 15).tolist() == [fresh]
    assert not flag(WORDS, rows, "gyro", 14).any()
    assert counts(WORDS, rows, "supply").tolist() == [supply]
    assert counts(WORDS, rows, "wide").tolist() == [wide]
    assert flag(WORDS, rows, "wide", 23).tolist() == [top]


def test_the_words_of_a_known_burst():
    """0x8014 and 0xBFEC of an ADIS16405: new data, +20 and -20 counts, 1.0 and -1.0 deg/s."""
    packet = bytes.fromhex("A5 04 8014 BFEC 8000 0813 000000")
    rows = decoded(packet + bytes([sum(packet) & 0xFF]))
    np.testing.assert_allclose(values(WORDS, rows, "gyro"), [[1.0, -1.0, 0.0]])
    assert counts(WORDS, rows, "supply").tolist() == [0x813]


def test_the_range_in_a_packet_chooses_its_scale():
    columns = {"gyro": np.full((4, 3), 80), "supply": 0, "wide": 0}
    rows = decoded(encode(WORDS, {"range": np.array([4, 2, 1, 3]), **columns}))
    np.testing.assert_allclose(values(WORDS, rows, "gyro")[:, 0], [4.0, 2.0, 1.0, np.nan])
    assert quantize(WORDS, "gyro", [[1.0, 1.0, 1.0]], selected=2).tolist() == [[40, 40, 40]]
    assert quantize(WORDS, "gyro", [[1e9, -1e9, 0.0]]).tolist() == [[8191, -8192, 0]]


def test_written_as_a_file_and_read_back():
    for data in (WORDS.to_dict(), tomllib.loads(WORDS.to_toml())):
        assert protocol_from_dict(data) == WORDS


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ([{"type": "f32", "low_bits": 3}], "whole numbers only"),
        ([{"type": "u16", "low_bits": 17}], "low_bits must be 1 to 16"),
        ([{"type": "u16", "flags": {"new": 16}}], "bit 16 of 'new' is not 0 to 15"),
        ([{"type": "u16", "flags": {"New Data": 1}}], "take a lower-case word"),
        ([{"type": "u16", "flags": {"a": 1}}], "'a' is there twice"),
        ([{"type": "u16", "faults": {"a\x1b[31m": 1}}], "cannot be printed"),
        ([{"type": "u16", "faults": {"": 1}}], "must have a name"),
        ([{"type": "u16", "faults": {"low": 0.5}}], "number of a bit"),
        ([{"type": "u16", "scale_by": "b"}], "go together"),
        ([{"type": "u16", "scale_by": "b", "scales": {"1": 2}}], "not among the fields"),
        ([{"type": "u16", "scale_by": "a", "scales": {"x": 2}}], "by a whole number"),
        ([{"type": "u16", "scale_by": "a", "scales": {"1": 0}}], "other than 0"),
    ],
)
def test_mistakes_are_named(fields, sentence):
    described = [{"name": "a", **field} for field in fields]
    with pytest.raises(LayoutError, match=sentence):
        protocol_from_dict({"name": "x", "header": "A5", "fields": described})


def test_an_unknown_kind_is_named():
    with pytest.raises(LayoutError, match=r"lab\.toml: the kind 'morse' is not known"):
        protocol_from_dict({"kind": "morse"}, source="lab.toml")
