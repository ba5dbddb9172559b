"""Protocol files: what they say, what they may not say, and how a mistake is named."""

import math
from pathlib import Path

import pytest

from imu_rig.errors import InputError
from imu_rig.session.protocol import JigProtocol, Pose, builtin_protocols, load_protocol


@pytest.mark.parametrize("name", builtin_protocols())
def test_every_builtin_protocol_loads_under_its_own_name(name: str) -> None:
    assert load_protocol(name).name == name


def test_the_default_is_the_studied_list_of_24_poses() -> None:
    protocol = load_protocol("full")
    fitted = [step for step in protocol.steps if step.kind == "pose"]
    assert len(fitted) == 24
    assert protocol.steps[:24] == tuple(fitted)
    assert protocol.hold_s == 2.0
    pose, poses = {"pan": 0.0, "tilt": 0.0, "roll": 0.0}, []
    for step in fitted:
        pose |= {a: getattr(step, a) for a in pose if getattr(step, a) is not None}
        poses.append(dict(pose))
    rings = [(p["pan"], p["roll"]) for p in poses[::3]]
    assert rings == [
        (0, -180),
        (90, -135),
        (0, -90),
        (90, -45),
        (0, 0),
        (90, 45),
        (0, 90),
        (90, 135),
    ]
    assert all(p["tilt"] == 0 for p in poses[::3])
    assert [p["tilt"] for p in poses[1:3]] == [60, -60]
    assert [p["tilt"] for p in poses[7:9]] == [90, -90]


def test_a_rotation_is_held_shorter_than_a_pose() -> None:
    protocol = load_protocol("six-faces-and-turns")
    holds = {step.kind: protocol.hold_of(step) for step in protocol.steps}
    assert holds["rotation"] < holds["pose"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name = ", "not a TOML file"),
        ('name = "x"', "steps"),
        ('name = "x"\nsteps = []', "steps"),
        ('name = "x"\nsteps = [{ pan = "left" }]', "steps.1.pan"),
        ('name = "x"\nsteps = [{ pan = nan }]', "steps.1.pan"),
        ('name = "x"\nsteps = [{ pan = 9999 }]', "steps.1.pan"),
        ('name = "x"\nsteps = [{ yaw = 3 }]', "steps.1.yaw"),
        ('name = "x"\nhold_s = -1\nsteps = [{ pan = 0 }]', "hold_s"),
        ('name = "x"\norder = [["pan"]]\nsteps = [{ pan = 0 }]', "order"),
        ('name = "x"\nsteps = [{ pan = 0, mounting = 2 }]', "mounting 2"),
        ('name = "x"\nsteps = [{ pan = 0 }]\n[limits]\naccel_mg = 0', "limits.accel_mg"),
        ('name = "x"\nsteps = [{ pan = 0 }]\n[[mountings]]\naxis = [0, 0, 0]', "mountings"),
    ],
)
def test_a_mistake_is_named_with_file_and_field(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_protocol(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="full"):
        load_protocol("nonesuch")


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.toml"
    path.write_bytes(b"#" * 1_000_000)
    with pytest.raises(InputError, match="too large"):
        load_protocol(path)


def test_a_protocol_survives_its_own_json() -> None:
    protocol = load_protocol("full")
    assert JigProtocol.model_validate(protocol.model_dump(mode="json")) == protocol


def test_a_pose_is_written_for_people() -> None:
    assert str(Pose(pan=90, tilt=-45, roll=0)) == "pan +90° tilt -45° roll +0°"


def test_a_mounting_is_a_rotation_about_an_axis_of_the_plate() -> None:
    protocol = load_protocol("two-mountings")
    flat, on_end = protocol.mounting_turns
    assert flat == (0.0, 0.0, 0.0)
    assert on_end == pytest.approx((0.0, math.pi / 2, 0.0))
    assert set(protocol.mounting_of_steps) == {0, 1}
    assert all(mounting.instruction for mounting in protocol.mountings)


def test_the_check_protocol_is_short_and_fits_nothing() -> None:
    protocol = load_protocol("check")
    assert protocol.only_checks
    assert 8 <= len(protocol.steps) <= 10
    assert not load_protocol("full").only_checks
    assert 4 <= sum(step.kind == "check" for step in load_protocol("full").steps) <= 6
