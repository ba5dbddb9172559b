"""Several streams on one port: each is watched, counted and recorded in its own right."""

import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from firmware_protocols.known import load_protocol
from imu_rig.calibration.certificate import load_certificate
from imu_rig.cli.recorded_trial import recorded_facts
from imu_rig.clock import ScaledClock, SystemClock
from imu_rig.devices import mti
from imu_rig.devices.stream_device import StreamHealth
from imu_rig.errors import DeviceError, InputError
from imu_rig.monitor.engine import NothingKept
from imu_rig.packet_stream import PacketBlock
from imu_rig.recorder.engine import Recorder
from imu_rig.recorder.keeper import DeviceKeeper
from imu_rig.recorder.setup import DeviceSetup, TrialSetup
from imu_rig.recorder.status import DeviceStatus
from imu_rig.recorder.stream_watch import StreamWatch, statistics_of, together
from imu_rig.recording import open_trial
from imu_rig.recording.replay import RecordedWires
from imu_rig.stopping import StopRequest
from simulators.served_devices import ServedDevices

CERTIFICATE = Path(__file__).parents[1] / "data" / "certificate-v1.json"
CLOCK = SystemClock()
FASTER = ScaledClock(3.0)  # where only what happens is looked at, and not when
PATIENCE_S = 20.0


@contextmanager
def recording(devices, path, clock=CLOCK, **more):
    """Record in a thread of its own; yields the stop, the statuses and the sentences."""
    stop, statuses, notices, errors = StopRequest(), [], [], []
    recorder = Recorder(
        TrialSetup(devices=devices),
        path,
        clock,
        stop=stop,
        observe=statuses.append,
        notify=notices.append,
        **more,
    )

    def run():
        try:
            recorder.run()
        except DeviceError as error:
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield statuses, notices, errors, thread
    finally:
        stop.make("enough")
        thread.join(PATIENCE_S)
    assert not thread.is_alive()


def until(condition):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


def states(statuses):
    return {row.name: row.state for row in statuses[-1].rows} if statuses else {}


def receiver(served, **more):
    url = served.add("receiver", "two-imu", seed=3)
    return (DeviceSetup(name="receiver", port=url, layout="two-imu", **more),)


