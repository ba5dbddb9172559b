"""Checksums: published check values, and the fast form against the plain one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocols.checksums import SIZES, checksum, checksum_rows, fast_checksum

# Of "123456789": the catalogue of parametrised CRC algorithms; Fletcher and sums by hand.
CHECK_VALUES = {
    "sum8": 0xDD,
    "xor8": 0x31,
    "fletcher16": 0x1EDE,
    "crc8": 0xF4,
    "crc16-ccitt-false": 0x29B1,
    "crc16-xmodem": 0x31C3,
    "crc16-modbus": 0x4B37,
    "crc16-x25": 0x906E,
    "crc16-mcrf4xx": 0x6F91,
    "crc32": 0xCBF43926,
}


def test_every_kind_has_a_check_value():
    assert set(CHECK_VALUES) == set(SIZES)


@pytest.mark.parametrize("kind", SIZES)
def test_check_value(kind):
    data = b"123456789"
    assert checksum(kind, data) == CHECK_VALUES[kind]
    assert fast_checksum(kind)(data) == CHECK_VALUES[kind]
    rows = np.frombuffer(data * 3, np.uint8).reshape(3, 9)
    assert checksum_rows(kind, rows).tolist() == [CHECK_VALUES[kind]] * 3


@pytest.mark.parametrize("kind", SIZES)
@given(st.integers(0, 70), st.integers(0, 5), st.integers(0, 3), st.integers(0, 2**32))
def test_rows_agree_with_the_definition(kind, length, number, before, seed):
    table = np.random.default_rng(seed).integers(0, 256, (number, before + length), np.uint8)
    rows = table[:, before:]
    expected = [checksum(kind, row.tobytes()) for row in rows]
    result = checksum_rows(kind, rows)
    assert result.tolist() == expected
    assert result.dtype.itemsize == SIZES[kind]
    assert [fast_checksum(kind)(row.tobytes()) for row in rows] == expected


@pytest.mark.parametrize("kind", SIZES)
def test_longest_rows_of_extreme_bytes(kind):
    rows = np.repeat(np.array([0x00, 0xFF, 0x80], np.uint8)[:, np.newaxis], 4096, axis=1)
    assert checksum_rows(kind, rows).tolist() == [checksum(kind, r.tobytes()) for r in rows]


@pytest.mark.parametrize("kind", SIZES)
def test_more_rows_than_one_block(kind):
    rows = np.random.default_rng(1).integers(0, 256, (30_001, 11), np.uint8)
    result = checksum_rows(kind, rows)
    for at in (0, 15_000, 23_830, 23_831, 23_832, 30_000):
        assert result[at] == checksum(kind, rows[at].tobytes())


@pytest.mark.parametrize("kind", [k for k in SIZES if k.startswith("crc")])
def test_a_crc_notices_every_single_flipped_bit(kind):
    packet = np.frombuffer(b"an ordinary packet, 26 byt", np.uint8)
    bits = np.unpackbits(packet)
    flipped = np.packbits(bits ^ np.eye(len(bits), dtype=np.uint8), axis=1)
    assert (checksum_rows(kind, flipped) != checksum(kind, packet.tobytes())).all()
