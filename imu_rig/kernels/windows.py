"""Statistics over moving windows of time, each from the samples of its own window only.

No running sums: a result depends on nothing outside of its window, so that a recording that comes
in pieces gives bit for bit what the whole one does. Windows are those of `imu_rig.kernels.rolling`.
Each function takes ``first`` and ``last`` of `window_edges`, shape (m,), and returns shape (m,).
"""

from __future__ import annotations

import math

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.kernels.compiled import compiled
from imu_rig.kernels.rolling import SLACK_S


@compiled
def window_edges(
    t: FloatArray, half: float, begin: int, end: int
) -> tuple[IntArray, IntArray, int]:
    """Find the windows around the samples from ``begin`` to before ``end``.

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    half : float
        Reach of a window to either side [s].
    begin, end : int

    Returns
    -------
    first, last : shape (m,)
        First sample in each window, and the first one after it.
    complete : int
        How many of these windows end before the newest sample: later samples cannot be in them.
    """
    n = len(t)
    first = np.empty(end - begin, np.int64)
    last = np.empty(end - begin, np.int64)
    reach = half + SLACK_S
    complete = 0
    low = 0
    high = 0
    for k in range(begin, end):
        while t[low] < t[k] - reach:
            low += 1
        high = max(high, k + 1)
        while high < n and t[high] <= t[k] + reach:
            high += 1
        first[k - begin] = low
        last[k - begin] = high
        if high < n:
            complete += 1
    return first, last, complete


@compiled
def mean_square(x: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the mean of ``|x|^2``; x of shape (n, 3)."""
    found = np.empty(len(first))
    for k in range(len(first)):
        total = 0.0
        for i in range(first[k], last[k]):
            total += x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1] + x[i, 2] * x[i, 2]
        found[k] = total / (last[k] - first[k])
    return found


@compiled
def largest_norm(x: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the largest ``|x|``; x of shape (n, 3). NaN where a value in the window is."""
    found = np.empty(len(first))
    for k in range(len(first)):
        most = 0.0
        for i in range(first[k], last[k]):
            square = x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1] + x[i, 2] * x[i, 2]
            if not square <= most:
                most = square
            if math.isnan(most):
                break
        found[k] = math.sqrt(most)
    return found


@compiled
def mean_square_excess(x: FloatArray, size: float, first: IntArray, last: IntArray) -> FloatArray:
    """Return the mean of ``(|x| - size)^2``; x of shape (n, 3)."""
    found = np.empty(len(first))
    for k in range(len(first)):
        total = 0.0
        for i in range(first[k], last[k]):
            norm = math.sqrt(x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1] + x[i, 2] * x[i, 2])
            total += (norm - size) * (norm - size)
        found[k] = total / (last[k] - first[k])
    return found


@compiled
def scatter(x: FloatArray, size: float, first: IntArray, last: IntArray) -> FloatArray:
    """Return the mean of ``|x - m|^2``; x of shape (n, 3).

    ``m`` is the mean of x over the window, stretched to a length of ``size`` where that is
    positive. Infinite for windows of fewer than three samples, which say nothing of variation.
    """
    found = np.empty(len(first))
    for k in range(len(first)):
        number = last[k] - first[k]
        if number < 3:
            found[k] = np.inf
            continue
        a, b, c = 0.0, 0.0, 0.0
        for i in range(first[k], last[k]):
            a += x[i, 0]
            b += x[i, 1]
            c += x[i, 2]
        stretch = 1.0 / number
        if size > 0.0:
            stretch = size / math.sqrt(a * a + b * b + c * c)
        a, b, c = a * stretch, b * stretch, c * stretch
        total = 0.0
        for i in range(first[k], last[k]):
            p, q, r = x[i, 0] - a, x[i, 1] - b, x[i, 2] - c
            total += p * p + q * q + r * r
        found[k] = total / number
    return found
