"""The front door of calibration: a recording in, a result with its evidence out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.evidence import result_of
from imu_rig.calibration.ferraris import ferraris
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
from imu_rig.calibration.prepare import magnetometer_alone_fits, prepare, still_spans
from imu_rig.calibration.readings import require_readings
from imu_rig.calibration.result import CalibrationResult, DeviceInfo
from imu_rig.calibration.session import CommandedPoses, Outcome, Session
from imu_rig.calibration.temperature import believable, sensitivity
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
    block, notes = believable(block)
    if method == MAGNETOMETER:
        alone = magnetometer_alone(block, local, device or DeviceInfo(), field_ut)
        return replace(alone, warnings=(*notes, *alone.warnings))
    block = require_readings(block)
    method = chosen_method(method, on_jig=commanded is not None)
    facts = known or Known()
    if windows is None and facts.spans:
        windows = windows_with(facts, still_spans(block))
    try:
        session, warnings = prepare(block, windows, local, commanded, accel_limit, gyro_limit)
        session = replace(session, known=facts)
        outcome = METHODS[method](session)
    except DataError as error:
        if not magnetometer_alone_fits(block):
            raise
        raise DataError(
            f"{error}. There is a magnetometer and no gyroscope: to calibrate the magnetometer "
            f"alone, which needs no rests, take --method {MAGNETOMETER}"
        ) from error
    warnings = [*notes, *warnings]
    thermal = sensitivity(session, outcome)
    if thermal is not None:
        session, outcome = thermal.session, thermal.outcome
        warnings += thermal.notes
    result = result_of(session, outcome, method, device or DeviceInfo(), warnings)
    result = replace(result, temperature=None if thermal is None else thermal.term)
    mag, more = magnetometer_beside(session, outcome, field_ut)
    result = replace(result, mag=mag, warnings=(*result.warnings, *more))
    if commanded is None or not any(commanded.check):
        return result
    verification = _verification(
        block, windows, commanded, result, limits or Limits(), accel_limit, gyro_limit
    )
    return replace(result, verification=verification)


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
