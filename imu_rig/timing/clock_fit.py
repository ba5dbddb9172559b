"""A device's clock on the host's, from arrivals that come late in bursts.

Every packet arrives at ``host = true time + delay`` with ``delay >= 0``, and true time is nearly a
straight line over the device's clock. Delays are one-sided and can be huge (Bluetooth holds data
back 20 to 100 ms, after a drop-out seconds), so the line wanted is the one below all arrivals that
comes closest to them; see `imu_rig.timing.lower_line`.

A crystal does not keep its rate: over a day it wanders by a millionth or two with temperature, and
by as much within ten minutes when a sensor is put on a warm shoe, so that one line for a day errs
by tens of milliseconds. A long record is therefore fitted in windows of ten minutes, each of which
overlaps its neighbours by half, and the lines are blended into each other. Any blend of lines below
all arrivals lies below all arrivals.

The stated uncertainty covers what the fit cannot tell from the arrivals: how late the least late
packets were beyond the least delay possible, the skew where the record is too short to show it, and
a wandering crystal. It does not cover the least delay possible itself: a part of the delay that
all packets share (time of flight, a sensor's filter, the last byte's way over a serial line) is
invisible to anyone who sees arrivals only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.timing.lower_line import scatter, slopes_below

# What the fit keeps and trusts.
BIN_S = 0.5  # of device time, of which only the packet with the smallest delay is kept
WINDOW_S = 600.0  # over which a crystal is taken for even: 2 ppm of change bend it by 0.15 ms
MIN_SPAN_S = 10.0  # of record before a skew is fitted at all
MAX_SKEW = 0.02  # a microcontroller's RC oscillator; crystals stay below 100 ppm
TYPICAL_SKEW = 50e-6  # of a crystal, for the uncertainty where none could be fitted
TYPICAL_DELAY_S = 0.05  # of a Bluetooth burst, for the uncertainty while there are few packets
FEW_BINS = 8
# How late the luckiest packets are is not known better than to some part of how late all are.
LUCK = 0.02  # of the typical delay, with many packets
FEW_LUCK = 2.0  # of the typical delay, divided by the number of bins, with few
# Where a link flushes in step with the sensor (a converter's latency timer of 16 ms, a sample every
# 10 ms), delays take a few values only, and the least possible one may not be among them for long.
STEP_GAPS = 2.5  # times the largest gap expected among delays of all sizes
STEP_SHARE = 0.75  # of the delays are looked at; the latest are sparse in any case
# The rest by simulation over delays that are often, seldom or never tiny (see
# tests/benchmarks/clock_study.py), in units of the scatter of the blocks' minima.
LINE_NOISE = 1.0  # error of the line, root mean square over the record
DRIFT_NOISE = 2.0  # error of slope times span, at most
# For the blending of windows.
MIN_WINDOW_BINS = 20  # with packets, for a window to have a line of its own
BLEND_STEPS = 16  # straight pieces from one window's middle to the next one's
TOGETHER = 64  # windows worked on at a time, for bounded memory


@dataclass(frozen=True)
class ClockFit:
    """``host = device * (1 + skew) + offset_s``, and what a long record departs from that by.

    Attributes
    ----------
    offset_s : float
        Host time of the device's zero, by the least delayed packets [s].
    skew : float
        Seconds of host time per second of device time, minus 1.
    sigma_s : float
        Standard uncertainty of a mapped time within the record [s], where it is worst, apart from
        the constant part of the delay.
    impossible_skew : float or None
        What the arrivals ask for where it is more than was to be believed: ``skew`` is the largest
        believed one then, and every mapped time is wrong.
    knots_s : shape (m,) or None
        Device times [s] at which the departure from the straight line is known; straight between.
        None where the record is a straight line.
    departure_s : shape (m,) or None
        The departures [s].
    """

    offset_s: float
    skew: float
    sigma_s: float
    impossible_skew: float | None = None
    knots_s: FloatArray | None = field(default=None, compare=False, repr=False)
    departure_s: FloatArray | None = field(default=None, compare=False, repr=False)

    def host(self, device_s: FloatArray) -> FloatArray:
        """Map device times [s] to host times [s]."""
        device = np.asarray(device_s)
        mapped: FloatArray = device * (1.0 + self.skew) + self.offset_s
        if self.knots_s is not None and self.departure_s is not None:
            mapped = mapped + np.interp(device, self.knots_s, self.departure_s)
        return mapped


def alignment_sigma_s(*sigmas_s: float) -> float:
    """Return the standard uncertainty [s] of the time between samples of two devices.

    Each device is aligned to the host's clock on its own, so that their errors are independent:
    the root of the sum of squares of the ``sigma_s`` of both. Constant delays do not cancel unless
    both devices send over the same kind of link.
    """
    return math.hypot(*sigmas_s)


def fit_clock(
    device_s: FloatArray,
    host_s: FloatArray,
    *,
    max_skew: float = MAX_SKEW,
    min_span_s: float = MIN_SPAN_S,
    default_skew: float = 0.0,
) -> ClockFit:
    """Fit a whole record.

    Parameters
    ----------
    device_s : shape (n,)
        Unwrapped device clock of each packet [s], one segment without a restart, not decreasing.
        n >= 1.
    host_s : shape (n,)
        Arrival of each packet, host clock [s].
    max_skew : float
        Largest skew believed, of either sign; the fit says where more is asked for.
    min_span_s : float
        Records shorter than this [s] keep ``default_skew``.
    default_skew : float

    Returns
    -------
    ClockFit
    """
    device, host = np.asarray(device_s, dtype=float), np.asarray(host_s, dtype=float)
    if len(device) == 0:
        raise ValueError("a clock cannot be fitted to no packets")
    first = _bin_starts(device)
    skew = default_skew
    for _ in range(2):  # the second time the bins' minima are taken along the fitted skew
        best = _least_in_bins(device, host, skew, first)
        x, y = device[best], host[best]
        fit = fit_minima(x, y, max_skew, min_span_s, default_skew)
        skew = fit.skew
    if x[-1] - x[0] > WINDOW_S and fit.impossible_skew is None:
        fit = _blended(fit, x, y, max_skew)
    return with_unseen(fit, host[first] - fit.host(device[first]))


def with_unseen(fit: ClockFit, late_s: FloatArray) -> ClockFit:
    """Add to a fit's uncertainty what the least late packets do not show.

    Parameters
    ----------
    fit : ClockFit
    late_s : shape (n,)
        How late packets were [s], the late ones as likely to be among these as the others.
    """
    late = np.sort(late_s)
    typical = max(0.0, float(late[len(late) // 2]))
    luck = max(LUCK, FEW_LUCK / len(late)) * typical
    late = late[: math.ceil(STEP_SHARE * len(late))]
    step = 0.0
    if len(late) >= MIN_WINDOW_BINS:
        gap = float(np.diff(late).max())
        if gap > STEP_GAPS * float(late[-1] - late[0]) * math.log(len(late)) / len(late):
            step = gap / math.sqrt(3.0)  # the least delay is anywhere within the gap
    return replace(fit, sigma_s=math.hypot(fit.sigma_s, luck, step))


def _bin_starts(device: FloatArray) -> IntArray:
    """Index of the first packet of every bin of device time."""
    bins = ((device - device[0]) * (1.0 / BIN_S)).astype(np.int64)
    starts: IntArray = np.concatenate(([0], np.flatnonzero(bins[1:] != bins[:-1]) + 1))
    return starts


def _least_in_bins(device: FloatArray, host: FloatArray, skew: float, first: IntArray) -> IntArray:
    """Index of the least late packet of every bin."""
    late = host - device * (1.0 + skew)
    least = np.minimum.reduceat(late, first)
    sizes = np.diff(first, append=len(late))
    at = np.flatnonzero(late == np.repeat(least, sizes))
    # of several that are equally late the first
    best: IntArray = at[np.searchsorted(at, first)]
    return best


def fit_minima(
    device: FloatArray, host: FloatArray, max_skew: float, min_span_s: float, default_skew: float
) -> ClockFit:
    """Fit one line to the least delayed packets of the bins, in order of increasing device time."""
    x, y = device - device[0], (host - host[0]) - (device - device[0]) * (1.0 + default_skew)
    span = float(x[-1])
    asked, impossible = 0.0, None
    fitted = span >= min_span_s and len(x) > 2
    if fitted:
        wanted = _slope(x, y)
        asked = float(np.clip(wanted, -max_skew - default_skew, max_skew - default_skew))
        if abs(wanted - asked) * span > DRIFT_NOISE * _scatter(y - wanted * x):
            impossible = wanted + default_skew
    slope, base, sigma = (
        float(figure[0])
        for figure in _trusted(
            x[None], y[None], np.array([len(x)]), np.array([asked]), fitted=fitted
        )
    )
    skew = slope + default_skew
    return ClockFit(base + (host[0] - device[0] * (1.0 + skew)), skew, sigma, impossible)


def _slope(x: FloatArray, y: FloatArray) -> float:
    return float(slopes_below(x[None], y[None], np.array([len(x)]))[0])


def _scatter(above: FloatArray) -> float:
    return float(scatter(above[None], np.array([len(above)]))[0])


def _trusted(
    x: FloatArray, y: FloatArray, count: IntArray, asked: FloatArray, *, fitted: bool = True
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return slopes as far as they are to be trusted, heights at x = 0 and uncertainties.

    A slope that hardly exceeds its own error would do more harm than the one expected, which is 0.
    """
    span = x[np.arange(len(x)), count - 1] - x[:, 0]
    unknown = TYPICAL_SKEW * span
    trust = np.zeros(len(x))
    if fitted:
        drift = DRIFT_NOISE * scatter(y - asked[:, None] * x, count)
        excess = np.maximum(np.abs(asked) * span, 1e-15)
        trust = np.maximum(0.0, 1.0 - (drift / excess) ** 2)
        unknown = (1.0 - trust) * np.minimum(unknown, drift)
    slope = trust * asked
    late = y - slope[:, None] * x
    few = np.where(count < FEW_BINS, TYPICAL_DELAY_S / count, 0.0)
    noise = LINE_NOISE * scatter(late, count)
    return slope, late.min(axis=1), np.sqrt(noise**2 + few**2 + unknown**2 / 3)


