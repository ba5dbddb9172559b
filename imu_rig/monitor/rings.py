"""Rings of the last samples in memory that two processes share: written always, read at leisure.

The writer never waits: it states how many samples there will be, overwrites the oldest and states
that it has. What it may have touched while a reader copied, the reader drops. One that is slow sees
fewer moments in time and always the newest samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray

USUAL_RATE_HZ = 200.0  # of a stream that states none
SPARE = 1.3  # a device may be faster than it states
FEWEST, MOST = 64, 20_000  # samples of a ring


def ring_size(rate_hz: float | None, seconds: float) -> int:
    """Return how many samples of a stream are kept."""
    wanted = math.ceil((rate_hz or USUAL_RATE_HZ) * seconds * SPARE)
    return max(FEWEST, min(MOST, wanted))


@dataclass
class Ring:
    """The last samples of one stream.

    Parameters
    ----------
    size, columns : int
        Samples kept; numbers in each besides its time.
    numbers : buffer of ``size * (columns + 1)`` float64, optional
        Shared memory; otherwise memory of this process.
    written : buffer of two int64, optional
        How many samples were ever written, and how many will have been after what is being written
        now, likewise.
    """

    size: int
    columns: int
    numbers: Any = None
    written: Any = None

    def __post_init__(self) -> None:
        if self.numbers is None:
            self.numbers = np.zeros(self.size * (self.columns + 1))
        if self.written is None:
            self.written = np.zeros(2, np.int64)
        self._table = np.frombuffer(self.numbers).reshape(self.size, self.columns + 1)
        self._written = np.frombuffer(self.written, np.int64)

    def write(self, t: FloatArray, numbers: Sequence[FloatArray]) -> None:
        """Add samples: times [s] and columns, shapes (n,) and (n, k) each; one writer only."""
        rows = np.column_stack((t, *numbers))[-self.size :]
        count = int(self._written[0])
        places = (count + np.arange(len(rows))) % self.size
        self._written[1] = count + len(rows)
        self._table[places] = rows
        self._written[0] = count + len(rows)

    def read(self) -> FloatArray:
        """Return the samples that are surely whole, oldest first, shape (n, 1 + columns)."""
        before = int(self._written[0])
        first = max(0, before - self.size)
        rows = self._table[np.arange(first, before) % self.size]
        overtaken = int(self._written[1]) - self.size - first  # meanwhile
        kept: FloatArray = rows[max(0, overtaken) :]
        return kept
