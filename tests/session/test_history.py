"""A session read back from a trial file that nobody vouches for."""

from pathlib import Path

import numpy as np
import pytest

from firmware_protocols.layout import load_layout
from firmware_protocols.packets import encode
from imu_rig.clock import SteppedClock
from imu_rig.devices.jig import load_jig
from imu_rig.errors import DataError, InputError
from imu_rig.recording.reader import open_trial
from imu_rig.recording.writer import TrialWriter
from imu_rig.session.history import read_session, session_config
from imu_rig.session.protocol import load_protocol
from imu_rig.session.solve import solve_session

LAYOUT = load_layout("mpu9150-28").to_dict()
POSE = {
    "index": 0,
    "name": "first",
    "kind": "pose",
    "commanded_deg": {"pan": 0, "tilt": 0, "roll": 0},
    "still_s": [1.0, 2.0],
}


def trial(path: Path, *, device: object = "shoe", layout: object = LAYOUT, **pose: object) -> Path:
    config = session_config(load_protocol("quick"), load_jig("paper-jig"), "shoe", "1", "")
    with TrialWriter.create(path, {**config, "device": device}, clock=SteppedClock()) as writer:
        writer.add_source("imu", "imu", {"layout": layout})
        writer.event("pose", **(POSE | pose))
    return path


def test_a_session_is_read_back(tmp_path: Path) -> None:
    session = read_session(open_trial(trial(tmp_path / "a.imu-trial")))
    assert session.finished == {0}
    assert session.next_step == 1
    assert session.device == "shoe"


def test_a_name_that_utf8_cannot_hold_is_made_one_that_it_can(tmp_path: Path) -> None:
    session = read_session(open_trial(trial(tmp_path / "a.imu-trial", device="\ud800")))
    assert session.device.encode() == b"?"


@pytest.mark.parametrize(
    "change",
    [
        {"layout": None},
        {"layout": {"name": 3}},
        {"index": -1},
        {"index": "x"},
        {"still_s": [1.0]},
        {"commanded_deg": {"pan": 1e9}},
        {"kind": "dance"},
        {"turns": [{"axes": []}]},
    ],
)
def test_nonsense_is_one_sentence(tmp_path: Path, change: dict[str, object]) -> None:
    path = trial(tmp_path / "a.imu-trial", **change)
    with pytest.raises(InputError, match=r"a\.imu-trial: the session in it makes no sense"):
        read_session(open_trial(path))


@pytest.mark.parametrize("pace", [0.95, 1.05])
def test_nothing_is_measured_with_times_that_cannot_be_right(tmp_path: Path, pace: float) -> None:
    """A computer too busy to read its port makes the sensor's clock look off by per cents."""
    path, clock, layout = tmp_path / "a.imu-trial", SteppedClock(), load_layout("mpu9150-28")
    config = session_config(load_protocol("quick"), load_jig("paper-jig"), "shoe", "1", "")
    number = np.arange(1500)
    still = {name: np.zeros((1500, 3), int) for name in ("accel", "gyro", "mag")}
    columns = {"seq": number % 256, "status": 0 * number, "time": number * 10_000, **still}
    data = encode(layout, columns)
    with TrialWriter.create(path, config, clock=clock) as writer:
        source = writer.add_source("imu", "imu", {"layout": LAYOUT})
        for i in range(0, len(data), layout.length):
            clock.advance(0.01 * pace)
            writer.bytes_in(source, clock.now_ns(), data[i : i + layout.length])
        writer.event("pose", **POSE)
    with pytest.raises(DataError, match=r"a\.imu-trial: the sensor's clock .* disagree by .5 %"):
        solve_session(open_trial(path))
