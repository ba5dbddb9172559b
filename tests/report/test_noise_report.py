"""The noise report and its units."""

import re

import numpy as np
import pytest

from imu_rig.blocks import ImuBlock
from imu_rig.calibration.noise import NoiseAnalysis, analyse_noise
from imu_rig.calibration.result import DeviceInfo
from imu_rig.report.noise import noise_report
from imu_rig.report.noise_units import UNITS, noise_rows


@pytest.fixture(scope="module")
def analysis() -> NoiseAnalysis:
    rng = np.random.default_rng(1)
    n = 6000
    t = np.arange(n) / 100.0
    accel = 0.0392266 * rng.standard_normal((n, 3)) + [0.0, 0.0, 9.8]
    gyro = np.radians(0.05) * rng.standard_normal((n, 3))
    block = ImuBlock(t=t, accel=accel, gyro=gyro, host_s=t)
    return analyse_noise(block, device=DeviceInfo(name="<b>sensor</b>"))


def number(text: str) -> float:
    return float(text.split("±")[0].replace("−", "-"))


def test_units_are_those_of_data_sheets(analysis: NoiseAnalysis) -> None:
    assert analysis.model.accel is not None
    assert analysis.model.gyro is not None
    accel = {r[0]: r[1:] for r in noise_rows(UNITS["accel"], analysis.model.accel)}
    gyro = {r[0]: r[1:] for r in noise_rows(UNITS["gyro"], analysis.model.gyro)}
    for axis in range(3):
        assert number(accel["White noise [µg/√Hz]"][axis]) == pytest.approx(400.0, rel=0.06)
        # 400 ug/sqrt(Hz) = 0.00392 m/s/sqrt(s) = 0.2354 m/s/sqrt(h)
        assert number(accel["Velocity random walk [m/s/√h]"][axis]) == pytest.approx(
            0.235, rel=0.06
        )
        assert number(gyro["White noise [deg/s/√Hz]"][axis]) == pytest.approx(0.005, rel=0.06)
        assert number(gyro["Angle random walk [deg/√h]"][axis]) == pytest.approx(0.3, rel=0.06)
        assert gyro["Bias instability [deg/h]"][axis].startswith("<")
    assert "Quantization [deg]" not in gyro


def test_the_page_stands_alone_and_escapes_names(analysis: NoiseAnalysis) -> None:
    page = noise_report(analysis)
    assert "<b>sensor" not in page
    assert "<script" not in page
    assert not re.search(r'(?:src|href)="(?!#)', page)
    assert page.count("<svg") == 2
    assert "averaging time [s]" in page
    assert "white noise, slope" in page
    assert not re.search(r"\b(nan|inf)\b", page, re.IGNORECASE)
    assert page == noise_report(analysis)
