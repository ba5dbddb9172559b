"""`imu-rig solve` with what is known beside a recording: parts, turns, rates."""

import contextlib
import html
import json
import re
import time
from pathlib import Path

import numpy as np
import pytest

from imu_rig.cli import working
from imu_rig.cli.working import Working
from imu_rig.importing.column_map import load_column_map
from imu_rig.importing.read_table import read_table
from imu_rig.kernels import compiled

DEG = np.pi / 180
STORED = Path(__file__).parents[1] / "data" / "certificate-v1.json"


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


def test_a_table_leaves_its_units_and_a_way_to_use_the_certificate(inside, turned, tmp_path):
    rows = np.loadtxt(turned, delimiter=",", skiprows=1)
    counts = np.round(rows * ([1] + [16384] * 3 + [131] * 3))
    counts[:, 0] = rows[:, 0]
    np.savetxt(turned, counts, delimiter=",", header="t,ax,ay,az,gx,gy,gz", comments="")
    out, units = tmp_path / "out", ("--accel-unit", "16384 LSB/g", "--gyro-unit", "131 LSB/(deg/s)")
    known = ("--method", "turntable", "--rates", tmp_path / "rates.csv")
    inside("solve", turned, *units, *known, "-o", out)
    certificate = out / "certificate.json"
    device = json.loads(certificate.read_text())["device"]
    assert device["accel_recorded_unit"] == "16384 LSB/g"
    assert device["gyro_recorded_unit"] == "131 LSB/(deg/s)"
    page = " ".join(inside("certificate", "show", certificate).stdout.split())
    assert "accelerometer 16384 LSB/g, gyroscope 131 LSB/(deg/s)" in page
    header = tmp_path / "foot.h"
    inside("certificate", "export", certificate, "--to", "c", "-o", header)
    assert "accelerometer 16384 LSB/g" in header.read_text()
    assert "foot_accel" not in header.read_text()  # one attitude does not calibrate it

    report = (out / "report.html").read_text()
    assert "imu-rig export" not in report
    assert "packet layout" not in report
    (python,) = (
        text
        for text in map(html.unescape, re.findall(r"<pre>(.*?)</pre>", report, re.DOTALL))
        if "apply_certificate" in text
    )
    found = {}
    with contextlib.chdir(tmp_path):
        exec(python.replace("'certificate.json'", repr(str(certificate))), found)  # noqa: S102
    turning = found["calibrated"].gyro[350:550, 2]
    assert np.mean(turning) == pytest.approx(60 * DEG, rel=2e-3)


def test_a_certificate_is_no_recording(inside, tmp_path):
    for command in ("solve", "noise"):
        told = inside(command, STORED, code=2).stderr
        assert f"imu-rig certificate show {STORED}" in told


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


def test_the_first_run_says_that_it_compiles(monkeypatch, capsys):
    monkeypatch.setattr(working, "FIRST_S", 0.01)
    monkeypatch.setattr(compiled._State, "compiling", 1)
    for unkept, told in ((0, "Compiling, in the first run only"), (1, "Compiling in every run")):
        monkeypatch.setattr(compiled._State, "unkept", unkept)
        with Working("Reading"):
            time.sleep(0.1)
        assert capsys.readouterr().err.startswith(told)


def test_named_faces_without_a_method_are_told_the_one_that_takes_them(inside, tmp_path):
    """Parts that were cut out of a recording and put together run on from one into the next."""
    rng = np.random.default_rng(2)
    rows = ["part,ax,ay,az,gx,gy,gz"]
    for name, up in (("x", 0), ("y", 1), ("z", 2)):
        for sense, sign in (("a", -1.0), ("p", 1.0)):
            face = np.zeros(6)
            face[up] = sign
            noise = [0.003] * 3 + [0.05] * 3
            rows += [
                f"{name}_{sense}," + ",".join(f"{v:.5f}" for v in row)
                for row in face + noise * rng.standard_normal((300, 6))
            ]
    table = tmp_path / "faces.csv"
    table.write_text("\n".join(rows) + "\n")
    stderr = inside("solve", table, *UNITS, "--rate", 100, code=2).stderr
    assert "6 still poses cannot determine" in stderr
    assert "All six faces are there" in stderr
    assert "--method ferraris" in stderr
    advised = stderr.split("corners up: ")[1].split(".")[0].split(", ")
    assert not {"+x", "-x", "+y", "-y", "+z", "-z"} & set(advised)
    other = table.read_text().replace("_a,", "_first,").replace("_p,", "_second,")
    table.write_text(other)
    inside("solve", table, *UNITS, "--rate", 100, code=2)


def test_the_column_map_of_the_readme_can_be_read(tmp_path):
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    example = readme.split("```toml\n")[1].split("```")[0]
    (tmp_path / "map.toml").write_text(example)
    rng = np.random.default_rng(3)
    rest = [0, 0, 16384, 0, 0, 0, 20, 0, -40] + 2.0 * rng.standard_normal((400, 9))
    np.savetxt(tmp_path / "bare.txt", rest, fmt="%.1f")
    block = read_table(tmp_path / "bare.txt", load_column_map(tmp_path / "map.toml"))
    assert block.accel[:, 2].mean() == pytest.approx(9.80665, abs=0.01)
    assert block.mag[:, 2].mean() == pytest.approx(-40, abs=1)
