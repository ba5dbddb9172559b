"""The jig in a calibration report: its own errors, the frame it gives, what its servos did."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imu_rig.arrays import FloatArray
from imu_rig.calibration.findings import Finding
from imu_rig.calibration.jig_estimate import Estimate, JigEstimate
from imu_rig.calibration.result import CalibrationResult
from imu_rig.report.facts import JigTruth
from imu_rig.report.figures import count_axis, pose_numbers
from imu_rig.report.numbers import fixed
from imu_rig.report.page import Html, element, facts, section
from imu_rig.report.parameters import ParameterGroup, parameter_group
from imu_rig.report.svg import AFTER, INK, LEFT_OUT, TRUTH, Figures, new_figure, panel, report_style
from imu_rig.report.tables import group_table
from imu_rig.units import DEG

SERVOS = ("pan", "tilt", "roll")
MARKS = {"slip": ("slip from here on", LEFT_OUT), "bumped": ("bumped", TRUTH),
         "mislabelled": ("mislabelled", "#2e7d32")}  # fmt: skip
"""How findings that are of the jig stand in the figure: words and colour."""


def jig_section(result: CalibrationResult, truth: JigTruth | None, *, before: int) -> Html:
    """Return the section, or nothing where the jig was not estimated.

    Parameters
    ----------
    result : CalibrationResult
        What was found.
    truth : JigTruth or None
        What a simulated jig really is.
    before : int
        Figures in the page so far.
    """
    jig = result.jig
    if jig is None:
        return Html("")
    drawn = Figures(before)
    with report_style():
        drawn.add(
            "servos",
            deviation_figure(result),
            "What the servos did",
            "By how much each axis missed its commanded angle in each pose, beyond its gain and "
            "zero; the band is the repeatability, ± one standard deviation. Near tilt ±90° pan and "
            "roll turn about the same axis, and only the two together show.",
        )
    return section(
        "The jig itself",
        element(
            "p",
            "What the session tells about the jig it ran on. None of this is in the sensor’s own "
            "parameters above: they rest on the size of gravity and on the gyroscope, and servos "
            "that err by degrees do not change them.",
        ),
        element(
            "div",
            group_table("Servos and axes", _servos(jig, truth)),
            group_table("How the sensor sits: the frame", _frame(jig)),
            class_="pair" if truth is None else "pair wide",
        ),
        element(
            "p",
            "The frame is exactly as good as the servos: a sensor that is put back to a commanded "
            "attitude stands there as level as the servos repeat. Turning the sensor on the plate "
            "about the roll axis looks the same as another zero of the roll servo, so that part of "
            "the mounting is only as good as that zero; pan’s zero is a choice of heading. Where "
            "an axis comes to the ends of its travel from inside, its backlash looks like gain.",
            class_="note",
        ),
        facts(_spreads(jig)),
        element("div", *drawn.parts, class_="figures"),
    )


def deviation_figure(result: CalibrationResult) -> Figure:
    """Draw what each servo missed by in each pose, with findings marked."""
    jig = result.jig
    assert jig is not None
    figure = new_figure(430.0)
    x = np.array(pose_numbers(result.poses), dtype=float)
    missed = jig.deviation / DEG
    for axis, name in enumerate(SERVOS):
        axes = panel(figure, 66.0, 300.0 - 127.0 * axis, 442.0, 100.0)
        spread = float(jig.repeatability[axis]) / DEG
        axes.axhspan(-spread, spread, color=AFTER, alpha=0.13, linewidth=0.0)
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.plot(x, missed[:, axis], "o", color=AFTER, markersize=5.0)
        reach = max(float(np.nanmax(np.abs(missed[:, axis]), initial=0.0)), 2.0 * spread)
        axes.set_ylim(-1.2 * reach, 1.2 * reach)
        axes.set_ylabel(f"{name} [deg]")
        count_axis(axes, x)
        axes.locator_params(axis="y", nbins=5)
        if axis < 2:
            axes.set_xticklabels([])
        _mark_findings(axes, name, x, jig, result.findings)
    figure.axes[-1].set_xlabel("pose number")
    _legend(figure, result.findings)
    return figure


def _mark_findings(
    axes: Axes, servo: str, x: FloatArray, jig: JigEstimate, findings: Sequence[Finding]
) -> None:
    for finding in findings:
        if finding.kind not in MARKS or finding.axis not in ("", servo):
            continue
        where = x[np.isin(jig.commanded, finding.poses)]
        begin = 0.5 if finding.kind == "slip" else 0.0
        for place in where - begin:
            axes.axvline(place, color=MARKS[finding.kind][1], linewidth=2.0, alpha=0.75, zorder=0.5)


def _legend(figure: Figure, findings: Sequence[Finding]) -> None:
    axes = figure.axes[0]
    axes.plot([], [], "o", color=AFTER, markersize=5.0, label="deviation of the servo")
    for kind, (words, colour) in MARKS.items():
        if any(finding.kind == kind for finding in findings):
            axes.plot([], [], color=colour, linewidth=2.0, label=words)
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=4, borderaxespad=0.2,
        handletextpad=0.4, columnspacing=1.2, handlelength=1.2, fontsize=11.5,
    )  # fmt: skip


def _servos(jig: JigEstimate, truth: JigTruth | None) -> list[ParameterGroup]:
    skews = Estimate(
        np.concatenate((jig.tilt_skew.value, jig.roll_skew.value)),
        np.concatenate((jig.tilt_skew.sigma, jig.roll_skew.sigma)),
    )
    known = None if truth is None else (truth.tilt_skew, truth.roll_skew)
    return [
        _group(("Servo gain error", "%", 0.01), SERVOS, jig.servo_gain),
        _group(("Servo zero", "deg", DEG), ("tilt",), jig.tilt_zero),
        _group(("Axes off square", "deg", DEG), ("tilt to pan", "roll to tilt"), skews, known),
        _group(("Tilt of the base", "deg", DEG), ("about x", "about y"), jig.base),
    ]


def _frame(jig: JigEstimate) -> list[ParameterGroup]:
    groups = []
    for i, (turn, axis) in enumerate(zip(_rows(jig.mounting), _rows(jig.roll_axis), strict=True)):
        number = f" {i + 1}" if len(jig.mounting.value) > 1 else ""
        groups += [
            _group(
                (f"Mounting{number}, beyond the nominal one", "deg", DEG),
                ("about x", "about y", "about z"), turn,
            ),
            _group(
                (f"Roll axis as the sensor sees it{number}", "unit vector", 1.0), "xyz", axis
            ),
        ]  # fmt: skip
    level = ("Off level with all servos at zero", "deg", DEG)
    return [*groups, _group(level, ("about y", "about x"), jig.level)]


def _rows(several: Estimate) -> list[Estimate]:
    return [Estimate(v, s) for v, s in zip(several.value, several.sigma, strict=True)]


def _group(
    kind: tuple[str, str, float],
    names: Sequence[str],
    found: Estimate,
    truth: Sequence[float | None] | None = None,
) -> ParameterGroup:
    return parameter_group(kind, names, found.value, found.sigma, truth)


def _spreads(jig: JigEstimate) -> list[tuple[str, str]]:
    pan, tilt, roll = (fixed(float(value), 2) for value in jig.repeatability / DEG)
    return [
        ("Repeatability of the servos", f"pan {pan}, tilt {tilt}, roll {roll} deg, standard dev."),
        ("Wobble of a pose", f"{fixed(jig.wobble / DEG, 2)} deg per axis, beyond the servos"),
    ]
