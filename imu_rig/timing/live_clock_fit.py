"""The clock fit while packets arrive: cheap, in bounded memory, over the last ten minutes."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.timing.clock_fit import (
    BIN_S,
    MAX_SKEW,
    MIN_SPAN_S,
    WINDOW_S,
    ClockFit,
    fit_minima,
    with_unseen,
)

KEPT_BINS = 60  # with packets, kept however old: a slow sensor's or those before a long silence
WORTH_S = 1e-6  # by which a packet must be ahead of the fit for another


class LiveClockFit:
    """Fits one line to the last ten minutes, again and again.

    Parameters
    ----------
    max_skew, min_span_s
        As for `fit_clock`.
    """

    def __init__(self, *, max_skew: float = MAX_SKEW, min_span_s: float = MIN_SPAN_S) -> None:
        self._max_skew, self._min_span_s = max_skew, min_span_s
        self._default_skew = 0.0
        self._fit: ClockFit | None = None
        self._table = np.empty((5, 0))

    @property
    def fit(self) -> ClockFit | None:
        """The fit as of the last update; None before the first packet."""
        return self._fit

    def update(self, device_s: FloatArray, host_s: FloatArray) -> ClockFit:
        """Take in the next packets (n >= 1, device time not decreasing); return the new fit."""
        device, host = np.asarray(device_s, dtype=float), np.asarray(host_s, dtype=float)
        if len(device) == 0:
            raise ValueError("a clock cannot be fitted to no packets")
        fit = self._fit
        grown = self._remember(device, host)
        if fit is None or grown or np.any(fit.host(device) - host > WORTH_S):
            _, least_device, least_host, any_device, any_host = self._table
            fit = fit_minima(
                least_device, least_host, self._max_skew, self._min_span_s, self._default_skew
            )
            fit = self._fit = with_unseen(fit, any_host - fit.host(any_device))
        return fit

    def restart(self) -> None:
        """Forget the segment, for the device's clock began anew; its crystal is still the same."""
        if self._fit is not None:
            self._default_skew = self._fit.skew
            if np.ptp(self._table[1]) >= MIN_SPAN_S:  # it is known better than from a few seconds
                self._min_span_s = max(self._min_span_s, MIN_SPAN_S)
        self._fit = None
        self._table = np.empty((5, 0))

    def _remember(self, device: FloatArray, host: FloatArray) -> bool:
        """Keep the least late and the first packet of every bin; return whether there are more.

        The rows of the table: number of the bin, device and host time of its least late packet,
        device and host time of its first.
        """
        pace = 1.0 + (self._default_skew if self._fit is None else self._fit.skew)
        bins = np.floor(device / BIN_S)
        table = self._table
        if table.shape[1] and bins[0] == bins[-1] == table[0, -1]:
            late = host - device * pace
            least = int(np.argmin(late))
            if late[least] < table[2, -1] - table[1, -1] * pace:
                table[1, -1], table[2, -1] = device[least], host[least]
            return False
        since = int(np.searchsorted(table[0], bins.min()))
        new = np.concatenate((table[:, since:], np.stack((bins, device, host, device, host))), 1)
        new = new[:, np.argsort(new[0], kind="stable")]
        first = np.flatnonzero(np.diff(new[0], prepend=-np.inf))
        least_late = np.lexsort((new[2] - new[1] * pace, new[0]))[first]
        kept = np.concatenate((new[:1, first], new[1:3, least_late], new[3:, first]))
        table = np.concatenate((table[:, :since], kept), axis=1)
        recent = int(np.searchsorted(table[0], table[0, -1] - WINDOW_S / BIN_S, side="right"))
        self._table = table[:, max(0, min(recent, table.shape[1] - KEPT_BINS)) :]
        return True
