"""Packets as they arrive, put in the order in which the device made them, each of them once.

Counts what went wrong on the way under its own name: lost, duplicate, reordered, stray, restart.
Works on the raw counter and clock fields only and knows nothing of what else a packet holds.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from imu_rig.arrays import AnyArray, FloatArray, IntArray
from imu_rig.timing.clock_fit import MAX_SKEW
from imu_rig.timing.counters import Unwrapper, differences, remainder
from imu_rig.timing.device_time import DeviceTime

TimeSource = Literal["device clock", "packet counter", "arrival"]

# Constants of time.
SHORT_CLOCK_S = 2.0  # clocks that wrap sooner are no clocks: transport delays hide their wraps
GUESSED_PERIOD_S = 0.01  # between packets, where neither layout nor data tell it yet
COUNTED_SKEW = 0.1  # by which the real rate of counted packets may differ from the nominal rate
SILENCE_S = 1.0  # without a packet: uncounted samples begin a new segment after it
PERIOD_MEMORY = 200  # packets over which the measured period follows a change
RECENT = 64  # packets among which a late one is recognized as a duplicate


@dataclass(frozen=True)
class OrderStats:
    """What has become of the order of a device's packets.

    Attributes
    ----------
    lost : int
        Samples missing between those delivered, by counter or clock.
    duplicates, reordered, strays : int
        Packets repeated; packets that came after later ones; packets with an impossible clock.
    restarts : int
        Times that the device's clock or counter began anew.
    leaps : int
        Times that it leapt ahead of the host's clock, as when the computer had slept.
    """

    lost: int = 0
    duplicates: int = 0
    reordered: int = 0
    strays: int = 0
    restarts: int = 0
    leaps: int = 0


@dataclass(frozen=True)
class Ordered:
    """Packets to deliver.

    Attributes
    ----------
    rows : shape (m,)
        Indices of the packets handed in, in the device's order, without duplicates.
    device_s : shape (m,)
        Device time of each [s]; not decreasing within a segment.
    segment : shape (m,)
        Number of the stretch of unbroken device time that each belongs to, not decreasing.
    counter : shape (m,) or None
        Unwrapped packet counter, increasing; a difference above 1 is a loss.
    held : bool
        Whether the last packet handed in is to be handed in again, first, with what follows.
    """

    rows: IntArray
    device_s: FloatArray
    segment: IntArray
    counter: IntArray | None
    held: bool


class SampleOrder:
    """Orders the packets of one device.

    Parameters
    ----------
    clock_modulus : int or None
        Where the device clock wraps [ticks]; None for packets without a clock.
    tick_s : float
        Its tick [s].
    counter_modulus : int or None
        Where the packet counter wraps; None for packets without one.
    period_s : float or None
        Nominal time between packets [s].
    """

    def __init__(
        self,
        *,
        clock_modulus: int | None = None,
        tick_s: float = 1e-6,
        counter_modulus: int | None = None,
        period_s: float | None = None,
    ) -> None:
        self._period_s = period_s
        self._counter = None if counter_modulus is None else Unwrapper(counter_modulus)
        self.time_source: TimeSource = "arrival"
        self._time: DeviceTime | None = None
        self._index_period_s = period_s or GUESSED_PERIOD_S
        if clock_modulus is not None and clock_modulus * tick_s >= SHORT_CLOCK_S:
            self.time_source = "device clock"
            self._time = DeviceTime(clock_modulus, tick_s, max_skew=MAX_SKEW)
        elif counter_modulus is not None:
            self.time_source = "packet counter"
            skew = np.inf if period_s is None else COUNTED_SKEW
            self._time = DeviceTime(counter_modulus, self._index_period_s, max_skew=skew)
        # equal clocks mean equal packets only if the clock ticks faster than the packets come
        self._identified = self.time_source == "packet counter" or (
            self.time_source == "device clock"
            and (counter_modulus is not None or 4 * tick_s < self._index_period_s)
        )
        self._lost = self._duplicates = self._reordered = self._strays = 0
        self._index, self._silences = 0, 0
        self._last_host_s: float | None = None
        self._last: tuple[int, float] | None = None
        self._recent: deque[tuple[int, float, int]] = deque(maxlen=RECENT)

    @property
    def stats(self) -> OrderStats:
        """Counts so far."""
        restarts, leaps = 0, 0
        if self._time is not None:
            restarts, leaps = self._time.restarts, self._time.leaps
        return OrderStats(
            self._lost, self._duplicates, self._reordered, self._strays, restarts, leaps
        )

    def feed(self, clock: AnyArray | None, counter: AnyArray | None, host_s: FloatArray) -> Ordered:
        """Order the next packets, given their raw fields and their arrival [s], each shape (n,)."""
        if self._time is None:
            rows, device_s, segment, held = self._by_arrival(host_s)
        else:
            ticks = clock if self.time_source == "device clock" else counter
            if ticks is None:
                raise ValueError(f"packets without the field that tells time by {self.time_source}")
            unwrapped = self._time.feed(ticks, host_s)
            self._strays += unwrapped.strays
            rows, device_s, segment = unwrapped.rows, unwrapped.device_s, unwrapped.epoch
            held = unwrapped.held
        counts = None if counter is None else np.asarray(counter, np.int64)
        if counts is not None and len(rows) < len(counts):
            counts = counts[rows]
        fresh = self._sort(device_s, segment, counts)
        rows, device_s, segment = rows[fresh], device_s[fresh], segment[fresh]
        counts = None if counts is None else counts[fresh]
        numbers = self._number(device_s, segment, counts)
        if len(rows):
            self._last = (int(segment[-1]), float(device_s[-1]))
        return Ordered(rows, device_s, segment, numbers, held)

    def _by_arrival(self, host_s: FloatArray) -> tuple[IntArray, FloatArray, IntArray, bool]:
        count = len(host_s)
        before = -np.inf if self._last_host_s is None else self._last_host_s
        silences = self._silences + np.cumsum(differences(host_s, before) > SILENCE_S)
        device_s = (self._index + np.arange(count, dtype=float)) * self._index_period_s
        if count:
            self._index += count
            self._silences, self._last_host_s = int(silences[-1]), float(host_s[-1])
        rows: IntArray = np.arange(count, dtype=np.int64)
        return rows, device_s, silences.astype(np.int64), False

    def _sort(
        self, device_s: FloatArray, segment: IntArray, counts: IntArray | None
    ) -> IntArray | slice:
        """Sort by device time; leave out duplicates and what comes too late to deliver."""
        count = len(device_s)
        if count == 0:
            return slice(None)
        numbers = np.zeros(count, np.int64) if counts is None else counts
        later = (np.diff(device_s) > 0) | (np.diff(segment) > 0)
        if later.all() and self._since_last(device_s[:1], segment[:1])[0] > 0:
            # as nearly always: there is nothing to sort
            self._remember(np.arange(max(0, count - RECENT), count), segment, device_s, numbers)
            return slice(None)
        order = np.lexsort((device_s, segment))
        fresh = np.ones(count, dtype=bool)
        since_last = self._since_last(device_s, segment)
        if self._identified:
            same = (np.diff(device_s[order]) == 0) & (np.diff(segment[order]) == 0)
            same &= np.diff(numbers[order]) == 0
            fresh[order[1:][same]] = False
            for row in np.flatnonzero((since_last <= 0) & fresh).tolist():
                key = (int(segment[row]), float(device_s[row]), int(numbers[row]))
                fresh[row] = key not in self._recent
            self._duplicates += count - int(fresh.sum())
        self._reordered += self._out_of_order(device_s[fresh], segment[fresh])
        self._remember(np.flatnonzero(fresh)[-RECENT:], segment, device_s, numbers)
        fresh &= since_last >= 0
        delivered: IntArray = order[fresh[order]]
        return delivered

    def _remember(
        self, rows: IntArray, segment: IntArray, device_s: FloatArray, numbers: IntArray
    ) -> None:
        for row in rows.tolist():
            self._recent.append((int(segment[row]), float(device_s[row]), int(numbers[row])))

    def _since_last(self, device_s: FloatArray, segment: IntArray) -> FloatArray:
        """Device time since the last sample delivered [s]; infinite in another segment."""
        if self._last is None:
            return np.full(len(device_s), np.inf)
        return np.where(segment == self._last[0], device_s - self._last[1], np.inf)

    def _out_of_order(self, device_s: FloatArray, segment: IntArray) -> int:
        """Count the packets that arrived after one the device made later."""
        count = 0
        edges = [0, *(np.flatnonzero(np.diff(segment)) + 1).tolist(), len(segment)]
        for start, stop in pairwise(edges):
            times = device_s[start:stop]
            floor = -np.inf
            if self._last is not None and start < stop and self._last[0] == segment[start]:
                floor = self._last[1]
            newest = np.maximum.accumulate(np.concatenate(([floor], times)))[:-1]
            count += int(np.sum(times < newest))
        return count

    def _number(
        self, device_s: FloatArray, segment: IntArray, counts: IntArray | None
    ) -> IntArray | None:
        """Unwrap the counter of ordered packets and count what is missing between them."""
        if len(device_s) == 0:
            return counts
        previous = (int(segment[0]), float("nan")) if self._last is None else self._last
        apart = differences(device_s, previous[1])
        apart[differences(segment, previous[0]) != 0] = np.nan
        if counts is None or self._counter is None:
            if self.time_source == "device clock":
                self._follow_period(apart, np.ones(len(apart)))
                self._lost += _missing(np.rint(apart / (self._period_s or np.inf)))
            return None
        period_s = self._index_period_s
        if self.time_source == "device clock":
            steps = differences(counts, counts[0])
            remainder(steps, self._counter.modulus)
            self._follow_period(apart, steps)
            period_s = self._period_s or np.inf
        before = self._counter.last
        starts = [0, *(np.flatnonzero(np.isnan(apart[1:])) + 1).tolist(), len(apart)]
        parts = []
        for start, stop in pairwise(starts):
            if np.isnan(apart[start]):
                self._counter.restart()
            parts.append(self._counter.feed(counts[start:stop], apart[start:stop] / period_s))
        numbers = np.concatenate(parts) if len(parts) > 1 else parts[0]
        self._lost += _missing(differences(numbers, numbers[0] if before is None else before))
        return numbers

    def _follow_period(self, apart: FloatArray, steps: AnyArray) -> None:
        """Measure the time between packets from neighbours that follow each other closely."""
        near = (steps >= 1) & (steps <= 4) & (apart > 0)
        if not near.any():
            return
        measured = float(np.median(apart[near] / steps[near]))
        if self._period_s is None:
            self._period_s = measured
        weight = min(1.0, int(near.sum()) / PERIOD_MEMORY)
        self._period_s += weight * (measured - self._period_s)


def _missing(steps: AnyArray) -> int:
    """Sum up what lies between samples, given their distances; NaN is a new beginning."""
    missing = np.fmax(steps - 1, 0)
    return int(missing.sum())
