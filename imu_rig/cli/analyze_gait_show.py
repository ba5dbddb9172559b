"""The gait of a set of trials on a terminal, and the same as plain values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from imu_rig.foreign_text import one_line

if TYPE_CHECKING:
    from imu_rig.arrays import FloatArray
    from imu_rig.gait.distance import WalkDistance
    from imu_rig.report.gait_facts import GaitReport, GaitTrial

LABELS = 15
NAME_WIDTH = 22
MOST_TRIALS = 24
AXES = "xyz"


def distance_head() -> list[str]:
    """Return the columns of the file of distances."""
    kinds = ("known", "uncalibrated", "calibrated", "smoother")
    ends = [f"{kind}_{axis}_m" for kind in kinds for axis in AXES]
    return ["trial", *ends, "walked_m", "walked_sigma_m"]


def distance_rows(report: GaitReport) -> list[list[Any]]:
    """Return the rows of the file of distances; what is not known is NaN."""
    known = _three(report.known)
    return [
        [
            trial.name,
            *known,
            *_three(_of(trial.uncalibrated)),
            *_three(_of(trial.calibrated)),
            *_three(trial.ours),
            round(trial.strides.distance, 4),
            round(trial.strides.distance_sigma, 4),
        ]
        for trial in report.trials
    ]


def gait_summary(report: GaitReport, files: dict[str, str]) -> dict[str, Any]:
    """Return the figures of a set of trials as plain values, SI units but for degrees."""
    from imu_rig.report.stride_table import SUFFIXES, SUMMARIZED

    pooled = {}
    for name, _ in SUMMARIZED:
        unit, found = report.pooled(name)
        if found.count:
            pooled[name + SUFFIXES[unit]] = {"mean": found.mean, "sd": found.sd, "n": found.count}
    content: dict[str, Any] = {
        "facts": dict(report.facts),
        "gait": pooled,
        "trials": [_trial_values(trial) for trial in report.trials],
        "left_out": dict(report.left_out),
        "files": files,
    }
    comparison = report.comparison()
    if report.known is not None:
        content["known_m"] = report.known.tolist()
    if comparison is not None:
        content["improvement_percent"] = {
            axis.axis: {
                "mean": axis.mean,
                "sd": axis.sd,
                "median": axis.median,
                "of_mean_error": axis.pooled,
                "each": axis.improvement.tolist(),
            }
            for axis in comparison.axes
        }
    return content


def _trial_values(trial: GaitTrial) -> dict[str, Any]:
    strides = trial.strides
    return {
        "trial": trial.name,
        "strides": len(strides),
        "walking": int(strides.walking.sum()),
        "walked_m": strides.distance,
        "walked_sigma_m": strides.distance_sigma,
        "smoother_m": trial.ours.tolist(),
        "uncalibrated_m": None if trial.uncalibrated is None else _three(_of(trial.uncalibrated)),
        "calibrated_m": None if trial.calibrated is None else _three(_of(trial.calibrated)),
        "notes": list(trial.notes),
        "double_integration_notes": list(trial.doubts),
    }


def show_gait(report: GaitReport, files: dict[str, str]) -> None:
    """Print the card of a set of trials."""
    from imu_rig.cli.sheet import Sheet
    from imu_rig.report.numbers import counted, fixed

    sheet = Sheet(LABELS)
    strides = len(report.walking)
    sheet.head(
        f"{counted(strides, 'stride')} in {counted(len(report.trials), 'trial')}",
        f", {int(report.walking.sum())} of steady walking or running",
    )
    for label, name, unit, scale, places in (
        ("length", "length", "m", 1.0, 3),
        ("duration", "duration", "s", 1.0, 3),
        ("velocity", "velocity", "m/s", 1.0, 2),
        ("cadence", "cadence", "steps/min", 1.0, 1),
        ("stance", "stance_share", "% of a stride", 100.0, 1),
    ):
        _, found = report.pooled(name)
        if found.count:
            spread = f" ± {fixed(scale * found.sd, places)}" if math.isfinite(found.sd) else ""
            sheet.entry(f"  {label}", f"{fixed(scale * found.mean, places)}{spread} {unit}")
    sheet.blank()
    for lines in (_table(report), *_distances(report)):
        for line in lines:
            sheet.row([(line, "")])
    comparison = report.comparison()
    if comparison is not None:
        told = "; ".join(
            f"{a.axis} {fixed(a.mean, 1)} ± {fixed(a.sd, 1)} %" for a in comparison.axes
        )
        sheet.blank()
        sheet.entry("  calibrating", f"makes errors smaller by: {told}")
    sheet.blank()
    for note in (*report.remarks, report.doubted):
        if not note:
            continue
        sheet.entry("  note", note, "yellow")
    if files:
        sheet.command(files["report"], "  report")
    sheet.blank()


def _table(report: GaitReport) -> list[str]:
    """Lines of the trials: strides, and how far was walked."""
    from imu_rig.report.foot import told_with_sigma

    lines = [f"  {'trial':{NAME_WIDTH}}{'strides':>8}{'walked [m]':>17}"]
    for trial in report.trials[:MOST_TRIALS]:
        walked = told_with_sigma(trial.strides.distance, trial.strides.distance_sigma)
        line = f"  {one_line(trial.name, NAME_WIDTH - 1):{NAME_WIDTH}}{len(trial.strides):>8}"
        lines.append(f"{line}{walked:>17}")
    return [*lines, *_more(report)]


def _distances(report: GaitReport) -> list[list[str]]:
    """Lines of the distance along each axis and its error, by each method; none without."""
    from imu_rig.report.numbers import MISSING, fixed

    if report.known is None or not report.integrated:
        return []
    ways = ["raw", "calibrated", "smoother"] if report.compared else ["raw", "smoother"]
    width = 18 if len(ways) == 3 else 24
    tables = []
    for axis, letter in enumerate(AXES):
        head = "".join(f"{way + ' (error)':>{width}}" for way in ways)
        known = fixed(float(report.known[axis]), 2)
        lines = ["", f"  {letter} [m], known {known}".ljust(NAME_WIDTH + 2) + head]
        for trial in report.trials[:MOST_TRIALS]:
            found = {
                "raw": _of(trial.uncalibrated),
                "calibrated": _of(trial.calibrated),
                "smoother": trial.ours,
            }
            line = f"  {one_line(trial.name, NAME_WIDTH - 1):{NAME_WIDTH}}"
            for way in ways:
                values, told = found[way], MISSING
                if values is not None:
                    error = fixed(float(values[axis] - report.known[axis]), 2, sign=True)
                    told = f"{fixed(float(values[axis]), 2)} ({error})"
                line += f"{told:>{width}}"
            lines.append(line)
        tables.append([*lines, *_more(report)])
    return tables


def _more(report: GaitReport) -> list[str]:
    more = len(report.trials) - MOST_TRIALS
    return [f"  ... and {more} more, in distances.csv"] if more > 0 else []


def _of(found: WalkDistance | None) -> FloatArray | None:
    return None if found is None else found.distance


def _three(values: FloatArray | None) -> list[float]:
    if values is None:
        return [math.nan] * 3
    return [round(float(value), 5) for value in values]
