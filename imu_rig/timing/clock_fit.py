"""A device's clock as a straight line on the host's, from arrivals that come late in bursts.

Every packet arrives at ``host = (1 + skew) * device + offset + delay`` with ``delay >= 0``. Delays
are one-sided and can be huge (Bluetooth holds data back 20 to 100 ms, after a drop-out seconds),
so that averages are useless and minima are good: the line wanted is the one below all points that
comes closest to them. It runs along one edge of the lower convex hull, the edge at the middle of
the record (Moon, Skelly and Towsley 1999). A constant part of the delay is invisible to anyone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray, IntArray

# What the fit keeps and trusts.
BIN_S = 0.5  # of device time, of which only the packet with the smallest delay is kept
WINDOW_BINS = 1200  # that the live fit remembers: ten minutes, over which a crystal runs evenly
MIN_SPAN_S = 10.0  # of record before a skew is fitted at all
MAX_SKEW = 0.02  # a microcontroller's RC oscillator; crystals stay below 100 ppm
TYPICAL_SKEW = 50e-6  # of a crystal, for the uncertainty where none could be fitted
# The smallest of n delays stands above none by about the spread of the bins' minima times n to a
# power between -1 (delays as likely to be tiny as not) and -1/2 (tiny ones are rare).
MINIMUM_POWER = -0.75
DRIFT_NOISE = 2.0  # error of slope times span in units of that


@dataclass(frozen=True)
class ClockFit:
    """``host = device * (1 + skew) + offset_s``.

    Attributes
    ----------
    offset_s : float
        Host time of the device's zero, by the least delayed packets [s].
    skew : float
        Seconds of host time per second of device time, minus 1.
    sigma_s : float
        Standard uncertainty of a mapped time within the record [s], apart from the constant
        part of the delay.
    impossible_skew : float or None
        What the arrivals ask for where it is more than was to be believed: ``skew`` is the largest
        believed one then, and every mapped time is wrong.
    """

    offset_s: float
    skew: float
    sigma_s: float
    impossible_skew: float | None = None

    def host(self, device_s: FloatArray) -> FloatArray:
        """Map device times [s] to host times [s]."""
        mapped: FloatArray = np.asarray(device_s) * (1.0 + self.skew) + self.offset_s
        return mapped


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
        Unwrapped device clock of each packet [s], one segment without a restart. n >= 1.
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
    skew = default_skew
    for _ in range(2):  # the second time the bins' minima are taken along the fitted skew
        late = (host - host[0]) - (device - device[0]) * (1.0 + skew)
        best = _least_in_bins(device, late)
        fit = _fit_minima(device[best], host[best], max_skew, min_span_s, default_skew)
        skew = fit.skew
    return fit


def _least_in_bins(device: FloatArray, late: FloatArray) -> IntArray:
    """Index of the least late packet of every bin of device time."""
    bins = np.floor((device - device[0]) / BIN_S)
    order = np.lexsort((late, bins))
    first = np.flatnonzero(np.diff(bins[order], prepend=-np.inf) > 0)
    least: IntArray = order[first]
    return least


def _fit_minima(
    device: FloatArray, host: FloatArray, max_skew: float, min_span_s: float, default_skew: float
) -> ClockFit:
    """Fit through the least delayed packets of the bins; both arrays sorted by device time."""
    x, y = device - device[0], (host - host[0]) - (device - device[0])
    span, bins = float(x[-1]), len(x)
    slope, drift, unknown = default_skew, 0.0, TYPICAL_SKEW * span
    impossible: float | None = None
    if span >= min_span_s and bins > 2:
        asked = _middle_slope(x, y)
        slope = float(np.clip(asked, -max_skew, max_skew))
        if abs(asked - slope) * span > DRIFT_NOISE * _noise(y - asked * x):
            impossible = asked
        residual = y - slope * x
        drift = DRIFT_NOISE * _noise(residual)
        # a slope that hardly exceeds its own error would do more harm than the one expected
        excess = (slope - default_skew) * span
        trust = max(0.0, 1.0 - (drift / excess) ** 2) if excess else 0.0
        slope = default_skew + trust * (slope - default_skew)
        unknown = (1.0 - trust) * min(unknown, drift)
    late = y - slope * x
    offset = float(late.min()) + (host[0] - device[0] * (1.0 + slope))
    sigma = float(np.sqrt(_noise(late) ** 2 + drift**2 / 4 + unknown**2 / 3))
    return ClockFit(float(offset), slope, sigma, impossible)


def _noise(late: FloatArray) -> float:
    """Estimate how late the least late packet was [s], from the least late ones of the bins."""
    return float(np.median(late) - late.min()) * math.pow(len(late), MINIMUM_POWER)


def _middle_slope(x: FloatArray, y: FloatArray) -> float:
    """Slope of the lower hull's edge over the mean of ``x``: the line below all, closest to all."""
    hull: list[tuple[float, float]] = []
    for point in zip(x.tolist(), y.tolist(), strict=True):
        while len(hull) > 1:
            (ax, ay), (bx, by) = hull[-2], hull[-1]
            if (bx - ax) * (point[1] - ay) > (by - ay) * (point[0] - ax):
                break
            hull.pop()
        hull.append(point)
    middle = float(x.mean())
    right = next(i for i in range(1, len(hull)) if hull[i][0] >= middle or i == len(hull) - 1)
    (ax, ay), (bx, by) = hull[right - 1], hull[right]
    return (by - ay) / (bx - ax)