def test_a_stream_that_falls_silent_alone_has_a_gap_of_its_own(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(CLOCK) as served:
        devices = receiver(served, certificates={"foot": CERTIFICATE})
        with recording(devices, path) as (statuses, notices, _, _):
            until(lambda: set(states(statuses).values()) == {"live"})
            served.silence("receiver", stream="waist")
            until(lambda: states(statuses)["receiver/waist"] == "silent")
            assert states(statuses)["receiver/foot"] == "live"
            assert statuses[-1].devices[0].state == "silent"  # the worst of them
            problem = next(r.problem for r in statuses[-1].rows if r.name == "receiver/waist")
            assert "foot" in problem
            served.silence("receiver", False, stream="waist")
            until(lambda: set(states(statuses).values()) == {"live"})
        runs = served.counters_of("receiver")
    told = [sentence for sentence in notices if "receiver/waist is back" in sentence]
    trial = open_trial(path)
    [gap] = trial.gaps
    assert gap.fields["stream"] == "waist"
    assert gap.fields["reason"] == "silent"
    [(_, before), (after, _)] = runs["waist"]
    assert (gap.fields["counter_after"] - gap.fields["counter_before"]) == after - before
    [missing] = trial.missing("receiver/waist")
    assert missing.samples == after - before - 1
    assert missing.reason == "silent"
    assert f"; {missing.samples} packets are missing by its counter." in told[0]
    assert trial.missing("receiver/foot") == []
    assert np.all(np.diff(trial.imu("receiver/foot").counter) == 1)
    of_port = trial.device_statistics("receiver")[-1][1]
    of_waist = trial.device_statistics("receiver/waist")[-1][1]
    of_foot = trial.device_statistics("receiver/foot")[-1][1]
    assert (of_waist["gaps"], of_foot["gaps"], of_port["gaps"]) == (1, 0, 1)
    assert of_foot["packets"] == len(trial.samples("receiver/foot"))
    assert of_port["packets"] == of_foot["packets"] + of_waist["packets"]
    kept = load_certificate(CERTIFICATE)
    assert trial.certificate("receiver/foot") == kept
    calibrated = trial.imu("receiver/foot", calibrated=True)
    assert not np.allclose(calibrated.accel, trial.imu("receiver/foot").accel)
    with pytest.raises(InputError, match="no certificate"):
        trial.certificate("receiver/waist")
    # the port never went: a replay must not take it away
    assert {chunk.what for chunk in RecordedWires(trial)} == {"in", "end"}


def test_a_port_that_is_unplugged_is_missing_in_all_its_streams_and_vanishes_once(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(CLOCK) as served:
        with recording(receiver(served), path) as (statuses, notices, _, _):
            until(lambda: set(states(statuses).values()) == {"live"})
            served.unplug("receiver")
            until(lambda: set(states(statuses).values()) == {"lost"})
            assert len(notices) == 1  # of the port, not of each stream
            served.plug("receiver")
            until(lambda: set(states(statuses).values()) == {"live"})
        runs = served.counters_of("receiver")
    trial = open_trial(path)
    assert {gap.fields["stream"] for gap in trial.gaps} == {"foot", "waist"}
    for stream in ("foot", "waist"):
        [missing] = trial.missing(f"receiver/{stream}")
        assert missing.reason == "unplugged"
        [(_, before), (after, _)] = runs[stream]
        assert missing.samples >= after - before - 1
    plugs = [chunk.what for chunk in RecordedWires(trial) if chunk.what in ("unplug", "plug")]
    assert plugs == ["unplug", "plug"]


def test_a_stream_that_never_comes_is_waited_for_unless_it_is_optional(tmp_path):
    with ServedDevices(CLOCK) as served:
        devices = receiver(served)
        served.silence("receiver", stream="waist")
        begun = recording(devices, tmp_path / "a.imu-trial", wait_s=0.9)
        with begun as (_, _, errors, thread):
            thread.join(PATIENCE_S)
        assert "receiver/waist" in str(errors[0])
        assert "optional=waist" in str(errors[0])
        optional = (devices[0].model_copy(update={"optional_streams": ("waist",)}),)
        with recording(optional, tmp_path / "b.imu-trial") as (statuses, _, _, _):
            until(lambda: statuses and statuses[-1].state == "recording")
    trial = open_trial(tmp_path / "b.imu-trial")
    assert [event.name for event in trial.events] == ["all_live"]
    assert len(trial.samples("receiver/waist")) == 0


def test_what_is_said_to_a_device_is_recorded_and_told_from_what_it_says(tmp_path):
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(FASTER) as served:
        url = served.add("mti", "xsens-mti", seed=1)
        device = (DeviceSetup(name="mti", port=url, layout="xsens-mti"),)
        with recording(device, path, FASTER) as (statuses, _, _, _):
            until(lambda: states(statuses) == {"mti": "live"})
    trial = open_trial(path)
    assert bytes.fromhex("FA FF 30 00 D1") in trial.wire("mti", "out").data  # GoToConfig
    assert bytes.fromhex("FA FF 31 00 D0") in trial.wire("mti", "in").data  # and its answer
    assert len(trial.imu("mti")) > 5
    assert trial.missing("mti") == []


def test_what_the_conversation_with_a_device_interrupts_is_not_lost(tmp_path):
    with ServedDevices(FASTER) as served:
        url = served.add("mti", "xsens-mti", seed=1)
        device = (DeviceSetup(name="mti", port=url, layout="xsens-mti"),)
        for path in (tmp_path / "a.imu-trial", tmp_path / "b.imu-trial"):  # it measures, then
            with recording(device, path, FASTER) as (statuses, _, _, _):
                until(lambda seen=statuses: states(seen) == {"mti": "live"})
            assert statuses[-1].devices[0].lost == 0
            trial = open_trial(path)
            assert {missing.reason for missing in trial.missing("mti")} <= {"set up"}
            facts = recorded_facts(trial)["devices"]["mti"]
            assert facts["lost"] == 0
            assert facts["rate_hz"] == pytest.approx(100.0, rel=0.02)


def test_an_interruption_by_a_conversation_is_told_from_a_loss():
    notes = []
    watched, layout = watch(notes)
    counter = np.array([4, 5, 9, 10, 14])
    host_s = np.array([1.0, 1.1, 1.5, 1.6, 2.4])

    def take(at, lost):
        rows = np.zeros(len(counter[at]), layout.dtype)
        block = PacketBlock(rows, host_s[at], host_s[at], None, counter[at])
        watched.take(block, StreamHealth(good=5, lost=lost))
        watched.show("live")

    watched.talked(0.9, 2.0)
    take(slice(0, 2), 0)
    take(slice(2, 3), 3)  # 6, 7 and 8 are missing as long as it was talked to
    assert watched.status.lost == 0
    take(slice(3, 5), 6)  # and 11, 12 and 13 after that
    assert watched.status.lost == 3
    [gap] = [note for note in notes if isinstance(note, dict)]
    assert (gap["counter_before"], gap["counter_after"], gap["until_s"]) == (5, 9, 1.5)


def test_a_device_that_was_heard_and_refuses_is_lost_and_not_waited_for():
    layout = load_protocol("two-imu")
    waist = layout.streams["waist"]

    class Refusing:
        protocol, running, opened_ns = layout, False, 0

        def start(self):
            raise DeviceError("left does not take its settings")

        def poll(self):
            block = PacketBlock(
                np.zeros(1, waist.dtype), np.ones(1), np.ones(1), None, np.ones(1, int)
            )
            return {"foot": PacketBlock.empty(layout.streams["foot"]), "waist": block}

        def stream_health(self, name):
            return StreamHealth(good=int(name == "waist"))

        def stop(self):
            pass

    setup = DeviceSetup(name="r", port="/dev/a", layout="two-imu")
    kept = DeviceKeeper(setup, Refusing(), NothingKept(0), 0, CLOCK, lambda sentence: None)
    kept.start()
    assert kept.tried.wait(PATIENCE_S)
    kept.join(PATIENCE_S)
    foot, waist_status = kept.status.rows
    assert (foot.state, waist_status.state) == ("waiting", "lost")
    assert "settings" in waist_status.problem


def test_a_device_that_refuses_to_talk_is_told_of_and_costs_the_others_nothing(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(mti, "ANSWER_S", 0.1)  # that it is waited for in vain
    path = tmp_path / "walk.imu-trial"
    with ServedDevices(FASTER) as served:
        left = DeviceSetup(name="left", port=served.add("left", "mpu9150-28"))
        odd = DeviceSetup(
            name="odd", port=served.add("odd", "baro-16"), layout="xsens-mti", required=False
        )
        with recording((left, odd), path, FASTER) as (statuses, _, _, _):
            until(lambda: states(statuses).get("left") == "live" and statuses[-1].rows[1].problem)
            assert states(statuses)["odd"] in ("waiting", "garbled")
            assert "odd" in statuses[-1].rows[1].problem
    assert len(open_trial(path).imu("left")) > 5


def watch(notes, name="waist"):
    class Log:
        def gap(self, source, t_ns, reason, **fields):
            notes.append(fields)

        def device_statistics(self, source, values):
            notes.append(values)

        def t_s(self, t_ns):
            return t_ns / 1e9

    layout = load_protocol("two-imu").streams["waist"]
    return StreamWatch(
        name, "receiver", "/dev/a", layout, required=True, log=Log(), source=1, notify=notes.append
    ), layout


def test_two_streams_that_fall_silent_together_do_not_look_like_one_that_goes_on():
    slow, _ = watch([])
    for age_s, goes_on in ((0.0, True), (0.29, True), (0.4, False), (0.59, False), (0.7, False)):
        slow.take(None, StreamHealth(good=5, last_packet_age_s=age_s))
        assert slow.going_on == goes_on
        assert slow.fresh == (age_s < 0.6)
    slow.take(None, StreamHealth())
    assert not slow.fresh  # nothing ever came


def test_faults_are_kept_after_they_have_gone():
    watched, layout = watch([])
    sick = StreamHealth(good=5, faults=("sensor over range", "supply low"))
    watched.take(None, sick)
    watched.show("live")
    assert watched.status.faults == ("sensor over range", "supply low")
    watched.take(PacketBlock.empty(layout), StreamHealth(good=9, faults=("supply low",)))
    watched.take(None, StreamHealth(good=12))
    watched.show("live")
    assert watched.status.faults == ()
    assert dict(watched.status.fault_counts) == {"sensor over range": 1, "supply low": 2}
    assert statistics_of(watched.status)["faults"] == {"sensor over range": 1, "supply low": 2}


def test_faults_without_end_take_no_room_without_end():
    watched, _ = watch([])
    for number in range(1000):
        watched.take(None, StreamHealth(faults=(f"fault {number}",)))
    watched.show("live")
    assert len(watched.status.fault_counts) < 100


def test_a_device_is_what_its_streams_are():
    foot = DeviceStatus("r/foot", "/dev/a", "live", rate_hz=50, packets=100, lost=2, corrupt=3)
    waist = DeviceStatus(
        "r/waist",
        "/dev/a",
        "lost",
        age_s=9.0,
        packets=40,
        lost=1,
        corrupt=3,
        gaps=1,
        problem="It has gone.",
    )
    whole = together("r", (foot, waist), required=True)
    assert (whole.state, whole.packets, whole.lost, whole.gaps) == ("lost", 140, 3, 1)
    assert whole.corrupt == 3  # those of the port: nobody knows of which stream they were
    assert whole.problem == "It has gone."
    assert whole.age_s == 9.0
    assert whole.rows == (foot, waist)
    alone = DeviceStatus("left", "/dev/b", "live")
    assert together("left", (alone,), required=True) is alone
    assert alone.rows == (alone,)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"layout": "two-imu", "optional_streams": ("hand",)}, "'hand'"),
        ({"layout": "mpu9150-28", "optional_streams": ("foot",)}, "one stream"),
        ({"layout": "two-imu", "certificate": "a.json"}, "certificate.foot=FILE"),
        ({"layout": "waist-unit", "certificates": {"barometer": "a.json"}}, "'barometer'"),
    ],
)
def test_streams_that_there_are_not_are_refused(values, named):
    with pytest.raises(InputError, match="Device 'r'") as refused:
        DeviceSetup(name="r", port="/dev/a", **values).protocol()
    assert named in str(refused.value)
