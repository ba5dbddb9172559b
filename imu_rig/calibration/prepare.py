"""Makes a recording ready for a solver: finds its stills, sets aside what cannot be used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.findings import Finding
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.magnetic import varies
from imu_rig.calibration.readings import refuse_dead_axes
from imu_rig.calibration.session import CommandedPoses, Session
from imu_rig.calibration.stills import (
    Stills,
    find_stills,
    frozen_rows,
    gaps,
    sample_rate,
    summarize,
    unbroken_windows,
)
from imu_rig.calibration.suspicion import MOVED, SATURATED_SHARE, at_limit
from imu_rig.errors import DataError, InputError

GROSSLY_MOVED = 80.0
"""Drift within a still, in its own standard errors, that makes its mean worthless."""
WARMED_C = 1.0
"""Change of temperature during a recording that is worth a sentence: half a milli-g, or so."""
RATE_SLIP = 10.0
"""Factor by which a stated sample rate may be too high so that rests look too short to be any."""
FEWEST_RESTS = 6
COPY_ROWS = 16
"""Neighbouring samples that noise never repeats in all readings."""
PLAUSIBLE_REST = (0.7, 1.4)
"""What an uncalibrated accelerometer may read at rest, over gravity."""


def prepare(
    block: ImuBlock,
    windows: Sequence[tuple[float, float]] | FloatArray | None,
    gravity: Gravity,
    commanded: CommandedPoses | None,
    accel_limit: float | None,
    gyro_limit: float | None,
) -> tuple[Session, list[str]]:
    """Return a session for a solver, and sentences about what was set aside.

    Parameters
    ----------
    block : ImuBlock
        The recording.
    windows : shape (m, 2), optional
        Begin and end of every still [s]; found where not given.
    gravity : Gravity
        Local gravity.
    commanded : CommandedPoses, optional
        One row per window; check poses are kept out.
    accel_limit, gyro_limit : float, optional
        Range limits [m/s^2, rad/s].

    Raises
    ------
    DataError
        Nothing usable is left, or the recording contradicts its units or rate.
    InputError
        Commanded angles that do not fit the windows.
    """
    refuse_dead_axes(block)
    if commanded is not None and (windows is None or len(commanded.angles_deg) != len(windows)):
        raise InputError(
            "commanded angles need one still window each: give as many windows as poses"
        )
    names: tuple[str, ...] = ()
    broken: list[str] = []
    place: IntArray | None = None
    apart = np.zeros(len(block), dtype=bool)
    if windows is None:
        stills = _find(block)
    else:
        spans = np.asarray(windows, dtype=float).reshape(-1, 2)
        names = commanded.names if commanded is not None else ()
        names = names or tuple(f"pose {i + 1}" for i in range(len(spans)))
        if commanded is not None:
            apart = _kept_apart(block, spans, commanded)
            fitted = ~np.array(commanded.check or (False,) * len(spans), dtype=bool)
            if not fitted.any():
                raise DataError("every pose is a check pose: nothing is left to calibrate from")
            place = np.flatnonzero(fitted)
            names = tuple(np.array(names, dtype=object)[fitted])
            spans, commanded = spans[fitted], commanded.only(fitted)
        whole = unbroken_windows(block, spans)
        place = np.arange(len(spans))[whole] if place is None else place[whole]
        broken = [
            f"{name} was set aside: samples are missing inside it."
            for name, keep in zip(names, whole, strict=True)
            if not keep
        ]
        names = tuple(name for name, keep in zip(names, whole, strict=True) if keep)
        commanded = _commanded_of(commanded, whole)
        stills = summarize(block, spans[whole])
    names = names or tuple(f"pose {i + 1}" for i in range(len(stills)))
    findings = _moved(stills, names)
    accel_bad, gyro_bad = at_limit(block.accel, accel_limit), at_limit(block.gyro, gyro_limit)
    frozen = frozen_rows(block)
    saturated = _saturated_axis(stills, accel_bad)
    usable = (saturated < 0) & (stills.drift <= GROSSLY_MOVED)
    findings += _saturation(block, stills, names, saturated)
    warnings = [*broken, *(finding.text for finding in findings)]
    usable &= _alive(stills, names, frozen, warnings)
    usable &= _original(block, stills, names, warnings)
    if gyro_bad.any():
        warnings.append(_gyro_saturation(gyro_bad))
    holes = len(gaps(block.t))
    if holes:
        many = "" if holes == 1 else "s"
        warnings.append(f"The recording has {holes} gap{many} in its samples; no still spans one.")
    warmth = temperature_range(block)
    if warmth is not None and warmth[1] - warmth[0] > WARMED_C:
        warnings.append(
            f"The sensor's temperature changed by {warmth[1] - warmth[0]:.1f} degC during the "
            "recording: let it warm up first."
        )
    kept = stills.only(usable)
    if len(stills):
        _plausible_rest(kept, gravity)
    session = Session(
        block=block,
        stills=kept,
        names=tuple(name for name, keep in zip(names, usable, strict=True) if keep),
        order=np.flatnonzero(usable) if place is None else place[usable],
        gravity=gravity,
        commanded=_commanded_of(commanded, usable),
        gyro_bad=gyro_bad | (frozen | apart)[:, None],
        has_gyro=has_gyro(block),
        findings=tuple(
            f if place is None else replace(f, poses=tuple(int(place[i]) for i in f.poses))
            for f in findings
        ),
    )
    return session, warnings


def _find(block: ImuBlock) -> Stills:
    """Find the stills, or say that the sample rate is wrong where that explains their lack."""
    if magnetometer_alone_fits(block):
        return find_stills(block)  # a sensor turned slowly without a gyroscope rests at any rate
    try:
        stills = find_stills(block)
    except DataError as error:
        slower = still_spans(replace(block, t=block.t * RATE_SLIP))
        if len(slower) < FEWEST_RESTS:
            raise
        raise DataError(_at_another_rate(block, len(slower))) from error
    if len(stills) < FEWEST_RESTS:
        slower = still_spans(replace(block, t=block.t * RATE_SLIP))
        if len(slower) >= max(FEWEST_RESTS, 2 * len(stills)):
            raise DataError(_at_another_rate(block, len(slower)))
    return stills


def magnetometer_alone_fits(block: ImuBlock) -> bool:
    """Whether a magnetometer is there to calibrate, and no gyroscope to tell what rested."""
    return varies(block) and not has_gyro(block)


def has_gyro(block: ImuBlock) -> bool:
    """Whether the gyroscope shows anything at all."""
    return bool(np.any(np.ptp(block.gyro, axis=0) > 0))


def _at_another_rate(block: ImuBlock, count: int) -> str:
    rate = sample_rate(block.t)
    return (
        f"with {rate:.4g} samples per second hardly any rest is long enough, but with "
        f"{rate / RATE_SLIP:.4g} there are {count}: check the sample rate or the unit of time"
    )


def _kept_apart(block: ImuBlock, spans: FloatArray, commanded: CommandedPoses) -> BoolArray:
    """Mark samples (n,) that no move of the fit may span.

    Check poses, the moves to and from them, and the sensor's being turned over.
    """
    check = np.array(commanded.check or (False,) * len(spans), dtype=bool)
    start = np.searchsorted(block.t, spans[:, 0], side="left")
    stop = np.searchsorted(block.t, spans[:, 1], side="right")
    apart = np.zeros(len(block), dtype=bool)
    for i in np.flatnonzero(check):
        apart[start[i] : stop[i]] = True
    remounted = np.diff(commanded.mountings) != 0
    for i in np.flatnonzero(check[1:] | check[:-1] | remounted):
        apart[stop[i] : start[i + 1]] = True
    return apart


def _moved(stills: Stills, names: tuple[str, ...]) -> list[Finding]:
    return [
        Finding(
            "moved",
            f"The sensor moved during {names[i]} ({stills.t0[i]:.1f} to {stills.t1[i]:.1f} s), so "
            + (
                "it was set aside"
                if stills.drift[i] > GROSSLY_MOVED
                else "its mean is taken as less certain"
            )
            + ": let it settle longer there, and hold it quite still.",
            (i,),
        )
        for i in np.flatnonzero(stills.drift > MOVED).tolist()
    ]


def _saturated_axis(stills: Stills, bad: BoolArray) -> IntArray:
    """Axis of the accelerometer (m,) that is at its range limit in each still, or -1."""
    axes = np.full(len(stills), -1)
    for i, (start, stop) in enumerate(zip(stills.start, stills.stop, strict=True)):
        share = bad[start:stop].mean(axis=0)
        if share.max() > SATURATED_SHARE:
            axes[i] = int(np.argmax(share))
    return axes


def _saturation(
    block: ImuBlock, stills: Stills, names: tuple[str, ...], saturated: IntArray
) -> list[Finding]:
    found = []
    for axis in sorted(set(saturated[saturated >= 0].tolist())):
        poses = tuple(np.flatnonzero(saturated == axis).tolist())
        extreme = max(
            float(np.abs(block.accel[stills.start[i] : stills.stop[i], axis]).max()) for i in poses
        )
        left_out = " and ".join(
            filter(None, (", ".join(names[i] for i in poses[:-1]), names[poses[-1]]))
        )
        text = (
            f"Axis {'xyz'[axis]} of the accelerometer is at its range limit ({extreme:.2f} m/s^2) "
            f"in {left_out}, left out for it: choose a larger range."
        )
        found.append(Finding("saturated", text, poses, axis="xyz"[axis], size=extreme))
    return found


def _alive(
    stills: Stills, names: tuple[str, ...], frozen: BoolArray, warnings: list[str]
) -> BoolArray:
    if frozen.any():
        warnings.append(
            f"The sensor hung: {int(frozen.sum())} samples repeat the one before in every reading; "
            "poses and moves with such samples were left out."
        )
    usable = np.ones(len(stills), dtype=bool)
    for i, (start, stop) in enumerate(zip(stills.start, stills.stop, strict=True)):
        usable[i] = not frozen[start:stop].any()
    return usable


def _original(
    block: ImuBlock, stills: Stills, names: tuple[str, ...], warnings: list[str]
) -> BoolArray:
    """Mark stills (m,) that do not repeat an earlier one sample for sample."""
    readings = np.concatenate((block.accel, block.gyro), axis=1)
    first = block.accel[:, 0]
    usable = np.ones(len(stills), dtype=bool)
    half = COPY_ROWS // 2
    for i in range(1, len(stills)):
        middle = int(stills.start[i] + stills.stop[i]) // 2
        near = readings[max(0, middle - half) : middle + half]
        if len(near) < COPY_ROWS or not np.all(np.ptp(near[:, :3], axis=0) > 0):
            continue
        alike = np.flatnonzero(first[half : stills.start[i]] == first[middle]) + half
        alike = alike[np.all(readings[alike] == readings[middle], axis=1)]
        usable[i] = not any(np.array_equal(readings[k - half : k + half], near) for k in alike)
    copies = [names[i] for i in np.flatnonzero(~usable)]
    if copies:
        also = f" and {len(copies) - 1} more repeat earlier poses" if len(copies) > 1 else ""
        warnings.append(
            f"{copies[0]}{also or ' repeats an earlier pose'} sample for sample: the recording "
            "holds copies of itself, which count once."
        )
    return usable


def _gyro_saturation(bad: BoolArray) -> str:
    counts = bad.sum(axis=0)
    parts = [f"{int(n)} of {axis}" for n, axis in zip(counts, "xyz", strict=True) if n]
    return (
        f"The gyroscope is at its range limit in some samples ({', '.join(parts)}); those moves "
        "were left out: turn more slowly or choose a larger range."
    )


def _plausible_rest(stills: Stills, gravity: Gravity) -> None:
    if not len(stills):
        raise DataError(
            "no still pose is usable: the sensor hung or is at its range limit in all of them"
        )
    rest = float(np.median(np.linalg.norm(stills.accel_mean, axis=1)))
    low, high = (gravity.value * f for f in PLAUSIBLE_REST)
    if not low < rest < high:
        raise DataError(
            f"at rest the accelerometer reads {rest:.4g} m/s^2, but gravity is "
            f"{gravity.value:.2f}: its unit or range setting is wrong"
        )


def _commanded_of(commanded: CommandedPoses | None, usable: BoolArray) -> CommandedPoses | None:
    return None if commanded is None else commanded.only(usable)


def still_spans(block: ImuBlock) -> FloatArray:
    """Begin and end (m, 2) of the stills [s]; a turntable may never rest."""
    try:
        found = find_stills(block)
    except DataError:
        return np.empty((0, 2))
    return np.stack((found.t0, found.t1), axis=1)


def temperature_range(block: ImuBlock) -> tuple[float, float] | None:
    """Lowest and highest temperature [degC]; None where none is a number."""
    if block.temperature is None:
        return None
    known = block.temperature[np.isfinite(block.temperature)]
    return (float(known.min()), float(known.max())) if len(known) else None
