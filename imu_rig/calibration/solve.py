"""The front door of calibration: a recording in, a result with its evidence out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.ferraris import ferraris
from imu_rig.calibration.findings import Finding
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.joint import joint
from imu_rig.calibration.known import Known, windows_with
from imu_rig.calibration.magnetometer_beside import (
    MAGNETOMETER,
    magnetometer_alone,
    magnetometer_beside,
)
from imu_rig.calibration.multi_position import multi_position, static
from imu_rig.calibration.paper_method import paper, paper_diagonal
from imu_rig.calibration.result import (
    CalibrationResult,
    DeviceInfo,
    ErrorStages,
    ErrorSummary,
    MoveRow,
    PoseRow,
)
from imu_rig.calibration.session import CommandedPoses, Outcome, Session
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
from imu_rig.calibration.temperature import sensitivity
from imu_rig.calibration.turntable import turntable
from imu_rig.calibration.verification import Limits, Scatter, Verification, checks_of, verify
from imu_rig.errors import DataError, InputError

METHODS: dict[str, Callable[[Session], Outcome]] = {
    "joint": joint,
    "static": static,
    "ferraris": ferraris,
    "turntable": turntable,
    "multi-position": multi_position,
    "paper": paper,
    "paper-diagonal": paper_diagonal,
}
"""Every solver by the name that options and certificates use."""

DEFAULT_METHOD = "auto"
"""The method that a recording calls for; see `chosen_method`."""
WARMED_C = 3.0
RATE_SLIP = 10.0
"""Factor by which a stated sample rate may be too high so that rests look too short to be any."""
FEWEST_RESTS = 6
COPY_ROWS = 16
"""Neighbouring samples that noise never repeats in all readings."""
PLAUSIBLE_REST = (0.7, 1.4)
"""What an uncalibrated accelerometer may read at rest, over gravity."""


def solve(
    block: ImuBlock,
    windows: Sequence[tuple[float, float]] | FloatArray | None = None,
    *,
    method: str = DEFAULT_METHOD,
    gravity: Gravity | float | None = None,
    commanded: CommandedPoses | None = None,
    device: DeviceInfo | None = None,
    accel_limit: float | None = None,
    gyro_limit: float | None = None,
    limits: Limits | None = None,
    known: Known | None = None,
    field_ut: float | None = None,
) -> CalibrationResult:
    """Calibrate accelerometer and gyroscope from a recording of still poses and moves.

    A magnetometer is calibrated beside them; where that fails, a warning says why.

    Parameters
    ----------
    block : ImuBlock
        The recording, nominally scaled.
    windows : shape (m, 2), optional
        Begin and end of every still [s] on ``block.t``, settling cut off; found automatically
        where not given.
    method : str
        A name in `METHODS`, ``"auto"`` for what `chosen_method` takes, or ``"magnetometer"``,
        which calibrates nothing else.
    gravity : Gravity or float, optional
        Local gravity, a number in m/s^2; standard gravity by default, which the result states.
    commanded : CommandedPoses, optional
        Angles the jig was told to take, one row per window; needs ``windows``.
    device : DeviceInfo, optional
        Which sensor.
    accel_limit, gyro_limit : float, optional
        Range limits [m/s^2, rad/s]; recognized by repeated extremes where not given.
    limits : Limits, optional
        Largest errors with which commanded check poses pass; they never take part in the fit.
    known : Known, optional
        Facts that some methods need: named parts, known rates.
    field_ut : float, optional
        Magnitude of the magnetic field [uT], where it is known.

    Raises
    ------
    DataError
        Data that cannot determine the calibration, with what to record in addition.
    InputError
        Arguments that do not fit each other.
    """
    local = Gravity.given(gravity) if isinstance(gravity, float | int) else gravity or Gravity()
    if method == MAGNETOMETER:
        return magnetometer_alone(block, local, device or DeviceInfo(), field_ut)
    method = chosen_method(method, on_jig=commanded is not None)
    facts = known or Known()
    if windows is None and facts.spans:
        windows = windows_with(facts, _stills_if_any(block))
    session, warnings = _prepare(block, windows, local, commanded, accel_limit, gyro_limit)
    session = replace(session, known=facts)
    outcome = METHODS[method](session)
    thermal = sensitivity(session, outcome)
    if thermal is not None:
        session, outcome = thermal.session, thermal.outcome
        warnings += thermal.notes
    result = _result(session, outcome, method, device or DeviceInfo(), warnings)
    result = replace(result, temperature=None if thermal is None else thermal.term)
    mag, more = magnetometer_beside(session, outcome, field_ut)
    result = replace(result, mag=mag, warnings=(*result.warnings, *more))
    if commanded is None or not any(commanded.check):
        return result
    verification = _verification(
        block, windows, commanded, result, limits or Limits(), accel_limit, gyro_limit
    )
    return replace(result, verification=verification)


def _stills_if_any(block: ImuBlock) -> FloatArray:
    """Begin and end (m, 2) of the stills [s]; a turntable may never rest."""
    try:
        found = find_stills(block)
    except DataError:
        return np.empty((0, 2))
    return np.stack((found.t0, found.t1), axis=1)


def chosen_method(method: str, *, on_jig: bool) -> str:
    """Return the method's own name; for ``"auto"`` joint on a jig and multi-position by hand.

    Raises
    ------
    InputError
        There is no such method.
    """
    if method == DEFAULT_METHOD:
        return "joint" if on_jig else "multi-position"
    if method not in METHODS:
        names = ", ".join((*METHODS, MAGNETOMETER))
        raise InputError(f"there is no method {method!r}; choose one of {names}")
    return method


def _verification(
    block: ImuBlock,
    windows: Sequence[tuple[float, float]] | FloatArray | None,
    commanded: CommandedPoses,
    result: CalibrationResult,
    limits: Limits,
    accel_limit: float | None,
    gyro_limit: float | None,
) -> Verification:
    spans = np.asarray(windows, dtype=float).reshape(-1, 2)
    checks = checks_of(
        block,
        spans,
        commanded.names or tuple(f"pose {i + 1}" for i in range(len(spans))),
        np.array(commanded.check),
        limits,
        mounting=commanded.mounting,
        accel_limit=accel_limit,
        gyro_limit=gyro_limit,
    )
    return verify(
        result.accel,
        result.gyro,
        checks,
        result.gravity.value,
        limits=limits,
        scatter=Scatter.of(result.accel_errors, result.gyro_errors),
    )


def _prepare(
    block: ImuBlock,
    windows: Sequence[tuple[float, float]] | FloatArray | None,
    gravity: Gravity,
    commanded: CommandedPoses | None,
    accel_limit: float | None,
    gyro_limit: float | None,
) -> tuple[Session, list[str]]:
    if not (np.all(np.isfinite(block.accel)) and np.all(np.isfinite(block.gyro))):
        raise DataError("the recording holds values that are not numbers")
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
    usable = saturated < 0
    findings += _saturation(block, stills, names, saturated)
    warnings = [*broken, *(finding.text for finding in findings)]
    usable &= _alive(stills, names, frozen, warnings)
    usable &= _original(block, stills, names, warnings)
    if gyro_bad.any():
        warnings.append(_gyro_saturation(gyro_bad))
    holes = len(gaps(block.t))
    if holes:
        warnings.append(f"The recording has {holes} gap(s) in its samples; no still spans one.")
    warmth = _temperature_range(block)
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
        has_gyro=bool(np.any(np.ptp(block.gyro, axis=0) > 0)),
        findings=tuple(
            f if place is None else replace(f, poses=tuple(int(place[i]) for i in f.poses))
            for f in findings
        ),
    )
    return session, warnings


def _find(block: ImuBlock) -> Stills:
    """Find the stills, or say that the sample rate is wrong where that explains their lack."""
    try:
        stills = find_stills(block)
    except DataError as error:
        slower = _stills_if_any(replace(block, t=block.t * RATE_SLIP))
        if len(slower) < FEWEST_RESTS:
            raise
        raise DataError(_at_another_rate(block, len(slower))) from error
    if len(stills) < FEWEST_RESTS:
        slower = _stills_if_any(replace(block, t=block.t * RATE_SLIP))
        if len(slower) >= max(FEWEST_RESTS, 2 * len(stills)):
            raise DataError(_at_another_rate(block, len(slower)))
    return stills


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
            f"The sensor moved during {names[i]} ({stills.t0[i]:.1f} to {stills.t1[i]:.1f} s).",
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


def _temperature_range(block: ImuBlock) -> tuple[float, float] | None:
    """Lowest and highest temperature [degC]; None where none is a number."""
    if block.temperature is None:
        return None
    known = block.temperature[np.isfinite(block.temperature)]
    return (float(known.min()), float(known.max())) if len(known) else None


def _commanded_of(commanded: CommandedPoses | None, usable: BoolArray) -> CommandedPoses | None:
    return None if commanded is None else commanded.only(usable)


def _result(
    session: Session,
    outcome: Outcome,
    method: str,
    device: DeviceInfo,
    warnings: list[str],
) -> CalibrationResult:
    block, g = session.block, session.gravity.value
    poses, moves = _poses(session, outcome), _moves(session, outcome)
    held_out = np.array([np.nan if p.left_out is None else p.left_out for p in poses])
    gyro_held = np.array([np.nan if m.held_out_rad is None else m.held_out_rad for m in moves])
    return CalibrationResult(
        method=method,
        device=device,
        gravity=session.gravity,
        frame=outcome.frame,
        accel=outcome.accel.affine,
        gyro=None if outcome.gyro is None else outcome.gyro.affine,
        poses=poses,
        moves=moves,
        accel_errors=ErrorStages(
            ErrorSummary.of(np.linalg.norm(session.stills.accel_mean, axis=1) - g),
            ErrorSummary.of(np.array([p.after for p in poses])),
            ErrorSummary.of(held_out),
        ),
        gyro_errors=ErrorStages(
            ErrorSummary.of(np.array([m.before_rad for m in moves])),
            ErrorSummary.of(np.array([m.after_rad for m in moves])),
            ErrorSummary.of(gyro_held),
        ),
        rate_hz=sample_rate(block.t),
        duration_s=float(block.t[-1] - block.t[0]),
        temperature_c=_temperature_range(block),
        warnings=(*warnings, *outcome.warnings),
        accel_at_zero=outcome.accel_at_zero,
        straightness=outcome.straightness,
        jig=outcome.jig,
        findings=(
            *session.findings,
            *(
                replace(f, poses=tuple(int(session.order[i]) for i in f.poses))
                for f in outcome.findings
            ),
        ),
    )


def _poses(session: Session, outcome: Outcome) -> tuple[PoseRow, ...]:
    stills, accel, g = session.stills, outcome.accel, session.gravity.value
    calibrated = accel.affine.apply(stills.accel_mean)
    size = np.linalg.norm(calibrated, axis=1)
    raw = np.linalg.norm(stills.accel_mean, axis=1)
    angles = None if session.commanded is None else session.commanded.angles_deg.tolist()
    return tuple(
        PoseRow(
            name=session.names[i],
            t0=float(stills.t0[i]),
            t1=float(stills.t1[i]),
            count=int(stills.count[i]),
            direction=calibrated[i] / size[i],
            before=float(raw[i] - g),
            after=float(size[i] - g),
            sigma=float(accel.sigma[i]),
            left_out=_known(accel.left_out[i]),
            left_out_sigma=_known(accel.left_out_sigma[i]),
            commanded_deg=None if angles is None else tuple(angles[i]),
            vector_error=None if accel.vector_error is None else accel.vector_error[i],
        )
        for i in range(len(stills))
    )


def _moves(session: Session, outcome: Outcome) -> tuple[MoveRow, ...]:
    gyro = outcome.gyro
    if gyro is None:
        return ()
    rows = []
    for i in range(len(gyro.first)):
        vector = None if gyro.vector_error is None else gyro.vector_error[i]
        rows.append(
            MoveRow(
                start=session.names[gyro.first[i]],
                stop=session.names[gyro.last[i]],
                angle_rad=float(gyro.angle[i]),
                before_rad=float(gyro.before[i]),
                after_rad=float(gyro.after[i]),
                held_out_rad=_known(gyro.held_out[i]),
                sigma_rad=_known(gyro.sigma[i]),
                vector_error=None if vector is None or np.isnan(vector).any() else vector,
            )
        )
    return tuple(rows)


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
