"""Noise of a sensor at rest: from a recording to coefficients with their evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

import imu_rig
from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.allan import AllanCurve, Correlation, allan_curve
from imu_rig.calibration.allan_fit import AllanFit, Coefficient, fit_curve
from imu_rig.calibration.certificate_parts import DeviceEntry, RecordingEntry
from imu_rig.calibration.noise_model import AxisNoise, NoiseCoefficient, NoiseModel, SensorNoise
from imu_rig.calibration.readings import require_readings
from imu_rig.calibration.result import DeviceInfo
from imu_rig.calibration.stills import WINDOW_S, find_stills, gaps, sample_rate
from imu_rig.calibration.temperature import believable
from imu_rig.errors import DataError
from imu_rig.units import DEG

SENSORS = {"accel": "accelerometer", "gyro": "gyroscope", "mag": "magnetometer"}
SHORTEST_S = 10.0
"""Shortest rest from which even white noise is told."""
FEWEST = 200
CHUNK = 1 << 18
"""Samples in which rests are looked for at a time: bounds memory."""
SAME_POSE = 2.0 * DEG
"""Stretches on both sides of a gap count as one rest when gravity turned no more than this."""
WORTH_A_WORD = 0.05
"""Part of the recording that may be left out without a word."""
CLIPPED_SHARE = 0.2
"""Part of the samples at their extreme that means the range limit, where values vary at all."""
PEAK_TIME = 1.89
"""Averaging time, over the correlation time, at which the Allan deviation of a first-order
Gauss-Markov process peaks."""

Rows = tuple[int, int]
"""First row and one past the last."""


@dataclass(frozen=True, eq=False)
class AxisCurve:
    """Allan curve of one axis and the model fitted to it."""

    curve: AllanCurve
    fit: AllanFit


@dataclass(frozen=True, eq=False)
class NoiseAnalysis:
    """Noise of a sensor at rest.

    Attributes
    ----------
    model : NoiseModel
        What filters need.
    curves : dict
        Three axes by the sensor's name: "accel", "gyro" or "mag".
    span_s : (float, float)
        Begin and end of the rest that was used, on the time of the block [s].
    """

    model: NoiseModel
    curves: dict[str, tuple[AxisCurve, AxisCurve, AxisCurve]]
    span_s: tuple[float, float]


def analyse_noise(
    block: ImuBlock,
    *,
    device: DeviceInfo | None = None,
    recording: tuple[str, str] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> NoiseAnalysis:
    """Find the noise of accelerometer, gyroscope and, where there is one, magnetometer.

    Parameters
    ----------
    block : ImuBlock
        A recording of the sensor at rest, nominally scaled. Where it moved, the longest rest is
        used; gaps divide a rest into stretches that are combined.
    device : DeviceInfo, optional
        Which sensor.
    recording : (str, str), optional
        File name and SHA-256 (hexadecimal).
    progress : callable
        Told the part that is done, 0 to 1.

    Raises
    ------
    DataError
        Data that are not numbers, never at rest for 10 s, at the range limit or constant.
    """
    block = require_readings(block)
    block, unlikely = believable(block)
    sample_rate(block.t)  # refuses time that does not increase
    parts = _rest(block, progress)
    steps = sum(j - i - 1 for i, j in parts)
    length = float(sum(block.t[j - 1] - block.t[i] for i, j in parts))
    period = length / steps
    warnings = unlikely + _left_out(block, parts, length)
    curves: dict[str, tuple[AxisCurve, AxisCurve, AxisCurve]] = {}
    correlation: Correlation | None = None
    for number, (name, title) in enumerate(SENSORS.items()):
        values: FloatArray | None = getattr(block, name)
        if values is None or not _is_alive(values, parts, title, warnings):
            continue
        found = []
        for axis in range(3):
            curve = allan_curve([np.ascontiguousarray(values[i:j, axis]) for i, j in parts], period)
            correlation = correlation or Correlation(curve)
            found.append(AxisCurve(curve, fit_curve(curve, correlation)))
            progress(0.4 + 0.6 * (3 * number + axis + 1) / 9)
        curves[name] = (found[0], found[1], found[2])
    if not curves:
        raise DataError(
            "neither accelerometer nor gyroscope shows any noise: every axis is constant"
        )
    sensors = {name: _sensor_noise(axes) for name, axes in curves.items()}
    for name, axes in curves.items():
        warnings += _warnings(SENSORS[name], axes, sensors[name], length)
    model = NoiseModel(
        date=datetime.now(UTC).replace(microsecond=0),
        software=f"imu-rig {imu_rig.__version__}",
        device=DeviceEntry.of(device or DeviceInfo()),
        rate_hz=1.0 / period,
        duration_s=length,
        accel=sensors.get("accel"),
        gyro=sensors.get("gyro"),
        mag=sensors.get("mag"),
        temperature_c=_temperatures(block, parts),
        warnings=tuple(warnings),
        recording=None if recording is None else RecordingEntry.of(*recording),
    )
    return NoiseAnalysis(
        model, curves, (float(block.t[parts[0][0]]), float(block.t[parts[-1][1] - 1]))
    )


def _rest(block: ImuBlock, progress: Callable[[float], None]) -> list[Rows]:
    """Longest rest, and the others in the same pose: on the other side of gaps, as a rule."""
    edges = np.concatenate(([0], gaps(block.t) + 1, [len(block)]))
    rests: list[Rows] = []
    reason: DataError | None = None
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        try:
            rests += _rests_between(block, begin, end)
        except DataError as error:
            reason = error
        progress(0.4 * end / len(block))
    if not rests:
        raise reason or DataError("the recording holds no rest")
    longest = max(rests, key=lambda rest: rest[1] - rest[0])
    up = _up(block, longest)
    # Stretches much shorter than the longest would add effort and nothing else.
    parts = [
        rest
        for rest in rests
        if rest[1] - rest[0] >= 0.02 * (longest[1] - longest[0])
        and np.linalg.norm(_up(block, rest) - up) < SAME_POSE
    ]
    seconds = float(block.t[longest[1] - 1] - block.t[longest[0]])
    if longest[1] - longest[0] < FEWEST or seconds < SHORTEST_S:
        raise DataError(
            f"the longest rest in the recording is {seconds:.1f} s "
            f"({longest[1] - longest[0]} samples), too short to tell noise: record at least 10 "
            "minutes, better an hour, with the sensor on something heavy that nobody touches"
        )
    return parts


def _rests_between(block: ImuBlock, begin: int, end: int) -> list[Rows]:
    """Rests in rows that no gap breaks: looked for in overlapping chunks and joined again."""
    margin = round(2 * WINDOW_S * sample_rate(block.t[begin:end]))
    found: list[Rows] = []
    reason: DataError | None = None
    for first in range(begin, end, CHUNK):
        last = min(first + CHUNK + 2 * margin, end)
        try:
            stills = find_stills(block[first:last])
        except DataError as error:
            reason = error
            continue
        for i, j in zip(
            (stills.start + first).tolist(), (stills.stop + first).tolist(), strict=True
        ):
            # The finder cuts half a window from either end, which at the end of data is too much.
            start = begin if first == begin and i - begin <= margin else i
            stop = end if last == end and end - j <= margin else j
            if found and start <= found[-1][1]:
                found[-1] = (found[-1][0], max(stop, found[-1][1]))
            else:
                found.append((start, stop))
        if last == end:
            break
    if not found and reason is not None:
        raise reason
    return found


def _up(block: ImuBlock, rest: Rows) -> FloatArray:
    mean = block.accel[rest[0] : rest[1]].mean(axis=0)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-9))


def _left_out(block: ImuBlock, parts: list[Rows], length: float) -> list[str]:
    total = float(block.t[-1] - block.t[0])
    if length > (1.0 - WORTH_A_WORD) * total:
        return []
    begin, end = block.t[parts[0][0]] - block.t[0], block.t[parts[-1][1] - 1] - block.t[0]
    return [
        f"The sensor was not at rest all the time, or samples are missing: of {total:.0f} s only "
        f"{length:.0f} s were used (between {begin:.0f} and {end:.0f} s)."
    ]


def _is_alive(values: FloatArray, parts: list[Rows], title: str, warnings: list[str]) -> bool:
    dead, clipped = [], []
    for axis, letter in enumerate("xyz"):
        x = np.concatenate([values[i:j, axis] for i, j in parts])
        if not np.all(np.isfinite(x)):
            warnings.append(f"The {title} has values that are not numbers and was left out.")
            return False
        low, high = float(x.min()), float(x.max())
        if low == high:
            dead.append(letter)
        elif _is_clipped(x, low) or _is_clipped(x, high):
            clipped.append(letter)
    if len(dead) == 3:
        return False
    if dead:
        raise DataError(
            f"the {title}'s {', '.join(dead)} never changes: a dead axis, or a resolution too "
            "coarse to show its noise"
        )
    if clipped:
        raise DataError(
            f"the {title}'s {', '.join(clipped)} is at its range limit: choose a larger range"
        )
    return True


def _is_clipped(x: FloatArray, extreme: float) -> bool:
    """Whether an extreme is where a range ends: too frequent, though other values vary."""
    if float(np.mean(x == extreme)) < CLIPPED_SHARE:
        return False
    return len(np.unique(x[: 1 << 16])) > 8


def _temperatures(block: ImuBlock, parts: list[Rows]) -> tuple[float, float] | None:
    if block.temperature is None:
        return None
    used = [block.temperature[i:j] for i, j in parts]
    low, high = min(float(x.min()) for x in used), max(float(x.max()) for x in used)
    return (low, high) if np.isfinite(low) and np.isfinite(high) else None


def _sensor_noise(axes: tuple[AxisCurve, AxisCurve, AxisCurve]) -> SensorNoise:
    x, y, z = (_axis_noise(axis.curve, axis.fit) for axis in axes)
    return SensorNoise(x=x, y=y, z=z)


def _axis_noise(curve: AllanCurve, fit: AllanFit) -> AxisNoise:
    quantization, white, flicker, walk, ramp = (_entry(c) for c in fit.coefficients)
    lowest = int(np.argmin(curve.deviation))
    return AxisNoise(
        white=white,
        instability=flicker,
        walk=walk,
        quantization=quantization,
        ramp=ramp,
        floor=float(curve.deviation[lowest]),
        floor_s=float(curve.tau[lowest]),
        # A bias that is seen to walk is best modelled as a walk, whatever the time of the floor.
        correlation_time_s=None if flicker.value is None else _floor_time(curve, fit) / PEAK_TIME,
    )


def _floor_time(curve: AllanCurve, fit: AllanFit) -> float:
    """Averaging time at which the model is smallest, or flat within 2 % for the first time [s]."""
    tau = np.geomspace(curve.tau[0], curve.tau[-1], 500)
    variance = fit.variance(tau)
    return float(tau[np.argmax(variance < 1.02**2 * variance.min())])


def _entry(coefficient: Coefficient) -> NoiseCoefficient:
    return NoiseCoefficient(
        value=coefficient.value,
        standard_uncertainty=coefficient.sigma,
        low=coefficient.low,
        high=coefficient.high,
    )


def _warnings(
    title: str, axes: tuple[AxisCurve, AxisCurve, AxisCurve], noise: SensorNoise, length: float
) -> list[str]:
    warnings = []
    unknown = [c for c, axis in zip("xyz", noise, strict=True) if _only_white(axis)]
    if unknown:
        warnings.append(
            f"The record ({length / 60.0:.1f} min) is too short to determine the bias instability "
            f"and the random walk of the {title} ({', '.join(unknown)}): upper bounds are stated "
            f"instead. Record for {_longer(length)}."
        )
    drifting = [c for c, axis in zip("xyz", noise, strict=True) if axis.ramp.value is not None]
    if drifting:
        warnings.append(
            f"The {title} drifts steadily ({', '.join(drifting)}), as while it warms up: let it "
            "run for half an hour before the recording."
        )
    late = max(axis.fit.used[0] for axis in axes)
    if late > axes[0].curve.tau[0]:
        warnings.append(
            f"Averaging times below {late:.3g} s were left out of the {title}'s fit: there the "
            "noise is not white, as after a low-pass filter or under vibration."
        )
    for letter, axis in zip("xyz", axes, strict=True):
        if axis.fit.off_model is not None:
            low, high = axis.fit.off_model
            warnings.append(
                f"The {title}'s {letter} contradicts the noise model at averaging times of "
                f"{low:.3g} to {high:.3g} s: vibration, a filter or a change of temperature; look "
                "at the plot before you trust the coefficients."
            )
    return warnings


def _only_white(axis: AxisNoise) -> bool:
    """Whether nothing slower than white noise is determined."""
    return all(c.value is None for c in (axis.instability, axis.walk, axis.ramp))


def _longer(length: float) -> str:
    return "an hour" if length < 1800.0 else f"more than {2.0 * length / 3600.0:.0f} hours"
