"""`imu-rig import` and the commands that take other programs' recordings directly."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.io import loadmat, savemat

from imu_rig import open_trial
from imu_rig.importing.formats import FORMATS

DOCUMENT = Path(__file__).parents[2] / "docs" / "import.md"


def still(n, seed=1):
    rng = np.random.default_rng(seed)
    accel = np.array([0.3, -0.4, 9.79]) + 0.02 * rng.standard_normal((n, 3))
    return accel, 1e-3 * rng.standard_normal((n, 3))


def xsens(path, n=300, lost=(), first=0):
    accel, gyro = still(n)
    lines = ["// Update Rate: 100.0Hz", "PacketCounter\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z"]
    for i in range(n):
        if i not in lost:
            numbers = "\t".join(f"{v:.6f}" for v in [*accel[i], *gyro[i]])
            lines.append(f"{first + i:05d}\t{numbers}")
    path.write_text("\n".join(lines))
    return path


def test_import_info_and_export_of_two_sensors(inside, tmp_path):
    left = xsens(tmp_path / "left.txt", lost=(7, 8, 100))
    right = xsens(tmp_path / "right.txt", first=25)
    out = tmp_path / "walk.imu-trial"
    done = inside("import", left, right, "-o", out)
    assert "left" in done.stdout
    assert "297 samples, 3 missing" in done.stdout
    trial = open_trial(out)
    assert trial.sensors == ["left", "right"]
    assert trial.samples("right").t[0] == pytest.approx(0.25)
    assert sum(gap.samples for gap in trial.missing("left")) == 3
    told = inside("info", out).stdout
    assert "right" in told
    assert "as in the file" in told
    assert "±" not in told  # nobody knows how good the times of a file are
    facts = json.loads(inside("info", out, "--json").stdout)
    assert facts["devices"]["left"]["time_uncertainty_s"] is None
    exported = inside("export", out, "--sensor", "left", "-o", tmp_path / "left.csv", "--json")
    assert json.loads(exported.stdout)["devices"]["left"]["time_uncertainty_s"] is None
    inside("export", out, "--sensor", "left", "-o", tmp_path / "left.mat")
    assert np.isnan(loadmat(tmp_path / "left.mat")["left"]["time_uncertainty_s"].item())
    inside("export", out, "--sensor", "left", "-o", tmp_path / "left.mcap")
    with (tmp_path / "left.mcap").open("rb") as file:
        metadata = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    assert metadata["device left"]["time_uncertainty_s"] == "unknown"
    assert (tmp_path / "left.csv").stat().st_size > 10_000


def test_json_tells_what_was_made(inside, tmp_path):
    accel, gyro = still(300)
    content = {
        "imu": np.hstack((accel, gyro)),
        "ts": np.arange(300) / 200,
        "gt": np.zeros((300, 3)),
    }
    savemat(tmp_path / "a.mat", content)
    arguments = ("import", tmp_path / "a.mat", "-o", tmp_path / "a.imu-trial", "--json")
    facts = json.loads(inside(*arguments).stdout)
    assert facts["format"] == "pyshoe"
    assert facts["sources"] == {
        "foot": {"packets": 300, "missing": 0},
        "reference": {"packets": 300, "missing": 0},
    }
    again = inside(*arguments, code=2)
    error = json.loads(again.stdout)
    assert error["exit_code"] == 2
    assert "never overwritten" in error["error"]


def test_mistakes_are_one_sentence(inside, tmp_path):
    recording = xsens(tmp_path / "a.txt")
    out = tmp_path / "out.imu-trial"
    for arguments, words in (
        ((recording, "-o", tmp_path / "out.csv"), "ends in .imu-trial"),
        ((recording, "-o", tmp_path / "none" / "out.imu-trial"), "none"),
        ((tmp_path / "none.txt", "-o", out), "does not exist"),
        ((recording, "-o", out, "--format", "exe"), "is no format"),
        ((recording, "-o", out, "--format", "broad"), "no MATLAB file"),
        ((recording, "-o", out, "--rate", 50), "leave out the rate"),
        ((recording, recording, "-o", out), "named 'a'"),
    ):
        done = inside("import", *arguments, code=2)
        assert words in done.stderr
        assert done.stderr.count("\n") == 1
        assert not out.exists()


def test_escapes_in_a_file_do_not_reach_the_terminal(inside, tmp_path):
    folder = tmp_path / "x-IMU3 \x1b[31mred"
    folder.mkdir()
    accel, gyro = still(100)
    names = [f"{kind} {axis}" for kind in ("Gyroscope", "Accelerometer") for axis in "XYZ"]
    units = ["(deg/s)"] * 3 + ["(g)"] * 3
    header = ",".join(["Timestamp (us)", *(f"{n} {u}" for n, u in zip(names, units, strict=True))])
    rows = np.hstack((1e4 * np.arange(100)[:, None], gyro, accel / 9.80665))
    np.savetxt(folder / "Inertial.csv", rows, delimiter=",", header=header, comments="", fmt="%.6f")
    (folder / "Notes.csv").write_text("Timestamp (us),\x1b[2Jtext\n1,\x1b[2J\n")
    done = inside("import", folder, "-o", tmp_path / "a.imu-trial")
    assert "\x1b" not in done.stdout + done.stderr
    assert "100 samples" in done.stdout


def test_noise_and_solve_take_other_formats_directly(inside, tmp_path):
    accel, gyro = still(1200)
    savemat(tmp_path / "a.mat", {"imu_acc": accel, "imu_gyr": gyro, "sampling_rate": 100.0})
    other = json.loads(inside("noise", tmp_path / "a.mat", "--json", "--quiet").stdout)["noise"]
    assert other["duration_s"] == pytest.approx(12, abs=0.1)
    assert other["rate_hz"] == pytest.approx(100, rel=1e-3)
    refused = inside("solve", tmp_path / "a.mat", code=2)  # one pose is none to calibrate from
    assert "pose" in refused.stderr


def test_a_trial_under_another_name_is_a_trial(inside, tmp_path):
    inside("import", xsens(tmp_path / "a.txt", n=1200), "-o", tmp_path / "a.imu-trial")
    (tmp_path / "a.imu-trial").rename(tmp_path / "a.bin")
    noise = json.loads(inside("noise", tmp_path / "a.bin", "--json", "--quiet").stdout)["noise"]
    assert noise["duration_s"] == pytest.approx(12, abs=0.1)
    done = inside("import", tmp_path / "a.bin", "-o", tmp_path / "b.imu-trial", code=2)
    assert "trial file of imu-rig already" in done.stderr


def document_block(language):
    return DOCUMENT.read_text(encoding="utf-8").split(f"```{language}\n")[1].split("```")[0]


def test_the_map_of_the_document_is_right(inside, tmp_path):
    (tmp_path / "logger.toml").write_text(document_block("toml"))
    names = [f"{kind}{number}{axis}" for number in "12" for kind in "ag" for axis in "xyz"]
    lines = [";".join(["Zeit", *names, "T2"])]
    (accel, gyro), (other, _) = still(200, 1), still(200, 2)
    for i in range(200):
        rest = [*accel[i] / 9.80665, *np.degrees(gyro[i])]
        numbers = [*rest, *other[i] / 9.80665, *np.degrees(gyro[i]), 21.5]
        lines.append(";".join([str(10 * i), *(f"{v:.8f}".replace(".", ",") for v in numbers)]))
    (tmp_path / "logger.csv").write_text("\n".join(lines))
    out = tmp_path / "logger.imu-trial"
    inside("import", tmp_path / "logger.csv", "--map", tmp_path / "logger.toml", "-o", out)
    trial = open_trial(out)
    assert trial.sensors == ["shank", "thigh"]
    turned = other[:, [1, 0, 2]] * [1, -1, 1]
    assert np.allclose(trial.imu("thigh").accel, turned, atol=1e-6)
    assert np.allclose(trial.imu("shank").gyro, gyro, atol=1e-8)
    assert trial.imu("thigh").temperature[5] == 21.5
    assert np.allclose(trial.imu("thigh").t, np.arange(200) / 100)


def test_the_python_and_the_formats_of_the_document_are_right(tmp_path, monkeypatch, capsys):
    accel, gyro = still(300)
    savemat(tmp_path / "trial.mat", {"imu_acc": accel, "imu_gyr": gyro, "sampling_rate": 100.0})
    monkeypatch.chdir(tmp_path)
    exec(document_block("python"), {})  # noqa: S102
    assert capsys.readouterr().out.startswith("broad")
    rows = [line for line in DOCUMENT.read_text(encoding="utf-8").splitlines() if "| `" in line]
    assert {row.split("`")[1] for row in rows} == set(FORMATS)
