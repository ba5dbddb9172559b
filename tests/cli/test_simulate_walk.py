"""`imu-rig simulate walk`, as its users see it."""

import json

import numpy as np
import pytest

import imu_rig as package
from imu_rig.units import STANDARD_GRAVITY


def test_walks_are_listed(inside):
    told = inside("simulate", "walk", "--list").stdout
    assert "half-circle" in told
    assert "straight-50m" in told
    assert json.loads(inside("simulate", "walk", "--list", "--json").stdout)["corridor"]


def test_a_walk_becomes_a_trial_with_its_truth(inside, tmp_path):
    trial, truth = tmp_path / "walk.imu-trial", tmp_path / "truth.csv"
    devices = ("left-foot=mpu9150-28", "mti=xsens-mti@right-foot")
    done = inside(
        *("simulate", "walk", "half-circle", "--json"),
        *(part for device in devices for part in ("--device", device)),
        *("--trial", trial, "--truth", truth),
    )
    assert json.loads(done.stdout)["devices"]["mti"]["layout"] == "xsens-mti"
    recorded = package.open_trial(trial)
    assert recorded.sensors == ["left-foot", "mti"]
    assert recorded.ended == "complete"
    for name in recorded.sensors:
        block = recorded.imu(name)
        assert len(block) > 1000
        still = np.linalg.norm(block.accel[-200:].mean(axis=0))
        assert still == pytest.approx(STANDARD_GRAVITY, rel=0.1)
    assert truth.read_text().startswith("device,place,counter,device_s,t_s,x_m")


def test_a_walk_on_ports_ends_when_it_is_over(inside, tmp_path):
    truth = tmp_path / "truth.csv"
    walk = ("simulate", "walk", "half-circle", "--device", "a b=mpu9150", "--speed", "20")
    done = inside(*walk, "--no-wait", "--once", "--truth", truth)
    assert "imu-rig record --device 'a b=" in done.stdout
    assert "Walking:" in done.stderr
    assert len(truth.read_text().splitlines()) > 900


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["moon"], "there is no walk 'moon'; take one of half-circle, "),
        (["--device", "foot=abc"], "there is no kind of IMU 'abc'; take one of mpu9150, "),
        (["--device", "foot"], "--device 'foot' is not NAME=KIND[@PLACE]"),
        (["--device", "a=mpu9150@head"], "a: there is no place 'head'; take left-foot, "),
        (["--device", "a=mpu9150", "--device", "a=mpu9150"], "two devices 'a'"),
        (["--device", "a=mpu9150", "--device", "a/b=mpu9150"], "'a/b' reads like a stream of 'a'"),
        (["half-circle", "--truth", "/nowhere/x.csv", "--trial", "{}"], "/nowhere is not a folder"),
        (["half-circle", "--truth", "{}", "--trial", "{}"], "cannot be both trial and truth"),
    ],
)
def test_what_cannot_be_walked_is_named_in_a_sentence(inside, arguments, sentence, tmp_path):
    trial = str(tmp_path / "t.imu-trial")
    done = inside("simulate", "walk", *(a.format(trial) for a in arguments), code=2)
    assert sentence in done.stderr
    assert done.stderr.count("\n") <= 2


@pytest.mark.parametrize(
    ("option", "mine"),
    [("--trial", "t.csv"), ("--truth", "t.csv"), ("--truth", "t-strides.csv")],
)
def test_files_that_exist_are_kept(inside, tmp_path, option, mine):
    kept = tmp_path / mine
    kept.write_bytes(b"mine")
    link = tmp_path / "t-turns.csv"
    link.symlink_to(kept)
    done = inside("simulate", "walk", "straight-50m", "--once", option, tmp_path / "t.csv", code=2)
    assert f"{mine} exists" in " ".join(done.stderr.split())
    assert kept.read_bytes() == b"mine"
    assert set(tmp_path.iterdir()) == {kept, link}
