"""Means and minima over moving windows of time, one pass each.

A window is centred on its sample and reaches ``half`` seconds to both sides, both ends included,
so that equal and jittery time stamps and gaps need no special care: a window holds the samples
that fell into it, at least its own.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.kernels.compiled import compiled

REFRESH = 64
"""So many samples after the last time, the running sums are taken anew: rounding stays small."""

SLACK_S = 1e-9
"""A sample this far outside of a window is in it: stamps are sums of decimal fractions."""


@compiled
def moving_mean(t: FloatArray, values: FloatArray, half: float) -> FloatArray:
    """Return the mean of each column over a moving window.

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    values : shape (n, m)
    half : float
        Reach of the window to either side [s].

    Returns
    -------
    shape (n, m)
    """
    n, m = values.shape
    means = np.empty((n, m))
    sums = np.zeros(m)
    begin = 0
    end = 0
    reach = half + SLACK_S
    for k in range(n):
        old_begin = begin
        old_end = end
        while end < n and t[end] <= t[k] + reach:
            end += 1
        while t[begin] < t[k] - reach:
            begin += 1
        if k % REFRESH == 0 or begin >= old_end:
            for j in range(m):
                sums[j] = 0.0
            for i in range(begin, end):
                for j in range(m):
                    sums[j] += values[i, j]
        else:
            for i in range(old_end, end):
                for j in range(m):
                    sums[j] += values[i, j]
            for i in range(old_begin, begin):
                for j in range(m):
                    sums[j] -= values[i, j]
        share = 1.0 / (end - begin)
        for j in range(m):
            means[k, j] = sums[j] * share
    return means


@compiled
def moving_minimum(t: FloatArray, values: FloatArray, half: float) -> FloatArray:
    """Return the least value in a moving window, shape (n,).

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    values : shape (n,)
    half : float
        Reach of the window to either side [s].
    """
    n = len(values)
    least = np.empty(n)
    # Samples that may still be the least of a window, values rising from the oldest on.
    queue = np.empty(n, np.int64)
    head = 0
    tail = 0
    end = 0
    reach = half + SLACK_S
    for k in range(n):
        while end < n and t[end] <= t[k] + reach:
            while tail > head and values[queue[tail - 1]] >= values[end]:
                tail -= 1
            queue[tail] = end
            tail += 1
            end += 1
        while t[queue[head]] < t[k] - reach:
            head += 1
        least[k] = values[queue[head]]
    return least