class LiveClockFit:
    """The same while packets arrive: cheap, in bounded memory, over the last ten minutes.

    Parameters
    ----------
    max_skew, min_span_s
        As for `fit_clock`.
    """

    def __init__(self, *, max_skew: float = MAX_SKEW, min_span_s: float = MIN_SPAN_S) -> None:
        self._max_skew, self._min_span_s = max_skew, min_span_s
        self._default_skew = 0.0
        self._fit: ClockFit | None = None
        self._minima: dict[int, tuple[float, float]] = {}

    @property
    def fit(self) -> ClockFit | None:
        """The fit as of the last update; None before the first packet."""
        return self._fit

    @property
    def remembered(self) -> int:
        """How many packets the fit rests on."""
        return len(self._minima)

    def update(self, device_s: FloatArray, host_s: FloatArray) -> ClockFit:
        """Take in the next packets (n >= 1) and return the fit that includes them."""
        device, host = np.asarray(device_s, dtype=float), np.asarray(host_s, dtype=float)
        skew = self._default_skew if self._fit is None else self._fit.skew
        bins = np.floor(device / BIN_S).astype(np.int64)
        late = host - device * (1.0 + skew)
        known = len(self._minima)
        changed = False
        for number in np.unique(bins).tolist():
            rows = np.flatnonzero(bins == number)
            least = int(rows[np.argmin(late[rows])])
            held = self._minima.get(number)
            if held is None or late[least] < held[1] - held[0] * (1.0 + skew):
                self._minima[number] = (float(device[least]), float(host[least]))
                changed |= self._fit is None or late[least] < self._fit.offset_s
        while len(self._minima) > WINDOW_BINS:
            del self._minima[next(iter(self._minima))]
        if self._fit is None or changed or len(self._minima) != known:
            self._refit()
        if self._fit is None:
            raise ValueError("a clock cannot be fitted to no packets")
        return self._fit

    def restart(self) -> None:
        """Forget the segment, for the device's clock began anew; its crystal is still the same."""
        if self._fit is not None:
            self._default_skew = self._fit.skew
        self._fit, self._minima = None, {}

    def _refit(self) -> None:
        points = np.array(sorted(self._minima.values()))
        self._fit = _fit_minima(
            points[:, 0], points[:, 1], self._max_skew, self._min_span_s, self._default_skew
        )
