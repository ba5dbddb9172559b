"""`imu-rig noise` from outside."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from imu_rig.calibration.noise_model import load_noise_model

DEG = np.pi / 180.0


def table(path: Path, seconds: float) -> Path:
    """A sensor at rest in g and deg/s: 400 ug/sqrt(Hz), 0.005 deg/s/sqrt(Hz)."""
    rng = np.random.default_rng(1)
    n = round(100 * seconds)
    accel = 0.004 * rng.standard_normal((n, 3)) + [0.0, 0.0, 1.0]
    gyro = 0.05 * rng.standard_normal((n, 3))
    rows = np.column_stack((np.arange(n) / 100.0, accel, gyro))
    np.savetxt(path, rows, delimiter=",", header="t,ax,ay,az,gx,gy,gz", comments="", fmt="%.6f")
    return path


def test_noise_of_a_table_in_its_own_units(imu_rig: Any, tmp_path: Path) -> None:
    file = table(tmp_path / "still.csv", 60.0)
    units = ("--accel-unit", "g", "--gyro-unit", "deg/s")
    done = imu_rig("noise", file, *units, "--json", "-o", tmp_path / "out")
    answer = json.loads(done.stdout)
    model = load_noise_model(answer["files"]["noise"])
    assert model.gyro is not None
    assert model.accel is not None
    np.testing.assert_allclose(model.gyro.values("white"), 0.005 * DEG, rtol=0.06)
    np.testing.assert_allclose(model.accel.values("white"), 400e-6 * 9.80665, rtol=0.06)
    assert answer["noise"]["schema"] == "imu-rig/noise"
    page = Path(answer["files"]["report"]).read_text()
    assert "<script" not in page
    assert "deg/√h" in page
    shown = imu_rig("noise", file, *units).stdout
    assert "Angle random walk [deg/√h]" in shown
    assert max(map(len, shown.splitlines())) <= 80
    assert "too short to determine" in shown
    again = imu_rig("noise", file, *units, "-o", tmp_path / "out", code=2)
    assert "never overwritten" in again.stderr


def test_a_record_that_tells_nothing_is_refused_by_name(imu_rig: Any, tmp_path: Path) -> None:
    file = table(tmp_path / "short.csv", 3.0)
    done = imu_rig("noise", file, "--accel-unit", "g", "--gyro-unit", "deg/s", code=2)
    assert "short.csv" in done.stderr
    assert "record at least 10 minutes" in done.stderr
