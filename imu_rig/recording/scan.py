"""Find the sound records of a trial file, whatever happened to it, at about the disk's speed.

A record is taken only if its head and its payload pass their checksums, both of which start from
the file's own id. So damage can hide records and never invent or alter one.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from imu_rig.arrays import AnyArray, BoolArray, ByteArray, IntArray, StructArray
from imu_rig.recording.format import (
    CRC_SIZE,
    MAX_PAYLOAD,
    RECORD_HEAD_SIZE,
    RECORD_OVERHEAD,
    SYNC,
    FileHeader,
)

WINDOW_BYTES = 2 * MAX_PAYLOAD  # above the largest record, so that each scan gets on
_MAX_OVERLAP = 16
_SEED_SIZE = 4
_ROW_LENGTHS = (32, 64, 96)  # longer payloads: one call of zlib each is as fast
_ROWS_WORTH_IT = 256

_U32Array = npt.NDArray[np.uint32]

_HEAD = np.dtype(
    [
        ("sync", "V2"),
        ("kind", "u1"),
        ("source", "u1"),
        ("length", "<u4"),
        ("sequence", "<u4"),
        ("time_ns", "<i8"),
        ("head_crc", "<u4"),
    ]
)


@dataclass(frozen=True)
class Records:
    """``n`` sound records as columns.

    Attributes
    ----------
    offset : shape (n,)
        Where the payload begins [bytes].
    length : shape (n,)
        Length of the payload [bytes].
    kind, source, sequence : shape (n,)
        Fields of the record head.
    time_ns : shape (n,)
        Trial time [ns].
    """

    offset: IntArray
    length: npt.NDArray[np.uint32]
    kind: npt.NDArray[np.uint8]
    source: npt.NDArray[np.uint8]
    sequence: npt.NDArray[np.uint32]
    time_ns: IntArray

    def __len__(self) -> int:
        """Return the number of records."""
        return len(self.offset)

    def __getitem__(self, rows: IntArray | BoolArray | slice) -> Records:
        """Return the records that ``rows`` selects."""
        return Records(
            self.offset[rows],
            self.length[rows],
            self.kind[rows],
            self.source[rows],
            self.sequence[rows],
            self.time_ns[rows],
        )

    @property
    def end(self) -> IntArray:
        """Where the next record would begin, shape (n,) [bytes]."""
        return self.offset + self.length + (RECORD_OVERHEAD - RECORD_HEAD_SIZE)

    @staticmethod
    def empty() -> Records:
        """Return no records."""
        return _columns(np.empty(0, np.int64), np.empty(0, _HEAD))

    @staticmethod
    def concatenate(parts: list[Records]) -> Records:
        """Join records in the order given."""
        if not parts:
            return Records.empty()
        return Records(
            np.concatenate([p.offset for p in parts]),
            np.concatenate([p.length for p in parts]),
            np.concatenate([p.kind for p in parts]),
            np.concatenate([p.source for p in parts]),
            np.concatenate([p.sequence for p in parts]),
            np.concatenate([p.time_ns for p in parts]),
        )


@dataclass(frozen=True)
class Damage:
    """What is wrong with a trial file; all zero for a sound one.

    Attributes
    ----------
    records_lost : int
        Records that the sequence numbers say were written before the last sound one and are gone.
    bytes_skipped : int
        Bytes between sound records that are not part of one.
    tail_bytes : int
        Bytes after the last sound record: a record torn by a crash, or more.
    records_repeated : int
        Second copies of a record (same sequence number); left out.
    records_reordered : int
        Records found before one with a lower sequence number; put in their place.
    header_damaged : bool
        Whether a copy of the file header is damaged, or both.
    """

    records_lost: int = 0
    bytes_skipped: int = 0
    tail_bytes: int = 0
    records_repeated: int = 0
    records_reordered: int = 0
    header_damaged: bool = False

    def __bool__(self) -> bool:
        """Whether there is any damage."""
        return self != Damage()

    def __str__(self) -> str:
        """Return the damage in words."""
        words = [
            (self.records_lost, "record", "lost"),
            (self.bytes_skipped, "byte", "skipped"),
            (self.tail_bytes, "byte", "of a torn end"),
            (self.records_repeated, "repeated record", "left out"),
            (self.records_reordered, "record", "put back in order"),
        ]
        said = [f"{n} {what}{'s' * (n > 1)} {done}" for n, what, done in words if n]
        if self.header_damaged:
            said.append("header damaged")
        return ", ".join(said) if said else "none"


def scan_records(
    file: BinaryIO, header: FileHeader, *, window_bytes: int = WINDOW_BYTES
) -> tuple[Records, Damage]:
    """Find all sound records of a file, in order of their sequence numbers.

    Parameters
    ----------
    file : binary file
        Open for reading; its position is moved.
    header : FileHeader
        The file's header.
    window_bytes : int
        How much to read at a time, above the size of the largest record.
    """
    parts: list[Records] = []
    sound_bytes = 0
    end = header.size
    for records in iter_records(file, header, window_bytes=window_bytes):
        parts.append(records)
        if len(records):
            sound_bytes += int(records.length.sum(dtype=np.int64)) + RECORD_OVERHEAD * len(records)
            end = int(records.end[-1])
    size = max(file.seek(0, os.SEEK_END), end)
    records, reordered, repeated = _in_sequence(Records.concatenate(parts))
    return records, Damage(
        records_lost=int(records.sequence[-1]) + 1 - len(records) if len(records) else 0,
        bytes_skipped=end - header.size - sound_bytes,
        tail_bytes=size - end,
        records_repeated=repeated,
        records_reordered=reordered,
        header_damaged=header.damaged,
    )


def iter_records(
    file: BinaryIO, header: FileHeader, *, window_bytes: int = WINDOW_BYTES
) -> Iterator[Records]:
    """Yield the sound records of a file in the order they stand in it, one window at a time.

    Parameters
    ----------
    file, header, window_bytes
        As for :func:`scan_records`.
    """
    size = file.seek(0, os.SEEK_END)  # what a recorder adds meanwhile is left for the next reader
    buffer = bytearray(min(window_bytes, max(0, size - header.size)))
    base = header.size
    last = False
    while not last:
        file.seek(base)
        count = _fill(file, memoryview(buffer)[: max(0, size - base)])
        last = base + count >= size or count == 0
        window = np.frombuffer(buffer, np.uint8)[:count]
        records, done = _scan_window(window, header.seed, last)
        yield dataclasses.replace(records, offset=records.offset + base)
        base += done


def _fill(file: BinaryIO, view: memoryview) -> int:
    filled = 0
    while filled < len(view):
        part = file.read(len(view) - filled)
        if not part:
            break
        view[filled : filled + len(part)] = part
        filled += len(part)
    return filled


def _scan_window(window: ByteArray, seed: int, last: bool) -> tuple[Records, int]:
    """Return the records that end in ``window`` and how many of its bytes are dealt with."""
    size = len(window)
    if size < RECORD_OVERHEAD:
        return Records.empty(), size
    start, heads = _find_heads(window, seed)
    crc_at = start + RECORD_HEAD_SIZE + heads["length"]
    end = crc_at + (RECORD_OVERHEAD - RECORD_HEAD_SIZE)
    whole = end <= size
    cut = start[~whole]
    start, heads = _chosen(start, whole), _chosen(heads, whole)
    crc_at, end = _chosen(crc_at, whole), _chosen(end, whole)
    sound = _payloads_sound(window, heads, crc_at)
    start, heads, end = _chosen(start, sound), _chosen(heads, sound), _chosen(end, sound)
    start, heads, end = _without_nested(start, heads, end)
    waiting = _first_outside(cut, start, end)
    if waiting is not None and not last:
        before = start < waiting
        return _columns(start[before], heads[before]), waiting
    # A head that the window's edge cuts must be seen whole next time.
    done = max(size - RECORD_HEAD_SIZE + 1, int(end[-1]) if len(end) else 0)
    return _columns(start, heads), done


def _find_heads(window: ByteArray, seed: int) -> tuple[IntArray, StructArray]:
    """Return every place where a sound record head stands, and the heads."""
    places = np.flatnonzero(window[: 1 - RECORD_HEAD_SIZE] == SYNC[0])
    places = places[window[places + 1] == SYNC[1]]
    heads = _gather(window, places, _HEAD)
    covered = heads.view(np.uint8).reshape(-1, RECORD_HEAD_SIZE)[:, len(SYNC) : -CRC_SIZE]
    crc = np.full(len(places), zlib.crc32(bytes(covered.shape[1]), seed), np.uint32)
    _add_crc32(crc, covered)
    sound = (crc == heads["head_crc"]) & (heads["length"] <= MAX_PAYLOAD)
    # Records side by side fit in the window once. A file made to hold heads within heads within
    # heads would cost hours of checksums, so there is an end to them.
    asked = np.cumsum(heads["length"] * sound, dtype=np.int64)
    sound &= asked <= _MAX_OVERLAP * WINDOW_BYTES
    return _chosen(places, sound), _chosen(heads, sound)


def _payloads_sound(window: ByteArray, heads: StructArray, crc_at: IntArray) -> BoolArray:
    """Return which records have a sound payload; all must lie inside the window."""
    length = heads["length"].astype(np.int64)
    seeds = heads["head_crc"].copy()
    crc = np.empty(len(heads), np.uint32)
    one_by_one = np.ones(len(heads), bool)
    shortest = _SEED_SIZE
    for longest in _ROW_LENGTHS:
        fits = (length >= shortest) & (length <= longest) & (crc_at >= longest)
        rows = np.flatnonzero(fits)
        if len(rows) == len(heads):
            crc = _crc32_before(window, crc_at, length, seeds)
            one_by_one[:] = False
        elif len(rows) >= _ROWS_WORTH_IT:
            crc[rows] = _crc32_before(window, crc_at[rows], length[rows], seeds[rows])
            one_by_one[rows] = False
        shortest = longest + 1
    view = memoryview(window.data)
    ends = crc_at[one_by_one].tolist()
    starts = (crc_at - length)[one_by_one].tolist()
    crc[one_by_one] = [
        zlib.crc32(view[start:end], seed)
        for start, end, seed in zip(starts, ends, seeds[one_by_one].tolist(), strict=True)
    ]
    return np.asarray(crc == _gather(window, crc_at, np.dtype("<u4")), bool)


def _chosen(rows: AnyArray, flags: BoolArray) -> AnyArray:
    """Return the rows that are flagged, without a copy where all are."""
    if flags.all():
        return rows
    # Items of no type are copied whole, those of a structure field by field.
    whole = rows.view(f"V{rows.dtype.itemsize}") if rows.dtype.names else rows
    return whole[np.flatnonzero(flags)].view(rows.dtype)


def _without_nested(
    start: IntArray, heads: StructArray, end: IntArray
) -> tuple[IntArray, StructArray, IntArray]:
    """Leave out records that stand inside the payload of an earlier one."""
    if not np.any(start[1:] < end[:-1]):
        return start, heads, end
    keep: list[int] = []
    cursor = 0
    for row, (first, stop) in enumerate(zip(start.tolist(), end.tolist(), strict=True)):
        if first >= cursor:
            keep.append(row)
            cursor = stop
    return start[keep], heads[keep], end[keep]


def _first_outside(places: IntArray, start: IntArray, end: IntArray) -> int | None:
    """Return the first of ``places`` that no record from ``start`` to ``end`` covers."""
    if not len(places):
        return None
    if len(start):
        before = np.searchsorted(start, places, side="right") - 1
        places = places[(before < 0) | (places >= end[before])]
    return int(places[0]) if len(places) else None


def _in_sequence(records: Records) -> tuple[Records, int, int]:
    """Return the records in the order they were written, and the moved and repeated counts."""
    sequence = records.sequence
    if np.all(sequence[1:] > sequence[:-1]):
        return records, 0, 0
    order = np.argsort(sequence, kind="stable")
    first = np.ones(len(order), bool)
    first[1:] = np.diff(sequence[order]) != 0
    order = order[first]
    reordered = int(np.count_nonzero(np.diff(order) < 0))
    return records[order], reordered, len(records) - len(order)


def _columns(start: IntArray, heads: StructArray) -> Records:
    return Records(
        start + RECORD_HEAD_SIZE,
        heads["length"].copy(),
        heads["kind"].copy(),
        heads["source"].copy(),
        heads["sequence"].copy(),
        heads["time_ns"].copy(),
    )


def _gather(window: ByteArray, places: IntArray, dtype: np.dtype[Any]) -> AnyArray:
    """Return the items of ``dtype`` that begin at ``places``, aligned or not."""
    found: AnyArray = anywhere(window, dtype.itemsize)[places].view(dtype)
    return found


def anywhere(data: ByteArray, size: int) -> AnyArray:
    """Return the ``size`` bytes from every byte of ``data`` on, as one item each.

    Items of no type are copied whole, which is several times as fast as field by field.
    """
    return np.ndarray((max(0, len(data) - size + 1),), f"V{size}", data, strides=(1,))


def _crc32_before(
    window: ByteArray, ends: IntArray, lengths: IntArray, seeds: _U32Array
) -> _U32Array:
    """CRC-32 of the ``lengths`` bytes that stand before each of ``ends``, from its seed.

    A CRC is linear over the bits of its input. So a byte adds one table value that depends only on
    how many bytes follow it, zeros in front add nothing, and a seed acts as if it were XORed into
    the first four bytes, of which there must be four.
    """
    if not len(ends):
        return np.empty(0, np.uint32)
    width = int(lengths.max())
    found = _gather(window, ends - width, np.dtype(f"V{width}"))
    rows = found.view(np.uint8).reshape(len(ends), width)
    first = (width - lengths)[:, np.newaxis]
    seed_bytes = seeds.astype("<u4").view(np.uint8).reshape(-1, _SEED_SIZE)
    if first.any():
        rows *= np.arange(width) >= first
        rows[np.arange(len(ends))[:, np.newaxis], first + np.arange(_SEED_SIZE)] ^= seed_bytes
    else:
        rows[:, :_SEED_SIZE] ^= seed_bytes
    crc = _crc32_tables()[1][lengths]
    _add_crc32(crc, rows)
    return crc


def _add_crc32(crc: _U32Array, rows: ByteArray) -> None:
    """Add what the bytes of ``rows``, shape (n, width), make of the CRC of as many zeros."""
    tables, _ = _crc32_tables()
    added = np.empty_like(crc)
    for following, column in enumerate(rows.T[::-1]):
        tables[following].take(column, out=added, mode="wrap")  # checked bounds take a copy
        crc ^= added


@functools.cache
def _crc32_tables() -> tuple[_U32Array, _U32Array]:
    """Return what a byte adds by the number of bytes after it, and the CRC of so many zeros."""
    count = max(_ROW_LENGTHS)
    of_zeros = np.array([zlib.crc32(bytes(n)) for n in range(count + 1)], np.uint32)
    tables = np.empty((count, 256), np.uint32)
    tables[0] = [zlib.crc32(bytes([value])) ^ int(of_zeros[1]) for value in range(256)]
    for following in range(1, count):
        before = tables[following - 1]
        tables[following] = (before >> 8) ^ tables[0][before & 0xFF]
    return tables, of_zeros
