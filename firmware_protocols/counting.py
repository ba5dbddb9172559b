"""Counting lost, repeated and late packets by the counter that they carry.

What a counter cannot see: a loss of a whole number of its turns (256 packets of a u8 counter, 2.56 s
at 100 Hz) looks like none, and a longer loss looks shorter by whole turns. A step of more than
three quarters of a turn is taken for a step back, so with a u8 counter a loss of 192 to 254 packets
is reported as late packets. Whoever has a device clock too can tell.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

LATE_WINDOW = 64
"""A packet at most this far behind the newest is late; further behind, the counter was reset."""

_WINDOW_BITS = (1 << LATE_WINDOW) - 1


class SequenceCounter:
    """Running count of losses over the packets of one stream, in order of arrival.

    A step forward of d counts d - 1 as lost. A packet at most :data:`LATE_WINDOW` (and a quarter
    of the modulus) behind the newest is a duplicate if its number was there before and late
    (reordered) otherwise; a late packet is taken off the lost again. The same number twice in
    a row is a duplicate if the packets are equal byte by byte. Any other step is a restart of the
    counter, from which nothing can be counted.

    Attributes
    ----------
    lost, duplicates, reordered : int
    """

    def __init__(self, modulus: int) -> None:
        self.lost = 0
        self.duplicates = 0
        self.reordered = 0
        self._modulus = modulus
        self._most_forward = modulus - modulus // 4 - 1
        self._late_window = min(LATE_WINDOW, modulus // 4)
        self._newest: int | None = None
        self._newest_bytes = b""
        self._seen = 0  # bit k: the number k behind the newest was there
        self._missing = 0  # bit k: it was counted as lost

    def add(self, numbers: npt.NDArray[np.int64], rows: npt.NDArray[Any]) -> None:
        """Count the next packets.

        Parameters
        ----------
        numbers : shape (n,)
            Counter of each packet, 0 to modulus - 1.
        rows : shape (n, length), uint8
            The packets themselves.
        """
        if not len(numbers):
            return
        first = 0
        if self._newest is None:
            self._restart(int(numbers[0]), rows[0])
            first = 1
        steps = np.diff(numbers[first:], prepend=self._newest) % self._modulus
        if not len(steps):
            return
        if bool(((steps >= 1) & (steps <= self._most_forward)).all()):
            self._add_forward(steps, rows[-1])
            return
        for number, row in zip(numbers[first:].tolist(), rows[first:], strict=True):
            self._add_one(number, row)

    def _add_forward(self, steps: npt.NDArray[np.int64], last_row: npt.NDArray[Any]) -> None:
        self.lost += int(steps.sum()) - len(steps)
        for step in steps[-LATE_WINDOW - 1 :].tolist():
            self._advance(step)
        self._newest = (int(self._newest or 0) + int(steps.sum())) % self._modulus
        self._newest_bytes = last_row.tobytes()

    def _add_one(self, number: int, row: npt.NDArray[Any]) -> None:
        assert self._newest is not None
        forward = (number - self._newest) % self._modulus
        behind = self._modulus - forward
        if forward == 0:
            if row.tobytes() == self._newest_bytes:
                self.duplicates += 1
            else:
                self._restart(number, row)
        elif forward <= self._most_forward:
            self.lost += forward - 1
            self._advance(forward)
            self._newest = number
            self._newest_bytes = row.tobytes()
        elif behind > self._late_window:
            self._restart(number, row)
        elif self._seen >> behind & 1:
            self.duplicates += 1
        else:
            self._add_late(1 << behind)

    def _add_late(self, bit: int) -> None:
        self.reordered += 1
        self._seen |= bit
        if self._missing & bit:
            self._missing ^= bit
            self.lost -= 1

    def _advance(self, step: int) -> None:
        step_bits = min(step, LATE_WINDOW + 1)
        skipped = (1 << step_bits) - 2
        self._seen = (self._seen << step_bits | 1) & (_WINDOW_BITS << 1 | 1)
        self._missing = (self._missing << step_bits | skipped) & (_WINDOW_BITS << 1 | 1)

    def _restart(self, number: int, row: npt.NDArray[Any]) -> None:
        self._newest = number
        self._newest_bytes = row.tobytes()
        self._seen = 1
        self._missing = 0
