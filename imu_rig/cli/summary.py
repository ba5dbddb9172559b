"""A calibration in a terminal: the figures a person looks for first, and the same as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from imu_rig.units import DEG, MILLI_G

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.calibration.model import PhysicalFigures
    from imu_rig.calibration.result import CalibrationResult
    from imu_rig.report.facts import Truth

MILLIRADIAN = 1e-3
LABEL_WIDTH = 34


def result_lines(result: CalibrationResult, truth: Truth | None = None) -> list[str]:
    """Lines that tell a result; with ``truth`` beside the true values.

    Uncertainties are standard uncertainties.
    """
    from imu_rig.calibration.model import physical_figures

    accel = result.accel_errors
    lines = [
        f"Calibration of {result.device.name or 'the sensor'} by {result.method} from "
        f"{len(result.poses)} poses and {len(result.moves)} moves",
        "",
    ]
    if accel.before and accel.after:
        held = f", left out {accel.held_out.rms / MILLI_G:.2f} mg" if accel.held_out else ""
        lines.append(
            f"  gravity magnitude, rms error     {accel.before.rms / MILLI_G:8.2f} mg before, "
            f"{accel.after.rms / MILLI_G:.2f} mg after{held}"
        )
    gyro = result.gyro_errors
    if gyro.before and gyro.after:
        held = f", held out {gyro.held_out.rms / DEG:.3f} deg" if gyro.held_out else ""
        lines.append(
            f"  gravity direction per move, rms  {gyro.before.rms / DEG:8.3f} deg before, "
            f"{gyro.after.rms / DEG:.3f} deg after{held}"
        )
    lines.append("")
    header = f"  {'':{LABEL_WIDTH}}{'estimate':>12}{'std. unc.':>12}"
    lines.append(header + (f"{'true':>12}{'error':>12}" if truth else ""))
    true = None if truth is None else physical_figures(truth.accel)
    lines += _figures("accelerometer", result.accel_figures, MILLI_G, "mg", true)
    if result.gyro_figures is not None:
        true = None
        if truth is not None and truth.gyro is not None:
            true = physical_figures(truth.gyro, truth.accel)
        lines += _figures("gyroscope", result.gyro_figures, DEG, "deg/s", true)
    lines += ["", "  " + result.gravity.statement]
    return lines


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
        line = f"  {label:{LABEL_WIDTH}}{value / scale:12.4f}{sigma / scale:12.4f}"
        if true:
            line += f"{true[i] / scale:12.4f}{(value - true[i]) / scale:12.4f}"
        lines.append(line)
    return lines


def json_text(certificate: Certificate, files: Mapping[str, str]) -> str:
    """One JSON object: the certificate's content, and the files written."""
    content = {
        "certificate": certificate.model_dump(mode="json", by_alias=True),
        "files": dict(files),
    }
    return json.dumps(content, default=_plain, allow_nan=False)


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value)
