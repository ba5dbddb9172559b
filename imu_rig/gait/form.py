"""Whether a recording is made of numbers and times that anything can be worked out from."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.kernels.columns import extent

LEAST_S = 1.0
"""A stride takes about that long."""

LEAST_HZ, MOST_HZ = 20.0, 20_000.0
"""A running foot rests for 60 to 80 ms: below 20 Hz no sample may fall into it. No sensor of this
kind is faster than 20 kHz: its times would be in another unit."""

EQUAL_SHARE = 0.2
"""Single samples with the time of the one before do little harm; when it is a fifth of them, they
came in bursts and bear the times of their arrival."""

JITTER_SHARE = 0.3
"""From here on the scatter of intervals is told, as a share of the median interval."""

EVEN = 1.001
"""Intervals of which the longest is at most so many times the shortest do not scatter."""

MOST_ACCEL, MOST_GYRO = 5000.0, 120.0
"""No foot sensor measures more than 500 g or 7000 deg/s [m/s^2, rad/s]."""

FEW = 0.001
DEAD_S = 1.0
MOVES_RATE, MOVES_FORCE = 0.3, 1.0
"""What turns or shakes this much, root mean square [rad/s, m/s^2], shows it on every axis."""


def check_form(block: ImuBlock) -> tuple[str, ...]:
    """Check shapes, numbers, times and live channels.

    Returns
    -------
    tuple of str
        What its reader should know.

    Raises
    ------
    DataError
        Naming the first thing that keeps any answer from being true.
    """
    n = len(block)
    for name in ("accel", "gyro"):
        shape = getattr(block, name).shape
        if shape != (n, 3):
            raise DataError(
                f"{name} of the recording has the shape {shape}, not ({n}, 3): give x, y and z of "
                "every sample"
            )
    if n < 3:
        raise DataError(f"the recording has only {n} samples; record at least one whole stride")
    accel = np.ascontiguousarray(block.accel, dtype=float)
    gyro = np.ascontiguousarray(block.gyro, dtype=float)
    of_accel, of_gyro = extent(accel), extent(gyro)
    _require_numbers(block, of_gyro, of_accel)
    notes = _check_times(np.asarray(block.t, dtype=float))
    _require_live_channels(block, of_gyro, of_accel)
    return notes


def _require_numbers(block: ImuBlock, of_gyro: FloatArray, of_accel: FloatArray) -> None:
    if not np.isfinite(block.t).all():
        raise DataError("some times of the recording are no numbers; leave these samples out")
    for told, values, word in (
        (of_gyro, block.gyro, "gyroscope"),
        (of_accel, block.accel, "accelerometer"),
    ):
        if np.isfinite(told).all():
            continue
        bad = ~np.isfinite(np.asarray(values, dtype=float))
        if bad.all():
            raise DataError(f"the recording has no {word}; a foot needs both")
        if bad.all(axis=0).any():
            axis = "xyz"[int(np.argmax(bad.all(axis=0)))]
            raise DataError(f"the {axis} axis of the {word} is missing; a foot needs all six")
        rows = np.flatnonzero(bad.any(axis=1))
        if len(rows):
            raise DataError(
                f"{len(rows)} of {len(block)} samples of the {word} are no numbers, the first at "
                f"{block.t[rows[0]]:.2f} s; leave these samples out: a gap is handled"
            )


def _check_times(t: FloatArray) -> tuple[str, ...]:
    dt = np.diff(t)
    if np.any(dt < 0.0):
        at = int(np.argmax(dt < 0.0))
        raise DataError(
            f"time goes back at {t[at]:.3f} s (by {-dt[at]:.3g} s); sort the samples, or cut the "
            "recording there"
        )
    if t[-1] == t[0]:
        raise DataError("all samples have the same time; give the times or the sample rate")
    equal = float(np.mean(dt == 0.0))
    if equal > EQUAL_SHARE:
        raise DataError(
            f"{100 * equal:.0f} % of the samples have the same time as the one before: these are "
            "times of arrival in bursts; use the times of the device, or the sample rate"
        )
    least, most = float(dt.min()), float(dt.max())
    even = 0.0 < most < EVEN * least
    usual = 0.5 * (least + most) if even else float(np.median(dt[dt > 0.0]))
    rate = 1.0 / usual
    if rate > MOST_HZ:
        raise DataError(f"by its times the recording has {rate:.3g} samples per second; {_SECONDS}")
    if rate < LEAST_HZ:
        unit = f"; {_SECONDS}" if rate < 2.0 else ""
        raise DataError(
            f"the recording has {rate:.3g} samples per second; below {LEAST_HZ:.0f} the moments "
            f"when a foot rests are missed{unit}"
        )
    if t[-1] - t[0] < LEAST_S:
        raise DataError(
            f"the recording lasts {t[-1] - t[0]:.2f} s; record at least one whole stride"
        )
    scatter = 0.0 if even else float(np.percentile(np.abs(dt - usual), 75)) / usual
    if scatter > JITTER_SHARE:
        return (
            f"the times scatter: half of the intervals are within {100 * scatter:.0f} % of "
            f"{1e3 * usual:.1f} ms or further off; if the sensor samples evenly, use its own clock",
        )
    return ()


_SECONDS = "are they in seconds? State the unit of time (--time-unit)"


def _require_live_channels(block: ImuBlock, of_gyro: FloatArray, of_accel: FloatArray) -> None:
    for values, told, most, word, unit in (
        (block.accel, of_accel, MOST_ACCEL, "accelerometer", "m/s2"),
        (block.gyro, of_gyro, MOST_GYRO, "gyroscope", "rad/s"),
    ):
        if np.abs(told[:2]).max() <= most:
            continue
        wild = np.flatnonzero((np.abs(values) > most).any(axis=1))
        if 0 < len(wild) <= max(1, int(FEW * len(block))):
            raise DataError(
                f"the {word} reads {np.abs(values[wild[0]]).max():.3g} {unit} at "
                f"{block.t[wild[0]]:.2f} s, which no foot does; leave broken samples out"
            )
    turns, shakes = (float(np.sqrt(max(told[3].sum(), 0.0))) for told in (of_gyro, of_accel))
    if not of_gyro[:2].any() and shakes > 0.0:
        raise DataError("the gyroscope reads zero throughout; a foot needs a gyroscope")
    for told, alive, word in (
        (of_gyro, turns > MOVES_RATE, "gyroscope"),
        (of_accel, shakes > MOVES_FORCE, "accelerometer"),
    ):
        dead = told[0] == told[1]
        if alive and dead.any():
            axis = "xyz"[int(np.argmax(dead))]
            raise DataError(
                f"the {axis} axis of the {word} never changes, while the others move; it is broken "
                "or the wrong column"
            )
    if shakes > MOVES_FORCE and (of_gyro[0] == of_gyro[1]).all():
        raise DataError("the gyroscope never changes, while the accelerometer does; it is broken")
