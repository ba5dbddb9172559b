"""The bytes of a trial file: header, records, JSON (described in docs/trial-file.md)."""

import enum
import json
import math
import re
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imu_rig.errors import InputError

SUFFIX = ".imu-trial"
VERSION = 1
# As in PNG: a byte above 127 and line ends of both kinds betray a transfer that changed the file.
MAGIC = b"\x89IMU\r\n\x1a\n"
SYNC = b"\xd3\x91"

_FILE_HEADER = struct.Struct("<8sHH8sqI")  # magic, version, header size, file id, wall ns, CRC
_RECORD_FIELDS = struct.Struct("<BBIIq")  # kind, source, payload length, sequence, trial ns
_CRC = struct.Struct("<I")
CLOCK_PAIR = struct.Struct("<qq")  # host monotonic ns, wall ns since 1970 UTC

HEADER_COPY_SIZE = _FILE_HEADER.size
HEADER_SIZE = 2 * HEADER_COPY_SIZE
CRC_SIZE = _CRC.size
RECORD_HEAD_SIZE = len(SYNC) + _RECORD_FIELDS.size + CRC_SIZE
RECORD_OVERHEAD = RECORD_HEAD_SIZE + CRC_SIZE

MAX_PAYLOAD = 1 << 20
_LONGEST_INTEGER = 20  # digits and sign of a number of 64 bits
_LONG_INTEGER = re.compile(rb"[0-9]{19}")
MAX_SOURCES = 255
MAX_SEQUENCE = (1 << 32) - 1
TRIAL = 0  # source number of records about the trial itself

# Words in the JSON of records, for who writes them and who looks for them.
TRIAL_KIND = "trial"  # of the configuration, where it is no session of a jig
CERTIFICATES = "certificates"  # in the descriptor of a source: those of its streams by name
IMPORTED_FROM = "imported_from"  # in the descriptor of a source that no recorder heard
MARKER, RESUMED = "marker", "resumed"  # events
UNPLUGGED, SILENT, UNREADABLE = "unplugged", "silent", "unreadable"  # reasons of gaps
SET_UP = "set up"  # likewise: what was said to the device before the recording of it interrupted it
DAMAGE = "damage"  # likewise, in a repaired file
STREAM = "stream"  # of a gap: which of several streams of its source
STREAMS = "streams"  # of statistics: those of each stream by its name


class Kind(enum.IntEnum):
    """What a record holds; readers skip kinds they do not know."""

    CONFIG = 1
    SOURCE = 2
    BYTES_IN = 3
    BYTES_OUT = 4
    EVENT = 5
    GAP = 6
    CLOCK_PAIR = 7
    STATISTICS = 8
    END = 9


@dataclass(frozen=True)
class FileHeader:
    """The first bytes of a trial file.

    Attributes
    ----------
    file_id : bytes
        Eight random bytes; every checksum in the file starts from them.
    created_wall_ns : int
        Wall clock at creation [ns since 1970 UTC].
    version : int
        Version of the format.
    size : int
        Offset of the first record [bytes].
    damaged : bool
        Whether a copy of it, or both, did not pass their checksums.
    """

    file_id: bytes
    created_wall_ns: int
    version: int = VERSION
    size: int = HEADER_SIZE
    damaged: bool = False

    @property
    def seed(self) -> int:
        """Where the checksum of every record head starts."""
        return zlib.crc32(self.file_id)

    def encode(self) -> bytes:
        """Return both copies."""
        fields = _FILE_HEADER.pack(
            MAGIC, self.version, self.size, self.file_id, self.created_wall_ns, 0
        )[:-CRC_SIZE]
        return 2 * (fields + _CRC.pack(zlib.crc32(fields)))


class HeaderLost(InputError):  # noqa: N818  (a state of the file)
    """A file that does not begin with a header that can be read."""


