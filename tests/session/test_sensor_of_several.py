"""A session with one of several inertial sensors on a port."""

from pathlib import Path

import numpy as np
import pytest

from firmware_protocols.known import load_protocol
from imu_rig.cli.hardware import Hardware
from imu_rig.clock import SteppedClock
from imu_rig.devices.jig import load_jig
from imu_rig.errors import InputError
from imu_rig.recording.reader import open_trial
from imu_rig.recording.writer import TrialWriter
from imu_rig.session.history import read_session, session_config
from imu_rig.session.protocol import load_protocol as load_steps
from imu_rig.session.run import resumed_setup
from simulators.config import RigConfig
from simulators.world import World

TWO = load_protocol("two-imu")


def session(path: Path, stream: object) -> Path:
    """Write what a receiver sends of which only the waist is on the jig, as a session keeps it."""
    world = World(RigConfig.speaking(TWO, 1, "waist"))
    config = session_config(load_steps("quick"), load_jig("paper-jig"), "waist", "7", "")
    described = {"layout": TWO.to_dict()} | ({} if stream is None else {"stream": stream})
    with TrialWriter.create(path, config, clock=SteppedClock()) as writer:
        number = writer.add_source("imu", "imu", described)
        for step in range(1, 41):
            world.advance(0.05 * step)
            writer.bytes_in(number, round(5e7 * step), world.take("imu"))
    return path


@pytest.mark.parametrize("stream", ["foot", "waist"])
def test_a_session_names_its_sensor_and_is_read_as_that(stream: str, tmp_path: Path) -> None:
    trial = open_trial(session(tmp_path / "s.imu-trial", stream))
    record = read_session(trial)

    assert record.stream == stream
    np.testing.assert_array_equal(trial.imu("imu").accel, trial.imu(f"imu/{stream}").accel)
    assert trial.imus == ["imu/foot", "imu/waist"]


@pytest.mark.parametrize("stream", [None, "hip", 7])
def test_where_it_names_none_both_are_offered(stream: object, tmp_path: Path) -> None:
    trial = open_trial(session(tmp_path / "s.imu-trial", stream))

    assert read_session(trial).stream is None
    with pytest.raises(InputError, match="several sensors: 'imu/foot', 'imu/waist'"):
        trial.imu("imu")


def test_a_session_goes_on_with_the_sensor_it_began_with(tmp_path: Path) -> None:
    path = session(tmp_path / "s.imu-trial", "waist")
    again = Hardware(imu="a", maestro="b").setup(load_steps("quick"), "waist", "")

    assert resumed_setup(path, again).stream == "waist"


@pytest.mark.parametrize(
    ("stream", "words"), [(None, "foot, waist: name one"), ("hip", "'hip' is none of them")]
)
def test_which_sensor_must_be_said_before_anything_moves(stream: str | None, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Hardware(layout="two-imu", stream=stream).setup(load_steps("quick"), "imu", "")


@pytest.mark.parametrize(("stream", "kind"), [("foot", "two-imu"), ("waist", "two-imu-waist")])
def test_the_simulated_jig_carries_the_sensor_that_is_named(stream: str, kind: str) -> None:
    assert RigConfig.speaking(TWO, 1, stream).imu == kind


def test_the_only_sensor_of_a_port_may_be_named_too() -> None:
    assert RigConfig.speaking(load_protocol("waist-unit"), 1, "accel").imu == "waist-unit"
