"""A session against every fault: it recovers and says so, or parks within a second and stops.

Simulated hardware, real pseudo-terminals, the drivers and the engine as a user runs them, ten
times as fast as life.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_protocols.layout import load_layout
from firmware_protocols.maestro import CommandParser, SetTarget
from imu_rig.clock import ScaledClock
from imu_rig.devices.jig import load_jig
from imu_rig.errors import SessionInterrupted, SessionStopped, StorageError
from imu_rig.recording.reader import Trial, open_trial
from imu_rig.session.history import read_session
from imu_rig.session.progress import Progress
from imu_rig.session.protocol import JigProtocol, Step
from imu_rig.session.run import SessionSetup, resumed_setup, run_session
from imu_rig.stopping import StopRequest
from simulators.rig import RigConfig, SimulatedRig

SPEED = 10.0
JIG = load_jig("paper-jig")
SHORT = JigProtocol(
    name="short",
    hold_s=0.8,
    steps=(
        Step(roll=0, tilt=20),
        Step(tilt=-10),
        Step(tilt=0, roll=30),
    ),
)
FAULTY_STEP = 2
WORDS = (
    "off",
    "stuck",
    "garbage",
    "wrong",
    "slow",
    "delayed",
    "intermittent",
    "unplug",
    "brownout",
    "reset",
)


@pytest.fixture
def clock() -> ScaledClock:
    return ScaledClock(SPEED)


@pytest.fixture
def rig(clock: ScaledClock) -> Iterator[SimulatedRig]:
    with SimulatedRig(RigConfig.random(3), clock=clock) as simulated:
        yield simulated


def setup_on(rig: SimulatedRig) -> SessionSetup:
    return SessionSetup(
        imu_url=rig.imu_url,
        maestro_url=rig.maestro_url,
        layout=load_layout("mpu9150-28"),
        jig=JIG,
        protocol=SHORT,
        device="shoe",
    )


def park_targets() -> dict[int, int]:
    pan, tilt, roll = JIG.park_deg
    axes = ((JIG.pan, pan), (JIG.tilt, tilt), (JIG.roll, roll))
    return {axis.channel: axis.pulse(angle) for axis, angle in axes}


def targets_sent(trial: Trial) -> list[tuple[float, int, int]]:
    """Every (time, channel, target) that went out to the controller."""
    wire = trial.wire("maestro", "out")
    sent, start = [], 0
    for t, stop in zip(wire.t, wire.stops, strict=True):
        for command in CommandParser().feed(wire.data[start:stop]):
            if isinstance(command, SetTarget):
                sent.append((float(t), command.channel, command.target))
        start = stop
    return sent


class Injector:
    """Injects a fault when the session is at a stop, once."""

    def __init__(
        self, rig: SimulatedRig, device: str, word: str, state: str, seconds: float | None
    ) -> None:
        self._rig, self._fault, self._state = rig, (device, word), state
        self._seconds = seconds
        self.done = False

    def __call__(self, progress: Progress) -> None:
        if not self.done and progress.step == FAULTY_STEP and progress.state == self._state:
            self.done = True
            self._rig.fault(*self._fault, duration_s=self._seconds)


def parked_after_fault(trial: Trial) -> bool:
    """Whether the park pose was the last thing commanded, on every channel."""
    last = {channel: target for _, channel, target in targets_sent(trial)}
    return last == park_targets()


def seconds_to_park(trial: Trial) -> float:
    """Time from the first fault that the session noticed to the first park command after it."""
    noticed = next(event.t for event in trial.events if event.name == "fault")
    targets = park_targets()
    return next(
        t - noticed
        for t, channel, target in targets_sent(trial)
        if t >= noticed - 0.05 and targets[channel] == target
    )


SITUATIONS = (
    ("imu", "moving", False),
    ("imu", "holding", False),
    ("imu", "moving", True),
    ("imu", "holding", True),
    ("maestro", "moving", False),
    ("maestro", "holding", False),
    ("maestro", "moving", True),
)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Meet every device with every fault, short and lasting; in every state only if asked.

    Whether the rig moves or holds then takes turns from fault to fault.
    """
    if "situation" not in metafunc.fixturenames:
        return
    chosen = [
        pytest.param(word, situation, id="-".join((*map(str, situation), word)))
        for number, word in enumerate(WORDS)
        for device in ("imu", "maestro")
        for lasting in (False, True)
        for situation in _situations(device, lasting, number, metafunc.config)
    ]
    metafunc.parametrize(("word", "situation"), chosen)


def _situations(
    device: str, lasting: bool, number: int, config: pytest.Config
) -> list[tuple[str, str, bool]]:
    there = [s for s in SITUATIONS if (s[0], s[2]) == (device, lasting)]
    if config.getoption("--exhaustive"):
        return there
    return [there[(number + lasting) % len(there)]]


