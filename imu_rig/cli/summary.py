"""A calibration in a terminal: the figures a person looks for first, and the same as JSON."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING

from imu_rig.cli.magnetometer_summary import (
    ERROR_WIDTH,
    counted_readings,
    magnetometer_errors,
    magnetometer_lines,
)
from imu_rig.foreign_text import LONGEST_PARAGRAPH, one_line
from imu_rig.units import DEG, MILLI_G

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.calibration.jig_estimate import JigEstimate
    from imu_rig.calibration.model import PhysicalFigures
    from imu_rig.calibration.result import CalibrationResult, ErrorStages
    from imu_rig.calibration.verification import Verification
    from imu_rig.report.facts import Truth

MILLIRADIAN = 1e-3
LABEL_WIDTH = 33
NUMBER_WIDTH = 11
WIDTH = 78
MOST_REASONS = 6
ENDED_WIDTH = 44
"""Of the words for how the checks of one kind ended."""
IN_A_REPORT = "are in a report, which --output DIR writes"
FIXED_BELOW = 1e-12
"""A standard uncertainty below belongs to what a convention or the method fixed."""


def result_lines(
    result: CalibrationResult, truth: Truth | None = None, *, reported: bool = True
) -> list[str]:
    """Lines that tell a result; with ``truth`` beside the true values.

    Uncertainties are standard uncertainties; ``reported`` says whether there is a report too.
    """
    from imu_rig.calibration.findings import by_importance
    from imu_rig.calibration.model import physical_figures

    lines = _failed(result.verification)
    mag = result.mag
    source = f"{len(result.poses)} poses and {len(result.moves)} moves"
    if mag is not None and result.only_magnetometer:
        source = counted_readings(mag)
    name = one_line(result.device.name) or "the sensor"
    head = f"Calibration of {name} by {result.method} from {source}"
    lines += [*textwrap.wrap(head, WIDTH, subsequent_indent="  "), ""]
    lines += _errors("gravity magnitude, rms [mg]", result.accel_errors, MILLI_G)
    lines += _errors("gravity direction, rms [deg]", result.gyro_errors, DEG)
    lines += _reaches(result)
    lines += [] if mag is None else [magnetometer_errors(mag)]
    if result.verification is not None:
        lines += ["", *verification_lines(result.verification, reported=reported)]
    elif not result.only_magnetometer:
        lines += ["", *paragraph("Not verified: no poses were measured for checking alone.")]
    lines.append("")
    header = f"  {'':{LABEL_WIDTH}}{'estimate':>{NUMBER_WIDTH}}{'std. unc.':>{NUMBER_WIDTH}}"
    lines.append(header + (f"{'true':>{NUMBER_WIDTH}}{'error':>{NUMBER_WIDTH}}" if truth else ""))
    true = None if truth is None else physical_figures(truth.accel)
    if result.has_accel:
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
    if result.jig is not None:
        lines += ["", *paragraph(_jig(result.jig))]
    if result.has_accel:
        lines += ["", *paragraph(result.gravity.statement)]
    for note in () if mag is None else mag.notes:
        lines += ["", *paragraph(note)]
    for warning in by_importance(result.findings, result.warnings):
        lines += ["", *paragraph(one_line(warning, LONGEST_PARAGRAPH), mark="! ")]
    return lines


def _failed(verification: Verification | None) -> list[str]:
    """Return what must be read before anything else."""
    if verification is None or verification.passed:
        return []
    return [*paragraph(verification.headline, mark="!! "), ""]


def verification_lines(
    verification: Verification, *, reported: bool = True, every: str = IN_A_REPORT
) -> list[str]:
    """Lines that tell how checks kept out of the fit ended.

    Where there are too many reasons, the rest are in the report; where there is none
    (``reported``), ``every`` says how to see them.
    """
    limits = verification.limits
    lines = paragraph(
        f"{verification.headline} Limits: {limits.accel / MILLI_G:g} mg and "
        f"{limits.turn / DEG:g} deg, and {limits.sigma:g} predicted standard deviations."
    )
    for label, kind, unit, name in (
        ("poses, magnitude", "pose", MILLI_G, "mg"),
        ("moves, direction", "move", DEG, "deg"),
    ):
        rows = [row for row in verification.rows if row.kind == kind]
        found = [(abs(r.error), r.sigmas) for r in rows if r.error is not None and r.sigmas]
        if found:
            error, sigmas = (max(column) for column in zip(*found, strict=True))
            failed = sum(row.state == "failed" for row in rows)
            count, verb = (failed, "FAILED") if failed else (len(found), "passed")
            ended = f"{count} of {len(found)} {verb}"
            void = "" if len(found) == len(rows) else f", {len(rows) - len(found)} void"
            lines.append(
                f"  {f'{label}: {ended}{void}':{ENDED_WIDTH}}{error / unit:.3f} {name}, "
                f"{sigmas:.1f} std. dev. at most"
            )
    reasons = verification.reasons
    for reason in reasons[:MOST_REASONS]:
        lines += paragraph(one_line(reason, LONGEST_PARAGRAPH), mark="! ")
    if len(reasons) > MOST_REASONS:
        where = "are in the report" if reported else every
        lines += paragraph(f"{len(reasons) - MOST_REASONS} more {where}.", mark="! ")
    return lines


def paragraph(sentence: str, mark: str = "") -> list[str]:
    """Break a sentence into indented lines; ``mark`` stands before the first."""
    return textwrap.wrap(
        sentence, WIDTH, initial_indent="  " + mark, subsequent_indent="  " + " " * len(mark)
    )


def _errors(label: str, stages: ErrorStages, unit: float) -> list[str]:
    if stages.before is None or stages.after is None:
        return []
    parts = [(stages.before, "raw"), (stages.after, "fitted"), (stages.held_out, "left out")]
    texts = [f"{errors.rms / unit:.3f} {name}" for errors, name in parts if errors is not None]
    return [f"  {label:{ERROR_WIDTH}}{'   '.join(texts)}"]


def _reaches(result: CalibrationResult) -> list[str]:
    """Lines that tell how far errors of a reading at rest and of a turn reach."""
    from imu_rig.calibration.reach import reading_reach, turn_reach

    rows = (
        ("reading at rest, 95 % [mg]", reading_reach(result), MILLI_G),
        ("turn of 90 deg, 95 % [deg]", turn_reach(result), DEG),
    )
    return [
        f"  {label:{ERROR_WIDTH}}{reach.rms / unit:.3f} rms   {reach.maximum / unit:.3f} at worst"
        for label, reach, unit in rows
        if reach is not None
    ]


def _jig(jig: JigEstimate) -> str:
    """Tell the jig's own errors, and how good a frame it gives, in short."""
    import numpy as np

    gain = ", ".join(f"{100.0 * value:+.2f}" for value in jig.servo_gain.value)
    repeats = ", ".join(f"{value / DEG:.2f}" for value in jig.repeatability)
    axis, level = (float(np.max(e.sigma)) / DEG for e in (jig.roll_axis, jig.level))
    return (
        f"The jig: servo gain {gain} %, repeating to {repeats} deg (pan, tilt, roll). Its frame is "
        f"as good as its servos: roll axis in the sensor known to {axis:.2f} deg, level of a pose "
        f"to {level:.2f} deg. The figures above do not depend on it."
    )


