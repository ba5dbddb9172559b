"""Stride lengths of a tracked marker beside those of a foot's strides.

The marker tells its own rests: a stride of it goes from where it stood to where it stands next. So
no fit of a frame enters, and on a straight way not where on the foot the marker sits either. In
turns it does: a marker beside the sensor goes another way by their distance times the angle, 2 cm
in a stride that turns by 30 deg about a marker 4 cm aside. That is no error of either.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import DataError
from imu_rig.gait.strides import Strides
from imu_rig.reference.footprints import StrideComparison
from imu_rig.reference.reference import Reference

REST_S = 0.10
"""Length of the window around a footfall in which the marker is taken to rest at its slowest; less
than a runner's foot is on the ground."""
AROUND_S = 0.25
"""So far from the sensor's quietest moment its slowest window is looked for: half a stance."""
FASTEST_MS = 0.5
"""A marker that is faster than this even then was not seen at rest; a rolling heel does 0.2 m/s."""


def compare_optical_strides(
    strides: Strides, reference: Reference, *, time_offset: float = 0.0
) -> StrideComparison:
    """Compare the lengths of strides with those of the marker's, where it was seen at both ends.

    Parameters
    ----------
    strides : Strides
    reference : Reference
        With positions.
    time_offset : float
        Added to the reference's times to find the estimate's [s], as of `Alignment`.

    Raises
    ------
    DataError
        No positions, or no stride at both of whose ends the marker was seen at rest.
    """
    if reference.position is None:
        raise DataError("the reference has no positions; take one that has")
    t = reference.t + time_offset
    begin = _rests(t, reference.position, strides.start)
    end = _rests(t, reference.position, strides.end)
    true = np.linalg.norm((end - begin)[:, :2], axis=1)
    seen = np.isfinite(true)
    if not seen.any():
        raise DataError(
            "the marker was not seen at rest at both ends of any stride; check that the reference "
            "is of this foot and on the same clock"
        )
    return StrideComparison(
        length=strides.length[seen],
        true_length=true[seen],
        count=int(np.count_nonzero(seen)),
        true_count=int(np.count_nonzero(seen)),
        distance=float(strides.length[seen].sum()),
        true_distance=float(true[seen].sum()),
    )


def _rests(t: FloatArray, position: FloatArray, when: FloatArray) -> FloatArray:
    """Mean places (m, 3) of the marker where it goes least around some times; NaN where unseen."""
    places = np.full((len(when), 3), np.nan)
    for i, moment in enumerate(when):
        first, last = np.searchsorted(t, (moment - AROUND_S, moment + AROUND_S))
        if last - first < 3:
            continue
        step = (t[last - 1] - t[first]) / (last - 1 - first)
        width = max(2, round(REST_S / step) + 1) if step > 0.0 else last - first
        if last - first < width:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(position[first:last], width, axis=0)
        gone = np.linalg.norm(windows[:, :, -1] - windows[:, :, 0], axis=1)
        if np.all(np.isnan(gone)):
            continue
        best = int(np.nanargmin(gone))
        if gone[best] <= FASTEST_MS * step * (width - 1):
            places[i] = windows[best].mean(axis=1)
    return places
