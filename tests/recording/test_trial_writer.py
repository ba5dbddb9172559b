"""What the recorder promises while all is well: times, sources, order, names, no overwriting."""

import math
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from rows_of_trials import CONFIG, DESCRIPTOR, FEW_NOTES, SOURCE, numbers, row, write_trial

from imu_rig.clock import SteppedClock, SystemClock
from imu_rig.errors import InputError
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial
from imu_rig.recording.format import MAX_PAYLOAD
from imu_rig.recording.latency import Latency, LatencyCounts

HERE = Path(__file__).parent
HOUR_NS = 3_600_000_000_000


@pytest.fixture
def path(tmp_path):
    return tmp_path / "trial.imu-trial"


@pytest.fixture
def clock():
    return SteppedClock(5_000_000_000)


def create(path, clock, **options):
    return TrialWriter.create(
        path, CONFIG, clock=clock, options=RecordingOptions(note_s=3600.0, **options)
    )


def test_everything_written_is_read_back(path, clock):
    with create(path, clock) as trial:
        first = trial.add_source("imu", "imu", {"layout": {"a": [1, 2.5, None, True]}})
        second = trial.add_source("maestro", "servo", {"url": "/dev/ttyACM0"})
        trial.bytes_in(first, 5_000_000_000, b"abc")
        clock.advance(0.5)
        trial.bytes_out(second, clock.now_ns(), b"\x84\x00")
        trial.bytes_in(second, clock.now_ns(), memoryview(b"xy"))
        trial.event("pose", name="level", angles=np.array([1.5, 2.0]), n=np.int64(3), ok=True)
        clock.advance(0.5)
        trial.bytes_in(first, clock.now_ns(), bytearray(b"defg"))
        trial.gap(first, clock.now_ns(), "unplugged", until_s=2.0)
        assert trial.t_s(clock.now_ns()) == 1.0
    found = open_trial(path)
    assert found.config == CONFIG
    assert [(s.id, s.name, s.kind, s.descriptor) for s in found.sources.values()] == [
        (1, "imu", "imu", {"layout": {"a": [1, 2.5, None, True]}}),
        (2, "maestro", "servo", {"url": "/dev/ttyACM0"}),
    ]
    wire = found.wire("imu")
    assert (wire.data, wire.t.tolist(), wire.stops.tolist()) == (b"abcdefg", [0.0, 1.0], [3, 7])
    assert not wire.breaks.any()
    assert found.wire("imu", "out").data == b""
    assert found.wire("maestro", "out").data == b"\x84\x00"
    assert found.wire("maestro").t.tolist() == [0.5]
    [event] = found.events
    assert (event.t, event.name) == (0.5, "pose")
    assert event.fields == {"name": "level", "angles": [1.5, 2.0], "n": 3, "ok": True}
    [gap] = found.gaps
    assert (gap.t, gap.source, gap.fields) == (1.0, 1, {"reason": "unplugged", "until_s": 2.0})
    assert found.ended == "complete"
    assert found.duration_s == 1.0
    assert not found.damage
    assert len(found.sha256) == 64


def test_the_end_counts_what_was_written(path, clock):
    content = write_trial(path, 30)
    trial = open_trial(path)
    [(_, end)] = trial._objects(9)
    assert end["sources"] == {
        SOURCE: {"records_in": 30, "bytes_in": sum(len(row(n)) for n in range(30))}
    }
    assert end["unwritten_records"] == 0
    assert end["records"] <= len(trial.records)
    assert end["bytes"] < len(content)


def test_acknowledged_is_what_another_reader_sees_at_once(path, clock):
    with create(path, clock) as trial:
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        for number in range(20):
            trial.bytes_in(source, 5_000_000_000 + number * 10_000_000, row(number))
            assert trial.flush()
            seen = open_trial(path)
            assert len(seen.records) == trial.written_records
            assert path.stat().st_size == trial.acknowledged_bytes
            assert numbers(seen) == list(range(number + 1))
            assert seen.ended is None
            assert not seen.damage


def test_a_taken_name_is_never_overwritten(path, clock):
    path.write_bytes(b"precious")
    with pytest.raises(InputError, match="exists already") as caught:
        create(path, clock)
    assert str(path) in str(caught.value)
    assert path.read_bytes() == b"precious"


@pytest.mark.parametrize(
    "name", ["Größe 1.imu-trial", "a b'\"\n;$.imu-trial", "-rf", os.fsdecode(b"\xff.imu-trial")]
)
def test_odd_names_are_names(tmp_path, clock, name):
    path = tmp_path / name
    config = {"file": str(path)}
    with TrialWriter.create(path, config, clock=clock, options=FEW_NOTES) as trial:
        trial.event("note", text=name)
    found = open_trial(path)
    assert found.config == config
    assert found.events[0].fields == {"text": name}


