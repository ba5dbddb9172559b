"""What a calibration amounts to, in plain words."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imu_rig.calibration.findings import by_importance
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.result import CalibrationResult, ErrorStages, ErrorSummary
from imu_rig.report.facts import SessionSummary
from imu_rig.report.numbers import counted, significant
from imu_rig.units import DEG, MILLI_G

METHODS = {
    "joint": "sensor and jig together; the sensor rests on the magnitude of gravity and the "
    "gyroscope’s turns, the servos count no more than they repeat",
    "static": "the magnitude of gravity in still poses, for an accelerometer alone",
    "ferraris": "six faces of a block and three turns of known angle",
    "turntable": "known rates of a turntable",
    "paper": "the published least squares, which trusts the commanded angles of the jig",
    "paper-diagonal": "the published least squares with gain and offset per axis only, which "
    "trusts the commanded angles of the jig",
    "magnetometer": "the constant magnitude of the magnetic field and its constant angle to "
    "gravity",
    "multi-position": "multi-position least squares, which trusts gravity alone and needs no "
    "commanded angles",
}
TRUST_FROM = 8
"""Left-out poses from which on the ratio of error to prediction says something."""
TRUST_BELOW = 2.0
"""Left-out errors so many times their prediction show that the uncertainties are too small."""


@dataclass(frozen=True)
class Verdict:
    """The head of a report.

    Attributes
    ----------
    headline : str
        One line.
    sentences : tuple of str
        What was calibrated, how, and how good it is.
    attention : tuple of str
        Everything that a careful reader must know before using the calibration.
    """

    headline: str
    sentences: tuple[str, ...]
    attention: tuple[str, ...]


def verdict(result: CalibrationResult, session: SessionSummary | None = None) -> Verdict:
    """Put a result into words."""
    checked = result.verification
    failed = checked is not None and not checked.passed
    reasons = () if checked is None else checked.reasons or (checked.headline,) * failed
    attention = (
        *reasons,
        *by_importance(result.findings, result.warnings),
        *_own_observations(result, session),
    )
    sensors = _calibrated(result)
    if checked is not None and failed:
        headline = checked.headline
    elif attention:
        headline = f"{sensors} calibrated, with {counted(len(attention), 'point')} to heed"
    else:
        headline = f"{sensors} calibrated; nothing needs attention"
    sentences = [_what(result, session)]
    if checked is not None and not failed:
        sentences.append(checked.headline)
    if result.has_accel:
        sentences.append(_accelerometer(result))
    if result.gyro is not None:
        sentences.append(_gyroscope(result))
    ratio = left_out_ratio(result)
    if ratio is not None:
        sentences.append(
            f"Errors of left-out poses are {significant(ratio, 2)} times as large as predicted "
            "(root mean square); near 1, the stated uncertainties are true."
        )
    if result.gravity.known:
        sentences.append(gravity_sentence(result.gravity))
    return Verdict(headline, tuple(sentences), attention)


def _calibrated(result: CalibrationResult) -> str:
    names = ["accelerometer"] if result.has_accel else []
    names += [] if result.gyro is None else ["gyroscope"]
    names += [] if result.mag is None else ["magnetometer"]
    listed = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
    return listed[:1].upper() + listed[1:]


def gravity_sentence(gravity: Gravity) -> str:
    """Say what the accelerometer was scaled to, in typographic units."""
    return gravity.statement.replace("m/s^2", "m/s²")


def left_out_ratio(result: CalibrationResult) -> float | None:
    """RMS of left-out errors over their predicted uncertainty; None where too few are known."""
    ratios = [
        pose.left_out / pose.left_out_sigma
        for pose in result.poses
        if pose.left_out is not None and pose.left_out_sigma
    ]
    ratios = [ratio for ratio in ratios if math.isfinite(ratio)]
    if len(ratios) < TRUST_FROM:
        return None
    return float(np.sqrt(np.mean(np.square(ratios))))


def _own_observations(result: CalibrationResult, session: SessionSummary | None) -> list[str]:
    stated = result.gravity.known or result.only_magnetometer
    found = [] if stated else [gravity_sentence(result.gravity)]
    if result.accel_errors.held_out is None and result.has_accel:
        found.append(
            "No pose was kept out of the fit, so nothing here shows how accurate the "
            "accelerometer is; a residual of the fit does not."
        )
    if result.gyro is not None and result.gyro_errors.held_out is None:
        found.append(
            "No move was kept out of the fit, so nothing here shows how accurate the gyroscope "
            "is; a residual of the fit does not."
        )
    for name, errors in _stages(result):
        if errors.before and errors.held_out and errors.held_out.rms >= errors.before.rms:
            found.append(
                f"On data kept out of the fit the calibrated {name} is no better than the "
                "uncalibrated one: do not use this calibration for it."
            )
    ratio = left_out_ratio(result)
    if ratio is not None and ratio > TRUST_BELOW:
        found.append(
            f"Errors of left-out poses are {significant(ratio, 2)} times as large as predicted: "
            "take the uncertainties of the accelerometer as too small by about that factor."
        )
    if session is not None and session.finished < session.planned:
        found.append(
            f"The session ended after {session.finished} of {session.planned} stops; the "
            "calibration rests on what was measured until then."
        )
    return found


def _stages(result: CalibrationResult) -> list[tuple[str, ErrorStages]]:
    stages = [("accelerometer", result.accel_errors)] if result.has_accel else []
    return stages if result.gyro is None else [*stages, ("gyroscope", result.gyro_errors)]


def _what(result: CalibrationResult, session: SessionSummary | None) -> str:
    name = result.device.name or "The sensor"
    serial = f" (serial {result.device.serial})" if result.device.serial else ""
    poses, moves = counted(len(result.poses), "still pose"), counted(len(result.moves), "move")
    data = poses if result.gyro is None else f"{poses} and {moves}"
    if result.mag is not None and result.only_magnetometer:
        data = counted(result.mag.count, "sample")
    where = f" on the jig {session.jig}" if session is not None and session.jig else ""
    method = METHODS.get(result.method)
    how = f": {method}." if method else "."
    return f"{name}{serial} was calibrated from {data}{where} by the method “{result.method}”{how}"


def _accelerometer(result: CalibrationResult) -> str:
    return _accuracy(
        result.accel_errors,
        MILLI_G,
        "mg",
        "the magnitude of gravity",
        "On poses kept out of the fit",
        "pose",
    )


def _gyroscope(result: CalibrationResult) -> str:
    return _accuracy(
        result.gyro_errors,
        DEG,
        "deg",
        "the direction of gravity that the gyroscope carries from pose to pose",
        "On moves kept out of the fit",
        "move",
    )


def _accuracy(
    errors: ErrorStages, unit: float, name: str, quantity: str, where: str, each: str
) -> str:
    def size(summary: ErrorSummary) -> str:
        return f"{significant(summary.rms / unit)} {name}"

    shown = errors.held_out or errors.after
    if shown is None:
        return f"No error of {quantity} could be stated."
    if errors.held_out is None:
        return (
            f"In the data of the fit itself, {quantity} errs by {size(shown)} "
            f"(root mean square over {counted(shown.count, each)}); this is no measure of accuracy."
        )
    before = ""
    if errors.before is not None and shown.rms > 0.0:
        factor = errors.before.rms / shown.rms
        gain = f", {significant(factor, 2)} times more" if factor > 1.0 else ""
        before = f"; before calibration it was {size(errors.before)}{gain}"
    return (
        f"{where}, {quantity} errs by {size(shown)} (root mean square over "
        f"{counted(shown.count, each)}; median {significant(shown.median / unit)}, largest "
        f"{significant(shown.maximum / unit)} {name}){before}."
    )
