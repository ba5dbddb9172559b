"""Still intervals of a recording: found from accelerometer and gyroscope, summarized honestly.

An accelerometer alone calls a slow turn about the vertical still; the gyroscope sees it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.mean_noise import mean_covariances, mean_variances, slow_terms
from imu_rig.calibration.resolution import counts_of, lost_variance
from imu_rig.errors import DataError, InputError
from imu_rig.units import DEG, MILLI_G, STANDARD_GRAVITY

WINDOW_S = 0.4
"""Length of the sliding window whose scatter and mean decide. The row in its middle is judged, so
half of it is cut from either end of a still: a jig's ring-down, a hand that lets go."""
SHORTEST_S = 0.6
"""Shortest still worth a mean."""
GAP_S = 0.1
"""A hole in the time stamps that a still or a move may not span."""
FROZEN_S = 0.1
"""Repeated readings of this length are no measurement."""
SCATTER_FACTOR = 3.0
"""A still's scatter stays below this many times the recording's own noise floor."""
TREMOR = 2.0 * DEG
"""Scatter of the rate that is still whatever the noise floor [rad/s]: a hand or a table that
trembles like this at 2 Hz tilts by 0.2 deg, which changes the mean gravity by a few ppm."""
NEVER_STILL = 60.0 * MILLI_G
"""Scatter of an accelerometer [m/s^2] that is no sensor's noise: it was in motion throughout."""
LEAST_ACCEL_NOISE = 0.2 * MILLI_G
LEAST_GYRO_NOISE = 0.005 * DEG
"""Below the noise of any sensor of the class, so that noiseless data have a floor too."""
BIAS_TOLERANCE = 0.5 * DEG
"""Most that the mean rate in a still may differ from the bias, beside noise [rad/s]: covers the
bias walk of a recording of several minutes."""
TREMOR_SHARE = 0.5
"""Part of the scatter in a window that a tremor of 1 or 2 Hz can leave in its mean."""
FEWEST_SAMPLES = 8
"""Fewer samples make no mean with an uncertainty."""


@dataclass(frozen=True, eq=False)
class Stills:
    """Means over ``m`` still intervals of one block.

    Attributes
    ----------
    start, stop : shape (m,)
        First row and one past the last row of each interval.
    t0, t1 : shape (m,)
        Time of the first and last averaged sample [s].
    accel_mean, gyro_mean : shape (m, 3)
        Means [m/s^2, rad/s].
    accel_cov : shape (m, 3, 3)
        Covariance of each mean specific force [m^2/s^4]: a hand or a table that trembles turns
        the sensor, so the axes' errors belong together and gravity's magnitude is known better
        than any axis.
    gyro_sem : shape (m, 3)
        Standard errors of the mean rates [rad/s].
    count : shape (m,)
        Samples averaged.
    drift : shape (m,)
        Difference of the two halves of the still that its slowest change makes, largest over the
        axes of the accelerometer, in the standard errors of a typical still: above 8 the sensor
        moved.
    """

    start: IntArray
    stop: IntArray
    t0: FloatArray
    t1: FloatArray
    accel_mean: FloatArray
    gyro_mean: FloatArray
    accel_cov: FloatArray
    gyro_sem: FloatArray
    count: IntArray
    drift: FloatArray

    def __len__(self) -> int:
        """Return the number of stills."""
        return int(self.start.shape[0])

    @property
    def accel_sem(self) -> FloatArray:
        """Standard errors (m, 3) of the mean specific forces, axis by axis [m/s^2]."""
        return np.asarray(np.sqrt(np.diagonal(self.accel_cov, axis1=1, axis2=2)))

    def only(self, keep: BoolArray) -> Stills:
        """Return the stills that ``keep`` (m,) marks."""
        return Stills(**{f.name: getattr(self, f.name)[keep] for f in fields(self)})


def sample_rate(t: FloatArray) -> float:
    """Median sample rate [Hz] of time stamps [s], shape (n,).

    Raises
    ------
    DataError
        Fewer than two samples, or time that does not increase.
    """
    if len(t) < 2:
        raise DataError("the recording holds fewer than two samples")
    steps = np.diff(t)
    if not np.all(steps > 0):
        raise DataError(f"time does not increase after sample {int(np.argmin(steps > 0))}")
    return float(1.0 / np.median(steps))


