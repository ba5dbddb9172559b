"""The checksum of unknown packets: every kind, over every stretch that ends before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from firmware_protocols.checksums import SIZES, checksum_rows, fast_checksum
from imu_rig.arrays import ByteArray

PROBES = 3  # packets that are tried; one of them must be whole
HOLDS = 0.9  # share of the packets of which it must hold
LEAST_DIFFERENT = 6  # packets with different checksums, for chance to be ruled out
MANY_BYTES = 256
FEW_STARTS = 24  # from which checksums are tried in packets longer than that


@dataclass(frozen=True)
class FoundChecksum:
    """A checksum that ends the packet and covers everything from byte ``start`` up to itself."""

    kind: str
    start: int
    byte_order: str

    @property
    def size(self) -> int:
        """Bytes of it."""
        return SIZES[self.kind]


def find_checksum(rows: ByteArray) -> FoundChecksum | None:
    """Return the checksum with which every row, shape (n, length), ends; None if there is none."""
    for kind, size in sorted(SIZES.items(), key=lambda item: -item[1]):
        if rows.shape[1] <= size + 1:
            continue
        if len(np.unique(rows[:, -size:], axis=0)) < LEAST_DIFFERENT:
            continue
        for start, order in _likely(rows, kind, size):
            if _holds(rows, kind, start, size, order):
                return FoundChecksum(kind, start, order)
    return None


def _likely(rows: ByteArray, kind: str, size: int) -> list[tuple[int, str]]:
    """Return starts and byte orders that fit one of the first packets, smallest start first."""
    length = rows.shape[1] - size
    # one that covers less than half would be that of the last of several packets in a row
    starts = range(length // 2 + 1 if length <= MANY_BYTES else FEW_STARTS)
    of = fast_checksum(kind)
    found: set[tuple[int, str]] = set()
    for row in rows[:PROBES]:
        whole = row.tobytes()
        sent = whole[length:]
        wanted = {
            int.from_bytes(sent, "little"): "little",
            int.from_bytes(sent, "big"): "big" if size > 1 else "little",
        }
        for start in starts:
            order = wanted.get(of(whole[start:length]))
            if order is not None:
                found.add((start, order))
    return sorted(found)


def _holds(rows: ByteArray, kind: str, start: int, size: int, order: str) -> bool:
    sign = "<" if order == "little" else ">"
    sent = np.ascontiguousarray(rows[:, -size:]).view(f"{sign}u{size}")[:, 0]
    covered = np.ascontiguousarray(rows[:, start:-size])
    return bool(np.mean(checksum_rows(kind, covered) == sent) >= HOLDS)
