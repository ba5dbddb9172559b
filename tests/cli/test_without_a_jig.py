"""`imu-rig solve` with what is known beside a recording: parts, turns, rates."""

import json
import time

import numpy as np
import pytest

from imu_rig.cli import working
from imu_rig.cli.working import Working

DEG = np.pi / 180


@pytest.fixture
def turned(tmp_path):
    """A table of steady rates about z, deg/s and g, and the rates beside it."""
    rng = np.random.default_rng(1)
    rate = np.repeat([0.0, 60.0, -60.0], 300)
    gyro = np.stack((0 * rate, 0 * rate, 1.02 * rate + 0.5), axis=1)
    rows = np.column_stack(
        (
            np.arange(900) / 100,
            np.tile([0, 0, 1.0], (900, 1)) + 0.003 * rng.standard_normal((900, 3)),
            gyro + 0.05 * rng.standard_normal((900, 3)),
        )
    )
    table = tmp_path / "log.csv"
    np.savetxt(table, rows, delimiter=",", header="t,ax,ay,az,gx,gy,gz", comments="")
    (tmp_path / "rates.csv").write_text(
        "t0,t1,axis,rate_dps\n0.2,2.8,z,0\n3.2,5.8,z,60\n6.2,8.8,-z,60\n"
    )
    return table


UNITS = ("--accel-unit", "g", "--gyro-unit", "deg/s")


def test_a_turntable(inside, turned, tmp_path):
    rates = tmp_path / "rates.csv"
    out = tmp_path / "out"
    done = inside(
        "solve", turned, *UNITS, "--method", "turntable", "--rates", rates, "-o", out, "--json"
    )
    assert json.loads(done.stdout)
    certificate = json.loads((out / "certificate.json").read_text())
    assert certificate["gyro"]["K"][2][2] == pytest.approx(1 / 1.02, abs=2e-3)
    assert (out / "report.html").is_file()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--method", "turntable"), "--rates"),
        (("--parts", "x.json"), "--parts belongs to --method ferraris"),
        (("--rates", "x.csv", "--method", "ferraris"), "--rates belongs to --method turntable"),
        (("--turn-angle", "5", "--method", "ferraris"), "more than 60"),
        (("--parts", "x.json", "--method", "ferraris"), "x.json"),
    ],
)
def test_options_that_do_not_fit_are_refused(inside, turned, options, said):
    done = inside("solve", turned, *UNITS, *options, code=2)
    assert said in done.stderr


def test_a_long_computation_shows_a_sign_of_life_and_a_short_one_does_not(monkeypatch, capsys):
    with Working("Reading"):
        pass
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(working, "FIRST_S", 0.01)
    with Working("Reading") as sign:
        sign.now("Solving")
        time.sleep(0.1)
    assert capsys.readouterr().err.startswith("Solving ... 0 s")
