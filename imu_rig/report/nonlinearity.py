"""Nonlinearity in a calibration report: how much the accelerometer bends, and what that changes."""

from __future__ import annotations

from imu_rig.calibration.model import physical_figures
from imu_rig.calibration.result import CalibrationResult
from imu_rig.report.facts import Truth
from imu_rig.report.numbers import significant
from imu_rig.report.page import Html, element, section
from imu_rig.report.parameters import accelerometer, parameter_group
from imu_rig.report.tables import group_table
from imu_rig.units import MILLI_G

SHOWS = 3.0
"""Standard uncertainties from which on a term is said to show."""
MILLI = 1e-3


def nonlinearity_section(result: CalibrationResult, truth: Truth | None) -> Html:
    """Return the section, or nothing where no nonlinearity was estimated."""
    bend, at_zero = result.straightness, result.accel_at_zero
    if bend is None or at_zero is None:
        return Html("")
    true = None
    if truth is not None and truth.accel_at_zero is not None:
        true = physical_figures(truth.accel_at_zero)
    slope = accelerometer(at_zero, true)
    terms = [
        parameter_group(
            (f"{name} part at 1 g", "mg", MILLI), "xyz", term.value, term.sigma,
            None if truth is None else known,
        )
        for name, term, known in (
            ("Quadratic", bend.quadratic, None if truth is None else truth.quadratic),
            ("Cubic", bend.cubic, None if truth is None else truth.cubic),
        )
    ]  # fmt: skip
    return section(
        "Linearity of the accelerometer",
        element("p", f"{_shows(result)} {_deviation(bend.deviation)}"),
        element(
            "p",
            "A sensor that bends has two straight lines. The best line over ±1 g, which is K and b "
            "of this calibration, fits readings at rest and slow movement. The gain at zero input "
            "is the slope that a small acceleration along a level axis sees.",
        ),
        element(
            "div",
            group_table("Nonlinearity", terms),
            group_table("Gain at zero input", (slope.scale, slope.bias)),
            class_="pair" if true is None else "pair wide",
        ),
        element(
            "p",
            "A quadratic part shifts a reading the same way up and down, a cubic part stretches or "
            "shrinks it the farther out it is. Nothing was seen beyond ±1 g. The uncertainties of "
            "all other parameters include that of these parts.",
            class_="note",
        ),
    )


def _shows(result: CalibrationResult) -> str:
    bend = result.straightness
    assert bend is not None
    shown = [
        f"a {name} part on axis {axis}"
        for name, term in (("quadratic", bend.quadratic), ("cubic", bend.cubic))
        for axis, value, sigma in zip("xyz", term.value, term.sigma, strict=True)
        if abs(value) > SHOWS * sigma
    ]
    if not shown:
        return f"No bend shows: every part is below {SHOWS:g} of its standard uncertainties."
    return f"The sensor bends, beyond {SHOWS:g} standard uncertainties: {', '.join(shown)}."


def _deviation(size: float) -> str:
    if size <= 0.0:
        return "Readings leave the straight line by no more than the terms’ own uncertainty."
    return (
        f"Over all attitudes, readings leave the straight line by {significant(size / MILLI_G, 2)} "
        "mg (root mean square, the terms’ own uncertainty taken off)."
    )
