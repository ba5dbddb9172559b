"""A session in two mountings, with checks: asked, refused, done wrong, interrupted, gone on with.

Simulated hardware over real pseudo-terminals, ten times as fast as life.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from firmware_protocols.layout import load_layout
from imu_rig.clock import ScaledClock
from imu_rig.devices.jig import load_jig
from imu_rig.errors import SessionInterrupted, SessionStopped
from imu_rig.recording.reader import open_trial
from imu_rig.session.history import read_session
from imu_rig.session.progress import Progress
from imu_rig.session.protocol import JigProtocol, Mounting, Step
from imu_rig.session.run import SessionSetup, resumed_setup, run_session
from imu_rig.session.solve import solve_session
from imu_rig.stopping import StopRequest
from simulators.rig import RigConfig, SimulatedRig

PROTOCOL = JigProtocol(
    name="turned over",
    hold_s=0.8,
    steps=(
        Step(tilt=40),
        Step(tilt=-40),
        Step(tilt=40, roll=60, mounting=2),
        Step(tilt=-40),
        Step(roll=-30, kind="check"),
    ),
    mountings=(
        Mounting(name="flat"),
        Mounting(name="on end", instruction="Turn it over.", axis=(0, 1, 0), angle_deg=90),
    ),
)


class Person:
    """Turns the simulated sensor over when asked, the first times in a wrong way."""

    def __init__(self, rig: SimulatedRig, *, mistakes: int = 0) -> None:
        self._rig, self._mistakes = rig, mistakes
        self.asked: list[str] = []

    def ask(self, request: str, turn: tuple[float, float, float]) -> bool:
        self.asked.append(request)
        wrong = len(self.asked) <= self._mistakes
        self._rig.remount((np.pi / 2, 0.0, 0.0) if wrong else turn)
        return True

    def ready(self) -> bool:
        return True


@pytest.fixture
def clock() -> ScaledClock:
    return ScaledClock(10.0)


@pytest.fixture
def rig(clock: ScaledClock) -> Iterator[SimulatedRig]:
    with SimulatedRig(RigConfig.random(3), clock=clock) as simulated:
        yield simulated


def setup_on(rig: SimulatedRig) -> SessionSetup:
    return SessionSetup(
        imu_url=rig.imu_url,
        maestro_url=rig.maestro_url,
        layout=load_layout("mpu9150-28"),
        jig=load_jig("paper-jig"),
        protocol=PROTOCOL,
        device="shoe",
    )


def test_the_person_is_asked_until_gravity_stands_right_and_mountings_and_checks_are_kept(
    tmp_path: Path, clock: ScaledClock, rig: SimulatedRig
) -> None:
    path = tmp_path / "session.imu-trial"
    person = Person(rig, mistakes=1)
    states: list[str] = []

    def observe(progress: Progress) -> None:
        if not states or states[-1] != progress.state:
            states.append(progress.state)

    run_session(setup_on(rig), path, clock, hands=person, observe=observe)
    assert len(person.asked) == 2
    assert person.asked[0] == "Turn it over."
    assert "should be its -x axis" in person.asked[1]
    at = states.index("remounting")
    assert states[at - 1] == "parking"
    trial = open_trial(path)
    record = read_session(trial)
    assert [visit.mounting for visit in record.visits] == [0, 0, 1, 1, 1]
    assert [visit.kind for visit in record.visits] == ["pose"] * 4 + ["check"]
    result = solve_session(trial, method="paper-diagonal")
    assert len(result.poses) == 4
    assert result.verification is not None
    assert {row.name.split(":")[0] for row in result.verification.rows if row.kind == "pose"} == {
        "5"
    }
    assert len(result.moves) <= 2, "no move leads across the mountings"


def test_without_hands_the_session_stops_and_goes_on_once_the_sensor_is_turned(
    tmp_path: Path, clock: ScaledClock, rig: SimulatedRig
) -> None:
    path = tmp_path / "session.imu-trial"
    with pytest.raises(SessionStopped, match=r"must be turned over now: Turn it over.*is parked"):
        run_session(setup_on(rig), path, clock)
    assert read_session(open_trial(path)).finished == {0, 1}

    # gone on with although nobody turned it: asked again, and stopped while waiting
    class Slow(Person):
        def ask(self, request: str, turn: tuple[float, float, float]) -> bool:
            self.asked.append(request)
            stop.make("Stopped by SIGINT.")
            return True

        def ready(self) -> bool:
            return False

    stop, slow = StopRequest(), Slow(rig)
    setup = resumed_setup(path, setup_on(rig))
    with pytest.raises(SessionInterrupted, match="The jig is parked"):
        run_session(setup, path, clock, resume=True, hands=slow, stop=stop)
    assert slow.asked == ["Turn it over."]
    assert read_session(open_trial(path)).finished == {0, 1}

    rig.remount(PROTOCOL.mounting_turns[1])
    run_session(resumed_setup(path, setup_on(rig)), path, clock, resume=True)
    record = read_session(open_trial(path))
    assert [visit.mounting for visit in record.visits] == [0, 0, 1, 1, 1]
