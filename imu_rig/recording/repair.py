"""Save what is sound in a damaged trial file to a new one; the damaged file is never altered.

The new file holds every sound record in the order it was written, with a new number, and in the
place of lost ones a gap that counts them. It is made of nothing but the bytes of the old file, so
repairing again gives the same bytes. Memory does not grow with the file, except where a power
cut left records out of order: then 26 bytes of each are held.
"""

from __future__ import annotations

import hashlib
import os
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from imu_rig.clock import NS_PER_S
from imu_rig.errors import InputError, NameTaken
from imu_rig.files import whole_file
from imu_rig.recording.file_header import read_file_header
from imu_rig.recording.format import (
    DAMAGE,
    RECORD_OVERHEAD,
    SUFFIX,
    TRIAL,
    FileHeader,
    Kind,
    encode_json,
    encode_records,
)
from imu_rig.recording.log import Count, Entry
from imu_rig.recording.notes import LONGEST_NS, wire_counts
from imu_rig.recording.scan import Damage, iter_records, scan_records
from imu_rig.recording.storage import OsFileSystem, open_undisturbed, require_space
from imu_rig.recording.survey import Progress, Survey, in_parts, survey_trial

REPAIRED = "repaired"

_PIECE_BYTES = 1 << 20


@dataclass(frozen=True)
class SourceLoss:
    """What of one source was saved.

    Attributes
    ----------
    name : str
        Its name; ``source-N`` where no description of it is left.
    records, bytes : int
        Kept, of both directions.
    lost_records, lost_bytes : int or None
        Lost, by the counts in the end record; None where there is none to go by.
    """

    name: str
    records: int
    bytes: int
    lost_records: int | None
    lost_bytes: int | None


@dataclass(frozen=True)
class Repair:
    """What a repair found and did.

    Attributes
    ----------
    path : Path
        The file that was looked at.
    target : Path or None
        The file that was made of it; None where there is nothing to repair.
    written : bool
        False where ``target`` had exactly this content already.
    damage : Damage
        What is wrong with ``path``.
    ended : str or None
        How the recording ended; None where it was cut off.
    records : int
        Sound records, all of which are kept.
    duration_s : float
        Trial time of the last of them [s].
    lost_s : float
        Time between the records on both sides of each loss, in all [s].
    sources : tuple of SourceLoss
    """

    path: Path
    target: Path | None
    written: bool
    damage: Damage
    ended: str | None
    records: int
    duration_s: float
    lost_s: float
    sources: tuple[SourceLoss, ...]

    @property
    def bytes_dropped(self) -> int:
        """Bytes of the file that belong to no sound record."""
        return self.damage.bytes_skipped + self.damage.tail_bytes


def default_target(path: Path) -> Path:
    """Return ``walk.repaired.imu-trial`` for ``walk.imu-trial``."""
    stem = path.name.removesuffix(SUFFIX)
    return path.with_name(f"{stem}.repaired{SUFFIX}")


def repair_trial(
    path: Path, target: Path | None = None, *, progress: Progress = lambda _, __: None
) -> Repair:
    """Write the sound records of a trial file to a new file.

    Parameters
    ----------
    path : Path
        The trial file; it is read only.
    target : Path, optional
        Name of the new file; by default `default_target`.
    progress : callable
        Told now and then how far it is.

    Raises
    ------
    InputError
        If ``path`` is no trial file or is being written by another program, or ``target`` holds
        something else.
    StorageError
        If the disk is full or fails.
    """
    target = default_target(path) if target is None else target
    with open_undisturbed(path) as file:
        header = read_file_header(file, path)
        survey = survey_trial(file, header, progress)
        if not survey.damage and survey.ended is not None:
            return _outcome(path, None, survey, written=False)
        if target.exists() and target.samefile(path):
            raise InputError(f"{path} is never altered by its repair; name another file for it.")
        pieces = _repaired(file, header, survey, progress)
        written = not os.path.lexists(target)
        if written:
            _write(target, pieces, survey.size)
        elif not _holds(target, pieces):
            raise NameTaken(
                f"{target} exists and holds something else; name another file for what is repaired."
            )
        return _outcome(path, target, survey, written=written)


def _repaired(
    file: BinaryIO, header: FileHeader, survey: Survey, progress: Progress
) -> Iterator[bytes]:
    """Yield the repaired file in pieces."""
    sha256 = _sha256(file, survey.size, progress)
    # An id of its own, which is the same each time: a block of the old file passes no check here.
    file_id = hashlib.sha256(b"repaired" + sha256).digest()[: len(header.file_id)]
    new = FileHeader(file_id, header.created_wall_ns)
    piece = new.encode()
    size = number = 0
    batch: list[Entry] = []
    waiting = 0
    for entry in _entries(file, header, survey, sha256.hex(), progress):
        batch.append(entry)
        waiting += RECORD_OVERHEAD + len(entry[3])
        if waiting >= _PIECE_BYTES:
            piece += encode_records(new.seed, number, batch)
            yield piece
            size, number = size + len(piece), number + len(batch)
            piece, batch, waiting = b"", [], 0
    if survey.ended is None:
        value = {
            "reason": "interrupted",
            "records": number + len(batch),
            "bytes": size + len(piece) + waiting,
            "sources": wire_counts(survey.counts, survey.names),
        }
        batch.append((Kind.END, TRIAL, survey.last_ns, encode_json(value, "The end")))
    yield piece + encode_records(new.seed, number, batch)