def gaps(t: FloatArray) -> IntArray:
    """Rows after which a hole in the time stamps follows: more than `GAP_S` and 3 samples."""
    steps = np.diff(t)
    return np.flatnonzero(steps > max(GAP_S, 3.0 * float(np.median(steps))))


def frozen_rows(block: ImuBlock) -> BoolArray:
    """Mark samples (n,) that repeat the one before in all six readings, `FROZEN_S` or longer.

    A sensor that hangs looks perfectly still. Where half of all samples repeat, the recording is
    coarse or noiseless and nothing is marked.
    """
    readings = np.concatenate((block.accel, block.gyro), axis=1)
    same = np.all(readings[1:] == readings[:-1], axis=1)
    frozen = np.zeros(len(block), dtype=bool)
    if len(same) and float(np.mean(same)) < 0.5:
        start, stop = _runs(same)
        for i, j in zip(start, stop, strict=True):
            if block.t[j] - block.t[i] > FROZEN_S:
                frozen[i + 1 : j + 1] = True
    return frozen


def find_stills(
    block: ImuBlock, *, shortest_s: float = SHORTEST_S, window_s: float = WINDOW_S
) -> Stills:
    """Find the intervals in which the sensor neither turned nor moved, and summarize them.

    A sample is still when, in the window around it, accelerometer and gyroscope scatter no more
    than `SCATTER_FACTOR` times the recording's own noise floor and the mean rate agrees with the
    bias, which is the rate that most quiet windows share. Neighbours between which nothing
    turned count as one pose, of which the longer part is kept.

    Raises
    ------
    DataError
        No still interval.
    """
    rate = sample_rate(block.t)
    width = max(8, round(window_s * rate))
    if len(block) < 2 * width:
        raise DataError(f"the recording is shorter than {2 * window_s:g} s, too short for a still")
    a_mean, a_var = _sliding(block.accel, width)
    g_mean, g_var = _sliding(block.gyro, width)
    quiet = _unbroken(np.flatnonzero(frozen_rows(block)), len(block), width)
    a_floor = _noise_floor(a_var[quiet], LEAST_ACCEL_NOISE)
    g_floor = _noise_floor(g_var[quiet], LEAST_GYRO_NOISE)
    if np.sqrt(a_floor) > NEVER_STILL:
        reads = float(np.median(np.linalg.norm(a_mean[a_var < 4.0 * a_floor], axis=1)))
        if reads > 3.0 * STANDARD_GRAVITY:
            raise DataError(
                f"in its quietest moments the accelerometer reads {reads:.4g} m/s^2, but gravity "
                f"is {STANDARD_GRAVITY:.2f}: its unit or range setting is wrong"
            )
        raise DataError(
            "the sensor was never held still: even in its quietest moments the accelerometer "
            f"scatters by {np.sqrt(a_floor) / MILLI_G:.0f} mg; hold it still for a second or two "
            "in every attitude"
        )
    quiet &= _unbroken(gaps(block.t), len(block), width)
    quiet &= a_var < SCATTER_FACTOR**2 * a_floor
    quiet &= g_var < max(SCATTER_FACTOR**2 * g_floor, TREMOR**2)
    tolerance = BIAS_TOLERANCE + 6.0 * float(np.sqrt(g_floor / width))
    bias = _shared_rate(g_mean[quiet], tolerance, step=max(1, width // 4))
    off = np.linalg.norm(g_mean - bias, axis=1)
    still = quiet & (off < tolerance + TREMOR_SHARE * np.sqrt(g_var))
    start, stop = _runs(still)
    # Window k covers rows k to k + width - 1; the run's rows are the centres of its windows.
    start, stop = start + width // 2, stop + width // 2
    keep = stop - start >= max(8, round(shortest_s * rate))
    keep &= _rests(block.gyro, start, stop, bias, tolerance)
    start, stop = _one_per_pose(block, start[keep], stop[keep])
    if not len(start):
        raise DataError(
            f"no still interval of {shortest_s:g} s or more: let the sensor rest for 2 s in every "
            "pose, on something firm"
        )
    return _summary(block, start, stop)


def unbroken_windows(block: ImuBlock, spans: FloatArray) -> BoolArray:
    """Mark the windows (m, 2) [s] that hold enough samples without a gap, shape (m,)."""
    start = np.searchsorted(block.t, spans[:, 0], side="left")
    stop = np.searchsorted(block.t, spans[:, 1], side="right")
    holes = gaps(block.t) if len(block) > 1 else np.empty(0, dtype=np.int64)
    inside = np.searchsorted(holes, stop - 1) > np.searchsorted(holes, start)
    return np.asarray((stop - start >= FEWEST_SAMPLES) & ~inside)


def summarize(block: ImuBlock, windows: Sequence[tuple[float, float]] | FloatArray) -> Stills:
    """Summarize given still intervals, e.g. the holds of a jig session.

    Parameters
    ----------
    block : ImuBlock
        The recording.
    windows : shape (m, 2)
        Begin and end of each interval [s] on ``block.t``, both included, in time order. Settling
        must be cut off already.

    Raises
    ------
    InputError
        A window that ends before it begins, or before the one ahead of it.
    DataError
        A window with fewer than 8 samples or with a gap inside.
    """
    spans = np.asarray(windows, dtype=float).reshape(-1, 2)
    start = np.searchsorted(block.t, spans[:, 0], side="left")
    stop = np.searchsorted(block.t, spans[:, 1], side="right")
    holes = gaps(block.t)
    for i, (first, last) in enumerate(zip(start, stop, strict=True)):
        if spans[i, 1] <= spans[i, 0]:
            raise InputError(f"still interval {i + 1} ends before it begins")
        if i and spans[i, 0] <= spans[i - 1, 1]:
            raise InputError(
                f"still interval {i + 1} begins before interval {i} ends: give them in time order"
            )
        if last - first < FEWEST_SAMPLES:
            raise DataError(
                f"still interval {i + 1} ({spans[i, 0]:.2f} to {spans[i, 1]:.2f} s) holds "
                f"{last - first} samples; {FEWEST_SAMPLES} are the least"
            )
        if np.any((holes >= first) & (holes < last - 1)):
            raise DataError(
                f"still interval {i + 1} ({spans[i, 0]:.2f} to {spans[i, 1]:.2f} s) spans a gap "
                "in the samples"
            )
    return _summary(block, start.astype(np.int64), stop.astype(np.int64))


def _summary(block: ImuBlock, start: IntArray, stop: IntArray) -> Stills:
    rate = sample_rate(block.t)
    rows = list(zip(start, stop, strict=True))
    count = stop - start
    accel = [slow_terms(block.accel[i:j], rate) for i, j in rows]
    gyro = [slow_terms(block.gyro[i:j], rate) for i, j in rows]
    means = np.array([block.accel[i:j].mean(axis=0) for i, j in rows]).reshape(-1, 3)
    least = LEAST_ACCEL_NOISE**2 / count, LEAST_GYRO_NOISE**2 / count
    hidden = [_hidden(getattr(block, sensor), sensor, rows) for sensor in ("accel", "gyro")]
    return Stills(
        start=start,
        stop=stop,
        t0=block.t[start],
        t1=block.t[stop - 1],
        accel_mean=means,
        gyro_mean=np.array([block.gyro[i:j].mean(axis=0) for i, j in rows]).reshape(-1, 3),
        accel_cov=mean_covariances(accel, count, means)
        + (least[0][:, None] + hidden[0])[:, :, None] * np.eye(3),
        gyro_sem=np.sqrt(mean_variances(gyro, count) + least[1][:, None] + hidden[1]),
        count=count,
        drift=_drift(accel),
    )


def _hidden(values: FloatArray, sensor: str, rows: list[tuple[int, int]]) -> FloatArray:
    """Variance (m, 3) that the counts of a sensor hide of its means.

    A gyroscope reads the same in all stills, and errs in all of them alike: to stay so large in
    what is found from all, the variance of each is so many times as large.
    """
    if not rows:
        return np.zeros((0, 3))
    variance = np.array([values[i:j].var(axis=0) for i, j in rows])
    means = np.array([values[i:j].mean(axis=0) for i, j in rows])
    hidden = lost_variance(variance, means, counts_of(values, sensor))
    return hidden * len(rows) if sensor == "gyro" else hidden


def _drift(terms: list[FloatArray]) -> FloatArray:
    """Size (m,) of the slowest change within each still, see `Stills`."""
    if not terms:
        return np.empty(0)
    variance = np.array([np.mean(c**2, axis=0) for c in terms])
    dof = np.array([float(len(c)) for c in terms])[:, None]
    # The median of a chi-square variable over its degrees of freedom (Wilson and Hilferty).
    typical = np.median(variance / (1.0 - 2.0 / (9.0 * dof)) ** 3, axis=0)
    typical = np.maximum(typical, LEAST_ACCEL_NOISE**2)
    slowest = np.array([c[0] for c in terms])
    # A steady drift that separates the halves by one standard error has a first term of this.
    unit = 8.0 * np.sqrt(2.0) / np.pi**2
    return np.asarray(np.max(np.abs(slowest) / (unit * np.sqrt(typical)), axis=1))


def _sliding(x: FloatArray, width: int) -> tuple[FloatArray, FloatArray]:
    """Mean (k, 3) and summed variance (k,) of every window of ``width`` rows."""
    centred = x - np.median(x, axis=0)
    zero = np.zeros((1, 3))
    total = np.concatenate((zero, np.cumsum(centred, axis=0)))
    square = np.concatenate((zero, np.cumsum(centred**2, axis=0)))
    mean = (total[width:] - total[:-width]) / width
    variance = (square[width:] - square[:-width]) / width - mean**2
    return mean + np.median(x, axis=0), np.clip(variance, 0.0, None).sum(axis=1)


def _noise_floor(variance: FloatArray, least: float) -> float:
    """Typical summed variance of a quiet window, grown from the quietest ones."""
    if not len(variance):
        return 3.0 * least**2
    floor = max(float(np.quantile(variance, 0.02)), 3.0 * least**2)
    for _ in range(20):
        grown = max(float(np.median(variance[variance < 4.0 * floor])), 3.0 * least**2)
        if abs(grown - floor) < 0.01 * floor:
            break
        floor = grown
    return floor


def _unbroken(breaks: IntArray, count: int, width: int) -> BoolArray:
    """Which windows of ``width`` rows hold none of the rows ``breaks`` but as their last."""
    broken = np.zeros(count, dtype=np.int64)
    broken[breaks] = 1
    total = np.concatenate(([0], np.cumsum(broken)))
    return np.asarray(total[width - 1 : -1] - total[:-width] == 0)


def _shared_rate(rates: FloatArray, tolerance: float, *, step: int) -> FloatArray:
    """Return the rate that most of the quiet windows (k, 3) agree on: the bias."""
    if not len(rates):
        return np.zeros(3)
    rates = rates[:: max(step, len(rates) // 500 + 1)]
    # Every still shares the bias; slow turns differ from one another. So: the densest place.
    distance = np.linalg.norm(rates[:, None, :] - rates[None, :, :], axis=-1)
    bias = rates[int(np.argmax(np.sum(distance < tolerance, axis=1)))]
    for _ in range(5):
        bias = np.median(rates[np.linalg.norm(rates - bias, axis=1) < tolerance], axis=0)
    return np.asarray(bias)


def _rests(
    gyro: FloatArray, start: IntArray, stop: IntArray, bias: FloatArray, tolerance: float
) -> BoolArray:
    """Which intervals turn, over their whole length, no faster than the bias explains."""
    total = np.concatenate((np.zeros((1, 3)), np.cumsum(gyro - bias, axis=0)))
    mean = (total[stop] - total[start]) / (stop - start)[:, None]
    return np.asarray(np.linalg.norm(mean, axis=1) < tolerance)


def _runs(mask: BoolArray) -> tuple[IntArray, IntArray]:
    edges = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def _one_per_pose(block: ImuBlock, start: IntArray, stop: IntArray) -> tuple[IntArray, IntArray]:
    """Of neighbours that nothing turned apart, keep the longer."""
    kept: list[tuple[int, int]] = []
    for i, j in zip(start.tolist(), stop.tolist(), strict=True):
        if kept and _same_pose(block, kept[-1], (i, j)):
            if j - i > kept[-1][1] - kept[-1][0]:
                kept[-1] = (i, j)
        else:
            kept.append((i, j))
    pairs = np.array(kept, dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _same_pose(block: ImuBlock, first: tuple[int, int], second: tuple[int, int]) -> bool:
    bias = block.gyro[first[0] : first[1]].mean(axis=0)
    rows = slice(first[1] - 1, second[0] + 1)
    steps = np.diff(block.t[rows])[:, None]
    turned = np.sum((block.gyro[rows][1:] - bias) * steps, axis=0)
    up = [block.accel[i:j].mean(axis=0) for i, j in (first, second)]
    tilted = np.linalg.norm(np.cross(*up)) / (np.linalg.norm(up[0]) * np.linalg.norm(up[1]))
    return bool(np.linalg.norm(turned) < 3.0 * DEG and tilted < 2.0 * DEG)
