"""Programs of the project against recordings in place of hardware."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import serial

from firmware_protocols.layout import load_layout
from imu_rig.clock import ScaledClock, SteppedClock, SystemClock
from imu_rig.devices.jig import load_jig
from imu_rig.devices.stream_device import PacketDevice
from imu_rig.errors import SessionStopped
from imu_rig.recorder.engine import Recorder
from imu_rig.recorder.setup import TrialSetup
from imu_rig.recorder.status import RecorderStatus
from imu_rig.recording.reader import Trial, open_trial
from imu_rig.session.history import read_session
from imu_rig.session.protocol import JigProtocol, Step
from imu_rig.session.run import SessionSetup, run_session
from imu_rig.stopping import StopRequest
from imu_rig.testing import FAST, replayed
from simulators.rig import RigConfig, SimulatedRig
from simulators.served_devices import ServedDevices

LAYOUTS = {
    "left shoe": "mpu9150-28",
    "right shoe": "mpu9150-28",
    "baro": "baro-16",
    "receiver": "two-imu",
}
SECONDS = 0.5
SPEED = 5.0


def recorded(ports: dict[str, str], path: Path, ended: Callable[[RecorderStatus], bool]) -> Trial:
    """Record devices until ``ended`` says so."""
    devices = [{"name": n, "port": port, "layout": LAYOUTS[n]} for n, port in ports.items()]
    stop = StopRequest()

    def observe(status: RecorderStatus) -> None:
        if ended(status):
            stop.make("enough")

    Recorder(
        TrialSetup.of({"devices": devices}, "test"), path, SystemClock(), stop=stop, observe=observe
    ).run()
    return open_trial(path)


@pytest.fixture(scope="module")
def original(tmp_path_factory) -> Trial:
    path = tmp_path_factory.mktemp("trials") / "original.imu-trial"
    with ServedDevices() as served:
        ports = {
            name: served.add(name, layout, seed=number, skew_ppm=40.0 * number)
            for number, (name, layout) in enumerate(LAYOUTS.items())
        }
        return recorded(ports, path, lambda status: status.recorded_s > SECONDS)


def assert_same_rows(one: Trial, two: Trial) -> None:
    assert list(one.sources) == list(two.sources)
    assert one.sensors == two.sensors
    assert {"receiver/foot", "receiver/waist"} < set(one.sensors)
    for name in LAYOUTS:
        assert one.wire(name).data == two.wire(name).data
    for name in one.sensors:
        a, b = one.samples(name), two.samples(name)
        assert len(a.t) > 10
        assert a.values.keys() == b.values.keys()
        for field in a.values:
            assert np.array_equal(a.values[field], b.values[field])
        assert np.array_equal(a.counter, b.counter)
        if a.device_s is not None:
            assert np.array_equal(a.device_s, b.device_s)


@pytest.mark.parametrize(
    ("transport", "speed"), [("pty", 1.0), ("pty", FAST), ("tcp", 2.0), ("tcp", FAST)]
)
def test_record_replay_record_gives_the_same_rows(original, transport, speed, tmp_path):
    with replayed(original, transport=transport, speed=speed) as replay:
        again = recorded(
            replay.ports(),
            tmp_path / "again.imu-trial",
            lambda status: replay.status.state == "ended",
        )
        assert replay.status.lost == dict.fromkeys(LAYOUTS, 0)
    assert_same_rows(original, again)


def test_the_first_test_of_the_document_runs_on_a_trial_of_several_devices(
    original, tmp_path, monkeypatch
):
    document = Path(__file__).parents[2] / "docs" / "replay.md"
    example = document.read_text().partition("```python\n")[2].partition("```")[0]
    (tmp_path / "walk.imu-trial").write_bytes(original.path.read_bytes())
    monkeypatch.chdir(tmp_path)
    read = bytearray()

    def program(url: str) -> int:
        with suppress(serial.SerialException), serial.serial_for_url(url, timeout=0.1) as port:
            while True:
                read.extend(port.read(100))

        return 42

    names = {"my_program": program}
    exec(example, names)  # noqa: S102  (our own document)
    names["test_my_program_counts_the_steps"]()
    assert bytes(read) == original.wire("left shoe").data


def test_a_device_can_be_stepped_through_its_recording(original):
    """The rate, the samples and the silence of a device under the hand of a test."""
    clock = SteppedClock()
    name = "left shoe"
    layout = load_layout(LAYOUTS[name])
    with replayed(original, [name], clock=clock) as replay:
        device = PacketDevice(name, replay.url(name), layout, clock)
        device.start()
        replay.wait_for_clients(5.0)
        count = 0
        for _ in range(8):
            replay.step(SECONDS / 10)
            arrived = threading.Event()
            for _ in range(100):
                count += len(device.poll()[""])
                due = np.count_nonzero(original.samples(name).host_s <= replay.status.t_s)
                if count >= due:
                    break
                arrived.wait(0.01)
            assert count == due
        device.stop()


JIG = load_jig("paper-jig")
SHORT = JigProtocol(name="short", hold_s=0.8, steps=(Step(roll=0, tilt=20), Step(tilt=0, roll=30)))


def run_short(ports: dict[str, str], path: Path, clock: ScaledClock) -> Trial:
    setup = SessionSetup(
        imu_url=ports["imu"],
        maestro_url=ports["maestro"],
        layout=load_layout("mpu9150-28"),
        jig=JIG,
        protocol=SHORT,
    )
    run_session(setup, path, clock)
    return open_trial(path)


@pytest.mark.slow
def test_a_whole_session_runs_against_the_recording_of_one(tmp_path):
    """The jig's answers follow the program's own commands, and the sensor's data are in time.

    A recording cannot wait for a machine that stalls as a jig does, so there are three attempts.
    """
    clock = ScaledClock(SPEED)
    with SimulatedRig(RigConfig.random(3), clock=clock) as rig:
        first = run_short(rig.ports(), tmp_path / "first.imu-trial", clock)
    for attempt in range(3):
        path = tmp_path / f"again-{attempt}.imu-trial"
        with replayed(first, clock=clock) as replay:
            try:
                finished = read_session(run_short(replay.ports(), path, clock)).finished
            except SessionStopped:
                finished = read_session(open_trial(path)).finished
            if len(finished) == len(SHORT.steps):
                assert replay.unknown_bytes("maestro") == 0
                assert len(replay.received("maestro")) > 100
                return
    pytest.fail(f"only the stops {finished} were finished")
