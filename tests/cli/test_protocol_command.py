"""`imu-rig protocol` and the table that `calibrate` shows before anything moves."""

import json
from pathlib import Path
from typing import Any

import pytest

from imu_rig.session.protocol import builtin_protocols, load_protocol


def test_the_protocols_are_listed_with_their_time(inside: Any) -> None:
    done = inside("protocol", "list")
    for name in builtin_protocols():
        assert f"  {name} " in done.stdout
    (for_paper,) = [line for line in done.stdout.splitlines() if "six-faces" in line]
    assert "only --method paper takes it" in for_paper
    told = json.loads(inside("protocol", "list", "--json").stdout)
    assert {p["name"]: p["stops"] for p in told["protocols"]}["full"] == len(
        load_protocol("full").steps
    )


def test_a_protocol_is_shown_with_what_it_tells(inside: Any) -> None:
    done = inside("protocol", "show", "full")
    assert "gyroscope scale [%]" in done.stdout
    told = json.loads(inside("protocol", "show", "full", "--json").stdout)
    groups = {group["name"]: group for group in told["expected"]["groups"]}
    assert 0.005 < groups["accelerometer scale"]["rms"] < 0.05
    (line,) = [row for row in done.stdout.splitlines() if "reading at rest, 95 %" in row]
    # Comparable with the line of a result that has the same label.
    assert float(line.split()[-1]) == pytest.approx(1.96 * told["expected"]["reading_mg"], rel=0.01)
    refused = inside("protocol", "show", "six-faces-and-turns")
    assert "cannot determine" in refused.stdout.replace("\n", " ")
    paper = inside("protocol", "show", "six-faces-and-turns", "--method", "paper")
    assert "gyroscope scale" in paper.stdout


def test_a_planned_protocol_is_written_and_can_be_run(inside: Any, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    arguments = ["--time", 60, "--search", 3, "--name", "mine", "-o", path]
    done = inside("protocol", "plan", *arguments)
    assert f"imu-rig calibrate --protocol {path}" in done.stdout
    assert "expected standard uncertainty" in path.read_text()
    assert "will count as not verified" in " ".join(done.stdout.split())
    assert load_protocol(path).name == "mine"
    dry = json.loads(
        inside("calibrate", "--dry-run", "--protocol", path, "--method", "joint", "--json").stdout
    )
    assert dry["duration_s"] <= 60
    assert dry["expected"]["groups"]
    inside("protocol", "plan", *arguments, code=2)  # never overwrites


def test_without_a_file_the_protocol_itself_is_printed(inside: Any, tmp_path: Path) -> None:
    done = inside("protocol", "plan", "--time", 60, "--search", 0)
    path = tmp_path / "piped.toml"
    path.write_text(done.stdout)
    assert load_protocol(path).name == "planned"
    assert "poses" in done.stderr


def test_a_short_reach_gets_the_proposal_of_two_mountings(inside: Any, tmp_path: Path) -> None:
    done = inside(
        *("protocol", "plan", "--time", 70, "--reach", 45, "--search", 0),
        *("-o", tmp_path / "short.toml"),
    )
    assert "--mountings 2" in done.stdout


def test_nonsense_is_refused(inside: Any, tmp_path: Path) -> None:
    assert "too short" in inside("protocol", "plan", "--time", 5, code=2).stderr
    assert "--time" in inside("protocol", "plan", "--time", "nan", code=2).stderr
    assert "reach" in inside("protocol", "plan", "--reach", "-3", code=2).stderr
    assert "nonesuch" in inside("protocol", "show", "nonesuch", code=2).stderr
    gone = tmp_path / "none" / "x.toml"
    assert (
        str(gone)
        in inside("protocol", "plan", "--time", 60, "--search", 0, "-o", gone, code=2).stderr
    )


def test_a_dry_run_shows_the_expected_uncertainties(inside: Any) -> None:
    done = inside("calibrate", "--dry-run")
    assert "accelerometer scale [%]" in done.stdout
    refused = inside("calibrate", "--dry-run", "--protocol", "six-faces-and-turns", code=2)
    assert "non-orthogonality xy" in refused.stderr
