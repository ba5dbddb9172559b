"""The period of unknown packets, and their bytes in rows of that length.

A stream of packets of one length is like itself one packet later: header, high bytes and whatever
else stays the same meet themselves. The lag at which most bytes do is the period. Lost bytes only
shift where that begins anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, ByteArray, IntArray

LONGEST = 1024
LEAST_PACKETS = 8
MOST_ROWS = 1000
ANALYSED_BYTES = 1 << 16
"""More tells no more."""

ABOVE_CHANCE = 6.0  # standard deviations by which equal bytes must outnumber those of chance
LEAST_EXCESS = 0.01
NEARLY_BEST = 0.8  # a multiple of the period is as good as the period itself
LONGEST_ANCHOR = 4
LEAST_ANCHORED = 0.35
MOST_ANCHORS = 6  # that are compared
AS_MANY = 0.98  # of the rows of the best
CONSTANT = 0.95  # share of the packets in which a byte must be the same


@dataclass(frozen=True)
class Aligned:
    """Bytes of the stream in rows of one period.

    Attributes
    ----------
    rows : shape (n, period), uint8
        Each from one anchor, a group of bytes that is found in every packet, to the next.
    starts : shape (n,), int64
        Where in the stream each row begins.
    """

    rows: ByteArray
    starts: IntArray

    @property
    def period(self) -> int:
        """Bytes of a row."""
        return int(self.rows.shape[1])

    @property
    def follows(self) -> BoolArray:
        """Whether each row but the first stands right behind the one before it, shape (n - 1,)."""
        return np.asarray(np.diff(self.starts) == self.period)

    def turned(self, by: int) -> Aligned:
        """Return rows that begin ``by`` bytes later; those without a row right behind are lost."""
        if by == 0:
            return self
        whole = np.flatnonzero(self.follows)
        rows = np.hstack([self.rows[whole, by:], self.rows[whole + 1, :by]])
        return Aligned(np.ascontiguousarray(rows), self.starts[whole] + by)


def find_period(data: bytes) -> int | None:
    """Return after how many bytes a stream is most like itself; None if it never is.

    Parameters
    ----------
    data : bytes
        At most `ANALYSED_BYTES` of it are looked at.
    """
    values = np.frombuffer(data[:ANALYSED_BYTES], np.uint8)
    longest = min(LONGEST, len(values) // 4)
    if longest < 2:
        return None
    shares = np.bincount(values, minlength=256) / len(values)
    chance = float(np.sum(shares**2))
    if chance > 0.999:  # one byte over and over
        return None
    excess = np.array(
        [np.mean(values[:-lag] == values[lag:]) - chance for lag in range(1, longest + 1)]
    )
    deviation = np.sqrt(chance * (1 - chance) / (len(values) - longest))
    best = float(excess.max())
    if best < max(ABOVE_CHANCE * deviation, LEAST_EXCESS):
        return None
    return int(np.argmax(excess >= NEARLY_BEST * best)) + 1


def align(data: bytes, period: int) -> Aligned | None:
    """Cut a stream into rows of its period; None where nothing in it tells where they begin.

    The anchor is the group of bytes that most often is found again exactly one period later and
    least often elsewhere. Among those that are nearly as good and found as often, it is the one
    with which most bytes of a row stay the same: others are also met in packets of another kind.
    """
    values = np.frombuffer(data[:ANALYSED_BYTES], np.uint8)
    anchors = sorted(_anchors(values, period), key=lambda anchor: -anchor[0])[:MOST_ANCHORS]
    best: Aligned | None = None
    most = -1
    for merit, at in anchors:
        if merit < max(LEAST_ANCHORED, NEARLY_BEST * anchors[0][0]):
            break
        starts = _in_step(at, period)
        starts = starts[starts + period <= len(values)][:MOST_ROWS]
        if len(starts) < max(LEAST_PACKETS, 0 if best is None else AS_MANY * len(best.rows)):
            continue  # what stays the same in part of the packets is no header
        rows = values[starts[:, None] + np.arange(period)]
        same = int(np.count_nonzero(constant_places(rows)))
        if same > most:
            best, most = Aligned(rows, starts), same
    return best


def constant_places(rows: ByteArray) -> BoolArray:
    """Return which bytes are the same in nearly all rows."""
    usual = np.array([np.bincount(column).argmax() for column in rows.T])
    return np.asarray((rows == usual).mean(axis=0) >= CONSTANT)


def _anchors(values: ByteArray, period: int) -> list[tuple[float, IntArray]]:
    """Return groups of bytes that are found again a period later: their merit and their places."""
    packets = len(values) / period
    anchors: list[tuple[float, IntArray]] = []
    codes = np.zeros(len(values), np.int64)
    for length in range(1, min(LONGEST_ANCHOR, period) + 1):
        last = len(values) - length + 1
        codes = (codes[:last] << 8) | values[length - 1 :]
        if last <= period:
            break
        again = codes[:-period] == codes[period:]
        if not again.any():
            break
        found, pairs = np.unique(codes[:-period][again], return_counts=True)
        likely = np.argsort(pairs)[-8:]
        for code, count in zip(found[likely].tolist(), pairs[likely].tolist(), strict=True):
            at = np.flatnonzero(codes == code)
            share = min(1.0, (count + 1) / packets)
            merit = share * min(1.0, (count + 1) / len(at)) * (1.0 + 0.02 * length)
            anchors.append((merit, at))
    return anchors


def _in_step(at: IntArray, period: int) -> IntArray:
    """Return the places that have another one exactly a period behind them, without overlaps."""
    steady = at[np.isin(at + period, at)]
    kept: list[int] = []
    free = 0
    for place in steady.tolist():
        if place >= free:
            kept.append(place)
            free = place + period
    return np.array(kept, np.int64)
