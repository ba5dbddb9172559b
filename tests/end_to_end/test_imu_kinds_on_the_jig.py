"""Whole sessions with other sensors than the jig's own, over real ports, faster than life."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from firmware_protocols.known import load_protocol
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.model import physical_figures
from imu_rig.cli.simulated import simulated_session
from imu_rig.devices.conversation import conversation_for
from imu_rig.devices.jig import load_jig
from imu_rig.recording.reader import open_trial
from imu_rig.session.history import read_session
from imu_rig.session.protocol import JigProtocol, Step
from imu_rig.session.run import SessionSetup, run_session
from imu_rig.session.solve import solve_session

SPEED = 9.0
SEED = 3

POSES = (
    (0, 30, -90),
    (0, -40, -90),
    (90, 0, -20),
    (90, -45, -20),
    (90, 50, 60),
    (0, 50, 90),
    (0, -50, 90),
    (90, 20, 160),
    (90, -20, 160),
    (0, 0, 0),
)
"""Enough of them, and no more, for the nine parameters of an accelerometer and a gyroscope's."""

PROTOCOL = JigProtocol(
    name="short",
    hold_s=0.7,
    steps=tuple(Step(pan=pan, tilt=tilt, roll=roll) for pan, tilt, roll in POSES),
)


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["adis16405-36", "xsens-mti", "mavlink-highres", "waist-unit"])
def test_a_session_finds_what_the_sensor_is_within_what_it_states(layout, tmp_path: Path) -> None:
    protocol = load_protocol(layout)
    setup = SessionSetup(
        imu_url="",
        maestro_url="",
        layout=protocol,
        jig=load_jig("paper-jig"),
        protocol=PROTOCOL,
    )
    path = tmp_path / "session.imu-trial"
    with simulated_session(setup, seed=SEED, speed=SPEED) as simulated:
        run_session(simulated.setup, path, simulated.clock, observe=simulated.observe)
        truth = simulated.truth()
        gravity = Gravity.given(simulated.rig.truth.gravity)
    trial = open_trial(path)
    assert read_session(trial).layout == protocol
    asked = bool(trial.wire("imu", "out").data)
    assert asked == (conversation_for(protocol) is not None), "what was said to it is kept"
    result = solve_session(trial, gravity=gravity)
    line = truth.accel
    found, true = physical_figures(result.accel), physical_figures(line)
    assert_alike(found, true)
    if load_protocol(layout).streams[protocol.inertial_streams[0]].has("gyro"):
        assert result.gyro_figures is not None
        assert_alike(result.gyro_figures, physical_figures(truth.gyro, line))
    else:
        assert result.gyro is None


def assert_alike(found, true) -> None:
    """Every figure within 4.5 of its stated standard uncertainties."""
    for name, sigma in (
        ("scale_percent", "scale_percent_u"),
        ("cross_rad", "cross_rad_u"),
        ("bias", "bias_u"),
    ):
        off = np.abs(getattr(found, name) - getattr(true, name))
        assert np.all(off < 4.5 * getattr(found, sigma)), (name, off, getattr(found, sigma))
