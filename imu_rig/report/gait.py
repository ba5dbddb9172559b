"""The report of gait over a set of trials: strides, and distances against a known one."""

from __future__ import annotations

import math

import numpy as np

from imu_rig import __version__
from imu_rig.arrays import FloatArray
from imu_rig.gait.improvement import AxisTable, TrialComparison
from imu_rig.report import gait_figures, stride_figures
from imu_rig.report.foot import told_with_sigma
from imu_rig.report.gait_facts import GaitReport, GaitTrial
from imu_rig.report.numbers import MISSING, counted, fixed
from imu_rig.report.page import Html, card, document, element, facts, folded, header, section, table
from imu_rig.report.stride_table import DECIMALS, SUMMARIZED, stride_table
from imu_rig.report.svg import Figures, report_style
from imu_rig.units import DEG

TITLE = "Gait"
MOST_DRAWN = 6
"""Trials of which the integration is drawn."""
MOST_TABLES = 40
"""Trials of which every stride is listed; all are in the file of strides."""


def gait_report(report: GaitReport, *, title: str = TITLE) -> str:
    """Return the report of a set of trials as the text of one HTML file that needs nothing else."""
    drawn = Figures()
    names = [trial.name for trial in report.trials]
    subtitle = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
    comparison = report.comparison()
    return document(
        f"{title}: {subtitle}",
        header("gait", title, subtitle),
        _verdict(report, comparison),
        element("div", *_cards(report, comparison), class_="cards"),
        _parameters(report),
        _strides(report, drawn),
        *_distances(report, comparison, drawn),
        section("Provenance", facts([*report.facts, ("Software", f"imu-rig {__version__}")])),
    )


def _verdict(report: GaitReport, comparison: TrialComparison | None) -> Html:
    strides = sum(len(trial.strides) for trial in report.trials)
    headline = f"{counted(strides, 'stride')} in {counted(len(report.trials), 'trial')}"
    notes = report.remarks
    sentences = []
    if report.known is not None:
        error = np.array([t.ours[0] for t in report.trials]) - report.known[0]
        sentences.append(
            f"Of {fixed(report.known[0], 2)} m along the walk the default smoother misses "
            f"{fixed(float(np.mean(np.abs(error))), 3)} m on average, "
            f"{fixed(float(np.max(np.abs(error))), 3)} m at most."
        )
    if comparison is not None:
        x = comparison.axes[0]
        sentences.append(
            f"Double integration misses {fixed(float(np.mean(x.uncalibrated_error)), 3)} m before "
            f"calibration and {fixed(float(np.mean(x.calibrated_error)), 3)} m after it."
        )
    points = [element("ul", *(element("li", note) for note in notes))] if notes else []
    return element(
        "div",
        element("h2", headline),
        *points,
        *(element("p", sentence) for sentence in sentences),
        class_="verdict care" if notes else "verdict",
    )


def _cards(report: GaitReport, comparison: TrialComparison | None) -> list[Html]:
    found = {
        name: report.pooled(name)[1] for name in ("length", "cadence", "velocity", "stance_share")
    }
    walking = int(np.count_nonzero(report.walking))
    cards = [
        card(
            "Strides",
            str(len(report.walking)),
            "",
            f"{walking} of them of steady walking or running",
        ),
        card(
            "Stride length",
            fixed(found["length"].mean, 3),
            "m",
            f"mean of steady strides; standard deviation {fixed(found['length'].sd, 3)} m",
        ),
        card("Cadence", fixed(found["cadence"].mean, 1), "steps/min", "of both feet"),
        card("Velocity", fixed(found["velocity"].mean, 2), "m/s", "mean over strides"),
        card(
            "Stance", fixed(100.0 * found["stance_share"].mean, 1), "%", "of a stride, on average"
        ),
    ]
    if comparison is not None:
        for axis in comparison.axes:
            cards.append(
                card(
                    f"Improvement, {axis.axis}",
                    fixed(axis.mean, 1),
                    "%",
                    f"by calibrating; from trial to trial ± {fixed(axis.sd, 1)} %",
                )
            )
    return cards


def _parameters(report: GaitReport) -> Html:
    rows = []
    for name, label in SUMMARIZED:
        unit, found = report.pooled(name)
        if found.count:
            places = DECIMALS[unit]
            spread = fixed(found.sd, places) if math.isfinite(found.sd) else MISSING
            named = f"{label} [{unit}]" if unit else label
            rows.append([named, fixed(found.mean, places), spread, str(found.count)])
    note = "Over the strides of steady walking and running of all trials."
    return section(
        "Gait parameters",
        table(["", "mean", "standard deviation", "strides"], rows),
        element("p", note, class_="note"),
    )


def _strides(report: GaitReport, drawn: Figures) -> Html:
    begin = len(drawn.parts)
    sigma = report.column("length_sigma")
    curves = [
        stride_figures.StrideCurve(
            report.column("length"), sigma if np.isfinite(sigma).any() else None, "length [m]"
        ),
        stride_figures.StrideCurve(report.column("velocity"), None, "velocity [m/s]"),
        stride_figures.StrideCurve(
            100.0 * report.column("stance_share"), None, "stance [%]", decimals=1
        ),
    ]
    angles = [
        stride_figures.StrideCurve(report.column("clearance"), None, "clearance [m]"),
        stride_figures.StrideCurve(
            report.column("contact_pitch") / DEG, None, "contact [deg]", decimals=1
        ),
        stride_figures.StrideCurve(
            report.column("toe_off_pitch") / DEG, None, "toe-off [deg]", decimals=1
        ),
    ]
    if len(report.walking):
        with report_style():
            drawn.add(
                "strides",
                stride_figures.over_strides(curves, report.walking),
                "Every stride",
                "Trial after trial; lines are the means of steady walking and running.",
            )
            drawn.add(
                "angles",
                stride_figures.over_strides(angles, report.walking),
                "Clearance and pitch",
                "How high the sensor was lifted; pitch of the foot as it meets the ground and as "
                "it leaves, positive with the toe up.",
            )
    rows = [_trial_row(trial) for trial in report.trials]
    head = ["trial", "strides", "distance [m]", "stride [m]", "velocity [m/s]", "cadence [1/min]"]
    head += ["stance"]
    every = [
        stride_table(f"{trial.name}: all {counted(len(trial.strides), 'stride')}", trial.strides)
        for trial in report.trials[:MOST_TABLES]
    ]
    return section(
        "Trials",
        table(head, rows),
        element("div", *drawn.parts[begin:], class_="figures"),
        *every,
    )


