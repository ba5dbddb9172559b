"""`imu-rig analyze foot` and `gait` from outside, on a simulated walk of 10 m."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest

from imu_rig.blocks import ImuBlock
from imu_rig.calibration.certificate import Certificate, load_certificate
from imu_rig.cli.analyze_methods import Found, Way, find_track
from imu_rig.errors import DataError
from imu_rig.recording.reader import open_trial

Run = Callable[..., CompletedProcess[str]]

OLD_CERTIFICATE = Path(__file__).parent.parent / "data" / "certificate-v1.json"
WALK_M = 10.0


@dataclass(frozen=True)
class Walked:
    """A trial of two feet and the waist, and the truth."""

    trial: Path
    truth: dict[str, np.ndarray]


@pytest.fixture(scope="module")
def walked(inside: Run, tmp_path_factory: pytest.TempPathFactory) -> Walked:
    folder = tmp_path_factory.mktemp("walk")
    devices = [f"--device={name}=mpu9150" for name in ("left-foot", "right-foot", "waist")]
    files = ("--trial", folder / "walk.imu-trial", "--truth", folder / "truth.csv")
    inside("simulate", "walk", "level-10m", *devices, *files)
    truth: dict[str, list[list[float]]] = {}
    with (folder / "truth.csv").open() as file:
        for row in csv.DictReader(file):
            values = [float(row[name]) for name in ("t_s", "x_m", "y_m", "z_m")]
            truth.setdefault(row["device"], []).append(values)
    return Walked(folder / "walk.imu-trial", {k: np.array(v) for k, v in truth.items()})


@pytest.fixture(scope="module")
def analysed(inside: Run, walked: Walked, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an analysis of the left foot."""
    folder = tmp_path_factory.mktemp("foot") / "out"
    inside("analyze", "foot", walked.trial, "--sensor", "left-foot", "-o", folder, "--json")
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_the_files_of_a_foot_agree_with_each_other_and_the_walk(
    walked: Walked, analysed: Path
) -> None:
    summary = json.loads((analysed / "summary.json").read_text())
    foot = summary["feet"]["left-foot"]
    strides, path = rows_of(analysed / "strides.csv"), rows_of(analysed / "trajectory.csv")
    assert foot["strides"] == len(strides) == 8
    assert sum(float(row["length_m"]) for row in strides) == pytest.approx(
        foot["distance_m"], abs=1e-3
    )
    # The sensor is as it comes from the shop: some per cent are its own.
    assert foot["distance_m"] == pytest.approx(WALK_M, rel=0.05)
    assert len(path) == len(open_trial(walked.trial).imu("left-foot"))
    assert float(path[0]["x_m"]) == 0.0
    assert [float(path[-1][f"{a}_m"]) for a in "xyz"] == pytest.approx(foot["end_m"], abs=1e-4)
    q = np.array([[float(row[name]) for name in ("qw", "qx", "qy", "qz")] for row in path])
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-6)
    still = np.mean([row["stands"] == "1" for row in path])
    assert 0.5 < still < 0.95
    page = (analysed / "report.html").read_text()
    assert "<script" not in page
    assert not re.search(r"\b(nan|inf)\b", page, re.IGNORECASE)
    assert Path(summary["files"]["report"]).samefile(analysed / "report.html")


def test_an_analysis_is_never_overwritten(inside: Run, walked: Walked, analysed: Path) -> None:
    before = (analysed / "summary.json").read_bytes()
    again = inside("analyze", "foot", walked.trial, "--sensor", "left-foot", "-o", analysed, code=2)
    assert "never overwritten" in again.stderr
    assert (analysed / "summary.json").read_bytes() == before


