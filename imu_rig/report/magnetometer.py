"""The magnetometer in a calibration report: what was found, and the field before and after."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from imu_rig.calibration.mag_result import MagPoints, MagResult
from imu_rig.calibration.result import CalibrationResult
from imu_rig.report.numbers import counted, significant
from imu_rig.report.page import Html, card, element, facts, folded, section
from imu_rig.report.parameters import magnetometer_sensor
from imu_rig.report.sphere import hemispheres
from imu_rig.report.svg import AFTER, BEFORE, INK, Figures, new_figure, panel, report_style
from imu_rig.report.tables import matrix_code, matrix_table, parameter_table
from imu_rig.units import DEG

MANY = 60
"""Readings beyond which they are marked by dots without numbers."""
ALIGNED_BY = {
    "none": "not aligned with the accelerometer: K is symmetric",
    "dip": "by the field's constant angle to gravity",
    "attitudes": "by the field's constant direction over the jig's attitudes",
}


def magnetometer_cards(mag: MagResult) -> list[Html]:
    """Cards with the figures that a person looks for first."""
    each = "pose" if mag.from_stills else "sample"
    cards = [
        card(
            "Magnetic field magnitude error",
            significant(mag.left_out_percent),
            "%",
            f"rms over {counted(mag.count, each)} left out of the fit; before: "
            f"{significant(mag.before_percent)} %",
        )
    ]
    if mag.direction_u is not None:
        cards.append(
            card(
                "Magnetic direction uncertainty",
                f"± {significant(mag.direction_u / DEG, 2)}",
                "deg",
                "standard uncertainty per axis of a calibrated reading's direction",
            )
        )
    return cards


def magnetometer_section(result: CalibrationResult, *, before: int) -> Html:
    """Return the section, or nothing where no magnetometer was calibrated.

    Parameters
    ----------
    result : CalibrationResult
        What was found.
    before : int
        Figures in the page so far.
    """
    mag, sensor = result.mag, magnetometer_sensor(result)
    if mag is None or sensor is None:
        return Html("")
    drawn = Figures(before)
    with report_style():
        drawn.add(
            "magmagnitude",
            magnitude_figure(mag.points),
            "Magnitude of the magnetic field",
            "Over its mean before, over the field after calibration, on two scales. "
            + ("One point per still pose." if mag.from_stills else "An even choice of samples."),
        )
        drawn.add(
            "magsphere",
            coverage_figure(mag.points),
            "Directions of the field in the sensor",
            "Where the field pointed, seen from +z in both halves (equal-area projection). "
            "What was never visited is known from its neighbours only.",
        )
    notes = [element("p", note.replace(" uT", " µT"), class_="note") for note in mag.notes]
    return section(
        "Magnetometer",
        facts(_facts(mag)),
        *notes,
        element("div", parameter_table(sensor), class_="pair wide"),
        element(
            "p",
            "Bias is the hard iron: what the sensor reads in no field. "
            f"{sensor.directions.name} x → y: angle by which axis x senses toward axis y"
            + (" of the accelerometer." if mag.alignment != "none" else " of the sensor itself."),
            class_="note",
        ),
        element("div", *drawn.parts, class_="figures"),
        folded(
            "K and b of the magnetometer, with standard uncertainties",
            element("p", "calibrated = K · raw − b, raw in µT."),
            matrix_table("Magnetometer", mag.affine, "µT"),
            element("h3", "In full precision"),
            element("pre", matrix_code("mag", mag.affine)),
        ),
    )


def _facts(mag: MagResult) -> list[tuple[str, str]]:
    each = "still pose" if mag.from_stills else "sample"
    known = "stated" if mag.field_known else "for a mean gain of 1"
    stated = [
        ("Field", f"{significant(mag.field_ut, 4)} µT, {known}"),
        ("Readings", counted(mag.count, each)),
        (
            "Magnitude error, rms",
            f"{significant(mag.before_percent)} % raw, {significant(mag.residual_percent)} % "
            f"fitted, {significant(mag.left_out_percent)} % left out of the fit",
        ),
        ("Axes", ALIGNED_BY[mag.alignment]),
    ]
    if mag.dip_rad is not None and mag.dip_u is not None:
        sense = "below" if mag.dip_rad >= 0.0 else "above"
        dip, sigma = abs(mag.dip_rad) / DEG, mag.dip_u / DEG
        stated.append(("Dip", f"{dip:.2f}° {sense} the horizontal, std. unc. {sigma:.2f}°"))
    if mag.alignment_u is not None:
        turn = significant(mag.alignment_u / DEG, 2)
        stated.append(("Std. unc. of the axes' rotation", f"{turn}°"))
    return stated


def magnitude_figure(points: MagPoints) -> Figure:
    """Magnitude of the field over time, before and after calibration."""
    figure = new_figure(370.0)
    above = panel(figure, 80.0, 226.0, 428.0, 116.0)
    below = panel(figure, 80.0, 46.0, 428.0, 132.0)
    size = 6.0 if len(points.t) <= MANY else 3.0
    t = points.t - points.t[0]
    above.plot(t, 100.0 * points.before, "s", color=BEFORE, markersize=size, label="before")
    below.plot(t, 100.0 * points.after, "o", color=AFTER, markersize=size, label="after")
    for axes in (above, below):
        axes.axhline(0.0, color=INK, linewidth=0.8, zorder=1)
        axes.set_ylabel("off [%]")
        axes.locator_params(axis="y", nbins=5)
        axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), borderaxespad=0.2)
    above.set_xticklabels([])
    below.set_xlabel("time from the first reading [s]")
    return figure


def coverage_figure(points: MagPoints) -> Figure:
    """Directions of the field in the sensor, coloured by the error of readings left out."""
    numbers = list(range(1, len(points.t) + 1)) if len(points.t) <= MANY else []
    return hemispheres(
        points.direction,
        np.abs(100.0 * points.left_out),
        numbers,
        "left-out error of the magnitude, absolute [%]",
        titles=("field along +z", "field along −z"),
    )
