"""`imu-rig verify`: pass, fail, another device, a check on simulated hardware."""

import json
from pathlib import Path
from typing import Any

import pytest

from imu_rig.calibration.verification import Limits
from imu_rig.cli.summary import result_lines
from imu_rig.recording.reader import open_trial
from imu_rig.session import solve

CHECK = """
name = "tiny check"
hold_s = 1.0
order = [["tilt"], ["pan", "roll"]]
steps = [
  { tilt = 60, kind = "check" },
  { tilt = -60, kind = "check" },
  { tilt = 0, roll = 90, kind = "check" },
]
"""


@pytest.fixture
def certificate(finished: dict[str, Any], tmp_path: Path) -> dict[str, Any]:
    """Content of the demo's certificate, to be changed and saved."""
    return json.loads(Path(finished["files"]["certificate"]).read_text())


def saved(content: dict[str, Any], folder: Path) -> Path:
    path = folder / "changed.json"
    path.write_text(json.dumps(content))
    return path


def test_a_session_passes_against_its_own_certificate_and_is_told_to_prove_nothing(
    inside: Any, finished: dict[str, Any]
) -> None:
    files = finished["files"]
    done = inside("verify", files["certificate"], files["trial"])
    assert "Verified: all" in done.stdout
    assert "proves nothing" in " ".join(done.stdout.split())


def test_a_sensor_that_drifted_fails_with_its_own_exit_code(
    inside: Any, finished: dict[str, Any], certificate: dict[str, Any], tmp_path: Path
) -> None:
    certificate["accel"]["b"][2] += 0.05
    path = saved(certificate, tmp_path)
    folder = tmp_path / "out"
    done = inside("verify", path, finished["files"]["trial"], "--json", "--output", folder, code=7)
    answer = json.loads(done.stdout)
    assert answer["passed"] is False
    assert answer["verification"]["state"] == "failed"
    drifted = [row["axis"] for row in answer["drift"] if row["drifted"] and not row["usual"]]
    assert drifted == ["z"]
    page = Path(answer["files"]["report"]).read_text()
    assert "Verification FAILED" in page
    assert "accelerometer bias z" in page


def test_the_certificate_of_another_device_is_refused_unless_forced(
    inside: Any, finished: dict[str, Any], certificate: dict[str, Any], tmp_path: Path
) -> None:
    certificate["device"]["serial"] = "another"
    path = saved(certificate, tmp_path)
    refused = inside("verify", path, finished["files"]["trial"], code=2)
    assert "serial number another" in refused.stderr
    forced = inside("verify", path, finished["files"]["trial"], "--force")
    assert "all the same" in forced.stderr


def test_a_check_on_a_jig_is_short_and_cannot_be_taken_for_a_calibration(
    inside: Any, finished: dict[str, Any], tmp_path: Path
) -> None:
    protocol = tmp_path / "tiny.toml"
    protocol.write_text(CHECK)
    folder = tmp_path / "out"
    done = inside(
        *("verify", finished["files"]["certificate"], "--simulate", "--speed", 5),
        *("--protocol", protocol, "--output", folder, "--quiet"),
    )
    assert "Verified: all 5 checks" in done.stdout
    assert (folder / "check.html").is_file()
    refused = inside("solve", folder / "check.imu-trial", code=2)
    assert "imu-rig verify" in refused.stderr


def test_a_file_and_hardware_together_are_refused(inside: Any, finished: dict[str, Any]) -> None:
    files = finished["files"]
    done = inside("verify", files["certificate"], files["trial"], "--simulate", code=2)
    assert "not both" in done.stderr


def test_a_failed_verification_is_the_first_thing_that_is_said(
    inside: Any, finished: dict[str, Any], tmp_path: Path
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solve, "limits_of", lambda stated: Limits(1e-9, 1e-9, 1e-3))
        result = solve.solve_session(open_trial(Path(finished["files"]["trial"])))
    lines = result_lines(result)
    assert "Verification FAILED: 10 of 10 checks" in lines[0]
    assert any("more are in the report" in line for line in lines)
    assert any("--output DIR writes" in line for line in result_lines(result, reported=False))


def test_a_check_without_a_report_says_how_to_get_it(
    inside: Any, finished: dict[str, Any], certificate: dict[str, Any], tmp_path: Path
) -> None:
    certificate["accel"]["b"][2] += 0.5
    path = saved(certificate, tmp_path)
    asked = ("verify", path, finished["files"]["trial"])
    told = " ".join(inside(*asked, code=7).stdout.replace("!", "").split())
    assert "more are in a report, which --output DIR writes." in told
    told = " ".join(inside(*asked, "-o", tmp_path / "out", code=7).stdout.split())
    assert "more are in the report." in told
    told = " ".join(inside(*asked, "--limit-mg", "900", code=7).stdout.split())
    assert "poses, magnitude: " in told
    assert "Check pose pose" not in told