def test_feet_are_found_by_name_and_told_on_eighty_columns(
    inside: Run, walked: Walked, tmp_path: Path
) -> None:
    done = inside("analyze", "foot", walked.trial, "--no-files", cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert re.search(r"^left-foot of walk", done.stdout, re.MULTILINE)
    assert re.search(r"^right-foot of walk", done.stdout, re.MULTILINE)
    assert "waist of" not in done.stdout
    assert "feet came out" not in done.stdout  # and nothing was wrong with them
    apart = inside("analyze", "foot", walked.trial, "--no-files", "--separate", "--straight")
    assert apart.stdout.count("Heading ") == 2  # a sentence of each foot about its corridor
    assert max(map(len, done.stdout.splitlines())) <= 80


def test_a_foot_that_cannot_be_followed_does_not_end_the_other(
    inside: Run, walked: Walked, monkeypatch: pytest.MonkeyPatch
) -> None:
    def limping(block: ImuBlock, way: Way, certificate: Certificate | None) -> Found:
        if block.accel[0, 0] == right.accel[0, 0]:
            raise DataError("it is in a pocket")
        return find_track(block, way, certificate)

    right = open_trial(walked.trial).imu("right-foot")
    monkeypatch.setattr("imu_rig.cli.analyze_feet.find_track", limping)
    told = inside("analyze", "foot", walked.trial, "--no-files", code=2)
    assert "left-foot of walk" in told.stdout
    assert "right-foot of walk.imu-trial is left out" in told.stdout
    assert "It is in a pocket." in told.stdout
    answer = json.loads(
        inside("analyze", "foot", walked.trial, "--json", "--no-files", code=2).stdout
    )
    assert list(answer["feet"]) == ["left-foot"]
    assert answer["left_out"] == {"right-foot": "It is in a pocket."}


def test_optics_beside_a_foot(inside: Run, walked: Walked, tmp_path: Path) -> None:
    truth = walked.truth["left-foot"].copy()
    truth[:, 1:] = truth[:, [2, 1, 3]] * [-1.0, 1.0, 1.0] + [3.0, -2.0, 0.5]  # a quarter turn
    reference = tmp_path / "optics.csv"
    np.savetxt(
        reference,
        truth,
        delimiter=",",
        header="time [s],x [m],y [m],z [m]",
        comments="",
        fmt="%.6f",
    )
    arguments = ("analyze", "foot", walked.trial, "--sensor", "left-foot", "--no-files", "--json")
    done = inside(*arguments, "--reference", reference, "--search-offset", 1)
    found = json.loads(done.stdout)["feet"]["left-foot"]["reference"]
    assert found["rmse_horizontal_m"] < 0.15
    assert found["rmse_vertical_m"] < 0.05
    assert not found["hands"]["suspect"]
    assert found["strides"]["paired"] >= 7
    assert found["strides"]["distance_m"] == pytest.approx(WALK_M, rel=0.05)
    refused = inside(*arguments, "--fit-lever", code=2)
    assert "--fit-lever is about a reference" in refused.stderr
    truth[:, 3] *= -1.0  # as an axis that points down, and the clock is another
    truth[:, 2] *= -1.0
    truth[:, 0] += 1.3
    np.savetxt(reference, truth, delimiter=",", header="time [s],x [m],y [m],z [m]", comments="")
    down = ("--reference", reference, "--reference-z-down")
    notes = json.loads(inside(*arguments, *down).stdout)["feet"]["left-foot"]["notes"]
    assert any("seems to be on another clock" in note for note in notes)
    truth[:, 0] += 1000.0
    np.savetxt(reference, truth, delimiter=",", header="time [s],x [m],y [m],z [m]", comments="")
    refused = inside(*arguments, "--reference", reference, code=2)
    assert "share 0 places" in refused.stderr
    assert "--search-offset" in refused.stderr


def test_footprints_beside_a_foot(inside: Run, walked: Walked, tmp_path: Path) -> None:
    strides = rows_of(walked.trial.parent / "truth-strides.csv")
    places = [[float(r["x_m"]), float(r["y_m"])] for r in strides if r["foot"] == "left"]
    prints = tmp_path / "prints.csv"
    begin = walked.truth["left-foot"][0, 1:3] - walked.truth["left-foot"][-1, 1:3] + places[-1]
    np.savetxt(prints, [begin, *places], delimiter=",", header="x,y", comments="")
    answer = json.loads(
        inside(
            *("analyze", "foot", walked.trial, "--sensor", "left-foot", "--no-files", "--json"),
            *("--footprints", prints),
        ).stdout
    )
    found = answer["feet"]["left-foot"]["footprints"]
    assert found["strides"] == found["true_strides"]
    assert found["mae_m"] < 0.08
    np.savetxt(prints, 3.0 * np.array([begin, *places]), delimiter=",", header="x,y", comments="")
    told = inside(
        *("analyze", "foot", walked.trial, "--sensor", "left-foot", "--no-files"),
        *("--footprints", prints),
    ).stdout
    assert "Do the footprints belong to this recording?" in " ".join(told.split())


def test_the_published_method_finds_the_same_walk(inside: Run, walked: Walked) -> None:
    answer = json.loads(
        inside(
            *("analyze", "foot", walked.trial, "--sensor", "left-foot", "--no-files", "--json"),
            *("--method", "paper"),
        ).stdout
    )
    foot = answer["feet"]["left-foot"]
    assert foot["distance_m"] == pytest.approx(WALK_M, rel=0.08)
    assert foot["distance_sigma_m"] is None
    assert any("two-filter" in note for note in foot["notes"])


def of_this_sensor(trial: Path) -> Certificate:
    """A certificate that knows the gyroscope's bias in this trial, and nothing else."""
    block = open_trial(trial).imu("left-foot")
    bias = tuple(block.gyro[block.t < block.t[0] + 3.0].mean(axis=0).tolist())
    old = load_certificate(OLD_CERTIFICATE)
    assert old.gyro is not None
    identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return old.model_copy(
        update={
            "gyro": old.gyro.model_copy(update={"K": identity, "b": bias}),
            "accel": old.accel.model_copy(update={"K": identity, "b": (0.0, 0.0, 0.0)}),
            "temperature": None,
        }
    )


def test_gait_of_a_known_distance_with_and_without_a_certificate(
    inside: Run, walked: Walked, tmp_path: Path
) -> None:
    certificate = tmp_path / "certificate.json"
    of_this_sensor(walked.trial).save(certificate)
    arguments = ("analyze", "gait", walked.trial, "--sensor", "left-foot", "--distance", "10")
    done = inside(*arguments, "--json", "-o", tmp_path / "raw", "--raw")
    answer = json.loads(done.stdout)
    assert answer["gait"]["length_m"]["n"] >= 6
    assert answer["trials"][0]["calibrated_m"] is None
    assert answer["trials"][0]["smoother_m"][0] == pytest.approx(WALK_M, rel=0.05)
    assert "no certificate" in (tmp_path / "raw" / "report.html").read_text()
    (row,) = rows_of(tmp_path / "raw" / "distances.csv")
    assert row["known_x_m"] == "10.0"
    assert row["calibrated_x_m"] == ""
    given = ("--certificate", certificate, "--any-device")
    calibrated = json.loads(inside(*arguments, "--json", "--no-files", *given).stdout)
    raw_m, calibrated_m = (
        np.abs(calibrated["trials"][0][f"{kind}_m"][0] - WALK_M)
        for kind in ("uncalibrated", "calibrated")
    )
    assert calibrated_m < 0.5 * raw_m
    improvement = calibrated["improvement_percent"]["x"]["mean"]
    assert improvement == pytest.approx(100.0 * (1.0 - calibrated_m / raw_m), abs=0.01)
    shown = inside(*arguments, "--no-files", *given).stdout
    assert max(map(len, shown.splitlines())) <= 80
    assert "makes errors smaller by: x" in shown


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["--sensor", "hand"],
            "has no inertial sensor 'hand' (it has left-foot, right-foot, waist)",
        ),
        (["--method", "magic"], "--method is one of default, paper"),
        (["--level", "maybe"], "--level is one of auto, always, never"),
        (["--detector", "luck"], "--detector is one of adaptive, paper, shoe"),
        (["--raw", "--certificate", "c.json"], "either --raw or --certificate"),
        (["--certificate", "c.json"], "does not say whose it is"),
        (["--no-files", "-o", "out"], "either --output or --no-files"),
        (["--reference", "optics.csv"], "a reference is of one"),
        (["--marker", "heel"], "--marker needs --reference"),
        (["--gravity", "9.8", "--latitude", "50"], "either --gravity or --latitude"),
        (["--rate", "100"], "knows its columns, units and rate"),
    ],
)
def test_options_that_cannot_be_meant(
    inside: Run, walked: Walked, arguments: list[str], words: str, tmp_path: Path
) -> None:
    done = inside("analyze", "foot", walked.trial, *arguments, code=2, cwd=tmp_path)
    assert words in " ".join(done.stderr.split())
    assert list(tmp_path.iterdir()) == []


