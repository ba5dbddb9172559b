"""Checksums of fixed-length packets: a plain definition of each and a fast one for many packets.

:func:`checksum` is the definition, one byte after the other. :func:`checksum_rows` gives the same
numbers for every row of an array. It uses that a CRC is affine over GF(2): the CRC of a row is
the CRC of zeros, XORed with one number per byte that depends on that byte and its place only.
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
UnsignedArray = npt.NDArray[np.unsignedinteger[Any]]

BLOCK_BYTES = 1 << 18
"""Rows are worked through in blocks of about this size, so that they stay in the L2 cache."""


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

    @property
    def table(self) -> tuple[int, ...]:
        """Return the register after one byte, for each byte, from a register of zero."""
        return _crc_table(self)

    def step(self, register: int, byte: int) -> int:
        if self.reflected:
            return (register >> 8) ^ self.table[(register ^ byte) & 0xFF]
        high = (register >> (self.width - 8)) ^ byte
        return ((register << 8) & self.mask) ^ self.table[high & 0xFF]

    def __call__(self, data: bytes) -> int:
        register = self.initial
        for byte in data:
            register = self.step(register, byte)
        return register ^ self.final_xor


@lru_cache(maxsize=32)
def _crc_table(crc: _Crc) -> tuple[int, ...]:
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


def checksum_rows(kind: str, rows: ByteRows) -> UnsignedArray:
    """Return the checksum of every row.

    Parameters
    ----------
    kind : str
        One of :data:`SIZES`.
    rows : shape (n, m), uint8
        What each checksum covers; need not be contiguous.

    Returns
    -------
    shape (n,), unsigned integers of ``SIZES[kind]`` bytes
    """
    count, length = rows.shape
    result = np.empty(count, dtype=f"u{SIZES[kind]}")
    per_block = max(1, BLOCK_BYTES // max(length, 1))
    for start in range(0, count, per_block):
        block = rows[start : start + per_block]
        result[start : start + per_block] = _block(kind, block)
    return result


def _block(kind: str, rows: ByteRows) -> UnsignedArray:
    length = rows.shape[1]
    if kind == "sum8":
        return np.add.reduce(rows, axis=1, dtype=np.uint8)
    if kind == "xor8":
        return np.bitwise_xor.reduce(rows, axis=1, dtype=np.uint8)
    if kind == "fletcher16":
        wide = rows.astype(np.uint32)  # 4096 bytes: below 255 * 4096 * 4097 / 2 < 2**32
        low = wide.sum(axis=1, dtype=np.uint32) % 255
        high = (wide @ np.arange(length, 0, -1, dtype=np.uint32)) % 255
        return (high << 8 | low).astype(np.uint16)
    return _crc_block(_CRCS[kind], rows)


def _crc_block(crc: _Crc, rows: ByteRows) -> UnsignedArray:
    tables, of_zeros = _place_tables(crc, rows.shape[1])
    columns = np.ascontiguousarray(rows.T)
    result = np.full(rows.shape[0], of_zeros, dtype=tables.dtype)
    term = np.empty_like(result)
    for table, column in zip(tables, columns, strict=True):
        np.take(table, column, out=term, mode="clip")
        result ^= term
    return result


@lru_cache(maxsize=16)
def _place_tables(crc: _Crc, length: int) -> tuple[UnsignedArray, int]:
    """Return what each byte adds at each place, shape (length, 256), and the CRC of zeros."""
    tables = np.empty((length, 256), dtype=f"u{crc.width // 8}")
    one_byte = np.array(crc.table, dtype=tables.dtype)
    row = one_byte
    for place in range(length - 1, -1, -1):
        tables[place] = row
        row = _advance(crc, row, one_byte)
    tables.flags.writeable = False
    return tables, crc(bytes(length))


def _advance(crc: _Crc, registers: UnsignedArray, one_byte: UnsignedArray) -> UnsignedArray:
    """Return each register after one more byte of zero."""
    if crc.width == 8:
        return one_byte[registers]
    if crc.reflected:
        return (registers >> 8) ^ one_byte[registers & 0xFF]
    return (registers << 8) ^ one_byte[registers >> (crc.width - 8)]
