"""`imu-rig export`: which devices, which format, raw or calibrated, and what it says."""

import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trials_to_export import BARO, LEFT, RIGHT, Device, write_trial

from imu_rig.cli.main import run as main
from imu_rig.recording import open_trial

CERTIFICATE = Path(__file__).resolve().parent.parent / "data" / "certificate-v1.json"
CONTENT = json.loads(CERTIFICATE.read_text())
Run = Callable[..., tuple[str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    def run(*arguments: object, code: int = 0) -> tuple[str, str]:
        monkeypatch.setattr(sys, "argv", ["imu-rig", "export", *map(str, arguments)])
        returned = 0
        try:
            main()
        except SystemExit as leaving:
            returned = int(leaving.code or 0)
        out, err = capsys.readouterr()
        assert returned == code, out + err
        assert "\x1b" not in out + err
        return out, err

    return run


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trial whose left shoe was recorded with its certificate."""
    path = tmp_path_factory.mktemp("walk") / "walk.imu-trial"
    left = Device("left shoe", lost=LEFT.lost, descriptor={"certificate": CONTENT})
    write_trial(path, [left, RIGHT, BARO])
    return path


def columns(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return {name: np.array(cells) for name, *cells in zip(header, *rows, strict=True)}


def calibrated(sensor: str, raw: np.ndarray) -> np.ndarray:
    """K raw - b, as the certificate states them."""
    gain, bias = np.array(CONTENT[sensor]["K"]), np.array(CONTENT[sensor]["b"])
    return np.array([gain @ sample - bias for sample in raw])


def test_everything_raw_beside_the_trial(run: Run, tmp_path: Path) -> None:
    trial = tmp_path / "walk.imu-trial"
    write_trial(trial, [LEFT, BARO])
    out, err = run(trial, "--to", "csv")
    assert (tmp_path / "walk_left_shoe.csv").is_file()
    assert "left shoe: 240 raw samples, 1 gap of 0.61 s (60 samples)" in out
    assert err == ""
    _, err = run(trial, "--to", "csv", code=2)
    assert "never overwritten" in err


def test_the_certificates_of_the_trial_are_applied_when_asked(
    run: Run, walk: Path, tmp_path: Path
) -> None:
    out, err = run(walk, "-o", tmp_path / "x.csv", "--calibrated", "--json")
    found = columns(tmp_path / "x_left_shoe.csv")
    for sensor, unit in (("accel", "mps2"), ("gyro", "radps")):
        expected = calibrated(sensor, LEFT.truth()[sensor])
        for place, axis in enumerate("xyz"):
            numbers = found[f"calibrated_{sensor}_{axis}_{unit}"].astype(float)
            largest = np.abs(expected[:, place]).max()
            assert np.abs(numbers - expected[:, place]).max() <= 2e-9 * largest
    assert "mag_x_uT" in found
    assert "accel_x_mps2" in columns(tmp_path / "x_왼발_31m.csv")
    assert "holds no certificate of '../왼발 \\x1b[31m': its values are raw" in err
    assert "has no magnetometer: its columns are raw" in err
    summary = json.loads(out)
    assert summary["devices"]["left shoe"]["calibrated"] == ["accel", "gyro"]
    uncertainty_s = open_trial(walk).time_uncertainty_s("left shoe")
    assert summary["devices"]["left shoe"]["time_uncertainty_s"] == uncertainty_s
    assert summary["calibrated"] == []  # of the other shoe nothing is
    assert summary["samples"] == len(LEFT.kept) + len(RIGHT.kept) + len(BARO.kept)
    assert set(summary["files"]) == set(map(str, tmp_path.iterdir()))


def test_a_certificate_of_a_file_is_for_one_sensor(run: Run, walk: Path, tmp_path: Path) -> None:
    asked = (walk, "-o", tmp_path / "x.mat", "--certificate", CERTIFICATE, "--any-device")
    _, err = run(*asked, code=2)
    assert "2 inertial sensors" in err
    out, err = run(*asked, "--sensor", "left shoe", "--sensor", "barometer")
    assert "left shoe: 240 calibrated (accel, gyro) samples" in out
    assert "barometer: 120 raw samples" in out
    assert "Applied all the same" in err


def test_a_folder_is_made_and_a_name_gets_the_suffix(run: Run, walk: Path, tmp_path: Path) -> None:
    one = (walk, "--sensor", "barometer", "--to", "csv", "-o")
    folder = tmp_path / "new"
    run(*one, f"{folder}/")
    run(*one, tmp_path / "walk.2")
    run(*one, tmp_path / "other.CSV")
    found = sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file())
    found = [name for name in found if "_markers" not in name]
    assert found == ["new/walk.csv", "other.CSV", "walk.2.csv"]
    before = (folder / "walk.csv").read_bytes()
    for again in (f"{folder}/", folder, tmp_path / "walk.2"):
        _, err = run(*one, again, code=2)
        assert "never overwritten" in err
    assert (folder / "walk.csv").read_bytes() == before
    _, err = run(*one, f"{tmp_path / 'other.CSV'}/", code=2)
    assert "other.CSV cannot be made" in err


def test_no_folder_is_left_by_an_export_that_fails(run: Run, tmp_path: Path) -> None:
    empty = tmp_path / "empty.imu-trial"
    write_trial(empty, [Device("left shoe", count=0)])
    run(empty, "--to", "csv", "-o", f"{tmp_path / 'new'}/", code=2)
    assert list(tmp_path.iterdir()) == [empty]


def test_devices_are_chosen_by_name(run: Run, walk: Path, tmp_path: Path) -> None:
    out, _ = run(walk, "-o", tmp_path / "x.csv", "--sensor", "barometer", "--raw", "--json")
    assert list(json.loads(out)["devices"]) == ["barometer"]
    assert (tmp_path / "x.csv").is_file()
    _, err = run(walk, "-o", tmp_path / "y.csv", "--sensor", "baro", code=2)
    assert "has no sensor 'baro'" in err
    assert "barometer" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--raw", "--calibrated"], "one of --raw, --calibrated and --certificate"),
        (["--to", "excel"], "csv, mcap, tlog, mat, parquet, c3d"),
        ([], "--to"),
        (["-o", "none/x.csv"], "none is not a folder"),
        (["--to", "csv", "--calibrated", "--sensor", "barometer"], "no certificate of"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(
    run: Run, walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments, words
) -> None:
    monkeypatch.chdir(tmp_path)
    out, err = run(walk, *arguments, "--json", code=2)
    assert words in err
    assert err.count("\n") == 1
    assert words in json.loads(out)["error"]
    assert list(tmp_path.iterdir()) == []


def test_what_a_format_does_not_hold_is_said(run: Run, walk: Path, tmp_path: Path) -> None:
    _, err = run(walk, "-o", tmp_path / "x.tlog")
    assert "left shoe: MAVLink has no place for status; left out." in err
    out, err = run(walk, "-o", tmp_path / "x.c3d", "--json")
    notes: list[Any] = json.loads(out)["notes"]
    assert any("grid of 100 Hz" in note for note in notes)
    assert all(note in err for note in notes)


def test_damage_is_said_and_the_rest_exported(run: Run, walk: Path, tmp_path: Path) -> None:
    data = bytearray(walk.read_bytes())
    data[len(data) // 2] ^= 1
    hurt = tmp_path / "hurt.imu-trial"
    hurt.write_bytes(data)
    out, err = run(hurt, "-o", tmp_path / "x.mcap", "--json")
    assert "is damaged" in err
    assert json.loads(out)["samples"] == len(LEFT.kept) + len(RIGHT.kept) + len(BARO.kept) - 1
