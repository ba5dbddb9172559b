"""The commands from outside: what they print, write and refuse."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from program import PROGRAM

from imu_rig.calibration.certificate import apply_certificate, load_certificate
from imu_rig.calibration.certificate_magnetometer import MagEntry
from imu_rig.calibration.certificate_parts import AffineEntry
from imu_rig.calibration.model import Affine
from imu_rig.recording.reader import open_trial


def test_help_needs_nothing_heavy() -> None:
    probe = (
        "import sys, imu_rig.cli.main, imu_rig.cli.commands; "
        "print([m for m in ('numpy', 'scipy', 'matplotlib', 'pydantic', 'serial', 'rich') "
        "if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_ctrl_c_while_the_program_starts_is_no_traceback() -> None:
    probe = (
        "import builtins, signal; real = builtins.__import__\n"
        "def interrupted(name, *rest):\n"
        "    if name == 'typer': signal.raise_signal(signal.SIGINT)\n"
        "    return real(name, *rest)\n"
        "builtins.__import__ = interrupted\n"
        "from imu_rig.cli.main import run; run()"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "imu-rig: interrupted\n")


@pytest.mark.parametrize("command", ["demo", "calibrate", "solve", "info", "export", "simulate"])
def test_every_command_explains_itself(imu_rig: Any, command: str) -> None:
    assert "Usage: imu-rig" in imu_rig(command, "--help").stdout


@pytest.mark.timeout(150)
def test_the_demo_ends_in_a_certificate_that_holds(finished: dict[str, Any]) -> None:
    files = {name: Path(path) for name, path in finished["files"].items()}
    assert all(path.is_file() for path in files.values())
    certificate = load_certificate(files["certificate"])
    trial = open_trial(files["trial"])
    assert trial.ended == "complete"
    assert not trial.damage
    assert certificate.recording is not None
    assert certificate.recording.sha256 == trial.sha256
    assert len(certificate.poses) == 24
    held_out = certificate.accel_errors.held_out
    before = certificate.accel_errors.before
    assert held_out is not None
    assert before is not None
    assert held_out.rms < before.rms / 20
    assert "<script" not in files["report"].read_text()


def test_a_session_exported_and_solved_as_a_table_says_the_same(
    inside: Any, finished: dict[str, Any], tmp_path: Path
) -> None:
    table = tmp_path / "session.csv"
    inside("export", finished["files"]["trial"], "-o", table)
    done = inside("solve", table, "--json")
    by_table = json.loads(done.stdout)["certificate"]
    by_trial = finished["certificate"]
    for sensor, tolerance in (("accel", 1e-3), ("gyro", 2e-3)):
        assert by_table[sensor]["K"] == pytest.approx(
            np.array(by_trial[sensor]["K"]), abs=tolerance
        )


def test_export_applies_a_certificate(
    inside: Any, finished: dict[str, Any], tmp_path: Path
) -> None:
    files = finished["files"]
    table = tmp_path / "calibrated.csv"
    done = inside(
        "export", files["trial"], "--certificate", files["certificate"], "-o", table, "--json"
    )
    summary = json.loads(done.stdout)
    block = apply_certificate(
        load_certificate(files["certificate"]), open_trial(files["trial"]).imu("imu")
    )
    rows = np.loadtxt(table, delimiter=",", skiprows=1, usecols=range(7))
    assert summary["samples"] == len(rows) == len(block)
    assert rows[:, 1:4] == pytest.approx(block.accel, rel=1e-6, abs=1e-6)
    assert rows[:, 4:7] == pytest.approx(block.gyro, rel=1e-6, abs=1e-8)
    assert table.read_text().startswith("t_s,calibrated_accel_x_mps2")
    inside("export", files["trial"], "-o", table, code=2)  # never overwrites


def test_info_tells_what_files_hold(inside: Any, finished: dict[str, Any]) -> None:
    files = finished["files"]
    facts = json.loads(inside("info", files["trial"], "--json").stdout)
    assert facts["ended"] == "complete"
    assert facts["session"]["finished"] == "29 of 29 stops"
    assert facts["sources"]["imu"]["lost"] == 0
    assert "29 of 29 stops" in inside("info", files["trial"]).stdout
    shown = json.loads(inside("info", files["certificate"], "--json").stdout)
    assert len(shown["certificate"]["poses"]) == 24


@pytest.mark.parametrize("method", ["paper", "paper-diagonal"])
def test_the_published_methods_solve_the_same_session_worse(
    inside: Any, finished: dict[str, Any], method: str
) -> None:
    done = inside("solve", finished["files"]["trial"], "--method", method, "--json")
    theirs = json.loads(done.stdout)["certificate"]["accel_errors"]["held_out"]["rms"]
    ours = finished["certificate"]["accel_errors"]["held_out"]["rms"]
    assert theirs > 5 * ours


def test_solve_writes_nothing_unless_told_and_never_overwrites(
    inside: Any, finished: dict[str, Any], tmp_path: Path
) -> None:
    trial = finished["files"]["trial"]
    inside("solve", trial, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []
    inside("solve", trial, "-o", tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "certificate.json",
        "report.html",
    ]
    refused = inside("solve", trial, "-o", tmp_path / "out", code=2)
    assert "never overwritten" in refused.stderr


def test_a_dry_run_moves_nothing_and_tells_the_plan(inside: Any) -> None:
    plan = json.loads(inside("calibrate", "--dry-run", "--json").stdout)
    kinds = [step["kind"] for step in plan["steps"]]
    assert (kinds.count("pose"), kinds.count("check")) == (24, 5)
    assert plan["duration_s"] == pytest.approx(sum(s["duration_s"] for s in plan["steps"]), abs=0.5)


def hand_table(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "hand.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["calibrate"], 2, "--imu PORT"),
        (["calibrate", "--imu", "/dev/none1", "--maestro", "/dev/none2"], 3, "/dev/none2"),
        (["calibrate", "--simulate", "--speed", "0"], 2, "--speed"),
        (["calibrate", "--simulate", "--fault", "imu:eaten@1"], 2, "imu:eaten"),
        (["calibrate", "--simulate", "--fault", "nonsense"], 2, "--fault nonsense"),
        (["calibrate", "--simulate", "--protocol", "none"], 2, "none"),
        (["calibrate", "--simulate", "--jig", "none.toml"], 2, "none"),
        (["calibrate", "--simulate", "--layout", "none"], 2, "none"),
        (["calibrate", "--resume", "none.imu-trial", "--simulate"], 2, "none.imu-trial"),
        (["calibrate", "--simulate", "--imu", "/dev/none1"], 2, "not both"),
        (["calibrate", "--simulate", "--protocol", "six-faces-and-turns"], 2, "--method paper"),
        (["calibrate", "--simulate", "--method", "guess"], 2, "multi-position"),
        (["solve", "none.imu-trial", "--rate", "100"], 2, "leave those options out"),
        (["solve", "none.csv"], 2, "none.csv"),
        (["solve", "none.imu-trial"], 2, "none.imu-trial"),
        (["solve", "x.csv", "--gravity", "3"], 2, "gravity"),
        (["solve", "x.csv", "--gravity", "9.8", "--latitude", "50"], 2, "not both"),
        (["solve", "x.csv", "--height", "50"], 2, "--latitude"),
        (["info", "none"], 2, "none"),
        (["export", "none", "-o", "x.csv"], 2, "none"),
        (["demo", "--seed", "-3"], 2, "--seed"),
    ],
)
def test_a_mistake_is_one_sentence_and_an_exit_code(
    inside: Any, tmp_path: Path, arguments: list[str], code: int, words: str
) -> None:
    done = inside(*arguments, code=code, cwd=tmp_path)
    assert words in done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("ax,ay,az,gx,gy,gz\n", "hand.csv"),
        ("ax,ay,az,gx,gy,gz\n0,0,nan,0,0,0\n" * 40, "line"),
        ("ax,ay,az,gx,gy,gz\n" + "0,0,1,0,0,0\n" * 400, "hand.csv"),
    ],
)
def test_a_bad_table_is_one_sentence(inside: Any, tmp_path: Path, text: str, words: str) -> None:
    path = hand_table(tmp_path, text)
    done = inside("solve", path, "--rate", 100, "--json", code=2)
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert json.loads(done.stdout)["exit_code"] == 2


@pytest.mark.parametrize(
    ("scale", "unit"), [(1 / 9.80665, "g"), (1.0, "m/s2"), (16384 / 9.80665, "16384 LSB/g")]
)
def test_a_missing_unit_is_guessed_and_asked_for(
    inside: Any, finished: dict[str, Any], tmp_path: Path, scale: float, unit: str
) -> None:
    block = open_trial(finished["files"]["trial"]).imu("imu")
    path = tmp_path / "plain.csv"
    rows = np.column_stack((block.accel * scale, block.gyro))
    np.savetxt(path, rows, delimiter=",", header="ax,ay,az,gx,gy,gz", comments="")
    done = inside("solve", path, "--rate", 100, code=2)
    assert f"--accel-unit {unit}" in done.stderr.replace('"', "").replace("'", "")


def test_the_real_recordings_solve_to_their_figures(inside: Any, imu_rig_data: Path) -> None:
    folder = imu_rig_data / "calibration" / "mikoff_mpu9150"
    for name, limit_mg in (("imu0.log", 0.30), ("imu1.log", 0.36)):
        done = inside(
            "solve",
            folder / name,
            *("--columns", "ax ay az gx gy gz", "--rate", 100),
            *("--accel-unit", "m/s2", "--gyro-unit", "rad/s", "--gravity", 9.81, "--json"),
        )
        certificate = json.loads(done.stdout)["certificate"]
        assert certificate["accel_errors"]["held_out"]["rms"] < limit_mg * 9.80665e-3
        assert np.degrees(certificate["gyro_errors"]["held_out"]["rms"]) < 0.25


def test_an_ill_posed_saturated_recording_is_warned_of(inside: Any, imu_rig_data: Path) -> None:
    path = imu_rig_data / "calibration/tomisuarez2_mpu6050/example_data_calibration.csv"
    done = inside(
        "solve",
        path,
        *("--rate", 100, "--accel-unit", "16384 LSB/g", "--gyro-unit", "131 LSB/(deg/s)", "--json"),
    )
    warnings = " ".join(json.loads(done.stdout)["certificate"]["warnings"])
    assert "range limit" in warnings
    assert "10 poses" in warnings


@pytest.mark.parametrize(
    ("protocol", "method"), [("six-faces-and-turns", "paper"), ("quick", "multi-position")]
)
def test_every_other_builtin_protocol_ends_in_a_certificate(
    imu_rig: Any, tmp_path: Path, protocol: str, method: str
) -> None:
    done = imu_rig(
        *("calibrate", "--simulate", "--speed", 8, "--protocol", protocol, "--method", method),
        *("--output", tmp_path / "out", "--json"),
    )
    assert json.loads(done.stdout)["certificate"]["gyro"] is not None
    assert "expected standard uncertainty" in done.stderr


def test_a_certificate_without_gyroscope_leaves_it_raw_and_says_so(
    inside: Any, finished: dict[str, Any], tmp_path: Path
) -> None:
    content = json.loads(Path(finished["files"]["certificate"]).read_text())
    content["gyro"] = None
    path = tmp_path / "accel-only.json"
    path.write_text(json.dumps(content))
    trial = finished["files"]["trial"]
    done = inside("export", trial, "--certificate", path, "-o", tmp_path / "x.csv", "--json")
    assert json.loads(done.stdout)["calibrated"] == ["accel", "mag"]
    assert "no gyroscope: its columns are raw" in done.stderr


@pytest.mark.parametrize("field", ["serial", "name", "layout"])
def test_the_certificate_of_another_sensor_is_not_applied_unless_asked_for(
    inside: Any, finished: dict[str, Any], tmp_path: Path, field: str
) -> None:
    content = json.loads(Path(finished["files"]["certificate"]).read_text())
    content["device"][field] = "of-another-sensor"
    if field == "name":
        content["device"]["serial"] = ""  # else the serial number decides
    path, table = tmp_path / "another.json", tmp_path / "x.csv"
    path.write_text(json.dumps(content))
    asked = ("export", finished["files"]["trial"], "--certificate", path, "-o", table)
    refused = inside(*asked, code=2)
    assert "of-another-sensor" in refused.stderr
    assert "--any-device" in refused.stderr
    assert not table.exists()
    done = inside(*asked, "--any-device")
    assert "all the same" in done.stderr
    assert "calibrated (accel, gyro, mag) samples" in done.stdout


def test_an_export_lists_every_sensor_that_was_calibrated(
    inside: Any, finished: dict[str, Any], tmp_path: Path
) -> None:
    """Here the field alone."""
    files = finished["files"]
    certificate = load_certificate(files["certificate"])
    nominal = AffineEntry.of(Affine(np.eye(3), np.zeros(3), 1e-4 * np.eye(12)))
    iron = AffineEntry.of(Affine(np.eye(3), np.array([20.0, 0.0, 0.0]), 1e-4 * np.eye(12)))
    mag = MagEntry(
        affine=iron,
        alignment="none",
        field_ut=48.0,
        field_known=False,
        from_stills=False,
        count=900,
        before_percent=30.0,
        residual_percent=0.5,
        left_out_percent=0.6,
    )
    path, table = tmp_path / "mag.json", tmp_path / "x.csv"
    changed = {"mag": mag, "accel": nominal, "gyro": None, "method": "magnetometer"}
    certificate.model_copy(update=changed).save(path)
    raw = tmp_path / "raw.csv"
    inside("export", files["trial"], "-o", raw)
    done = inside("export", files["trial"], "--certificate", path, "-o", table)
    assert "calibrated (mag) samples" in done.stdout
    assert "no accelerometer" in done.stderr
    assert "no gyroscope" in done.stderr
    before, after = (np.genfromtxt(path, delimiter=",", names=True) for path in (raw, table))
    named = dict(zip(before.dtype.names, after.dtype.names, strict=True))
    del named["utc"]
    assert [a for b, a in named.items() if a != b] == [
        f"calibrated_mag_{axis}_uT" for axis in "xyz"
    ]
    (column,) = [b for b, a in named.items() if not np.allclose(before[b], after[a])]
    assert column.startswith("mag_x")
    assert after[named[column]] == pytest.approx(before[column] - 20.0, abs=1e-3)


def hostile_files(folder: Path) -> dict[str, Path]:
    fifo, dots, deep = folder / "fifo", folder / "dots.toml", folder / "deep.toml"
    os.mkfifo(fifo)
    dots.write_text(".".join(["a"] * 30_000) + " = 1")
    deep.write_text("a = " + "[" * 5000 + "]" * 5000)
    return {"fifo": fifo, "zero": Path("/dev/zero"), "dots": dots, "deep": deep, "folder": folder}


@pytest.mark.parametrize(
    ("option", "kind"),
    [
        *(("--protocol", kind) for kind in ("fifo", "zero", "dots", "deep", "folder")),
        *(("--jig", kind) for kind in ("fifo", "dots")),
        *(("--layout", kind) for kind in ("zero", "dots")),
    ],
)
def test_hostile_files_are_refused_at_once(
    inside: Any, tmp_path: Path, option: str, kind: str
) -> None:
    path = hostile_files(tmp_path)[kind]
    done = inside("calibrate", "--dry-run", option, path, code=2)
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("kind", ["fifo", "zero", "folder"])
def test_hostile_recordings_and_certificates_are_refused_at_once(
    inside: Any, tmp_path: Path, kind: str
) -> None:
    path = hostile_files(tmp_path)[kind]
    inside("info", path, code=2)
    inside("export", path, "-o", tmp_path / "x.csv", code=2)
    named = tmp_path / "link.json"
    named.symlink_to(path)
    inside("info", named, code=2)


def test_a_full_device_as_output_is_said_not_traced(finished: dict[str, Any]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [PROGRAM, "info", finished["files"]["trial"]],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 5
    assert "Traceback" not in done.stderr
    assert "cannot be written" in done.stderr
