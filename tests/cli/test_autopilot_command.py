"""`imu-rig devices autopilot` as its users see it."""

import json
from collections.abc import Iterator
from typing import Any

import pytest

from firmware_protocols.known import load_protocol
from imu_rig.devices import mavlink_questions
from simulators import flight_controller
from simulators.served_devices import ServedDevices


@pytest.fixture
def served() -> Iterator[ServedDevices]:
    with ServedDevices() as devices:
        yield devices


@pytest.fixture(autouse=True)
def corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    parameters = {**flight_controller.PARAMETERS["px4"], "CAL_ACC0_XOFF": 0.12}
    monkeypatch.setitem(flight_controller.PARAMETERS, "px4", parameters)  # type: ignore[arg-type]


def test_what_px4_corrects_is_said(inside: Any, served: ServedDevices) -> None:
    port = served.add("pixhawk", load_protocol("mavlink-highres"))
    shown = inside("devices", "autopilot", port).stdout
    assert f"{port}  PX4" in shown
    assert "whole numbers travel as their bytes" in shown
    assert "CAL_ACC0_XOFF 0.12" in shown
    assert "its own first" in shown


def test_the_answer_for_programs(inside: Any, served: ServedDevices) -> None:
    port = served.add("pixhawk", load_protocol("mavlink-scaled"))
    done = inside("devices", "autopilot", port, "-p", "INS_ACC_ID", "--json")
    assert json.loads(done.stdout) == {
        "port": port,
        "autopilot": "ArduPilot",
        "encoding": "cast",
        "parameters": {"INS_ACC_ID": 2753028},
        "missing": [],
        "own_calibration": {},
        "contradictions": [],
    }


def test_another_device_and_a_wrong_name_are_sentences(
    inside: Any, served: ServedDevices, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mavlink_questions, "MEET_S", 0.3)
    port = served.add("foot", load_protocol("mpu9150-28"))
    done = inside("devices", "autopilot", port, code=4)
    assert f"{port}: no flight controller is heard" in done.stderr
    done = inside("devices", "autopilot", port, "-p", "A" * 17, code=2)
    assert "is no name of a parameter" in done.stderr
