"""A calibration in a terminal: the figures a person looks for first, and the same as JSON."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING

from imu_rig.cli.magnetometer_summary import (
    counted_readings,
    magnetometer_errors,
    magnetometer_lines,
)
from imu_rig.units import DEG, MILLI_G

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.calibration.model import PhysicalFigures
    from imu_rig.calibration.result import CalibrationResult, ErrorStages
    from imu_rig.calibration.verification import Verification
    from imu_rig.report.facts import Truth

MILLIRADIAN = 1e-3
LABEL_WIDTH = 30
NUMBER_WIDTH = 11
MOST_REASONS = 6


def result_lines(result: CalibrationResult, truth: Truth | None = None) -> list[str]:
    """Lines that tell a result; with ``truth`` beside the true values.

    Uncertainties are standard uncertainties.
    """
    from imu_rig.calibration.model import physical_figures

    lines = _failed(result.verification)
    mag = result.mag
    source = f"{len(result.poses)} poses and {len(result.moves)} moves"
    if mag is not None and result.only_magnetometer:
        source = counted_readings(mag)
    lines += [
        f"Calibration of {result.device.name or 'the sensor'} by {result.method} from {source}",
        "",
    ]
    lines += _errors("gravity magnitude error, rms [mg]", result.accel_errors, MILLI_G)
    lines += _errors("gravity direction per move, rms [deg]", result.gyro_errors, DEG)
    lines += [] if mag is None else [magnetometer_errors(mag)]
    if result.verification is not None:
        lines += ["", *verification_lines(result.verification)]
    lines.append("")
    header = f"  {'':{LABEL_WIDTH}}{'estimate':>{NUMBER_WIDTH}}{'std. unc.':>{NUMBER_WIDTH}}"
    lines.append(header + (f"{'true':>{NUMBER_WIDTH}}{'error':>{NUMBER_WIDTH}}" if truth else ""))
    true = None if truth is None else physical_figures(truth.accel)
    if not result.only_magnetometer:
        lines += _figures("accelerometer", result.accel_figures, MILLI_G, "mg", true)
    if result.gyro_figures is not None:
        true = None
        if truth is not None and truth.gyro is not None:
            true = physical_figures(truth.gyro, truth.accel)
        lines += _figures("gyroscope", result.gyro_figures, DEG, "deg/s", true)
    if mag is not None and result.mag_figures is not None:
        # A truth of simulated sensors holds accelerometer and gyroscope only.
        lines += _figures("magnetometer", result.mag_figures, 1.0, "uT", None)
        lines += ["", *magnetometer_lines(mag)]
    if not result.only_magnetometer:
        lines += ["", *paragraph(result.gravity.statement)]
    for note in () if mag is None else mag.notes:
        lines += ["", *paragraph(note)]
    for warning in result.warnings:
        lines += ["", *paragraph(warning, mark="! ")]
    return lines


def _failed(verification: Verification | None) -> list[str]:
    """Return what must be read before anything else."""
    if verification is None or verification.passed:
        return []
    return [*paragraph(verification.headline, mark="!! "), ""]


def verification_lines(verification: Verification) -> list[str]:
    """Lines that tell how checks kept out of the fit ended."""
    limits = verification.limits
    lines = paragraph(
        f"{verification.headline} Limits: {limits.accel / MILLI_G:g} mg and "
        f"{limits.turn / DEG:g} deg, and {limits.sigma:g} predicted standard deviations."
    )
    for label, kind, unit, name in (
        ("check poses, gravity magnitude", "pose", MILLI_G, "mg"),
        ("check moves, gravity direction", "move", DEG, "deg"),
    ):
        rows = [row for row in verification.rows if row.kind == kind]
        found = [(abs(r.error), r.sigmas) for r in rows if r.error is not None and r.sigmas]
        if found:
            error, sigmas = (max(column) for column in zip(*found, strict=True))
            lines.append(
                f"  {label:39}{error / unit:.3f} {name} and {sigmas:.1f} std. dev. at most "
                f"({len(found)} of {len(rows)} count)"
            )
    reasons = verification.reasons
    for reason in reasons[:MOST_REASONS]:
        lines += paragraph(reason, mark="! ")
    if len(reasons) > MOST_REASONS:
        lines += paragraph(f"{len(reasons) - MOST_REASONS} more are in the report.", mark="! ")
    return lines


def paragraph(sentence: str, mark: str = "") -> list[str]:
    """Break a sentence into indented lines; ``mark`` stands before the first."""
    return textwrap.wrap(
        sentence, 78, initial_indent="  " + mark, subsequent_indent="  " + " " * len(mark)
    )


def _errors(label: str, stages: ErrorStages, unit: float) -> list[str]:
    if stages.before is None or stages.after is None:
        return []
    line = f"  {label:39}{stages.before.rms / unit:.3f} raw   {stages.after.rms / unit:.3f} fitted"
    return [line + (f"   {stages.held_out.rms / unit:.3f} left out" if stages.held_out else "")]


def _figures(
    sensor: str,
    figures: PhysicalFigures,
    unit: float,
    unit_name: str,
    truth: PhysicalFigures | None,
) -> list[str]:
    rows = [
        (f"{sensor} scale {axis} [%]", figures.scale_percent[i], figures.scale_percent_u[i], 1.0)
        for i, axis in enumerate("xyz")
    ]
    true = [] if truth is None else list(truth.scale_percent)
    rows += [
        (f"{sensor} cross {name} [mrad]", figures.cross_rad[i], figures.cross_rad_u[i], MILLIRADIAN)
        for i, name in enumerate(figures.cross_names)
    ]
    true += [] if truth is None else list(truth.cross_rad)
    rows += [
        (f"{sensor} bias {axis} [{unit_name}]", figures.bias[i], figures.bias_u[i], unit)
        for i, axis in enumerate("xyz")
    ]
    true += [] if truth is None else list(truth.bias)
    lines = []
    for i, (label, value, sigma, scale) in enumerate(rows):
        numbers = [value, sigma, *((true[i], value - true[i]) if true else ())]
        columns = "".join(f"{number / scale:{NUMBER_WIDTH}.4f}" for number in numbers)
        line = f"  {label:{LABEL_WIDTH}}{columns}"
        lines.append(line)
    return lines


def json_text(
    certificate: Certificate, files: Mapping[str, str], truth: Truth | None = None
) -> str:
    """One JSON object: the certificate's content, the files written, and a simulation's truth."""
    content: dict[str, object] = {
        "certificate": certificate.model_dump(mode="json", by_alias=True),
        "files": dict(files),
    }
    if truth is not None:
        sensors = {"accel": truth.accel, "gyro": truth.gyro}
        content["truth"] = {
            name: {"K": affine.K.tolist(), "b": affine.b.tolist()}
            for name, affine in sensors.items()
            if affine is not None
        }
    return json.dumps(content, allow_nan=False)