def test_a_missing_folder_is_told(tmp_path, clock):
    with pytest.raises(InputError, match=r"the folder .* does not exist"):
        create(tmp_path / "no" / "where.imu-trial", clock)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may do all")
def test_a_forbidden_folder_is_told(tmp_path, clock):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match="cannot be created"):
            create(tmp_path / "x.imu-trial", clock)
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, 1 << 64, object(), {1, 2}, "x" * (MAX_PAYLOAD + 1)]
)
def test_what_is_not_json_is_refused_where_it_is_handed_in(path, clock, value):
    with pytest.raises(InputError, match="configuration"):
        TrialWriter.create(path, {"bad": value}, clock=clock)
    assert not path.exists()
    with create(path, clock) as trial:
        with pytest.raises(InputError, match="'bad event'"):
            trial.event("bad event", value=value)
        with pytest.raises(InputError, match="'bad source'"):
            trial.add_source("bad source", "imu", {"value": value})
    assert open_trial(path).events == []


def test_source_names_are_unique_and_their_number_is_limited(path, clock):
    with create(path, clock) as trial:
        assert [trial.add_source(f"s{n}", "imu", {}) for n in range(255)] == list(range(1, 256))
        with pytest.raises(InputError, match="'s3' already"):
            trial.add_source("s3", "imu", {})
        with pytest.raises(InputError, match="255 sources"):
            trial.add_source("one more", "imu", {})
    assert len(open_trial(path).sources) == 255


def test_what_is_larger_than_a_record_is_split(path, clock):
    data = os.urandom(2 * MAX_PAYLOAD + 5)
    with create(path, clock) as trial:
        trial.bytes_in(trial.add_source("camera", "port", {}), 5_000_000_000, data)
    wire = open_trial(path).wire("camera")
    assert wire.data == data
    assert np.diff(wire.stops, prepend=0).tolist() == [MAX_PAYLOAD, MAX_PAYLOAD, 5]


def test_threads_may_write_together(path, clock):
    with create(path, clock) as trial:
        sources = [trial.add_source(f"s{n}", "test", {}) for n in range(4)]

        def write(source):
            for number in range(500):
                trial.bytes_in(source, number, bytes([source]) + number.to_bytes(2, "big"))

        threads = [threading.Thread(target=write, args=(source,)) for source in sources]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found = open_trial(path)
    for source in sources:
        expected = b"".join(bytes([source]) + n.to_bytes(2, "big") for n in range(500))
        assert found.wire(f"s{source - 1}").data == expected
    assert not found.damage


def test_closing_again_and_writing_after_closing_do_nothing(path, clock):
    trial = create(path, clock)
    trial.close("stopped by hand")
    content = path.read_bytes()
    trial.close()
    trial.event("late")
    trial.bytes_in(1, 0, b"late")
    assert trial.flush(0.01) is False
    assert path.read_bytes() == content
    assert open_trial(path).ended == "stopped by hand"


@pytest.mark.parametrize(
    ("raised", "ended"),
    [
        (ValueError("no such pose"), "failed: no such pose"),
        (ValueError(), "failed: ValueError"),
        (ValueError(os.fsdecode(b"\xff")), "failed: \udcff"),
        (KeyboardInterrupt(), "interrupted"),
    ],
)
def test_an_exception_is_the_reason_of_the_end(path, clock, raised, ended):
    with pytest.raises(type(raised)), create(path, clock):
        raise raised
    assert open_trial(path).ended == ended


def test_a_wall_clock_that_is_set_changes_nothing_but_the_pairs(path, clock):
    wall = iter([0, 0, HOUR_NS, -HOUR_NS, 0] + 1000 * [0])
    options = RecordingOptions(note_s=0.001, wall_ns=lambda: next(wall))
    with TrialWriter.create(path, CONFIG, clock=clock, options=options) as trial:
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        for number in range(100):
            trial.bytes_in(source, 5_000_000_000 + number * 10_000_000, row(number))
            clock.advance(0.01)
            trial.flush()
        while trial.written_records < 120:
            trial.flush()
    found = open_trial(path)
    assert numbers(found) == list(range(100))
    pairs = found.clock_pairs
    assert pairs.wall_ns[:4].tolist() == [0, HOUR_NS, -HOUR_NS, 0]
    assert np.array_equal(pairs.host_ns - 5_000_000_000, np.round(pairs.t * 1e9))
    assert found.duration_s == 1.0
    assert found.statistics[0][1]["unwritten_records"] == 0


