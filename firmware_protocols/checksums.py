"""Checksums of fixed-length packets: a plain definition of each and a fast one for many packets.

:func:`checksum` is the definition, one byte after the other. :func:`checksum_rows` gives the same
numbers for every row of an array, working through all rows at once and, for a CRC, through two
bytes of each at a time.
"""

from __future__ import annotations

import binascii
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

ByteRows = npt.NDArray[np.uint8]
UnsignedArray = npt.NDArray[Any]  # of u1, u2 or u4

BLOCK_BYTES = 1 << 18
MIN_BLOCK_ROWS = 256


@dataclass(frozen=True)
class _Crc:
    """Parameters of a CRC in the usual (Rocksoft) notation; the width is a multiple of 8 bits."""

    width: int
    polynomial: int
    initial: int
    reflected: bool
    final_xor: int

    @property
    def mask(self) -> int:
        return (1 << self.width) - 1

    def __call__(self, data: bytes) -> int:
        table = _crc_table(self)
        register = self.initial
        if self.reflected:
            for byte in data:
                register = (register >> 8) ^ table[(register ^ byte) & 0xFF]
        else:
            for byte in data:
                high = (register >> (self.width - 8)) ^ byte
                register = ((register << 8) & self.mask) ^ table[high]
        return register ^ self.final_xor


@lru_cache(maxsize=32)
def _crc_table(crc: _Crc) -> tuple[int, ...]:
    """Return the register after one byte, for each byte, from a register of zero."""
    table = []
    for byte in range(256):
        if crc.reflected:
            flipped = int(f"{crc.polynomial:0{crc.width}b}"[::-1], 2)
            register = byte
            for _ in range(8):
                register = (register >> 1) ^ (flipped if register & 1 else 0)
        else:
            register = byte << (crc.width - 8)
            for _ in range(8):
                carry = register >> (crc.width - 1)
                register = ((register << 1) & crc.mask) ^ (crc.polynomial if carry else 0)
        table.append(register)
    return tuple(table)


def _sum8(data: bytes) -> int:
    return sum(data) & 0xFF


def _xor8(data: bytes) -> int:
    result = 0
    for byte in data:
        result ^= byte
    return result


def _fletcher16(data: bytes) -> int:
    low = high = 0
    for byte in data:
        low = (low + byte) % 255
        high = (high + low) % 255
    return high << 8 | low


_CRCS = {
    "crc8": _Crc(8, 0x07, 0x00, False, 0x00),
    "crc16-ccitt-false": _Crc(16, 0x1021, 0xFFFF, False, 0x0000),
    "crc16-xmodem": _Crc(16, 0x1021, 0x0000, False, 0x0000),
    "crc16-modbus": _Crc(16, 0x8005, 0xFFFF, True, 0x0000),
    "crc16-x25": _Crc(16, 0x1021, 0xFFFF, True, 0xFFFF),
    "crc16-mcrf4xx": _Crc(16, 0x1021, 0xFFFF, True, 0x0000),
    "crc32": _Crc(32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF),
}
_DEFINITIONS: dict[str, Callable[[bytes], int]] = {
    "sum8": _sum8,
    "xor8": _xor8,
    "fletcher16": _fletcher16,
    **_CRCS,
}
_IN_C: dict[str, Callable[[bytes], int]] = {
    "crc16-ccitt-false": lambda data: binascii.crc_hqx(data, 0xFFFF),
    "crc16-xmodem": lambda data: binascii.crc_hqx(data, 0),
    "crc32": zlib.crc32,
}

SIZES: dict[str, int] = {"sum8": 1, "xor8": 1, "fletcher16": 2} | {
    name: crc.width // 8 for name, crc in _CRCS.items()
}
"""Bytes that each kind of checksum takes in a packet. These are all the kinds there are."""


def checksum(kind: str, data: bytes) -> int:
    """Return the checksum of some bytes, by its definition.

    Parameters
    ----------
    kind : str
        One of :data:`SIZES`. ``crc16-x25`` is the catalogue's X-25 with the final inversion
        (906E for "123456789"); MAVLink's variant without it is ``crc16-mcrf4xx`` (6F91).
    data : bytes
        What the checksum covers.
    """
    return _DEFINITIONS[kind](data)