def test_a_session_survives_or_stops_safely(
    tmp_path: Path,
    clock: ScaledClock,
    rig: SimulatedRig,
    word: str,
    situation: tuple[str, str, bool],
) -> None:
    device, state, lasting = situation
    path = tmp_path / "session.imu-trial"
    inject = Injector(rig, device, word, state, None if lasting or word == "reset" else 2.0)
    notices: list[str] = []
    try:
        outcome = run_session(setup_on(rig), path, clock, observe=inject, notify=notices.append)
    except SessionStopped as stopped:
        sentence = str(stopped)
        trial = open_trial(path)
        assert lasting, f"a fault of two seconds was not survived: {sentence}"
        assert trial.ended is not None
        record = read_session(trial)
        assert record.finished >= set(range(FAULTY_STEP - 1)), "finished poses are kept"
        assert "\n" not in sentence
        if "could not be parked" in sentence:
            assert device == "maestro"
            assert word == "unplug"
        else:
            assert parked_after_fault(trial)
    else:
        assert outcome.finished == [0, 1, 2]
        trial = open_trial(path)
        assert trial.ended == "complete"
        assert parked_after_fault(trial)
    assert inject.done
    if any(event.name == "fault" for event in trial.events):
        assert notices, "a fault is never passed over in silence"
        if device == "imu" or word in {"garbage", "wrong", "stuck"}:
            assert seconds_to_park(trial) < 1.0


@pytest.mark.parametrize("word", ["stuck", "wrong", "slow", "off"])
@pytest.mark.parametrize("axis", ["tilt", "roll"])
def test_a_servo_that_does_not_do_as_told_is_seen_by_the_sensor(
    tmp_path: Path, clock: ScaledClock, rig: SimulatedRig, axis: str, word: str
) -> None:
    rig.fault(axis, word)
    path = tmp_path / "session.imu-trial"
    try:
        outcome = run_session(setup_on(rig), path, clock)
    except SessionStopped as stopped:
        sentence = str(stopped)
    else:
        sentence = ""
        assert word in {"slow", "wrong"}
        assert outcome.finished == [0, 1, 2]
    assert parked_after_fault(open_trial(path))
    assert not sentence or "servo" in sentence


@pytest.mark.parametrize("state", ["resting", "moving", "holding"])
def test_a_stop_request_parks_and_keeps_everything(
    tmp_path: Path, clock: ScaledClock, rig: SimulatedRig, state: str
) -> None:
    stop = StopRequest()

    def observe(progress: Progress) -> None:
        if progress.state == state and progress.step in (0, FAULTY_STEP) and stop.cause is None:
            stop.make("Stopped by SIGINT.")

    path = tmp_path / "session.imu-trial"
    with pytest.raises(SessionInterrupted):
        run_session(setup_on(rig), path, clock, stop=stop, observe=observe)
    trial = open_trial(path)
    assert trial.ended == "interrupted"
    assert parked_after_fault(trial)


def test_a_session_whose_file_is_deleted_says_so_and_parks(
    tmp_path: Path, clock: ScaledClock, rig: SimulatedRig
) -> None:
    path = tmp_path / "session.imu-trial"

    def observe(progress: Progress) -> None:
        if progress.step == FAULTY_STEP:
            path.unlink(missing_ok=True)

    with pytest.raises(StorageError, match="deleted or moved"):
        run_session(setup_on(rig), path, clock, observe=observe)
    clock.sleep(3.0)
    pulses = rig.state().pulses_us
    assert all(
        pulses[name] == pytest.approx(axis.pulse(0.0) / 4, abs=0.5)
        for name, axis in JIG.axes.items()
    )


def test_a_stopped_session_goes_on_from_its_last_finished_pose(
    tmp_path: Path, clock: ScaledClock, rig: SimulatedRig
) -> None:
    path = tmp_path / "session.imu-trial"
    inject = Injector(rig, "imu", "off", "moving", None)
    with pytest.raises(SessionStopped, match="pose 2 of 3"):
        run_session(setup_on(rig), path, clock, observe=inject)
    samples_before = len(open_trial(path).imu("imu"))
    rig.clear("imu")
    setup = resumed_setup(path, setup_on(rig))
    outcome = run_session(setup, path, clock, resume=True)
    assert outcome.finished == [1, 2]
    trial = open_trial(path)
    assert trial.ended == "complete"
    record = read_session(trial)
    assert sorted(record.finished) == [0, 1, 2]
    times = [visit.still_s[0] for visit in record.visits]
    assert times == sorted(times)
    assert len(trial.imu("imu")) > samples_before