def test_devices_have_statistics_beside_those_of_the_recorder(path, clock):
    with create(path, clock) as trial:
        left = trial.add_source("left", "imu", {})
        right = trial.add_source("right", "imu", {})
        clock.advance(1.0)
        trial.device_statistics(left, {"state": "live", "packets": np.int64(100)})
        trial.device_statistics(right, {"state": "silent", "packets": 0})
        with pytest.raises(InputError, match="statistics"):
            trial.device_statistics(right, {"rate_hz": math.nan})
    found = open_trial(path)
    assert found.device_statistics("left") == [(1.0, {"state": "live", "packets": 100})]
    assert found.device_statistics("right") == [(1.0, {"state": "silent", "packets": 0})]
    assert found.statistics == []


def test_a_gap_is_told_more_of_by_recording_it_again(path, clock):
    with create(path, clock) as trial:
        source = trial.add_source("imu", "imu", {})
        lost_ns = clock.now_ns()
        trial.gap(source, lost_ns, "unplugged", counter_before=7)
        clock.advance(2.0)
        trial.gap(source, lost_ns, "unplugged", until_s=2.0, counter_before=7, counter_after=90)
    [gap] = open_trial(path).gaps
    fields = {"reason": "unplugged", "until_s": 2.0, "counter_before": 7, "counter_after": 90}
    assert (gap.t, gap.fields) == (0.0, fields)


def test_the_latency_is_the_time_from_arrival_to_the_file(path):
    clock = SteppedClock(5_000_000_000)
    options = RecordingOptions(note_s=3600.0, join_s=3600.0)
    with TrialWriter.create(path, CONFIG, clock=clock, options=options) as trial:
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        assert trial.flush()
        assert trial.latency().records == 0
        now_ns = clock.now_ns()
        for waited_ms in [*99 * [2], 30]:
            trial.bytes_in(source, now_ns - waited_ms * 1_000_000, b"x")
        trial.bytes_out(source, 0, b"what is sent does not arrive")
        assert trial.flush()
        latency = trial.latency()
    assert latency.records == 100
    assert 0.002 <= latency.p50_s <= 0.00225
    assert 0.002 <= latency.p99_s <= 0.00225
    assert latency.max_s == 0.03


def test_latencies_beyond_all_bounds_are_counted():
    counts = LatencyCounts()
    counts.add([-5, 0, 10**18])
    assert counts.summary().max_s == 1e9
    assert counts.summary().p99_s == 1e9
    assert counts.take_latest().records == 3
    assert counts.take_latest() == Latency()
    counts.add([1_000_000])
    assert counts.take_latest() == Latency(1, 0.001, 0.001, 0.001)
    assert counts.summary().records == 4


def test_a_record_alone_is_written_at_once_and_others_wait_for_each_other(path):
    clock = SystemClock()
    options = RecordingOptions(note_s=3600.0, join_s=3600.0, queue_bytes=1 << 20)
    with TrialWriter.create(path, CONFIG, clock=clock, options=options) as trial:
        source = trial.add_source(SOURCE, "test", DESCRIPTOR)
        assert trial.flush()
        before = trial.written_records
        trial.bytes_in(source, clock.now_ns(), b"waits for others after the write before")
        assert trial.written_records == before
        trial.bytes_in(source, clock.now_ns(), bytes(1 << 16))  # as much as is written at once
        deadline = clock.now_ns() + 10 * 1_000_000_000
        while trial.written_records < before + 2:
            assert clock.now_ns() < deadline


def test_two_recorders_cannot_write_one_file(path, clock):
    with create(path, clock), pytest.raises(InputError, match="written by another program"):
        TrialWriter.append(path, clock=clock)
    assert open_trial(path).ended == "complete"


def test_the_name_of_the_marker_of_continued_trials_is_kept(path, clock):
    with create(path, clock) as trial, pytest.raises(InputError, match="use another"):
        trial.event("resumed")


def test_statistics_tell_how_the_recorder_is_doing(path):
    options = RecordingOptions(note_s=0.001)
    with TrialWriter.create(path, CONFIG, clock=SystemClock(), options=options) as trial:
        while trial.written_records < 20:
            trial.flush()
    statistics = [value for _, value in open_trial(path).statistics]
    assert all(value["disk_free_bytes"] > 0 for value in statistics)
    assert all(value["latency_p99_s"] is None for value in statistics)  # nothing arrived
    counts = [value["records"] for value in statistics]
    assert counts == sorted(counts)


def test_killed_recorders_lose_nothing_acknowledged():
    """IMU_RIG_KILLS sets how often; see kill_harness.py for the figures."""
    ran = subprocess.run(
        [sys.executable, str(HERE / "kill_harness.py")], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert '"bad": 0' in ran.stdout
