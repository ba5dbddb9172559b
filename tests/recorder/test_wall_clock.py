"""The wall clock may do what it likes during a trial: only the recorded clock pairs tell of it."""

import numpy as np

from firmware_protocols.layout import load_layout
from imu_rig.clock import SteppedClock, SystemClock
from imu_rig.recorder.engine import Recorder
from imu_rig.recorder.setup import TrialSetup
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial
from imu_rig.recording.format import Kind
from simulators.device_packets import DevicePackets
from simulators.served_devices import ServedDevices

LAYOUT = load_layout("mpu9150-28")
RATE_HZ = 100.0
HOUR_NS = 3_600_000_000_000
WALL_NS = 1_700_000_000_000_000_000
SECONDS = 12
STEP_AT_S = 6


def recorded(path, steps_ns):
    """Record the same packets at the same moments, with a wall clock that is set half-way."""
    clock = SteppedClock(50_000_000_000)
    start_ns = clock.now_ns()

    def wall_ns():
        passed = clock.now_ns() - start_ns
        return WALL_NS + passed + (steps_ns if passed >= STEP_AT_S * 1_000_000_000 else 0)

    packets = DevicePackets(LAYOUT, RATE_HZ, seed=1)
    options = RecordingOptions(wall_ns=wall_ns, note_s=0.0)
    with TrialWriter.create(path, {"kind": "trial"}, clock=clock, options=options) as trial:
        source = trial.add_source("shoe", "imu", {"layout": LAYOUT.to_dict()})
        for piece in range(SECONDS * 10):
            clock.advance(0.1)
            trial.bytes_in(source, clock.now_ns(), packets.make(piece * 10, 10))
            trial.flush()
        trial.event("marker", label="end")
    return open_trial(path)


def rows_of(trial, kind):
    records = trial.records
    rows = records.kind == kind
    return records.time_ns[rows].tolist(), records.source[rows].tolist()


def test_a_wall_clock_set_by_an_hour_changes_nothing_but_the_clock_pairs(tmp_path):
    steady = recorded(tmp_path / "steady.imu-trial", 0)
    for steps_ns in (HOUR_NS, -HOUR_NS):
        stepped = recorded(tmp_path / f"stepped{steps_ns}.imu-trial", steps_ns)
        assert stepped.wire("shoe").data == steady.wire("shoe").data
        for kind in (Kind.BYTES_IN, Kind.EVENT, Kind.SOURCE):
            assert rows_of(stepped, kind) == rows_of(steady, kind)
        one, other = stepped.samples("shoe"), steady.samples("shoe")
        assert len(one.t) == SECONDS * RATE_HZ
        assert np.array_equal(one.t, other.t)
        assert np.array_equal(one.host_s, other.host_s)
        assert np.array_equal(one.values["accel"], other.values["accel"])
        assert stepped.start_utc_ns == steady.start_utc_ns == WALL_NS
        assert stepped.duration_s == steady.duration_s
        assert stepped.missing("shoe") == steady.missing("shoe") == []
        ahead = stepped.clock_pairs.wall_ns - stepped.clock_pairs.host_ns
        assert np.ptp(ahead) == HOUR_NS
        assert np.ptp(steady.clock_pairs.wall_ns - steady.clock_pairs.host_ns) == 0


def test_a_running_recorder_does_not_mind_either(tmp_path):
    clock = SystemClock()
    start_ns = clock.now_ns()

    def wall_ns():
        return WALL_NS + (HOUR_NS if clock.now_ns() - start_ns > 300_000_000 else 0)

    path = tmp_path / "walk.imu-trial"
    with ServedDevices() as served:
        port = served.add("shoe", LAYOUT, 200.0)
        setup = TrialSetup.model_validate(
            {"devices": [{"name": "shoe", "port": port}], "duration_s": 0.5}
        )
        options = RecordingOptions(wall_ns=wall_ns, note_s=0.05)
        outcome = Recorder(setup, path, clock, options=options).run()
    trial = open_trial(path)
    assert np.ptp(trial.clock_pairs.wall_ns) == HOUR_NS
    assert outcome.reason == "complete"
    assert 0.5 <= outcome.recorded_s <= outcome.elapsed_s < 60.0
    assert np.allclose(np.diff(trial.samples("shoe").t), 0.005, atol=0.001)
    assert trial.gaps == trial.missing("shoe") == []
