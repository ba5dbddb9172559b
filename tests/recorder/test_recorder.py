"""A whole recording against simulated devices on real ports, with what can happen to it."""

import errno
import re
import threading
import time
import tracemalloc
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from firmware_protocols.layout import load_layout
from imu_rig.calibration.certificate import load_certificate
from imu_rig.clock import SystemClock
from imu_rig.devices.ports import open_port
from imu_rig.errors import DeviceError, InputError, PortError, StorageError
from imu_rig.recorder.engine import END_S, PORTS_S, Recorder
from imu_rig.recorder.setup import DeviceSetup, JigSetup, TrialSetup
from imu_rig.recorder.status import RecorderStatus
from imu_rig.recording import RecordingOptions, open_trial
from imu_rig.recording.storage import OsFileSystem
from imu_rig.stopping import StopRequest
from simulators.rig import RigConfig, SimulatedRig
from simulators.served_devices import ServedDevices

LAYOUT = load_layout("mpu9150-28")
PATIENCE_S = 20.0
MOST_EARLY = 100  # packets, half a second
MOST_LATE = 250  # a busy machine takes its time to close a port
GARBAGE_BYTES_PER_S = 1_000_000
GARBAGE_BYTES = 1_500_000
CERTIFICATE = Path(__file__).parents[1] / "data" / "certificate-v1.json"
CLOCK = SystemClock()


@dataclass
class Running:
    """A recording in a thread of its own."""

    setup: TrialSetup
    path: object
    options: RecordingOptions | None = None
    wait_s: float | None = None
    stop: StopRequest = field(default_factory=StopRequest)
    statuses: list[RecorderStatus] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    outcome: object = None
    error: BaseException | None = None

    def __post_init__(self):
        self.recorder = Recorder(
            self.setup,
            self.path,
            CLOCK,
            stop=self.stop,
            observe=self.statuses.append,
            notify=self.notices.append,
            wait_s=self.wait_s,
            options=self.options,
        )
        self.thread = threading.Thread(target=self._run)

    def _run(self):
        try:
            self.outcome = self.recorder.run()
        except BaseException as error:
            self.error = error

    def device(self, name):
        return next((d for d in self.statuses[-1].devices if d.name == name), None)

    def end(self, cause="stopped"):
        self.stop.make(cause)
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()


@contextmanager
def recording(setup, path, **options):
    running = Running(setup, path, **options)
    running.thread.start()
    try:
        yield running
    finally:
        running.end()


def wait_until(condition):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


def all_live(running):
    return running.statuses and all(d.state == "live" for d in running.statuses[-1].devices)


def assert_nothing_lost(served, path, name):
    """See that a file holds what a device handed out, but for the first and the last moment.

    Opening a port throws away what came before, and what comes while it is closed nobody reads;
    how much that is depends on the machine. Between them nothing may be missing.
    """
    counter = open_trial(path).imu(name).counter
    [(first, last)] = served.counters(name)
    assert np.all(np.diff(counter) == 1)
    early = int(counter[0] - first) % 256
    assert early < MOST_EARLY
    assert 0 <= last - first + 1 - early - len(counter) < MOST_LATE


def setup_of(served, names, rate_hz=200.0, **more):
    urls = [served.add(name, LAYOUT, rate_hz, seed=i) for i, name in enumerate(names)]
    devices = tuple(DeviceSetup(name=n, port=u) for n, u in zip(names, urls, strict=True))
    return TrialSetup(devices=devices, **more)


@pytest.mark.parametrize("transport", ["pty", "tcp"])
def test_every_packet_of_every_device_is_in_the_file(tmp_path, transport):
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(CLOCK, transport) as served:
        setup = setup_of(served, ["left", "right", "waist"], subject="S01", duration_s=0.6)
        outcome = Recorder(setup, path, CLOCK).run()
        for name in ("left", "right", "waist"):
            assert_nothing_lost(served, path, name)
    trial = open_trial(path)
    assert outcome.reason == trial.ended == "complete"
    assert outcome.recorded_s >= 0.6
    assert trial.config["subject"] == "S01"
    assert not trial.damage
    assert not trial.gaps
    assert [e.name for e in trial.events] == ["all_live"]
    for status in outcome.devices:
        assert status.lost == status.corrupt == status.reconnects == 0
        assert status.packets == len(trial.imu(status.name))
        assert trial.imu(status.name).t[-1] > 0.5
        _, told = trial.device_statistics(status.name)[-1]
        assert told.pop("rate_hz") == pytest.approx(200.0, rel=0.05)
        assert told == {
            "state": "live",
            "packets": status.packets,
            **dict.fromkeys(("lost", "corrupt", "duplicates", "restarts", "reconnects", "gaps"), 0),
        }