def decode_file_header(start: bytes, path: Path) -> FileHeader:
    """Read the header from the first ``HEADER_SIZE`` bytes of a file.

    Parameters
    ----------
    start : bytes
        The beginning of the file; less than ``HEADER_SIZE`` bytes if the file is shorter.
    path : Path
        Name for the messages.

    Raises
    ------
    InputError
        If the file is empty or of a newer version.
    HeaderLost
        If the start is zero-filled or foreign, or both copies are damaged.
    """
    start = start[:HEADER_SIZE]
    if not start:
        raise InputError(f"{path} is empty; there is nothing in it to read.")
    if not any(start):
        raise HeaderLost(
            f"{path} begins with zeros: the disk lost the start of this file, "
            "so take another copy of it."
        )
    copies = [start[:HEADER_COPY_SIZE], start[HEADER_COPY_SIZE:]]
    sound = [header for copy in copies if (header := _decode_copy(copy)) is not None]
    if not sound:
        if any(copy.startswith(MAGIC) for copy in copies):
            raise HeaderLost(
                f"{path}: both copies of the header are damaged, and nothing after them is sound; "
                "take another copy of the file."
            )
        raise HeaderLost(f"{path} is not a trial file of imu-rig.")
    header = sound[0]
    if header.version > VERSION:
        raise InputError(
            f"{path} has version {header.version} of the trial format and this imu-rig reads "
            f"versions up to {VERSION}; install a newer imu-rig."
        )
    if header.size < HEADER_SIZE:
        raise InputError(f"{path}: the header states a size of {header.size} bytes, not 64.")
    return FileHeader(
        header.file_id,
        header.created_wall_ns,
        header.version,
        header.size,
        damaged=len(sound) < len(copies),
    )


def _decode_copy(copy: bytes) -> FileHeader | None:
    if len(copy) < HEADER_COPY_SIZE or not copy.startswith(MAGIC):
        return None
    _, version, size, file_id, created, crc = _FILE_HEADER.unpack(copy)
    if zlib.crc32(copy[:-CRC_SIZE]) != crc:
        return None
    return FileHeader(file_id, created, version, size)


def encode_records(
    seed: int, first_sequence: int, records: Iterable[tuple[int, int, int, bytes]]
) -> bytes:
    """Return records that follow each other.

    Parameters
    ----------
    seed : int
        ``FileHeader.seed`` of the file they are for.
    first_sequence : int
        Number of the first.
    records : iterable
        Kind, source, trial time [ns] and payload, at most ``MAX_PAYLOAD`` bytes, of each.
    """
    parts: list[bytes] = []
    add = parts.append
    pack_fields, pack_crc, crc32 = _RECORD_FIELDS.pack, _CRC.pack, zlib.crc32
    for sequence, (kind, source, time_ns, payload) in enumerate(records, first_sequence):
        fields = pack_fields(kind, source, len(payload), sequence, time_ns)
        head_crc = crc32(fields, seed)
        add(SYNC)
        add(fields)
        add(pack_crc(head_crc))
        add(payload)
        # The second checksum goes on from the first, which ties the payload to its head.
        add(pack_crc(crc32(payload, head_crc)))
    return b"".join(parts)


def encode_json(value: Any, what: str) -> bytes:
    """Return ``value`` as strict UTF-8 JSON; numpy scalars and arrays become numbers and lists.

    Parameters
    ----------
    value : object
        Anything made of dict, list, str, int, finite float, bool and None.
    what : str
        Name of the value for the message, for example ``"The event 'pose'"``.

    Raises
    ------
    InputError
        If something in it is not JSON (an infinite number, an object) or takes more than 64 bits,
        or it is above 1 MiB.
    """
    try:
        text = json.dumps(
            value, ensure_ascii=False, allow_nan=False, separators=(",", ":"), default=_plain
        )
        # A file name that is not UTF-8 carries lone surrogates; JSON has an escape for them.
        payload = text.encode(errors="backslashreplace")
        if _LONG_INTEGER.search(payload):
            decode_json(payload)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{what} cannot be stored as JSON: {error}.") from error
    if len(payload) > MAX_PAYLOAD:
        raise InputError(
            f"{what} takes {len(payload)} bytes as JSON, above the {MAX_PAYLOAD} of a record."
        )
    return payload


def decode_json(payload: bytes) -> Any:
    """Return the value of a strict JSON payload.

    Raises
    ------
    ValueError
        If it is not UTF-8, not JSON, holds a number that no 64 bits do (NaN and the infinities
        among them), or is nested without reason.
    """
    try:
        return json.loads(
            payload.decode(),
            parse_constant=_refuse_constant,
            parse_float=_finite,
            parse_int=_of_64_bits,
        )
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is too large a number")
    return value


def _of_64_bits(text: str) -> int:
    value = int(text) if len(text) <= _LONGEST_INTEGER else 1 << 64
    if not -(1 << 63) <= value < 1 << 64:
        raise ValueError("an integer takes more than 64 bits")
    return value


def _plain(value: object) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not a JSON type")


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")
