"""What whole counts hide: how large a count is, and what a mean loses that noise does not dither.

Noise of half a count or more carries readings over several counts, and their mean is as good as if
they were not rounded. With less noise all readings of a still may be the same count, however long
it lasts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.units import DEG, MILLI_G

LARGEST_COUNTS = {"accel": 50.0 * MILLI_G, "gyro": 1.0 * DEG}
"""Larger steps are not those of a converter, but of a recording made up of few values."""
OFF_COUNT = 1e-3
"""Share of a count by which readings of whole counts may miss one, for how they were written."""


@dataclass(frozen=True)
class Counts:
    """One count of each axis, shape (3,), 0 where readings are no counts, and about zero.

    Devices that cut numbers off in place of rounding them have a count of twice the size there.
    """

    size: FloatArray
    about_zero: FloatArray


def counts_of(values: FloatArray, sensor: str) -> Counts:
    """Return the counts that readings are made of.

    Parameters
    ----------
    values : shape (n, 3)
        Readings [m/s^2, rad/s].
    sensor : str
        "accel" or "gyro".
    """
    counts, about_zero = np.zeros(3), np.zeros(3)
    for axis in range(3):
        steps = np.abs(np.diff(values[:, axis]))
        steps = steps[steps > 0]
        if not len(steps) or steps.min() > LARGEST_COUNTS[sensor]:
            continue
        # Half counts where numbers are cut off, which is read as the middle of what is meant.
        halves = steps / (0.5 * steps.min())
        whole = np.rint(halves)
        if np.max(np.abs(halves - whole)) < OFF_COUNT:
            counts[axis] = steps.min()
            about_zero[axis] = steps.min() * (2.0 if np.any(whole % 2) else 1.0)
    return Counts(counts, about_zero)


def lost_variance(variance: FloatArray, means: FloatArray, counts: Counts) -> FloatArray:
    """Return the variance (m, 3) of what rounding hides of the means of stills.

    That of a mean of rounded Gaussian readings about the true one, over all its places between
    two counts, is at most ``q^2 / 12 exp(-4 pi^2 s^2 / q^2)`` with the count q and the noise s
    (Widrow and Kollar, Quantization Noise, 2008: the first harmonic).

    Parameters
    ----------
    variance : shape (m, 3)
        Of the readings within each still, as they are rounded.
    means : shape (m, 3)
        Of the same readings.
    counts : Counts
    """
    near = np.abs(means) < 2.0 * counts.size
    q2 = np.where(near, counts.about_zero, counts.size) ** 2
    known = np.where(q2 > 0, q2, 1.0)
    noise = np.maximum(variance - q2 / 12.0, 0.0)
    return np.asarray(q2 / 12.0 * np.exp(-4.0 * np.pi**2 * noise / known))