def test_the_sensor_of_a_walk_is_calibrated_by_its_name(inside: Run) -> None:
    done = inside("calibrate", "--simulate", "--worn", code=2)
    assert "--worn needs --simulate, and --name" in " ".join(done.stderr.split())


def test_distances_that_are_none(inside: Run, walked: Walked) -> None:
    for text in ("ten", "1,2", "nan", "1e9"):
        done = inside("analyze", "gait", walked.trial, "--distance", text, code=2)
        assert "is no distance" in done.stderr
    for text in ("0", "-5,1,0"):
        done = inside("analyze", "gait", walked.trial, "--distance", text, code=2)
        assert "more than 0" in " ".join(done.stderr.split())
    far = ("--sensor", "left-foot", "--distance", "32.8", "--no-files")  # of feet
    told = " ".join(inside("analyze", "gait", walked.trial, *far).stdout.split())
    assert "is that the distance of this trial, in metres?" in told
    assert "x [m], known 32.80" in told


def test_a_recording_without_gyroscope_is_refused(inside: Run, tmp_path: Path) -> None:
    table = tmp_path / "walk.csv"
    accel = np.random.default_rng(1).normal([0.0, 0.0, 9.81], 0.1, (300, 3))
    rows: Any = np.column_stack((np.arange(300) / 100.0, accel))
    np.savetxt(table, rows, delimiter=",", header="t,ax,ay,az", comments="")
    for what in ("foot", "gait"):
        done = inside("analyze", what, table, "--accel-unit", "m/s2", "--no-files", code=2)
        assert "no gyroscope" in done.stderr


