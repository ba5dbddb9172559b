"""Read the header of a trial file, also of one that has lost it.

All that a reader needs of a header is the seed of the checksums. A CRC can be run backward, so
every record head tells from what its checksum started; where several agree, that is the file's.
"""

from __future__ import annotations

import zlib
from collections import Counter
from functools import cache
from pathlib import Path
from typing import BinaryIO

from imu_rig.recording.format import (
    CLOCK_PAIR,
    CRC_SIZE,
    HEADER_SIZE,
    MAX_PAYLOAD,
    RECORD_HEAD_SIZE,
    SYNC,
    FileHeader,
    HeaderLost,
    Kind,
    decode_file_header,
)
from imu_rig.recording.scan import iter_records

SEARCH_BYTES = 8 << 20  # from the start of the file in which records are looked for
MOST_CHECKED = 4 * SEARCH_BYTES  # in a file made to hold heads within heads
ENOUGH = 8  # heads that agree
_ALL_ONES = 0xFFFFFFFF


def read_file_header(file: BinaryIO, path: Path) -> FileHeader:
    """Return the header of a file, made anew from the records where both its copies are lost.

    Parameters
    ----------
    file : binary file
        Open for reading; its position is moved.
    path : Path
        Name for the messages.

    Raises
    ------
    InputError
        If the file is empty, zero-filled, foreign or of a newer version.
    """
    file.seek(0)
    try:
        return decode_file_header(file.read(HEADER_SIZE), path)
    except HeaderLost:
        found = _recovered_header(file)
        if found is None:
            raise
        return found


def _recovered_header(file: BinaryIO) -> FileHeader | None:
    """Return a header with which the records of a file read, or None where there are none."""
    file.seek(0)
    seed = _seed_of(file.read(SEARCH_BYTES))
    if seed is None:
        return None
    file_id = bytes(4) + _ending_in(seed, zlib.crc32(bytes(4)))
    header = FileHeader(file_id, 0, damaged=True)
    return FileHeader(file_id, _created_wall_ns(file, header), damaged=True)


def _seed_of(data: bytes) -> int | None:
    """Return the seed on which record heads agree and that a payload confirms."""
    votes: Counter[int] = Counter()
    at, budget = data.find(SYNC), MOST_CHECKED
    while 0 <= at <= len(data) - RECORD_HEAD_SIZE and budget > 0:
        fields = data[at + len(SYNC) : at + RECORD_HEAD_SIZE - CRC_SIZE]
        head_crc = int.from_bytes(data[at + RECORD_HEAD_SIZE - CRC_SIZE :][:CRC_SIZE], "little")
        length = int.from_bytes(fields[2:6], "little")
        budget -= RECORD_HEAD_SIZE + min(length, MAX_PAYLOAD)
        if length <= MAX_PAYLOAD and _payload_agrees(data, at, length, head_crc):
            seed = _before(head_crc, fields)
            votes[seed] += 1
            if votes[seed] == ENOUGH:
                break
            at += RECORD_HEAD_SIZE + length
        at = data.find(SYNC, at + 1)
    if not votes:
        return None
    seed, agreeing = votes.most_common(1)[0]
    return seed if agreeing > 1 else None


def _payload_agrees(data: bytes, at: int, length: int, head_crc: int) -> bool:
    start = at + RECORD_HEAD_SIZE
    stated = data[start + length : start + length + CRC_SIZE]
    return len(stated) == CRC_SIZE and zlib.crc32(
        data[start : start + length], head_crc
    ) == int.from_bytes(stated, "little")


def _before(crc: int, data: bytes) -> int:
    """Return the checksum that ``data`` turned into ``crc``."""
    table, by_top = _tables()
    state = crc ^ _ALL_ONES
    for byte in reversed(data):
        index = by_top[state >> 24]
        state = ((state ^ table[index]) << 8 & _ALL_ONES) | (index ^ byte)
    return state ^ _ALL_ONES


def _ending_in(crc: int, before: int) -> bytes:
    """Return the four bytes that turn the checksum ``before`` into ``crc``."""
    return (_before(crc, bytes(4)) ^ before).to_bytes(4, "little")


@cache
def _tables() -> tuple[list[int], dict[int, int]]:
    """Return CRC-32's table, and which entry of it has each top byte."""
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
        table.append(value)
    return table, {entry >> 24: index for index, entry in enumerate(table)}


def _created_wall_ns(file: BinaryIO, header: FileHeader) -> int:
    """Return the wall clock at the start by the first clock pair; 0 where there is none."""
    for records in iter_records(file, header):
        for row in range(len(records)):
            if records.kind[row] == Kind.CLOCK_PAIR and records.length[row] == CLOCK_PAIR.size:
                file.seek(int(records.offset[row]))
                _, wall_ns = CLOCK_PAIR.unpack(file.read(CLOCK_PAIR.size))
                return int(wall_ns) - int(records.time_ns[row])
        if len(records):
            break
    return 0
