"""Means and minima over moving windows of time, one pass each.

A window is centred on its sample and reaches ``half`` seconds to both sides, both ends included,
so that equal and jittery time stamps and gaps need no special care: a window holds the samples
that fell into it, at least its own.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
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


@compiled
def moving_motion(
    t: FloatArray,
    accel: FloatArray,
    gyro: FloatArray,
    half: float,
    lever: float,
    settling: float,
    gravity: float,
) -> FloatArray:
    """Return the motion statistic of `imu_rig.gait.statistic`, shape (n,) [m/s].

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    accel, gyro : shape (n, 3)
        [m/s^2, rad/s].
    half : float
        Reach of the window to either side [s].
    lever : float
        Makes a velocity of an angular rate [m].
    settling : float
        Makes one of an acceleration [s].
    gravity : float
        [m/s^2]
    """
    n = len(t)
    motion = np.empty(n)
    begin = 0
    end = 0
    reach = half + SLACK_S
    x, y, z, force, rate = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        old_begin = begin
        old_end = end
        while end < n and t[end] <= t[k] + reach:
            end += 1
        while t[begin] < t[k] - reach:
            begin += 1
        if k % REFRESH == 0 or begin >= old_end:
            x, y, z, force, rate = 0.0, 0.0, 0.0, 0.0, 0.0
            old_begin = begin
            old_end = begin
        for i in range(old_end, end):
            a, b, c = accel[i, 0], accel[i, 1], accel[i, 2]
            u, v, w = gyro[i, 0], gyro[i, 1], gyro[i, 2]
            x, y, z = x + a, y + b, z + c
            force += a * a + b * b + c * c
            rate += u * u + v * v + w * w
        for i in range(old_begin, begin):
            a, b, c = accel[i, 0], accel[i, 1], accel[i, 2]
            u, v, w = gyro[i, 0], gyro[i, 1], gyro[i, 2]
            x, y, z = x - a, y - b, z - c
            force -= a * a + b * b + c * c
            rate -= u * u + v * v + w * w
        share = 1.0 / (end - begin)
        size = np.sqrt(x * x + y * y + z * z) * share
        # |f - g u|^2 on average, with u the direction of the mean force, multiplied out.
        off = max(force * share - 2.0 * gravity * size + gravity * gravity, 0.0)
        motion[k] = np.sqrt(lever * lever * max(rate * share, 0.0) + settling * settling * off)
    return motion


@compiled
def moving_level(t: FloatArray, values: FloatArray, half: float) -> FloatArray:
    """Return the root mean square of values, shape (n,), over a moving window, shape (n,)."""
    n = len(t)
    level = np.empty(n)
    begin = 0
    end = 0
    reach = half + SLACK_S
    total = 0.0
    for k in range(n):
        while end < n and t[end] <= t[k] + reach:
            total += values[end] * values[end]
            end += 1
        while t[begin] < t[k] - reach:
            total -= values[begin] * values[begin]
            begin += 1
        if k % (64 * REFRESH) == 0:
            total = 0.0
            for i in range(begin, end):
                total += values[i] * values[i]
        level[k] = np.sqrt(max(total, 0.0) / (end - begin))
    return level


@compiled
def cell_sums(edges: IntArray, gyro: FloatArray, accel: FloatArray) -> FloatArray:
    """Return sums over the rows from each edge to the next, shape (c, 8).

    Of the three rates, the three forces, and the squares of both vectors.
    """
    cells = len(edges) - 1
    sums = np.zeros((cells, 8))
    for c in range(cells):
        for i in range(edges[c], edges[c + 1]):
            for j in range(3):
                w, f = gyro[i, j], accel[i, j]
                sums[c, j] += w
                sums[c, 3 + j] += f
                sums[c, 6] += w * w
                sums[c, 7] += f * f
    return sums
