"""How long records waited to be written, kept in a few hundred numbers however many there were."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from operator import sub

from imu_rig.clock import NS_PER_S

_STEPS_PER_DECADE = 20  # so a percentile is told to 12 %
_SHORTEST_NS = 10_000
_DECADES = 8
_UPPER_NS = [
    round(_SHORTEST_NS * 10 ** (step / _STEPS_PER_DECADE))
    for step in range(_DECADES * _STEPS_PER_DECADE + 1)
]


@dataclass(frozen=True)
class Latency:
    """Times from the host stamp of a record, its arrival, to its acknowledgement.

    Attributes
    ----------
    records : int
        How many records it is about; without any, all times are 0.
    p50_s, p99_s : float
        Half and 99 % of them took at most this [s]; up to 12 % too high and never too low.
    max_s : float
        The longest [s].
    """

    records: int = 0
    p50_s: float = 0.0
    p99_s: float = 0.0
    max_s: float = 0.0


class LatencyCounts:
    """A histogram of times on a logarithmic scale, in all and since the latest look at it."""

    def __init__(self) -> None:
        self._counts = [0] * (len(_UPPER_NS) + 1)
        self._max_ns = 0
        self._counts_before = list(self._counts)
        self._latest_max_ns = 0

    def add(self, latencies_ns: Sequence[int]) -> None:
        """Count some times [ns]."""
        if not latencies_ns:
            return
        counts = self._counts
        for latency_ns in latencies_ns:
            counts[bisect_left(_UPPER_NS, latency_ns)] += 1
        self._latest_max_ns = max(self._latest_max_ns, *latencies_ns)
        self._max_ns = max(self._max_ns, self._latest_max_ns)

    def summary(self) -> Latency:
        """Return what was counted so far."""
        return _summary(self._counts, self._max_ns)

    def take_latest(self) -> Latency:
        """Return what was counted since the last call; for the thread that adds."""
        latest = list(map(sub, self._counts, self._counts_before))
        taken = _summary(latest, self._latest_max_ns)
        self._counts_before = list(self._counts)
        self._latest_max_ns = 0
        return taken


def _summary(counts: list[int], max_ns: int) -> Latency:
    up_to = list(accumulate(counts))
    records = up_to[-1]
    if not records:
        return Latency()

    def percentile_s(share: float) -> float:
        step = bisect_left(up_to, share * records)
        upper_ns = _UPPER_NS[step] if step < len(_UPPER_NS) else max_ns
        return min(upper_ns, max_ns) / NS_PER_S

    return Latency(records, percentile_s(0.5), percentile_s(0.99), max_ns / NS_PER_S)
