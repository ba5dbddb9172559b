"""A device's clock continued over wraps, with restarts and stray values told from them.

A clock of 32 bits that counts microseconds wraps after 72 minutes; a device that browns out begins
at zero again; a packet layout without a checksum now and then lets through a packet that is none.
All three look like a jump. The host's clock tells them apart: over a wrap the device's clock
advances as much as the host's, over a restart it does not, and a stray value agrees with neither
of its neighbours.

While a computer sleeps its monotonic clock may stand still, and the device's goes on: when it wakes
packets seem to arrive before they can have been sent. A packet that others were lost before may
well be much less late than those others were, but never earlier than the promptest so far. Such a
leap ahead ends the stretch of unbroken time too, for one mapping cannot hold before and after it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imu_rig.arrays import AnyArray, FloatArray, IntArray
from imu_rig.timing.counters import differences, wrapped_steps

# How far the device's and the host's elapsed times may disagree.
REORDER_S = 0.2  # that a packet's clock may stand behind its predecessor's: it came out of order
JUDGED_PERIOD_S = 10.0  # clocks that wrap sooner cannot show a restart amid transport delays
SLACK_S = 30.0  # of buffered data, or a quarter of the clock's period where that is less
BURST_S = 0.05  # within which packets that waited for a link arrive together
LEAP_S = 0.5  # that a packet is ahead of the promptest before it; nobody sleeps for less


@dataclass(frozen=True)
class Unwrapped:
    """What became of the packets handed in.

    Attributes
    ----------
    rows : shape (m,)
        Indices of the packets kept, in order of arrival.
    device_s : shape (m,)
        Unwrapped device clock of each [s]; begins anew at a restart.
    epoch : shape (m,)
        How many restarts had happened before each.
    held : bool
        Whether the last packet handed in jumps and awaits its successor to be judged; it is not
        among ``rows`` and is to be handed in again, first, together with what follows.
    strays : int
        Packets dropped because their clock agrees with neither neighbour.
    """

    rows: IntArray
    device_s: FloatArray
    epoch: IntArray
    held: bool
    strays: int


@dataclass
class _Anchor:
    """The last packet kept."""

    raw: int
    ticks: float
    host_s: float


class DeviceTime:
    """Unwraps the clock of one device, packet after packet.

    Parameters
    ----------
    modulus : int
        Where the clock wraps [ticks].
    tick_s : float
        Length of a tick [s].
    max_skew : float
        By which the tick may be off; infinite where nothing is known of it.
    """

    def __init__(self, modulus: int, tick_s: float, *, max_skew: float = 0.02) -> None:
        period_s = modulus * tick_s
        self._modulus, self._tick_s = modulus, tick_s
        self._judged = period_s >= JUDGED_PERIOD_S
        self._slack_s = min(SLACK_S, period_s / 4)
        self._backward = int(min(REORDER_S, period_s / 4) / tick_s)
        self._near_s = period_s / 4  # within which no period can have passed unseen
        self._anchor: _Anchor | None = None
        self._epoch = self._leaps = 0
        self._max_skew = max_skew
        # How far the device's clock is ahead of the host's, since the first packet, and the most
        # that it ever was, forgotten as fast as a clock may fall behind.
        self._ahead_s, self._most_s = 0.0, -np.inf

    @property
    def restarts(self) -> int:
        """How often the device's clock began anew."""
        return self._epoch - self._leaps

    @property
    def leaps(self) -> int:
        """How often the device's clock leapt ahead of the host's."""
        return self._leaps

    def feed(self, raw: AnyArray, host_s: FloatArray) -> Unwrapped:
        """Unwrap the clock of the next packets.

        Parameters
        ----------
        raw : shape (n,)
            Clock fields as sent.
        host_s : shape (n,)
            Arrival of each packet, host clock [s], not decreasing.
        """
        values = np.asarray(raw)
        if len(values) == 0:
            return _kept([], 0)
        if self._anchor is None:
            self._anchor = _Anchor(int(values[0]), float(values[0]), float(host_s[0]))
        steps = self._steps(values, host_s, self._anchor)
        plausible = self._plausible(steps, host_s, self._anchor.host_s)
        leaps = self._leaps_ahead(steps, host_s, plausible)
        broken = ~plausible | leaps
        starts = np.flatnonzero(broken)
        starts = np.concatenate(([0], starts[starts > 0]))
        stops = [*starts[1:].tolist(), len(values)]
        # plain numbers: where every packet is a stray there are as many runs as packets
        firsts, hosts = values[starts].tolist(), host_s[starts].tolist()
        breaks, leapt = broken[starts].tolist(), leaps[starts].tolist()
        runs: list[tuple[IntArray, FloatArray, int]] = []
        strays, held = 0, False
        for number, (start, stop) in enumerate(zip(starts.tolist(), stops, strict=True)):
            first, first_s = firsts[number], hosts[number]
            if not breaks[number] or (not leapt[number] and self._continues(first, first_s)):
                pass
            elif stop - start > 1:
                self._epoch += 1
                silent_s = first_s - self._anchor.host_s
                # a device that began anew cannot have counted for longer than it was silent
                began_s = first * self._tick_s
                self._leaps += bool(leapt[number] or began_s > silent_s + self._slack_s)
                self._anchor = _Anchor(int(first), float(first), first_s)
            elif stop == len(values):
                held = True
                continue
            else:
                strays += 1
                continue
            ticks = np.cumsum(self._steps_of_run(steps, values, host_s, slice(start, stop)))
            ticks += self._anchor.ticks
            self._anchor = _Anchor(int(values[stop - 1]), float(ticks[-1]), float(host_s[stop - 1]))
            ticks *= self._tick_s
            runs.append((np.arange(start, stop), ticks, self._epoch))
        return _kept(runs, strays, held=held)

    def _steps(self, values: AnyArray, host_s: FloatArray, anchor: _Anchor) -> FloatArray:
        """Ticks from each packet to the next, with whole unseen periods added after long gaps."""
        steps = wrapped_steps(values, anchor.raw, self._modulus, self._backward).astype(float)
        elapsed = differences(host_s, anchor.host_s)
        elapsed /= self._tick_s
        for gap in np.flatnonzero(elapsed - steps > self._modulus / 2).tolist():
            # packets that waited for the link arrive together: only the freshest tells the time
            fresh = int(np.searchsorted(host_s, host_s[gap] + BURST_S, side="right"))
            together = slice(gap, max(fresh, gap + 1))
            silent = float(elapsed[together].sum() - steps[together].sum())
            steps[gap] += self._modulus * max(0.0, np.rint(silent / self._modulus))
        return steps

    def _steps_of_run(
        self, steps: FloatArray, values: AnyArray, host_s: FloatArray, run: slice
    ) -> FloatArray:
        """Ticks between the packets of a run and from the last one kept to its first."""
        if run.stop - run.start == len(values) or self._anchor is None:
            return steps
        if self._near_s < float(host_s[run.stop - 1]) - self._anchor.host_s:
            return self._steps(values[run], host_s[run], self._anchor)
        of_run = steps[run].copy()
        of_run[0] = self._step(int(values[run.start]), self._anchor)
        return of_run

    def _step(self, value: int, anchor: _Anchor) -> int:
        return (value - anchor.raw + self._backward) % self._modulus - self._backward

    def _plausible(self, steps: FloatArray, host_s: FloatArray, before_s: float) -> AnyArray:
        if not self._judged:
            return np.ones(len(steps), dtype=bool)
        excess = steps * self._tick_s
        excess -= differences(host_s, before_s)
        near: AnyArray = np.abs(excess, out=excess) <= self._slack_s
        near &= steps >= -self._backward
        return near

    def _leaps_ahead(
        self, steps: FloatArray, host_s: FloatArray, plausible: AnyArray
    ) -> npt.NDArray[np.bool_]:
        """Tell which packets are ahead of all before them by more than any clock errs."""
        if self._anchor is None or not np.isfinite(self._max_skew):
            return np.zeros(len(steps), dtype=bool)
        advance = steps * self._tick_s
        excess = advance - differences(host_s, self._anchor.host_s)
        if not plausible.all():
            advance[~plausible] = excess[~plausible] = 0.0
        ahead = np.cumsum(excess)
        ahead += self._ahead_s
        most = np.empty(len(ahead) + 1)
        most[0], most[1:] = self._most_s, host_s
        most[1:] *= self._max_skew
        most[1:] += ahead
        leaps: npt.NDArray[np.bool_] = excess > LEAP_S
        if leaps.any():
            least = LEAP_S + 2.0 * self._max_skew * advance
            before = np.maximum.accumulate(most)[:-1]
            leaps &= (excess > least) & (most[1:] - before > least)
        most = np.maximum.accumulate(most)
        # the last is handed in again if it is held
        settled = len(steps) - int(leaps[-1] or not plausible[-1])
        if settled:
            self._ahead_s, self._most_s = float(ahead[settled - 1]), float(most[settled])
        return leaps

    def _continues(self, value: int, host_s: float) -> bool:
        """Whether a packet continues the last one kept, with strays between them left out."""
        if self._anchor is None or not self._judged:
            return True
        elapsed_s = host_s - self._anchor.host_s
        step = self._step(value, self._anchor)
        silent = elapsed_s / self._tick_s - step
        if silent > self._modulus / 2:
            step += self._modulus * round(silent / self._modulus)
        return abs(step * self._tick_s - elapsed_s) <= self._slack_s


def _kept(
    runs: list[tuple[IntArray, FloatArray, int]], strays: int, *, held: bool = False
) -> Unwrapped:
    if not runs:
        return Unwrapped(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64), held, strays)
    if len(runs) == 1:
        rows, device_s, number = runs[0]
        return Unwrapped(rows, device_s, np.full(len(rows), number), held, strays)
    rows = np.concatenate([r for r, _, _ in runs])
    epoch = np.repeat([e for _, _, e in runs], [len(r) for r, _, _ in runs]).astype(np.int64)
    return Unwrapped(rows, np.concatenate([t for _, t, _ in runs]), epoch, held, strays)