def _blended(line: ClockFit, x: FloatArray, y: FloatArray, max_skew: float) -> ClockFit:
    """Follow the wander of the clock's rate around the line fitted to the whole record."""
    above = (y - y[0]) - (x - x[0]) * (1.0 + line.skew) - (line.host(x[:1])[0] - y[0])
    half = WINDOW_S / 2
    halves = np.floor((x - x[0]) / half)
    begins = x[0] + half * np.unique(halves)
    start = np.searchsorted(x, begins)
    stop = np.searchsorted(x, np.minimum(begins + WINDOW_S, x[-1] + BIN_S))
    # the last window ends with the record
    start = np.minimum(start, np.searchsorted(x, max(x[-1] - WINDOW_S, x[0])))
    worth = (stop - start >= MIN_WINDOW_BINS) & np.concatenate(([True], np.diff(start) > 0))
    start, stop = start[worth], stop[worth]
    if len(start) < 2:
        return line
    parts = [
        _window_lines(x, above, start[i : i + TOGETHER], stop[i : i + TOGETHER], line, max_skew)
        for i in range(0, len(start), TOGETHER)
    ]
    middle, height, slope, sigma = np.concatenate(parts, axis=1)
    knots, departure = _blend(middle, height, slope, x)
    # whatever the arrivals, time does not run backwards
    forward = np.maximum.accumulate(knots * (1.0 + line.skew) + departure)
    return ClockFit(
        line.offset_s,
        line.skew,
        float(sigma.max()),
        knots_s=knots,
        departure_s=forward - knots * (1.0 + line.skew),
    )


