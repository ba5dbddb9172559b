"""Matrices of numbers out of MATLAB files of version 5 to 7, and nothing else of them.

The format is MathWorks' "MAT-File Level 5". A reader of its own, because files come from outside:
every length is checked before anything is read or unpacked, and the common library ends the whole
program on some damaged files.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from imu_rig.arrays import FloatArray

HEADER_BYTES = 128
_COMPRESSED, _MATRIX = 15, 14
_FLAGS_TYPE, _DIMENSIONS_TYPE = 6, 5
_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
NUMERIC_CLASSES = range(6, 16)
"""Double, single and integers; truth values are a flag of 8-bit integers."""
_COMPLEX = 0x08
HEAD_BYTES = 4096
"""In which flags, shape and name of a variable must lie."""
MOST_DIMENSIONS = 32
LONGEST_NAME = 255


class DamagedError(Exception):
    """A file whose lengths and types do not fit together."""


@dataclass(frozen=True)
class Variable:
    """One variable of a file.

    Attributes
    ----------
    name : str
    shape : tuple of int
    numeric : bool
        Whether it is a matrix of real numbers.
    offset, size : int
        Where its element lies in the file, without its tag [bytes].
    compressed : bool
    data_offset : int
        Where its numbers begin, in the element as it is unpacked [bytes].
    """

    name: str
    shape: tuple[int, ...]
    numeric: bool
    offset: int
    size: int
    compressed: bool
    data_offset: int


def list_variables(file: BinaryIO) -> Iterator[Variable]:
    """Yield the variables of a file, reading little more than their names.

    Raises
    ------
    DamagedError
        If the file is not sound so far.
    """
    order = _byte_order(file)
    file.seek(0, 2)
    end = file.tell()
    at = HEADER_BYTES
    while at < end:
        file.seek(at)
        kind, size = _unpack(f"{order}II", file.read(8))
        at += 8
        if kind not in (_COMPRESSED, _MATRIX) or size > end - at:
            raise DamagedError
        head = file.read(min(size, HEAD_BYTES))
        start = 0
        if kind == _COMPRESSED:
            head = _inflated(head, HEAD_BYTES)
            if _unpack(f"{order}I", head[:4]) != (_MATRIX,):
                raise DamagedError
            start = 8
        if len(head) > start:  # an empty element stands for nothing
            yield _variable(head, start, order, at, size, compressed=kind == _COMPRESSED)
        at += size


def read_matrix(file: BinaryIO, variable: Variable) -> FloatArray:
    """Read one matrix of numbers, in its shape.

    Raises
    ------
    DamagedError
        If its bytes do not fit its shape.
    """
    order = _byte_order(file)
    count = math.prod(variable.shape)
    most = variable.data_offset + 8 * count + 64
    file.seek(variable.offset)
    # What cannot be packed takes a little more room when it is.
    data = file.read(min(variable.size, most + most // 1000 + 1000))
    if variable.compressed:
        data = _inflated(data, most, whole=True)
    kind, begin, size, _ = _element(data, variable.data_offset, order)
    if kind not in _TYPES:
        raise DamagedError
    dtype = np.dtype(f"{order}{_TYPES[kind]}")
    if size != count * dtype.itemsize:
        raise DamagedError
    numbers = np.frombuffer(data, dtype, count, begin)
    return numbers.astype(np.float64).reshape(variable.shape, order="F")


def _variable(
    head: bytes, start: int, order: str, offset: int, size: int, *, compressed: bool
) -> Variable:
    kind, begin, length, at = _element(head, start, order)
    if kind != _FLAGS_TYPE or length != 8:
        raise DamagedError
    (flags,) = _unpack(f"{order}I", head[begin : begin + 4])
    if flags & 0xFF == 17:  # an object of a newer kind, without a shape
        return Variable("", (), False, offset, size, compressed, 0)
    kind, begin, length, at = _element(head, at, order)
    if kind != _DIMENSIONS_TYPE or not 8 <= length <= 4 * MOST_DIMENSIONS or length % 4:
        raise DamagedError
    shape = _unpack(f"{order}{length // 4}i", head[begin : begin + length])
    if min(shape) < 0:
        raise DamagedError
    kind, begin, length, at = _element(head, at, order)
    if kind not in (1, 2, 16) or length > LONGEST_NAME:
        raise DamagedError
    name = head[begin : begin + length].decode("utf-8", errors="replace")
    numeric = flags & 0xFF in NUMERIC_CLASSES and not (flags >> 8) & _COMPLEX
    return Variable(name, shape, numeric, offset, size, compressed, at)


def _element(data: bytes, at: int, order: str) -> tuple[int, int, int, int]:
    """Type, begin and length of an element's data, and where the next one stands."""
    first, second = _unpack(f"{order}II", data[at : at + 8])
    if first >> 16:  # four bytes or less stand in the tag itself
        length = first >> 16
        if length > 4:
            raise DamagedError
        return first & 0xFFFF, at + 4, length, at + 8
    begin = at + 8
    return first, begin, second, begin + second + -second % 8


def _byte_order(file: BinaryIO) -> str:
    file.seek(0)
    mark = file.read(HEADER_BYTES)[-2:]
    if mark not in (b"IM", b"MI"):
        raise DamagedError
    return "<" if mark == b"IM" else ">"


def _unpack(form: str, data: bytes) -> tuple[int, ...]:
    try:
        return struct.unpack(form, data)
    except struct.error as error:
        raise DamagedError from error


def _inflated(data: bytes, most: int, *, whole: bool = False) -> bytes:
    """Unpack at most so many bytes; with ``whole`` that must be all, and its checksum right."""
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(data, most)
    except zlib.error as error:
        raise DamagedError from error
    if whole and not unpacker.eof:
        raise DamagedError
    return unpacked