def fast_checksum(kind: str) -> Callable[[bytes], int]:
    """Return the quickest function for the checksum of one packet, compiled where there is one."""
    return _IN_C.get(kind, _DEFINITIONS[kind])


def rows_per_block(length: int) -> int:
    """Return how many rows of this length to work on at once: what stays in the L2 cache."""
    return max(MIN_BLOCK_ROWS, BLOCK_BYTES // max(length, 1))


def checksum_rows(kind: str, rows: ByteRows) -> UnsignedArray:
    """Return the checksum of every row.

    Parameters
    ----------
    kind : str
        One of :data:`SIZES`.
    rows : shape (n, m), uint8
        What each checksum covers; the bytes of a row must be neighbours in memory.

    Returns
    -------
    shape (n,), unsigned integers of ``SIZES[kind]`` bytes
    """
    count, length = rows.shape
    result = np.empty(count, dtype=f"u{SIZES[kind]}")
    per_block = rows_per_block(length)
    for start in range(0, count, per_block):
        block = rows[start : start + per_block]
        result[start : start + per_block] = _block(kind, block)
    return result


def _block(kind: str, rows: ByteRows) -> UnsignedArray:
    if kind in _CRCS:
        return _crc_block(_CRCS[kind], rows)
    result: UnsignedArray
    if kind == "sum8":
        result = np.add.reduce(rows, axis=1, dtype=np.uint8)
    elif kind == "xor8":
        result = np.bitwise_xor.reduce(rows, axis=1, dtype=np.uint8)
    else:
        result = _fletcher16_block(rows)
    return result


def _fletcher16_block(rows: ByteRows) -> UnsignedArray:
    length = rows.shape[1]
    weights = np.arange(length, 0, -1, dtype=np.uint64)
    wide: UnsignedArray = rows.astype(np.uint64)
    low: UnsignedArray = wide.sum(axis=1, dtype=np.uint64) % np.uint64(255)
    high: UnsignedArray = (wide @ weights) % np.uint64(255)
    return (high << np.uint64(8) | low).astype(np.uint16)


def _crc_block(crc: _Crc, rows: ByteRows) -> UnsignedArray:
    """Return the CRC of each row, two bytes at a time for all rows at once.

    The register is kept in the order of the bytes that it meets, lowest first, whichever way the
    CRC runs: then one formula serves all of them.
    """
    by_byte, by_word = _tables(crc)
    number, length = rows.shape
    register: UnsignedArray
    register = np.full(number, _wire_order(crc, crc.initial), dtype=by_word.dtype)
    words = np.ascontiguousarray(rows[:, : length - length % 2].view("<u2").T)
    for word in words:
        index = word ^ (register if crc.width < 32 else register.astype(np.uint16))
        looked_up = by_word.take(index, mode="clip")
        register = looked_up if crc.width <= 16 else (register >> 16) ^ looked_up
    if length % 2:
        last = by_byte[(register ^ rows[:, -1]) & 0xFF]
        register = last if crc.width == 8 else (register >> 8) ^ last
    if not crc.reflected:
        register = register.byteswap()
    register ^= register.dtype.type(crc.final_xor)
    return register


def _wire_order(crc: _Crc, register: int) -> int:
    if crc.reflected:
        return register
    return int.from_bytes(register.to_bytes(crc.width // 8, "big"), "little")


@lru_cache(maxsize=16)
def _tables(crc: _Crc) -> tuple[UnsignedArray, UnsignedArray]:
    """Return the register after one byte and after two, from a register of zero."""
    code = f"u{crc.width // 8}"
    by_byte = np.array([_wire_order(crc, r) for r in _crc_table(crc)], dtype=code)
    words = np.arange(1 << 16, dtype=np.uint32)
    after_first = by_byte[words & 0xFF].astype(np.uint32)
    after_both = (after_first >> 8) ^ by_byte[(after_first ^ words >> 8) & 0xFF]
    return by_byte, after_both.astype(code)
