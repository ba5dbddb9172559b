"""What a jig session adds to a report: accuracy in use, the jig itself, linearity, findings."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from imu_rig.calibration.findings import Finding
from imu_rig.calibration.jig_estimate import Estimate, JigEstimate, Straightness
from imu_rig.calibration.model import Affine
from imu_rig.calibration.reach import reading_reach, turn_reach
from imu_rig.calibration.temperature_term import Slopes, TemperatureTerm
from imu_rig.report.accuracy import true_errors, uncertainty_map
from imu_rig.report.calibration import calibration_report
from imu_rig.report.facts import JigTruth
from imu_rig.report.jig import deviation_figure
from imu_rig.report.verdict import verdict
from imu_rig.units import DEG, MILLI_G

SLIP = Finding("slip", "The tilt servo slipped by +5.0 degrees.", (7,), axis="tilt", size=5.0)
BUMP = Finding("bumped", "Pose 12 stands 6.0 degrees off.", (11,), size=6.0)
BENT = Finding("nonlinear", "Axis x is not linear.", axis="x", size=3.0)


def estimate(*values: float, sigma: float = 0.01) -> Estimate:
    return Estimate(np.array(values), np.full(len(values), sigma))


def some_jig(poses: int) -> JigEstimate:
    deviation = np.random.default_rng(1).normal(size=(poses, 3)) * 0.4 * DEG
    deviation[7:, 1] += 5.0 * DEG
    deviation[3] = np.nan
    return JigEstimate(
        servo_gain=estimate(0.0123, -0.02, 0.005, sigma=0.001),
        tilt_zero=estimate(2.0 * DEG, sigma=0.1 * DEG),
        tilt_skew=estimate(1.0 * DEG, sigma=0.1 * DEG),
        roll_skew=estimate(-1.0 * DEG, sigma=0.1 * DEG),
        base=estimate(0.8 * DEG, -0.6 * DEG, sigma=0.1 * DEG),
        mounting=Estimate(np.array([[0.05, -0.02, 0.03]]), np.full((1, 3), 0.002)),
        roll_axis=Estimate(np.array([[0.999, -0.03, -0.02]]), np.full((1, 3), 0.001)),
        level=estimate(0.1 * DEG, 0.2 * DEG, sigma=0.5 * DEG),
        repeatability=np.array([0.25, 0.5, 0.35]) * DEG,
        wobble=0.1 * DEG,
        deviation=deviation,
        commanded=np.arange(poses),
    )


@pytest.fixture(scope="module")
def jig_result(make_result, truth):
    result = make_result(method="joint")
    bend = Straightness(
        estimate(2e-3, 0.0, 0.0, sigma=1e-4), estimate(0.0, 0.0, 0.0, sigma=3e-4), 0.7 * MILLI_G
    )
    findings = (BUMP, SLIP, BENT)
    return replace(
        result,
        accel_at_zero=result.accel,
        straightness=bend,
        jig=some_jig(len(result.poses)),
        findings=findings,
        warnings=(BUMP.text, SLIP.text, BENT.text, "The session was short."),
    )


@pytest.fixture(scope="module")
def page(jig_result, truth):
    known = replace(
        truth, accel_at_zero=truth.accel, quadratic=(0.002, 0, 0), cubic=(0, 0, 0),
        jig=JigTruth(0.011 * np.pi / 2, -0.0174),
    )  # fmt: skip
    return calibration_report(jig_result, truth=known)


def text_of(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html.split("</style>")[-1]))


def test_every_finding_is_told_once_the_gravest_first(jig_result, page):
    attention = verdict(jig_result).attention
    assert attention == (BENT.text, SLIP.text, BUMP.text, "The session was short.")
    for finding in (BENT, SLIP, BUMP):
        assert text_of(page).count(finding.text) == 1


def test_the_jig_is_told_with_uncertainties_apart_from_the_sensor(page):
    words = text_of(page)
    jig = words[words.index("The jig itself") :]
    for told in ("+1.23 0.10", "[%]", "[deg]", "frame is exactly as good as the servos"):
        assert told in jig
    assert "pan 0.25, tilt 0.50, roll 0.35 deg" in jig
    assert words.index("Gyroscope") < words.index("The jig itself")


def test_the_figure_of_the_servos_marks_what_was_found(jig_result):
    figure = deviation_figure(jig_result)
    pan, tilt, roll = figure.axes
    colours = {line.get_label(): line.get_color() for line in pan.get_lines()}
    assert {"slip from here on", "bumped"} <= set(colours)

    def marks(axes, colour):
        lines = [line for line in axes.get_lines() if line.get_color() == colour]
        return sorted(float(x) for line in lines for x in set(line.get_xdata()))

    slip, bump = colours["slip from here on"], colours["bumped"]
    # The eighth pose slipped, of the tilt alone; all axes of the twelfth were bumped.
    assert marks(tilt, slip) == [7.5]
    assert marks(roll, slip) == []
    assert marks(roll, bump) == marks(tilt, bump) == [12.0]
    assert tilt.get_ylim()[1] > 5.0
    shown = roll.get_lines()[1].get_ydata()
    assert np.isnan(shown[3])
    assert np.isfinite(shown[[2, 4]]).all()


def test_numbers_of_figures_go_on(page):
    numbers = [int(n) for n in re.findall(r"<b>Figure (\d+)\.", page)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert "What the servos did" in page


def test_linearity_says_which_axis_bends_and_how_far(page):
    words = text_of(page)
    assert "a quadratic part on axis x" in words
    assert "leave the straight line by 0.70 mg" in words
    assert "+2.00 0.10" in words


def test_a_straight_sensor_is_called_so(jig_result):
    zero = estimate(0.0, 0.0, 0.0, sigma=1e-4)
    page = calibration_report(replace(jig_result, straightness=Straightness(zero, zero, 0.0)))
    assert "No bend shows" in text_of(page)


def test_cards_state_how_far_errors_reach_with_95_percent(make_result):
    """Bias known to 0.1 mg in each axis alone: errors of sqrt(3) times that, in all directions."""
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.eye(3) * (0.1 * MILLI_G) ** 2
    rate = np.zeros((12, 12))
    rate[9:, 9:] = np.eye(3) * (0.01 * DEG) ** 2
    result = replace(
        make_result(),
        accel=Affine(np.diag([1.01, 1, 1]), np.zeros(3), covariance),
        gyro=Affine(np.diag([1.01, 1, 1]), np.zeros(3), rate),
    )
    reading, turn = reading_reach(result), turn_reach(result)
    assert reading.rms == pytest.approx(1.96 * np.sqrt(3) * 0.1 * MILLI_G, rel=1e-3)
    assert reading.maximum == pytest.approx(reading.rms, rel=1e-6)
    assert turn.rms == pytest.approx(1.96 * np.sqrt(3) * 0.01 * 1.5 * DEG, rel=1e-3)
    words = text_of(calibration_report(result))
    assert "Error of a calibrated reading ± 0.34 mg" in words
    assert "Error of a 90° turn ± 0.051 deg" in words


def test_true_errors_are_those_of_the_sensor_whatever_its_frame(make_result, truth):
    """A gain 0.1 % too large on all axes errs by 1 mg everywhere and by 0.09 deg per turn."""
    result = replace(
        make_result(),
        accel=Affine(1.001 * truth.accel.K, 1.001 * truth.accel.b, np.zeros((12, 12))),
        gyro=Affine(1.001 * truth.gyro.K, 1.001 * truth.gyro.b, np.zeros((12, 12))),
    )
    Q = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = replace(result, accel=result.accel.rotated(Q), gyro=result.gyro.rotated(Q))
    for found in (result, turned):
        reading, turn = true_errors(found, truth)
        g = result.gravity.value
        assert reading.rms == pytest.approx(1e-3 * g, rel=1e-6)
        assert turn.maximum == pytest.approx(0.09 * DEG, rel=1e-6)


def test_the_map_has_a_colour_for_every_attitude(make_result):
    """An uncertain z scale shows where z points up or down, not about the rim."""
    covariance = np.zeros((12, 12))
    covariance[8, 8] = 1e-8
    accel = Affine(np.eye(3), np.array([0.1, 0, 0]), covariance)
    figure = uncertainty_map(replace(make_result(), accel=accel))
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert "standard uncertainty of a reading at rest [mg]" in texts
    assert "0.1" in texts  # 1e-4 of 1 g, at the poles
    assert len(figure.axes[0].collections) >= 2


def test_verification_has_a_card_even_where_there_was_none(make_result):
    assert "Verification none no poses were measured" in text_of(calibration_report(make_result()))


def test_a_nominal_accelerometer_is_not_called_calibrated(make_result):
    """A turntable calibrates the gyroscope alone."""
    result = replace(
        make_result(method="turntable"), accel=Affine(np.eye(3), np.zeros(3), np.eye(12) * 1e-3)
    )
    words = text_of(calibration_report(result))
    assert verdict(result).headline.startswith("Gyroscope calibrated")
    assert "Error of a calibrated reading" not in words
    assert "Accelerometer scale" not in words
    assert "Error of a 90° turn" in words


def test_temperature_has_a_table_where_it_was_determined(make_result):
    no, yes = np.zeros(3, dtype=bool), np.array([True, False, True])
    term = TemperatureTerm(
        reference_c=29.0,
        low_c=25.0,
        high_c=35.0,
        accel_bias=Slopes(np.array([0.3, -0.1, 0.5]) * MILLI_G, np.full(3, 0.02 * MILLI_G), yes),
        accel_scale=None,
        gyro_bias=Slopes(np.full(3, 0.02 * DEG), np.full(3, 0.01 * DEG), no),
    )
    words = text_of(calibration_report(replace(make_result(), temperature=term)))
    assert "25.0 to 35.0 °C" in words
    assert "+0.300 ± 0.020 ✓ −0.100 ± 0.020 +0.500 ± 0.020 ✓" in words
    assert "scale [%/°C]" not in words
    assert "Change per degree" not in text_of(calibration_report(make_result()))