def _figures(
    sensor: str,
    figures: PhysicalFigures,
    unit: float,
    unit_name: str,
    truth: PhysicalFigures | None,
) -> list[str]:
    rows = [
        (f"scale {axis} [%]", figures.scale_percent[i], figures.scale_percent_u[i], 1.0)
        for i, axis in enumerate("xyz")
    ]
    true = [] if truth is None else list(truth.scale_percent)
    rows += [
        (
            f"{figures.angles} {name} [mrad]",
            figures.cross_rad[i],
            figures.cross_rad_u[i],
            MILLIRADIAN,
        )
        for i, name in enumerate(figures.cross_names)
    ]
    true += [] if truth is None else list(truth.cross_rad)
    rows += [
        (f"bias {axis} [{unit_name}]", figures.bias[i], figures.bias_u[i], unit)
        for i, axis in enumerate("xyz")
    ]
    true += [] if truth is None else list(truth.bias)
    lines = [f"  {sensor}"]
    for i, (label, value, sigma, scale) in enumerate(rows):
        numbers = [value, sigma, *((true[i], value - true[i]) if true else ())]
        texts = [f"{number / scale:.4f}" for number in numbers]
        if sigma < FIXED_BELOW:
            texts[1] = "fixed"
        columns = "".join(f"{text:>{NUMBER_WIDTH}}" for text in texts)
        lines.append(f"    {label:{LABEL_WIDTH - 2}}{columns}")
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
