"""Numbers for the messages of a stream that has none, so that losses are told from jitter.

The sequence number of a frame counts all messages of its sender. Where it is unbroken from one
message of a stream to the next, none of the stream was lost in between, however far apart their
times are: flight controllers send when their main loop comes round, half a period early or late.
Where it is broken, the times tell how many of the stream were lost, but no more than frames are
missing. A break of more than :data:`LONG_S` may be any number of frames, since the sequence number
comes round after 256. A frame that is repeated keeps its number, one that comes late gets that of
its place.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.int64]

LONG_S = 1.0
RESTART_S = 60.0
"""Longer steps of the clock are restarts, from which nothing can be counted."""

_HALF_TURN = 1 << 31  # of a clock of 32 bits

RECENT = 16
"""So many intervals without a loss tell the period."""


class StreamCounter:
    """Numbers the messages of one stream of one sender, in order.

    Parameters
    ----------
    tick_s : float
        Of the stream's clock, which has 32 bits.
    period_s : float
        Nominal, until intervals tell.
    """

    def __init__(self, tick_s: float, period_s: float) -> None:
        self._tick_s, self._period_s = tick_s, period_s
        self._sequence: int | None = None  # of the sender's last frame
        self._missing = 0  # frames since the stream's last message
        self._number = -1
        self._time = 0
        self._recent: list[float] = []

    def feed(self, sequence: Numbers, of_stream: Numbers, time: Numbers) -> Numbers:
        """Return the number of each message, counted from 0.

        Parameters
        ----------
        sequence : shape (m,)
            Of the sender's next frames, whatever they say.
        of_stream : shape (n,)
            Which of them are messages of the stream.
        time : shape (n,)
            Their clock [ticks].
        """
        if not len(sequence):
            return np.empty(0, dtype=np.int64)
        before = int(sequence[0]) - 1 if self._sequence is None else self._sequence
        steps = np.diff(sequence, prepend=before) & 0xFF
        missing = self._missing + np.cumsum(np.where(steps == 0, 0, (steps - 1) & 0xFF))
        self._sequence = int(sequence[-1])
        since = np.diff(missing[of_stream], prepend=0)
        left_over = int(missing[-1]) - (int(missing[of_stream[-1]]) if len(of_stream) else 0)
        self._missing = left_over
        if not len(of_stream):
            return np.empty(0, dtype=np.int64)
        first = self._number < 0
        apart = np.diff(time, prepend=int(time[0]) if first else self._time)
        apart = (apart + _HALF_TURN) % (2 * _HALF_TURN) - _HALF_TURN
        up = self._increments(since, (apart * self._tick_s).tolist(), first=first)
        again = (steps[of_stream] == 0) & (apart == 0)
        up[again] = 0
        numbers = self._number + np.cumsum(up)
        self._number, self._time = int(numbers[-1]), int(time[-1])
        return numbers

    def _increments(self, since: Numbers, apart_s: list[float], *, first: bool) -> Numbers:
        """Return by how much each message's number is beyond the one before."""
        up = np.ones(len(since), dtype=np.int64)
        broken = since > 0
        broken[0] |= first
        at = 0
        for place in [*np.flatnonzero(broken).tolist(), len(since)]:
            self._recent = [*self._recent, *apart_s[max(at, place - RECENT) : place]][-RECENT:]
            at = place + 1
            if place < len(since) and not (first and place == 0):
                up[place] = self._between(int(since[place]), apart_s[place])
        return up

    def _between(self, missing: int, apart_s: float) -> int:
        """Return how many messages further on the next one is, where frames are missing."""
        if not -LONG_S <= apart_s <= RESTART_S:
            return 1
        period_s = float(np.median(self._recent)) if self._recent else self._period_s
        far = round(apart_s / period_s) if period_s > 0 else 1
        if apart_s < 0:
            return min(far, -1)
        return max(1, far if apart_s > LONG_S else min(far, missing + 1))
