"""Device times to host times that strictly increase, by a clock fit for every segment."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.timing.clock_fit import ClockFit
from imu_rig.timing.sample_order import Ordered

SLOWEST = 0.5  # seconds of sample time per second of device time while a fit is corrected downwards
MIN_STEP_S = 1e-6  # between samples, so that time is strictly increasing


class HostTime:
    """Maps the samples of one device, block after block.

    Parameters
    ----------
    fit : callable
        Given a segment's number and the device and arrival times [s] of its next samples,
        returns the clock fit to map them by.
    """

    def __init__(self, fit: Callable[[int, FloatArray, FloatArray], ClockFit]) -> None:
        self._fit = fit
        self._last: tuple[int, float, float] | None = None  # segment, device time, host time

    def times(self, ordered: Ordered, host_s: FloatArray) -> FloatArray:
        """Map the next samples, shape (n,)."""
        t = np.empty(len(host_s))
        edges = [0, *(np.flatnonzero(np.diff(ordered.segment)) + 1).tolist(), len(t)]
        for start, stop in pairwise(edges):
            if stop == start:
                continue
            part, segment = slice(start, stop), int(ordered.segment[start])
            device = ordered.device_s[part]
            fit = self._fit(segment, device, host_s[part])
            t[part] = self._increasing(fit.host(device), device, segment, 1.0 + fit.skew)
            self._last = (segment, float(device[-1]), float(t[stop - 1]))
        return t

    def _increasing(
        self, t: FloatArray, device_s: FloatArray, segment: int, pace: float
    ) -> FloatArray:
        """Where a better fit would set time back, let it pass slower until it fits again."""
        slowest = SLOWEST * pace * (device_s - device_s[0])
        steps = MIN_STEP_S * np.arange(len(t))
        floor = -np.inf
        if self._last is not None:
            floor = self._last[2] + MIN_STEP_S
            if self._last[0] == segment:
                floor += SLOWEST * pace * float(device_s[0] - self._last[1])
        eased = np.maximum.accumulate(np.maximum(t - slowest, floor)) + slowest
        apart: FloatArray = np.maximum.accumulate(eased - steps) + steps
        return apart