def test_a_trial_that_cannot_be_followed_is_left_out_of_the_others(
    inside: Run, walked: Walked, tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    table = tmp_path / "shaken.csv"
    shaken = np.column_stack(
        (np.arange(600) / 100.0, rng.normal([0, 0, 9.8, 0, 0, 0], 3.0, (600, 6)))
    )
    np.savetxt(table, shaken, delimiter=",", header="t,ax,ay,az,gx,gy,gz", comments="")
    units = ("--accel-unit", "m/s2", "--gyro-unit", "rad/s")
    trial = tmp_path / "shaken.imu-trial"
    inside("import", table, *units, "-o", trial)
    alone = inside("analyze", "gait", trial, "--no-files", code=2)
    assert "shaken.imu-trial" in alone.stderr
    feet = json.loads(
        inside("analyze", "foot", trial, walked.trial, "--no-files", "--json", code=2).stdout
    )
    assert list(feet["errors"]) == [str(trial)]
    assert [list(one["feet"]) for one in feet["recordings"]] == [["left-foot", "right-foot"]]
    both = json.loads(
        inside("analyze", "gait", walked.trial, trial, "--no-files", "--json", code=2).stdout
    )
    assert list(both["left_out"]) == ["shaken"]
    assert [one["trial"] for one in both["trials"]] == ["walk, left-foot", "walk, right-foot"]
