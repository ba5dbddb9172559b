"""Counting lost, repeated and late packets by the counter that they carry.

What a counter cannot see: a loss of a whole number of its turns looks like none (256 packets of a
u8 counter, 2.56 s at 100 Hz), and a longer loss looks shorter by whole turns. A step of more than
three quarters of a turn is taken for a step back, so with a u8 counter a loss of 191 to 254 packets
is reported as late packets. Whoever has a device clock too can tell.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_protocols.protocol import DecodeStats

Numbers = npt.NDArray[np.int64]
AnyArray = npt.NDArray[Any]

LATE_WINDOW = 64
"""A packet at most this far behind the newest is late; further behind, the counter was reset."""

FEW = 16
"""Up to here counting one by one is quicker than arrays."""

_WINDOW_BITS = (1 << (LATE_WINDOW + 1)) - 1


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
        self._newest = -1
        self._newest_row: AnyArray = np.empty(0, dtype=np.uint8)
        self._seen = 0  # bit k: the number k behind the newest was there
        self._missing = 0  # bit k: it was counted as lost

    @property
    def stats(self) -> DecodeStats:
        """What was counted so far."""
        counted = (self.lost, self.duplicates, self.reordered)
        return DecodeStats(0, 0, 0, *counted)

    def add(self, numbers: Numbers, rows: AnyArray) -> None:
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
        if self._newest < 0:
            self._restart(int(numbers[0]), rows[0])
            numbers, rows = numbers[1:], rows[1:]
        if len(numbers) > FEW:
            previous = np.concatenate([[self._newest], numbers[:-1]])
            steps = (numbers - previous) & (self._modulus - 1)
            if bool(((steps > 0) & (steps <= self._most_forward)).all()):
                self._add_forward(steps, rows[-1])
                numbers, rows = numbers[:0], rows[:0]
        for number, row in zip(numbers.tolist(), rows, strict=True):
            self._add_one(number, row)
        self._newest_row = self._newest_row.copy()  # a view would keep all the rows in memory

    def _add_forward(self, steps: Numbers, last_row: AnyArray) -> None:
        total = int(steps.sum())
        self.lost += total - len(steps)
        recent = steps[-LATE_WINDOW - 1 :]
        if len(recent) > LATE_WINDOW and total == len(steps):
            self._seen, self._missing = _WINDOW_BITS, 0
        else:
            for step in recent.tolist():
                self._advance(step)
        self._newest = (self._newest + total) & (self._modulus - 1)
        self._newest_row = last_row

    def _add_one(self, number: int, row: AnyArray) -> None:
        forward = (number - self._newest) & (self._modulus - 1)
        behind = self._modulus - forward
        if forward == 0:
            if bool((row == self._newest_row).all()):
                self.duplicates += 1
            else:
                self._restart(number, row)
        elif forward <= self._most_forward:
            self.lost += forward - 1
            self._advance(forward)
            self._newest = number
            self._newest_row = row
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
        self._seen = (self._seen << step_bits | 1) & _WINDOW_BITS
        self._missing = (self._missing << step_bits | skipped) & _WINDOW_BITS

    def _restart(self, number: int, row: AnyArray) -> None:
        self._newest = number
        self._newest_row = row
        self._seen = 1
        self._missing = 0
