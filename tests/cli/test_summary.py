"""The summary in a terminal: short, within 80 columns, and safe with names from files."""

from dataclasses import replace

import numpy as np
import pytest

from imu_rig.calibration.findings import Finding
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.jig_estimate import Estimate, JigEstimate
from imu_rig.calibration.model import Affine
from imu_rig.calibration.result import (
    CalibrationResult,
    DeviceInfo,
    ErrorStages,
    ErrorSummary,
)
from imu_rig.calibration.verification import CheckRow, Limits, Verification
from imu_rig.cli.summary import result_lines
from imu_rig.report.facts import Truth
from imu_rig.units import DEG, MILLI_G

HOSTILE = "foot\x1b[2J\x1b]0;owned\x07\u202eleft\n\rCalibration of another " + "x" * 300
SLIP = Finding("slip", "The tilt servo slipped by +5.0 degrees.", (7,), axis="tilt")
SATURATED = Finding("saturated", "Axis z hit its limit in pose 3.", (2,), axis="z")


def estimate(value: np.ndarray, sigma: float) -> Estimate:
    return Estimate(np.asarray(value, dtype=float), np.full(np.shape(value), sigma))


JIG = JigEstimate(
    servo_gain=estimate(np.array([-0.0064, -0.0237, 0.0083]), 0.001),
    tilt_zero=estimate(np.zeros(1), 0.1),
    tilt_skew=estimate(np.zeros(1), 0.1),
    roll_skew=estimate(np.zeros(1), 0.1),
    base=estimate(np.zeros(2), 0.1),
    mounting=estimate(np.zeros((1, 3)), 0.1),
    roll_axis=estimate(np.array([[1.0, 0, 0]]), 0.05 * DEG),
    level=estimate(np.zeros(2), 0.5 * DEG),
    repeatability=np.array([0.25, 0.47, 0.33]) * DEG,
    wobble=0.1 * DEG,
    deviation=np.zeros((24, 3)),
    commanded=np.arange(24),
)


def errors(before: float, after: float) -> ErrorStages:
    return ErrorStages(
        *(ErrorSummary(24, size, size, size) for size in (before, after, 1.2 * after))
    )


@pytest.fixture
def result() -> CalibrationResult:
    bias = np.zeros((12, 12))
    bias[9:, 9:] = np.eye(3) * (0.1 * MILLI_G) ** 2
    rate = np.zeros((12, 12))
    rate[9:, 9:] = np.eye(3) * (0.01 * DEG) ** 2
    unit = 10.0 * MILLI_G
    checks = Verification(
        tuple(CheckRow("pose", HOSTILE, unit, unit, 12.3, 0.1 * unit, 0.1 * unit, 4.0)
              for _ in range(12)),
        Limits(), has_gyro=False,
    )  # fmt: skip
    return CalibrationResult(
        method="joint",
        device=DeviceInfo("foot-left", "7", "mpu9150-28"),
        gravity=Gravity.given(9.81),
        frame="sensor",
        accel=Affine(np.diag([1.02, 0.9, 1.0]), np.array([0.5, -3.0, 0.1]), bias),
        gyro=Affine(np.diag([1.02, 0.9, 1.0]), np.array([0.02, -0.5, 0.1]), rate),
        poses=(),
        moves=(),
        accel_errors=errors(139.027 * MILLI_G, 10.2 * MILLI_G),
        gyro_errors=errors(13.7 * DEG, 0.03 * DEG),
        rate_hz=100.0,
        duration_s=100.0,
        verification=checks,
        jig=JIG,
        findings=(SLIP, SATURATED),
        warnings=(SLIP.text, SATURATED.text, "The session was short."),
    )


def test_every_line_fits_80_columns_and_says_what_counts(result):
    exact = Truth(result.accel, result.gyro)
    lines = result_lines(result, exact)
    assert max(map(len, lines)) <= 80
    page = "\n".join(lines)
    # 95 % of errors: 1.96 sqrt(3) times what is known of each axis, in all directions.
    assert "reading at rest, 95 % [mg]       0.339 rms   0.339 at worst" in page
    assert "turn of 90 deg, 95 % [deg]       0.051 rms   0.051 at worst" in page
    assert "non-orthogonality xy [mrad]" in page
    assert "cross-axis yx [mrad]" in page
    scale = next(line for line in lines if "scale x" in line).split()
    assert scale[3:] == ["-1.9608", "fixed", "-1.9608", "0.0000"]  # 1/1.02 - 1
    assert any("bias x [mg]" in line and "fixed" not in line for line in lines)
    told = " ".join(page.split())
    assert "servo gain -0.64, -2.37, +0.83 %, repeating to 0.25, 0.47, 0.33 deg" in told
    assert "level of a pose to 0.50 deg" in told


def test_a_result_without_checks_says_that_it_is_not_verified(result):
    assert not any("Not verified" in line for line in result_lines(result))
    lines = result_lines(replace(result, verification=None))
    assert "  Not verified: no poses were measured for checking alone." in lines


def test_findings_are_told_once_the_gravest_first(result):
    page = "\n".join(result_lines(result))
    for text in (SLIP.text, SATURATED.text):
        assert page.count(text) == 1
    assert page.index(SATURATED.text) < page.index(SLIP.text) < page.index("session was short")


def test_names_from_files_do_not_steer_the_terminal(result):
    hostile = replace(result, device=DeviceInfo(HOSTILE), warnings=(HOSTILE,), findings=())
    lines = result_lines(hostile)
    assert all(line.isprintable() for line in lines)
    assert max(map(len, lines)) <= 80
    assert not any(line.startswith("Calibration of another") for line in lines)


def test_a_nominal_accelerometer_has_no_figures(result):
    turntable = replace(result, accel=Affine(np.eye(3), np.zeros(3), np.eye(12) * 1e-4))
    page = "\n".join(result_lines(turntable))
    assert "accelerometer" not in page
    assert "reading at rest" not in page
    assert "turn of 90 deg" in page
    assert "gravity" not in page.split("gyroscope")[-1].split("!")[0]