def _trial_row(trial: GaitTrial) -> list[str]:
    from imu_rig.report.stride_table import shown_summary

    strides = trial.strides
    means = {
        name: shown_summary(strides, name)[1].mean
        for name in ("length", "velocity", "cadence", "stance_share")
    }
    return [
        trial.name,
        str(len(strides)),
        told_with_sigma(strides.distance, strides.distance_sigma),
        fixed(means["length"], 3),
        fixed(means["velocity"], 3),
        fixed(means["cadence"], 1),
        fixed(means["stance_share"], 3),
    ]


def _distances(
    report: GaitReport, comparison: TrialComparison | None, drawn: Figures
) -> list[Html]:
    if not report.integrated:
        return []
    tables: list[Html] = []
    if comparison is not None:
        tables = [_axis_table(report, axis) for axis in comparison.axes]
    elif report.known is not None:
        tables = [_plain_table(report, report.known)]
    begin = len(drawn.parts)
    with report_style():
        for number, trial in enumerate(report.integrated[:MOST_DRAWN]):
            shown = trial.calibrated or trial.uncalibrated
            assert shown is not None
            other = trial.uncalibrated if trial.calibrated is not None else None
            drawn.add(
                f"walk{'abcdefghij'[number]}",
                gait_figures.integration(
                    shown, other, None if report.known is None else float(report.known[0])
                ),
                f"Acceleration, velocity, distance of {trial.name}",
                "Acceleration without gravity over the first strides, with the stance that the "
                "detector found; velocity, which is set to zero there; distance over the whole "
                "recording.",
            )
        if comparison is not None and len(report.compared) > 1:
            drawn.add(
                "errors",
                gait_figures.distance_errors(_errors(report, comparison)),
                "Errors of the distance, trial by trial",
                "x along the walk, y to the left, z up.",
            )
    text = (
        "Zero-velocity double integration: gravity is taken off by a gradient-descent attitude, "
        "the velocity is zero in stance, and the position is its integral. For comparison: the "
        "default smoother on the same readings, calibrated where there is a certificate."
    )
    doubts = [
        element("li", f"{trial.name}, {doubt}") for trial in report.trials for doubt in trial.doubts
    ]
    doubted = []
    if doubts:
        why = folded(f"Why, in {counted(len(doubts), 'sentence')}", element("ul", *doubts))
        doubted = [element("p", report.doubted), why]
    return [
        section(
            "Distance by double integration",
            element("p", text),
            *doubted,
            *tables,
            element("div", *drawn.parts[begin:], class_="figures"),
        )
    ]


def _axis_table(report: GaitReport, axis: AxisTable) -> Html:
    column = "xyz".index(axis.axis)
    rows = [
        [
            trial.name,
            fixed(float(axis.reference[k]), 2),
            fixed(float(axis.uncalibrated[k]), 3),
            fixed(float(axis.calibrated[k]), 3),
            fixed(float(axis.improvement[k]), 1),
            fixed(float(trial.ours[column]), 3),
        ]
        for k, trial in enumerate(report.compared)
    ]
    spread = f"{fixed(axis.mean, 1)} ± {fixed(axis.sd, 1)}"
    rows.append(["mean ± standard deviation", "", "", "", spread, ""])
    rows.append(["of the mean error of all trials", "", "", "", fixed(axis.pooled, 1), ""])
    head = ["trial", "known [m]", "not calibrated [m]", "calibrated [m]", "improvement [%]"]
    return table([*head, "default smoother [m]"], rows, caption=f"Distance along {axis.axis}")


def _plain_table(report: GaitReport, known: FloatArray) -> Html:
    rows = []
    for trial in report.integrated:
        found = trial.calibrated or trial.uncalibrated
        assert found is not None
        told = [fixed(float(v), 3) for v in found.distance]
        ours = [fixed(float(v), 3) for v in trial.ours]
        rows.append([trial.name, *told, *ours])
    head = ["trial", *(f"{a} [m]" for a in "xyz"), *(f"smoother {a} [m]" for a in "xyz")]
    where = ", ".join(fixed(float(v), 2) for v in known)
    note = (
        "There is no certificate to calibrate these trials with, so there is nothing to set beside."
        if all(t.calibrated is None for t in report.integrated)
        else ""
    )
    caption = f"Known: {where} m"
    return element(
        "div", table(head, rows, caption=caption), element("p", note, class_="note") if note else ""
    )


def _errors(report: GaitReport, comparison: TrialComparison) -> list[gait_figures.ErrorsOfAxis]:
    ours = np.array([trial.ours for trial in report.compared])
    return [
        gait_figures.ErrorsOfAxis(
            axis.axis,
            axis.uncalibrated - axis.reference,
            axis.calibrated - axis.reference,
            ours[:, column] - axis.reference,
        )
        for column, axis in enumerate(comparison.axes)
    ]
