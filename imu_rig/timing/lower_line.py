"""The straight line below all points that comes closest to them, and how well it is known.

Of delays that are one-sided and can be huge, averages are useless and minima are good. The line
that lies below all points and is highest at their mean runs along one edge of the lower convex
hull, the edge over the mean (Moon, Skelly and Towsley 1999).

All functions take many sets of points at once, one in each row, filled up on the right with points
at infinite height.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray, IntArray

# The points are cut into consecutive blocks, and the blocks' own minima show how far the minimum of
# an eighth of the points stands above that of all, whatever the delays are distributed like. Two
# blocks may be late as a whole, in a drop-out.
BLOCKS = 8
BLOCKS_USED = 6


def slopes_below(x: FloatArray, y: FloatArray, count: IntArray) -> FloatArray:
    """Return the slope of the line below all points that is highest at their mean.

    Parameters
    ----------
    x : shape (k, n)
        Increasing along each row.
    y : shape (k, n)
        Infinite from ``count`` on.
    count : shape (k,)
        Points of each row, at least 2.

    Returns
    -------
    shape (k,)
    """
    rows = np.arange(len(x))
    middle = np.sum(x, axis=1, where=np.isfinite(y)) / count
    left, right = np.zeros(len(x), np.int64), count - 1
    slope = np.empty(len(x))
    open_rows = rows
    # from the outermost points inwards: whatever lies deepest below the edge is a better end of it
    while len(open_rows):
        r, a, b = open_rows, left[open_rows], right[open_rows]
        slope[r] = (y[r, b] - y[r, a]) / (x[r, b] - x[r, a])
        above = y[r] - slope[r, None] * x[r]
        deepest = np.argmin(above, axis=1)
        ends = np.arange(len(r))
        deeper = above[ends, deepest] < np.minimum(above[ends, a], above[ends, b])
        deeper &= (deepest != a) & (deepest != b)
        to_left = x[r, deepest] <= middle[r]
        left[r[deeper & to_left]] = deepest[deeper & to_left]
        right[r[deeper & ~to_left]] = deepest[deeper & ~to_left]
        open_rows = r[deeper]
    return slope


def scatter(above: FloatArray, count: IntArray) -> FloatArray:
    """Return how far the minima of parts of the points stand above the minimum of all.

    Parameters
    ----------
    above : shape (k, n)
        Heights of the points above a line; infinite from ``count`` on.
    count : shape (k,)

    Returns
    -------
    shape (k,)
    """
    rows, width = above.shape
    starts = np.arange(BLOCKS) * count[:, None] // BLOCKS + width * np.arange(rows)[:, None]
    minima = np.minimum.reduceat(above.ravel(), starts.ravel()).reshape(rows, BLOCKS)
    minima.sort(axis=1)
    spread: FloatArray = minima[:, :BLOCKS_USED].mean(axis=1) - minima[:, 0]
    return spread
