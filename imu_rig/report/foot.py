"""The report of a walk: where a foot went, its strides, and how far that can be trusted."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imu_rig import __version__
from imu_rig.report import foot_figures, stride_figures
from imu_rig.report.foot_facts import FootAnalysis, FootReport, Measured
from imu_rig.report.numbers import MISSING, counted, decimals_for, duration, fixed
from imu_rig.report.page import Html, card, document, element, facts, header, section
from imu_rig.report.stride_table import kinds_note, shown_summary, stride_table, summary_table
from imu_rig.report.svg import Figures, report_style
from imu_rig.report.two_filter import two_filter_figures
from imu_rig.units import DEG

TITLE = "Where a foot went"


def foot_report(report: FootReport, *, title: str = TITLE) -> str:
    """Return the report of one recording as the text of one HTML file that needs nothing else.

    Parameters
    ----------
    report : FootReport
    title : str
    """
    names = ", ".join(foot.name for foot in report.feet)
    drawn = Figures()
    parts: list[Html] = []
    if report.shared:
        parts.append(_both_feet(report, drawn))
    for number, foot in enumerate(report.feet):
        parts += _of_foot(report, foot, drawn, number)
    return document(
        f"{title}: {report.recording}",
        header("trajectory and strides", title, f"{report.recording} · {names}"),
        *(_left_out(name, why) for name, why in report.left_out),
        *(
            _verdict(foot, several=len(report.feet) + len(report.left_out) > 1)
            for foot in report.feet
        ),
        *parts,
        _provenance(report),
    )


def told_with_sigma(value: float, sigma: float, least: int = 2) -> str:
    """Return a value and its standard uncertainty, as many digits as that supports."""
    if not math.isfinite(value):
        return MISSING
    if not math.isfinite(sigma) or sigma <= 0.0:
        return fixed(value, least)
    places = min(decimals_for(sigma), 4)
    return f"{fixed(value, places)} ± {fixed(sigma, places)}"


def _verdict(foot: FootAnalysis, *, several: bool) -> Html:
    strides = foot.strides
    who = f"{foot.name}: " if several else ""
    walked = told_with_sigma(strides.distance, strides.distance_sigma)
    headline = f"{who}{walked} m in {counted(len(strides), 'stride')}"
    points = [element("li", note) for note in foot.notes]
    inside = [element("ul", *points)] if points else []
    if not points:
        inside = [element("p", "Nothing in the recording speaks against this trajectory.")]
    return element(
        "div",
        element("h2", headline),
        *inside,
        class_="verdict care" if points else "verdict",
    )


def _left_out(name: str, why: str) -> Html:
    return element(
        "div", element("h2", f"{name} is left out"), element("p", why), class_="verdict care"
    )


def _both_feet(report: FootReport, drawn: Figures) -> Html:
    """Draw two feet that are in one frame together."""
    begin = len(drawn.parts)
    seen = next((f.reference.seen for f in report.feet if f.reference is not None), None)
    with report_style():
        drawn.add(
            "planboth",
            foot_figures.plan([(foot.name, foot.track) for foot in report.feet], seen),
            "The walk from above",
            _plan_caption(report.feet),
        )
    return section("Both feet", element("div", *drawn.parts[begin:], class_="figures"))


def _of_foot(report: FootReport, foot: FootAnalysis, drawn: Figures, number: int) -> list[Html]:
    several = len(report.feet) > 1
    letter = "ab"[number]
    begin = len(drawn.parts)
    seen = None if foot.reference is None else foot.reference.seen
    with report_style():
        if not report.shared:
            drawn.add(
                f"plan{letter}",
                foot_figures.plan([(foot.name, foot.track)], seen),
                "The walk from above",
                _plan_caption([foot]),
            )
        drawn.add(
            f"axes{letter}",
            foot_figures.axes_over_time(foot.track, seen),
            "Position over time",
            "Of the sensor, from where the recording begins. Bands hold 95 % of the errors that "
            "are to be expected of the sensor: as large as its certificate says, or as usual "
            "without one.",
        )
        if len(foot.track.footfalls):
            drawn.add(
                f"heading{letter}",
                foot_figures.heading_over_time(foot.track, foot.heading_at_footfalls),
                "Where the standing foot points",
                "Without another reference the heading drifts; the band says how far.",
            )
            drawn.add(
                f"height{letter}",
                foot_figures.height_over_way(foot.track),
                "Height of the footfalls",
                "Over the distance walked. Stairs and slopes show here; on a level floor what is "
                "left is error.",
            )
    trajectory = element("div", *drawn.parts[begin:], class_="figures")
    named = f"{foot.name} · " if several else ""
    cards = element("div", *_cards(foot), class_="cards")
    found = [
        section(foot.name, cards) if several else cards,
        *_comparisons(foot),
        section(f"{named}Trajectory", trajectory),
    ]
    found += _strides(foot, drawn, letter, named)
    found += _stance(foot, drawn, letter, named)
    return [*found, *_two_filters(foot, drawn, letter, named)]


def _plan_caption(feet: Sequence[FootAnalysis]) -> str:
    text = "Metres on equal axes; the foot first points along x."
    covariances = [foot.track.covariance for foot in feet]
    if any(covariance is not None for covariance in covariances):
        text += (
            " The ellipse holds the true end with 95 %; where it is larger than the walk, the axes "
            "cut it."
        )
    for foot in feet:
        if foot.reference is not None and foot.reference.seen is not None:
            text += " " + foot.reference.note
    return text


def _cards(foot: FootAnalysis) -> list[Html]:
    strides = foot.strides
    unknown = not math.isfinite(strides.distance_sigma)
    length, cadence, speed = (
        shown_summary(strides, name)[1] for name in ("length", "cadence", "velocity")
    )
    walking = int(np.count_nonzero(strides.walking))
    sigma = foot.heading_sigma / DEG
    cards = [
        card(
            "Distance",
            told_with_sigma(strides.distance, strides.distance_sigma),
            "m",
            "sum of the strides" if unknown else "sum of the strides ± standard uncertainty",
        ),
        card("Strides", str(len(strides)), "", f"{walking} of them of steady walking or running"),
        card(
            "Cadence", fixed(cadence.mean, 1), "steps/min", "of both feet, from this one's strides"
        ),
        card(
            "Stride length",
            fixed(length.mean, 3),
            "m",
            f"mean of steady strides; standard deviation {fixed(length.sd, 3)} m",
        ),
        card("Velocity", fixed(speed.mean, 2), "m/s", "mean over strides"),
        card(
            "Uncertainty of heading",
            MISSING if math.isnan(sigma) else f"± {fixed(sigma, 1)}",
            "" if math.isnan(sigma) else "deg",
            "standard, at the end against the start",
        ),
    ]
    cards += [card(*m.card) for m in (foot.reference, foot.footprints) if m is not None]
    return cards


def _comparisons(foot: FootAnalysis) -> list[Html]:
    found: list[tuple[str, Measured | None]] = [
        ("Against the reference", foot.reference),
        ("Against the footprints", foot.footprints),
    ]
    return [
        section(title, facts(measured.rows), element("p", measured.note, class_="note"))
        for title, measured in found
        if measured is not None
    ]


def _strides(foot: FootAnalysis, drawn: Figures, letter: str, named: str) -> list[Html]:
    strides = foot.strides
    if len(strides) == 0:
        return [section(f"{named}Strides", element("p", "There is no stride in it."))]
    sigma = strides.length_sigma if np.isfinite(strides.length_sigma).any() else None
    seen = next(
        (
            m.stride_lengths
            for m in (foot.footprints, foot.reference)
            if m is not None and m.stride_lengths is not None
        ),
        None,
    )
    curves = [
        stride_figures.StrideCurve(strides.length, sigma, "length [m]", seen),
        stride_figures.StrideCurve(strides.duration, None, "duration [s]"),
        stride_figures.StrideCurve(strides.height, None, "height [m]", least_span=0.1),
    ]
    begin = len(drawn.parts)
    with report_style():
        drawn.add(
            f"strides{letter}",
            stride_figures.over_strides(curves, strides.walking),
            "Every stride",
            "From footfall to footfall; the line is the mean of steady walking and running. A "
            "height beside zero is a stair, a slope, or error.",
        )
        if np.isfinite(strides.stance_share).any():
            more = [
                stride_figures.StrideCurve(
                    100.0 * strides.stance_share, None, "stance [%]", decimals=1
                ),
                stride_figures.StrideCurve(strides.clearance, None, "clearance [m]"),
                stride_figures.StrideCurve(strides.turn / DEG, None, "turn [deg]", decimals=1),
            ]
            drawn.add(
                f"more{letter}",
                stride_figures.over_strides(more, strides.walking),
                "Stance, clearance and turning",
                "Stance as part of the stride; how high the sensor was lifted; turns are positive "
                "to the left.",
            )
    note = kinds_note(strides)
    return [
        section(
            f"{named}Strides",
            summary_table([(foot.name, strides)]),
            *([note] if note is not None else []),
            element("p", "Mean ± standard deviation from stride to stride.", class_="note"),
            element("div", *drawn.parts[begin:], class_="figures"),
            stride_table(f"All {counted(len(strides), 'stride')}", strides),
        )
    ]


def _stance(foot: FootAnalysis, drawn: Figures, letter: str, named: str) -> list[Html]:
    begin = len(drawn.parts)
    with report_style():
        drawn.add(
            f"stance{letter}",
            stride_figures.stance(foot.track, foot.block.accel, foot.block.gyro, foot.motion_unit),
            "When the foot stands",
            "Some strides from the middle of the walk. Where what the detector compares lies "
            "below its threshold, the foot is taken to stand.",
        )
        drawn.add(
            f"angles{letter}",
            stride_figures.foot_angles(foot.track, foot.angles, ("roll", "pitch", "heading")),
            "Angles of the foot",
            "The same strides. Roll is positive with the left side up, pitch with the toe up, and "
            "heading to the left; a foot that points steeply has no heading.",
        )
    return [
        section(f"{named}Stance and angles", element("div", *drawn.parts[begin:], class_="figures"))
    ]


def _two_filters(foot: FootAnalysis, drawn: Figures, letter: str, named: str) -> list[Html]:
    """Draw what the published method shows of each of its filters."""
    if foot.steps is None:
        return []
    begin = len(drawn.parts)
    with report_style():
        for one in two_filter_figures(foot.steps):
            drawn.add(one.name + letter, one.figure, one.title, one.caption)
    inside = element("div", *drawn.parts[begin:], class_="figures")
    return [section(f"{named}Forward and backward filter", inside)]


def _provenance(report: FootReport) -> Html:
    stated: list[tuple[str, str]] = [("Recording", report.recording)]
    stated.append(("SHA-256 of the recording", element("span", report.sha256, class_="mono")))
    for foot in report.feet:
        bias = ", ".join(fixed(b / DEG, 3, sign=True) for b in foot.track.gyro_bias)
        stated += [
            (
                f"Data of {foot.name}",
                f"{fixed(foot.rate_hz, 2)} samples/s for {duration(foot.duration_s)}",
            ),
            ("Gyroscope bias taken off", f"{bias} deg/s"),
        ]
    stated += [*report.facts, ("Software", f"imu-rig {__version__}")]
    return section("Provenance", facts(stated))
