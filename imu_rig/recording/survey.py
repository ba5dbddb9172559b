"""What a trial file holds and lacks, as far as its repair needs to know."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from imu_rig.recording.format import RECORD_OVERHEAD, RESUMED, FileHeader, Kind, decode_json
from imu_rig.recording.log import Count
from imu_rig.recording.scan import Damage, Records, iter_records, scan_records

Progress = Callable[[str, float], None]
"""Told what is being done, and the share of it that is done."""

_WIRES = (int(Kind.BYTES_IN), int(Kind.BYTES_OUT))
_SPEAKING = (int(Kind.SOURCE), int(Kind.EVENT), int(Kind.END))
_BATCH_RECORDS = 1 << 14


@dataclass
class Survey:
    """What a trial file holds and lacks, as far as a repair needs to know.

    Attributes
    ----------
    damage : Damage
    in_order : bool
        Whether the records stand in the file in the order they were written.
    size : int
        Of the file [bytes].
    records : int
        Sound ones.
    last_ns, lost_ns : int
        Latest trial time, and time between the records on both sides of each loss, in all [ns].
    ended : str or None
        Why the recording ended.
    end_row : int or None
        Which of the sound records says so.
    counted : dict or None
        What the end says that each source sent; None where it is not about the whole file.
    counts : dict
        ``(kind, source)`` to what is there.
    names : dict
        Number of a source to its name.
    """

    damage: Damage
    in_order: bool
    size: int
    records: int = 0
    last_ns: int = 0
    lost_ns: int = 0
    ended: str | None = None
    end_row: int | None = None
    counted: dict[str, Any] | None = None
    counts: defaultdict[tuple[int, int], Count] = field(default_factory=lambda: defaultdict(Count))
    names: dict[int, str] = field(default_factory=dict)


class _OutOfOrder(Exception):  # noqa: N818  (it is no error)
    """Records do not stand in the order they were written."""


def survey_trial(file: BinaryIO, header: FileHeader, progress: Progress) -> Survey:
    """Look through a trial file once, or twice where its records are out of order."""
    size = file.seek(0, os.SEEK_END)
    try:
        survey = Survey(Damage(), in_order=True, size=size)
        survey.damage = _look(survey, file, header, iter_records(file, header), progress)
    except _OutOfOrder:
        records, damage = scan_records(file, header)
        survey = Survey(damage, in_order=False, size=size)
        _look(survey, file, header, in_parts(records), progress)
    return survey


def _look(
    survey: Survey,
    file: BinaryIO,
    header: FileHeader,
    batches: Iterable[Records],
    progress: Progress,
) -> Damage:
    """Fill in the survey; return the damage, which is right where the records are in order."""
    newest = -1
    newest_ns = 0
    sound_bytes = 0
    end = header.size
    resumed = False
    for records in batches:
        if not len(records):
            continue
        sequence = np.concatenate([[newest], records.sequence.astype(np.int64)])
        steps = np.diff(sequence)
        if np.any(steps <= 0):
            raise _OutOfOrder
        for row in np.flatnonzero(steps > 1).tolist():
            before_ns = int(records.time_ns[row - 1]) if row else newest_ns
            survey.lost_ns += max(0, int(records.time_ns[row]) - before_ns)
        for row in np.flatnonzero(np.isin(records.kind, _SPEAKING)).tolist():
            kind = int(records.kind[row])
            value = _json_object(_payload(file, records, row))
            if kind == Kind.SOURCE and isinstance(name := value.get("name"), str):
                if name not in survey.names.values():
                    survey.names.setdefault(int(records.source[row]), name)
            elif kind == Kind.EVENT and value.get("name") == RESUMED:
                resumed = True
                survey.ended = survey.end_row = survey.counted = None
            elif kind == Kind.END and "reason" in value:
                survey.ended = str(value["reason"])
                survey.end_row = survey.records + row
                counted = value.get("sources")
                survey.counted = counted if isinstance(counted, dict) and not resumed else None
        _count(survey.counts, records)
        survey.records += len(records)
        newest, newest_ns = int(sequence[-1]), int(records.time_ns[-1])
        survey.last_ns = max(survey.last_ns, int(records.time_ns.max()))
        sound_bytes += int(records.length.sum(dtype=np.int64)) + RECORD_OVERHEAD * len(records)
        end = int(records.end[-1])
        progress("looking for sound records", end / survey.size)
    return Damage(
        records_lost=newest + 1 - survey.records,
        bytes_skipped=end - header.size - sound_bytes,
        tail_bytes=max(0, survey.size - end),
        header_damaged=header.damaged,
    )


def _count(counts: dict[tuple[int, int], Count], records: Records) -> None:
    for kind in _WIRES:
        of_kind = records.kind == kind
        sources = records.source[of_kind]
        sizes = np.bincount(sources, records.length[of_kind], minlength=1)
        for source, number in enumerate(np.bincount(sources).tolist()):
            if number:
                counts[kind, source].records += number
                counts[kind, source].bytes += int(sizes[source])


def _json_object(payload: bytes) -> dict[str, Any]:
    try:
        value = decode_json(payload)
    except ValueError:  # a checksum vouches for the bytes, not for who wrote them
        return {}
    return value if isinstance(value, dict) else {}


def _payload(file: BinaryIO, records: Records, row: int) -> bytes:
    """Read the payload of one record."""
    file.seek(int(records.offset[row]))
    return file.read(int(records.length[row]))


def in_parts(records: Records) -> Iterator[Records]:
    """Yield records a few thousand at a time."""
    for start in range(0, len(records), _BATCH_RECORDS):
        yield records[start : start + _BATCH_RECORDS]
