"""An analysis of walks on a terminal, and the same as plain values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imu_rig.gait.strides import Strides
    from imu_rig.reference.tables import AxisTable
    from imu_rig.report.foot_facts import FootAnalysis, FootReport

LABELS = 15
"""Columns of the labels of a card."""


def sentences(*notes: str) -> tuple[str, ...]:
    """Return notes as sentences with a capital and a stop, each once."""
    told = (f"{note[:1].upper()}{note[1:].rstrip('.')}." for note in notes if note)
    return tuple(dict.fromkeys(told))


def foot_summary(report: FootReport, files: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a recording as plain values, SI units but for degrees."""
    return {
        "recording": report.recording,
        "sha256": report.sha256,
        "facts": dict(report.facts),
        "feet": {foot.name: _foot_values(foot) for foot in report.feet},
        "left_out": dict(report.left_out),
        "files": files,
    }


def _foot_values(foot: FootAnalysis) -> dict[str, Any]:
    from imu_rig.report.stride_table import SUFFIXES, SUMMARIZED, shown_summary
    from imu_rig.units import DEG

    strides, track = foot.strides, foot.track
    kinds: dict[str, int] = {}
    for kind in strides.kind.tolist():
        kinds[kind] = kinds.get(kind, 0) + 1
    gait = {}
    for name, _ in SUMMARIZED:
        unit, found = shown_summary(strides, name)
        if found.count:
            gait[name + SUFFIXES[unit]] = {"mean": found.mean, "sd": found.sd, "n": found.count}
    end = track.trajectory.position[-1]
    values: dict[str, Any] = {
        "distance_m": strides.distance,
        "distance_sigma_m": strides.distance_sigma,
        "strides": len(strides),
        "kinds": kinds,
        "gait": gait,
        "end_m": end.tolist(),
        "heading_sigma_deg": foot.heading_sigma / DEG,
        "rate_hz": foot.rate_hz,
        "duration_s": foot.duration_s,
        "gyro_bias_deg_s": (track.gyro_bias / DEG).tolist(),
        "accel_bias_ms2": track.accel_bias.tolist(),
        "pivot_m": track.pivot.tolist(),
        "notes": list(foot.notes),
    }
    if track.covariance is not None:
        values["end_sigma_m"] = track.covariance.position_sigma[-1].tolist()
    for name, measured in (("reference", foot.reference), ("footprints", foot.footprints)):
        if measured is not None:
            values[name] = measured.figures or dict(measured.rows)
    return values


def reference_tables(reports: Sequence[FootReport]) -> list[AxisTable]:
    """Return the tables of x, y and z over recordings with a reference; empty without."""
    from imu_rig.reference.tables import axis_tables

    aligned = {
        _stem(report, foot): foot.reference.alignment
        for report in reports
        for foot in report.feet
        if foot.reference is not None and foot.reference.alignment is not None
    }
    return axis_tables(aligned) if aligned else []


def _stem(report: FootReport, foot: FootAnalysis) -> str:
    stem = report.recording.rpartition(".")[0] or report.recording
    return f"{stem}, {foot.name}" if len(report.feet) > 1 else stem


def show_tables(tables: Sequence[AxisTable]) -> None:
    """Print the tables of recordings with a reference, one for each axis."""
    from imu_rig.cli.sheet import Sheet

    sheet = Sheet(LABELS)
    for table in tables:
        for line in table.lines():
            sheet.row([("  " + line, "")])
        sheet.blank()


def show_foot(report: FootReport, files: dict[str, Any]) -> None:
    """Print the card of a recording."""
    from imu_rig.cli.sheet import Sheet

    sheet = Sheet(LABELS)
    facts = dict(report.facts)
    for number, foot in enumerate(report.feet):
        if number:
            sheet.blank()
        _show_one(sheet, report, foot)
        if f"Calibration of {foot.name}" in facts:
            sheet.entry("  calibration", facts[f"Calibration of {foot.name}"])
    for name, why in report.left_out:
        sheet.blank()
        sheet.head(name, f" of {report.recording} is left out")
        sheet.entry("  because", why, "yellow")
    if "Method" in facts:
        sheet.entry("  method", facts["Method"])
    if files:
        sheet.command(files["report"], "  report")
        folder = files["report"].rpartition("/")[0] or "."
        several = "trajectory.csv" if len(report.feet) == 1 else "a trajectory of each foot"
        sheet.entry("  tables", f"strides.csv, {several} and summary.json in {folder}")
    sheet.blank()


def _show_one(sheet: Any, report: FootReport, foot: FootAnalysis) -> None:
    from imu_rig.report.foot import told_with_sigma
    from imu_rig.report.numbers import duration, fixed
    from imu_rig.report.stride_table import shown_summary
    from imu_rig.units import DEG

    strides = foot.strides
    sheet.head(f"{foot.name}", f" of {report.recording}, {duration(foot.duration_s)}")
    unsure = "" if math.isfinite(strides.distance_sigma) else " (uncertainty unknown)"
    walked = told_with_sigma(strides.distance, strides.distance_sigma)
    sheet.entry("  distance", f"{walked} m{unsure}", "bold")
    sheet.entry("  strides", stride_words(strides))
    length, time, cadence, speed, stance = (
        shown_summary(strides, name)[1]
        for name in ("length", "duration", "cadence", "velocity", "stance_share")
    )
    if length.count:
        spread = f", standard deviation {fixed(length.sd, 3)} m" if math.isfinite(length.sd) else ""
        sheet.entry("  mean stride", f"{fixed(length.mean, 3)} m{spread}")
    if time.count:
        sheet.entry(
            "  cadence",
            f"{fixed(cadence.mean, 1)} steps/min, {fixed(speed.mean, 2)} m/s, "
            f"{fixed(100.0 * stance.mean, 0)} % of a stride on the ground",
        )
    sheet.entry("  end", end_words(foot))
    sigma = foot.heading_sigma / DEG
    if math.isfinite(sigma):
        sheet.entry("  heading", f"unsure by ± {fixed(sigma, 1)} deg at the end against the start")
    for label, measured in (("reference", foot.reference), ("footprints", foot.footprints)):
        if measured is not None:
            for row, (name, value) in enumerate(measured.rows):
                sheet.entry("" if row else f"  {label}", f"{name.lower()}: {value}")
    for note in foot.notes:
        sheet.entry("  note", note, "yellow")


def stride_words(strides: Strides) -> str:
    """Tell how many strides there are of each kind, steady walking and running first."""
    from imu_rig.gait.stride_kinds import GAIT, KINDS
    from imu_rig.report.numbers import counted

    counts = {kind: int((strides.kind == kind).sum()) for kind in KINDS}
    steady = sum(counts.pop(kind) for kind in GAIT)
    others = ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)
    told = f"{counted(len(strides), 'stride')}, {steady} of them of steady walking or running"
    return f"{told}; {others}" if others else told


def end_words(foot: FootAnalysis) -> str:
    """Tell where a foot ended, seen from where it began, and how surely."""
    from imu_rig.report.foot import told_with_sigma

    covariance = foot.track.covariance
    sigmas = [math.nan] * 3 if covariance is None else covariance.position_sigma[-1].tolist()
    ways = (("ahead", "behind"), ("to the left", "to the right"), ("above", "below"))
    parts = [
        f"{told_with_sigma(abs(value), sigma)} m {ahead if value >= 0.0 else behind}"
        for value, sigma, (ahead, behind) in zip(
            foot.track.trajectory.position[-1].tolist(), sigmas, ways, strict=True
        )
    ]
    return f"{', '.join(parts)} its start"