def _window_lines(
    x: FloatArray,
    above: FloatArray,
    start: IntArray,
    stop: IntArray,
    line: ClockFit,
    max_skew: float,
) -> FloatArray:
    """Middle, height there, slope and uncertainty of each window's line, shape (4, k)."""
    count = stop - start
    columns = np.arange(int(count.max()))
    rows = np.minimum(start[:, None] + columns, stop[:, None] - 1)
    inside = columns < count[:, None]
    windows = x[rows]
    middle = np.sum(windows, axis=1, where=inside) / count
    windows = windows - middle[:, None]
    heights = np.where(inside, above[rows], np.inf)
    asked = slopes_below(windows, heights, count)
    asked = np.clip(asked, -max_skew - line.skew, max_skew - line.skew)
    slope, height, sigma = _trusted(windows, heights, count, asked)
    return np.stack((middle, height, slope, sigma))


def _blend(
    middle: FloatArray, height: FloatArray, slope: FloatArray, x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Blend each line into the next; return knots and departures there."""
    weight = np.arange(BLEND_STEPS) / BLEND_STEPS
    apart = np.diff(middle)[:, None]
    knots = (middle[:-1, None] + apart * weight).ravel()
    one = height[:-1, None] + slope[:-1, None] * apart * weight
    other = height[1:, None] - slope[1:, None] * apart * (1.0 - weight)
    inner = ((1.0 - weight) * one + weight * other).ravel()
    first = height[0] + slope[0] * (x[0] - middle[0])
    last = height[-1] + slope[-1] * (x[-1] - middle[-1])
    return (
        np.concatenate(([x[0]], knots, middle[-1:], [x[-1]])),
        np.concatenate(([first], inner, height[-1:], [last])),
    )