def _entries(
    file: BinaryIO, header: FileHeader, survey: Survey, sha256: str, progress: Progress
) -> Iterator[Entry]:
    """Yield the records of the repaired file, but for an end that is missing."""
    batches = iter_records(file, header)
    if not survey.in_order:
        batches = in_parts(scan_records(file, header)[0])
    repaired = Kind.EVENT, TRIAL, survey.last_ns, _event(survey, sha256)
    row = expected = before_ns = 0
    gaps_at: defaultdict[int, int] = defaultdict(int)
    for records in batches:
        columns = (
            records.offset,
            records.length,
            records.kind,
            records.source,
            records.sequence,
            records.time_ns,
        )
        for offset, length, kind, source, sequence, time_ns in zip(
            *(column.tolist() for column in columns), strict=True
        ):
            if sequence > expected:
                # Two gaps of one time would be taken for one, told twice.
                later_ns = gaps_at[before_ns] * (1 if before_ns < LONGEST_NS else -1)
                gaps_at[before_ns] += 1
                gap = _gap(sequence - expected, time_ns)
                yield Kind.GAP, TRIAL, before_ns + later_ns, gap
            if row == survey.end_row:
                yield repaired
            file.seek(offset)
            yield kind, source, time_ns, file.read(length)
            row, expected, before_ns = row + 1, sequence + 1, time_ns
        if len(records):
            progress("writing what is sound", row / survey.records)
    if survey.end_row is None:
        yield repaired


def _gap(records: int, until_ns: int) -> bytes:
    value = {"reason": DAMAGE, "records": records, "until_s": until_ns / NS_PER_S}
    return encode_json(value, "The gap")


def _event(survey: Survey, sha256: str) -> bytes:
    damage = survey.damage
    fields = {
        "sha256": sha256,
        "records_kept": survey.records,
        "records_lost": damage.records_lost,
        "bytes_dropped": damage.bytes_skipped + damage.tail_bytes,
        "lost": {
            loss.name: {"records": loss.lost_records, "bytes": loss.lost_bytes}
            for loss in _losses(survey)
            if loss.lost_records
        },
    }
    return encode_json({"name": REPAIRED, "fields": fields}, f"The event {REPAIRED!r}")


def _losses(survey: Survey) -> tuple[SourceLoss, ...]:
    kept: dict[int, Count] = {}
    for (_, source), count in survey.counts.items():
        both = kept.setdefault(source, Count())
        both.records += count.records
        both.bytes += count.bytes
    losses = []
    for number in sorted({*kept, *survey.names}):
        name = survey.names.get(number, f"source-{number}")
        count = kept.get(number, Count())
        stated = None if survey.counted is None else survey.counted.get(name, {})
        losses.append(
            SourceLoss(
                name,
                count.records,
                count.bytes,
                _lost(stated, "records", count.records),
                _lost(stated, "bytes", count.bytes),
            )
        )
    return tuple(losses)


def _lost(stated: object, what: str, kept: int) -> int | None:
    if not isinstance(stated, dict):
        return None
    counts = [stated.get(f"{what}_{direction}", 0) for direction in ("in", "out")]
    if not all(isinstance(count, int) for count in counts):
        return None
    return max(0, int(sum(counts)) - kept)


def _sha256(file: BinaryIO, size: int, progress: Progress) -> bytes:
    digest = hashlib.sha256()
    file.seek(0)
    while part := file.read(_PIECE_BYTES):
        digest.update(part)
        progress("taking the checksum", file.tell() / size)
    return digest.digest()


def _write(target: Path, pieces: Iterator[bytes], size: int) -> None:
    require_space(target, size, OsFileSystem())
    with whole_file(target, what="a repaired trial") as new:
        for piece in pieces:
            new.write(piece)


def _holds(target: Path, pieces: Iterator[bytes]) -> bool:
    """Whether a file has this content."""
    if not target.is_file():
        return False
    try:
        with target.open("rb") as file:
            return all(file.read(len(piece)) == piece for piece in pieces) and not file.read(1)
    except OSError as error:
        raise InputError(f"{target} exists and cannot be read ({error.strerror}).") from error


def _outcome(path: Path, target: Path | None, survey: Survey, *, written: bool) -> Repair:
    return Repair(
        path,
        target,
        written,
        survey.damage,
        survey.ended,
        survey.records,
        survey.last_ns / NS_PER_S,
        survey.lost_ns / NS_PER_S,
        _losses(survey),
    )