def test_an_unplugged_device_comes_back_with_a_gap_and_costs_the_others_nothing(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(CLOCK) as served:
        setup = setup_of(served, ["left", "right"])
        with recording(setup, path) as running:
            wait_until(lambda: all_live(running))
            served.unplug("left")
            wait_until(lambda: running.device("left").state == "lost")
            assert "has gone" in running.device("left").problem
            served.plug("left")
            wait_until(lambda: running.device("left").state == "live")
            running.recorder.mark("turn")
        assert_nothing_lost(served, path, "right")
        runs = served.counters("left")
    trial = open_trial(path)
    # the pseudo-terminal took with it what had not been read yet
    (before, after) = (runs[0][1], runs[1][0])
    gap = trial.gaps[-1]
    assert gap.fields["reason"] == "unplugged"
    assert gap.fields["counter_after"] - gap.fields["counter_before"] >= after - before
    counter = trial.imu("left").counter
    jump = int(np.argmax(np.diff(counter)))
    assert counter[jump + 1] - counter[jump] == (
        gap.fields["counter_after"] - gap.fields["counter_before"]
    )
    assert gap.t < gap.fields["until_s"] < trial.duration_s
    assert gap.fields["restarted"] is False
    assert running.outcome.devices[0].reconnects == 1
    assert [e.fields["label"] for e in trial.events if e.name == "marker"] == ["turn"]
    assert any("is back after" in notice for notice in running.notices)


def test_a_device_that_falls_silent_or_talks_nonsense_is_told_apart(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with (
        ServedDevices(CLOCK) as served,
        recording(setup_of(served, ["left", "right"]), path) as running,
    ):
        wait_until(lambda: all_live(running))
        served.silence("left", True)
        served.garbage("right", True)
        wait_until(lambda: running.device("left").state == "silent")
        wait_until(lambda: running.device("right").state == "garbled")
        # sound packets of the last two seconds are told of, where there are any
        assert re.search("sends nothing|has fallen silent", running.device("left").problem)
        assert re.search(
            "without any packet|damaged ones|nothing that can be read",
            running.device("right").problem,
        )
        served.silence("left", False)
        served.garbage("right", False)
        wait_until(lambda: all_live(running))
    trial = open_trial(path)
    last = {gap.source: gap.fields for gap in trial.gaps}
    by_name = {name: last[source.id] for name, source in trial.sources.items()}
    assert by_name["left"]["reason"] == "silent"
    assert by_name["right"]["reason"] == "unreadable"
    assert all(gap["counter_after"] > gap["counter_before"] for gap in by_name.values())


def test_a_device_that_starts_anew_is_not_mistaken_for_one_that_went_on(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(CLOCK) as served, recording(setup_of(served, ["left"]), path) as running:
        wait_until(lambda: running.statuses and running.device("left").packets > 100)
        served.unplug("left")
        wait_until(lambda: running.device("left").state == "lost")
        served.restart("left")
        served.plug("left")
        wait_until(lambda: running.device("left").state == "live")
    trial = open_trial(path)
    assert trial.gaps[-1].fields["restarted"] is True
    assert np.all(np.diff(trial.imu("left").t) > 0)


def test_a_recording_that_is_stopped_early_says_so(tmp_path):
    with ServedDevices(CLOCK) as served:
        setup = setup_of(served, ["left"], duration_s=600.0)
        with recording(setup, tmp_path / "walk.imu-trial") as running:
            wait_until(lambda: all_live(running))
            began = time.monotonic()
        assert time.monotonic() - began < 3.0
    assert running.outcome.reason == "interrupted"
    assert open_trial(tmp_path / "walk.imu-trial").ended == "interrupted"


def test_a_port_that_another_program_holds_leaves_no_file(tmp_path):
    with ServedDevices(CLOCK) as served:
        setup = setup_of(served, ["left"])
        other = open_port(setup.devices[0].port)
        try:
            with pytest.raises(PortError, match="another program"):
                Recorder(setup, tmp_path / "walk.imu-trial", CLOCK).run()
        finally:
            other.close()
    assert not list(tmp_path.iterdir())


def test_a_missing_device_is_waited_for_and_then_named(tmp_path):
    missing = TrialSetup(devices=(DeviceSetup(name="left", port=str(tmp_path / "none")),))
    with pytest.raises(PortError, match=r"Not heard within 0\.3 s: There is no port"):
        Recorder(missing, tmp_path / "walk.imu-trial", CLOCK, wait_s=0.3).run()
    assert not list(tmp_path.iterdir())
    with ServedDevices(CLOCK) as served:
        there = setup_of(served, ["right"])
        served.silence("right", True)
        silent = missing.devices[0].model_copy(update={"required": False})
        setup = TrialSetup(devices=(silent, *there.devices))
        with pytest.raises(DeviceError, match=r"right on .* sends nothing"):
            Recorder(setup, tmp_path / "walk.imu-trial", CLOCK, wait_s=2.0).run()


def test_a_device_that_is_plugged_in_late_joins(tmp_path):
    with ServedDevices(CLOCK) as served:
        setup = setup_of(served, ["left", "right"], duration_s=0.3)
        served.unplug("right")
        with recording(setup, tmp_path / "walk.imu-trial") as running:
            wait_until(lambda: running.statuses and running.device("left").state == "live")
            wait_until(lambda: running.device("right").state == "waiting")
            assert running.statuses[-1].state == "waiting"
            served.plug("right")
            running.thread.join(PATIENCE_S)
        assert running.outcome.reason == "complete"
        assert running.outcome.elapsed_s > running.outcome.recorded_s >= 0.3


@pytest.mark.parametrize("required", [True, False])
def test_a_late_device_whose_port_is_refused_costs_the_others_nothing(tmp_path, required):
    with ServedDevices(CLOCK) as served:
        setup = setup_of(served, ["left"])
        port = tmp_path / "late"
        late = DeviceSetup(name="late", port=str(port), required=required)
        setup = setup.model_copy(update={"devices": (*setup.devices, late)})
        with recording(setup, tmp_path / "walk.imu-trial") as running:
            wait_until(lambda: running.statuses and running.device("left").state == "live")
            wait_until(lambda: running.device("late").state == "waiting")
            port.write_text("no port at all")
            wait_until(lambda: "no serial port" in (running.device("late").problem or ""))
            before = running.device("left").packets
            wait_until(lambda: running.device("left").packets > before)
            port.unlink()
            port.symlink_to(served.add("late", LAYOUT, 200.0))
            wait_until(lambda: all_live(running))
    assert running.error is None


def test_an_optional_device_whose_port_is_refused_is_done_without(tmp_path):
    with ServedDevices(CLOCK) as served:
        setup = setup_of(served, ["left"], duration_s=0.3)
        refused = DeviceSetup(name="odd", port=str(tmp_path), required=False)
        setup = setup.model_copy(update={"devices": (*setup.devices, refused)})
        outcome = Recorder(setup, tmp_path / "walk.imu-trial", CLOCK).run()
    assert outcome.reason == "complete"


class FillingFileSystem(OsFileSystem):
    """A disk that another program fills for a moment; then there is room for a last word."""

    full = False

    def write(self, descriptor, data):
        if self.full:
            self.full = False
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(descriptor, data)


def test_a_disk_that_fills_up_ends_the_recording_and_keeps_what_was_written(tmp_path):
    disk = FillingFileSystem()
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(CLOCK) as served:
        with recording(
            setup_of(served, ["left"]), path, options=RecordingOptions(file_system=disk)
        ) as running:
            wait_until(lambda: all_live(running))
            disk.full = True
            running.thread.join(PATIENCE_S)
        assert isinstance(running.error, StorageError)
        assert "is full" in str(running.error)
    trial = open_trial(path)
    assert trial.ended == "disk_full"
    assert len(trial.imu("left")) > 10


def test_the_jig_is_recorded_and_parked_at_the_end(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with SimulatedRig(RigConfig.random(3), clock=CLOCK) as rig:
        maestro = open_port(rig.maestro_url)
        # channel 0 to 1600 us: somebody has moved the pan axis
        maestro.write(bytes((0x84, 0, 6400 & 0x7F, 6400 >> 7)))
        wait_until(lambda: rig.state().pulses_us["pan"] == 1600.0)
        maestro.close()
        setup = TrialSetup(
            devices=(DeviceSetup(name="imu", port=rig.imu_url),),
            jig=JigSetup(maestro=rig.maestro_url),
            duration_s=0.4,
        )
        Recorder(setup, path, CLOCK).run()
    trial = open_trial(path)
    assert [e.name for e in trial.events] == ["all_live", "parking"]
    sent = trial.wire("jig", "out").data
    assert sent.count(b"\x90") > 5
    assert len(trial.wire("jig", "in").data) > 10
    # only the axis that was held is moved; the released ones would jump
    targets = [sent[i : i + 4] for i in range(len(sent)) if sent[i] == 0x84]
    assert {command[1] for command in targets} == {0}


@contextmanager
def recorded_jig(path):
    """A jig whose pan axis is held, while it is being recorded."""
    with SimulatedRig(RigConfig.random(3), clock=CLOCK) as rig:
        maestro = open_port(rig.maestro_url)
        maestro.write(bytes((0x84, 0, 6040 & 0x7F, 6040 >> 7)))
        wait_until(lambda: rig.state().pulses_us["pan"] == 1510.0)
        maestro.close()
        setup = TrialSetup(jig=JigSetup(maestro=rig.maestro_url))
        with recording(setup, path) as running:
            wait_until(lambda: running.statuses)
            yield rig, running


def targets_sent(trial):
    sent = trial.wire("jig", "out").data
    return {sent[i + 1] for i in range(len(sent) - 3) if sent[i] == 0x84}


@pytest.mark.parametrize("word", ["off", "stuck", "slow", "delayed"])
def test_the_end_is_reached_within_three_seconds_whatever_the_jig_does(tmp_path, word):
    path = tmp_path / "walk.imu-trial"
    with recorded_jig(path) as (rig, running):
        rig.fault("maestro", word)
        before = time.monotonic()
        running.end()
        assert time.monotonic() - before < 3.0
    trial = open_trial(path)
    assert trial.ended == "complete"
    assert trial.events[-1].name == "parking"
    assert targets_sent(trial) == {0}  # nothing was waited for before that
    assert ("not answer" in (running.outcome.problem or "")) is (word == "off")


def test_whoever_asks_twice_does_not_wait_for_the_jig_to_arrive(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with recorded_jig(path) as (rig, running):
        rig.fault("maestro", "stuck")
        before = time.monotonic()
        running.stop.make("stopped")
        wait_until(lambda: running.statuses[-1].state == "stopping")
        running.end()
        assert time.monotonic() - before < END_S - PORTS_S  # which it would wait otherwise
    assert targets_sent(open_trial(path)) == {0}


def test_a_jig_that_stays_unplugged_is_told_and_holds_nothing_up(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with recorded_jig(path) as (rig, running):
        rig.fault("maestro", "unplug")
        wait_until(lambda: running.statuses[-1].problem)
        before = time.monotonic()
        running.end()
        assert time.monotonic() - before < 3.0
    assert "could not be parked" in running.outcome.problem
    trial = open_trial(path)
    assert trial.ended == "complete"
    [gap] = trial.gaps
    assert gap.fields == {"reason": "unplugged"}


@pytest.mark.parametrize("word", ["unplug", "off"])
def test_a_jig_that_comes_back_is_watched_again_and_its_gap_is_complete(tmp_path, word):
    path = tmp_path / "walk.imu-trial"
    with recorded_jig(path) as (rig, running):
        rig.fault("maestro", word)
        wait_until(lambda: running.statuses[-1].problem)
        rig.clear("maestro")
        wait_until(lambda: not running.statuses[-1].problem)
    assert running.outcome.problem is None
    trial = open_trial(path)
    assert [e.name for e in trial.events if e.name.startswith("jig")] == ["jig_lost", "jig_back"]
    [gap] = trial.gaps
    assert gap.source == trial.sources["jig"].id
    assert gap.fields["reason"] == ("unplugged" if word == "unplug" else "silent")
    assert gap.t < gap.fields["until_s"] < trial.duration_s


def test_a_jig_that_comes_back_at_the_last_moment_is_parked_and_nothing_is_left_to_tell(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with recorded_jig(path) as (rig, running):
        rig.fault("maestro", "unplug")
        wait_until(lambda: running.statuses[-1].problem)
        rig.clear("maestro")
        running.end()
    trial = open_trial(path)
    assert running.outcome.problem is None
    assert trial.gaps[-1].fields["until_s"] <= trial.duration_s
    assert targets_sent(trial) == {0}


def test_a_certificate_travels_with_the_trial_and_calibrates_it(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(CLOCK) as served:
        setup = setup_of(served, ["left", "right"], duration_s=0.2)
        left, right = setup.devices
        certified = left.model_copy(update={"certificate": CERTIFICATE})
        setup = setup.model_copy(update={"devices": (certified, right)})
        Recorder(setup, path, CLOCK).run()
    trial = open_trial(path)
    affine = load_certificate(CERTIFICATE).accel
    raw, calibrated = trial.imu("left"), trial.imu("left", calibrated=True)
    assert len(raw) > 20
    assert np.allclose(calibrated.accel, raw.accel @ np.array(affine.K).T - np.array(affine.b))
    with pytest.raises(InputError, match="no certificate of 'right'"):
        trial.imu("right", calibrated=True)


def test_a_file_that_is_no_certificate_is_refused_before_any_port_is_opened(tmp_path):
    bad = tmp_path / "certificate.json"
    bad.write_text("{}")
    setup = TrialSetup(devices=(DeviceSetup(name="left", port="/dev/null", certificate=bad),))
    with pytest.raises(InputError, match="is not a certificate"):
        Recorder(setup, tmp_path / "walk.imu-trial", CLOCK)


def test_a_battery_is_told_as_the_device_sends_it(tmp_path):
    with ServedDevices(CLOCK) as served:
        url = served.add("baro", "baro-16")
        setup = TrialSetup(
            devices=(DeviceSetup(name="baro", port=url, layout="baro-16"),), duration_s=0.3
        )
        outcome = Recorder(setup, tmp_path / "walk.imu-trial", CLOCK).run()
    trial = open_trial(tmp_path / "walk.imu-trial")
    sent, unit = trial.samples("baro").values["battery"], trial.samples("baro").units["battery"]
    assert outcome.devices[0].supply == (("battery", sent[-1], unit),)
    assert sent[-1] > 90  # fresh from the charger [%]


def test_a_device_that_floods_its_port_with_garbage_costs_the_others_nothing(tmp_path):
    """A megabyte per second that no packet can be found in, for some two seconds."""
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(CLOCK, "tcp") as served:
        setup = setup_of(served, ["left"])
        noisy = served.add("noisy", LAYOUT, GARBAGE_BYTES_PER_S / LAYOUT.length)
        served.garbage("noisy", True)
        noisy = DeviceSetup(name="noisy", port=noisy, required=False)
        with recording(
            setup.model_copy(update={"devices": (*setup.devices, noisy)}), path
        ) as running:
            wait_until(lambda: running.statuses and running.device("noisy").state == "garbled")
            tracemalloc.start()
            began, kept = running.statuses[-1].file_bytes, tracemalloc.get_traced_memory()[0]
            wait_until(lambda: running.statuses[-1].file_bytes > began + GARBAGE_BYTES)
            # what waits to be written and decoded comes and goes; what came would only grow
            wait_until(lambda: tracemalloc.get_traced_memory()[0] - kept < GARBAGE_BYTES)
            tracemalloc.stop()
            assert running.device("left").state == "live"
        assert_nothing_lost(served, path, "left")
    assert running.outcome.unwritten_records == 0
    trial = open_trial(path)
    assert len(trial.wire("noisy").data) > GARBAGE_BYTES
    assert len(trial.samples("noisy")) == 0
