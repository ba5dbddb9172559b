"""The golden trial of version 1 stays readable for ever, also by the reader in the description."""

import re
import runpy
from pathlib import Path

import numpy as np
from make_golden_trial import CONFIG, CREATED_NS, HOST_NS, LAYOUT, SAMPLES, golden_trial, packet
from one_stream import ImuStream

from firmware_protocols.layout import PacketLayout
from imu_rig.recording import open_trial
from imu_rig.units import STANDARD_GRAVITY

TESTS = Path(__file__).resolve().parent.parent
GOLDEN = TESTS / "data" / "golden-trial-v1.imu-trial"
DESCRIPTION = TESTS.parent / "docs" / "trial-file.md"


def test_the_golden_file_is_the_one_that_was_made():
    assert GOLDEN.read_bytes() == golden_trial()


def test_the_golden_file_holds_what_it_was_made_of():
    trial = open_trial(GOLDEN)
    assert not trial.damage
    assert trial.config == CONFIG
    assert trial.created_wall_ns == CREATED_NS
    assert trial.ended == "interrupted"
    assert trial.duration_s == 1.8
    assert [(s.id, s.name, s.kind) for s in trial.sources.values()] == [
        (1, "imu", "imu"),
        (2, "maestro", "servo"),
    ]
    [event] = trial.events
    assert (event.t, event.name) == (2e-6, "pose")
    assert event.fields == {"index": 3, "angles": [0, 90.5, -1e-3]}
    assert trial.wire("imu").data == b"".join(map(packet, range(SAMPLES)))
    assert trial.wire("maestro", "out").data == b"\x84\x00\x70\x2e"
    assert trial.wire("maestro").t.tolist() == [0.101]
    [gap] = trial.gaps
    assert (gap.t, gap.source, gap.fields["reason"]) == (1.51, 1, "unplugged")
    assert trial.clock_pairs.t.tolist() == [0.0, 1.8]
    assert trial.clock_pairs.host_ns[0] == HOST_NS
    assert trial.clock_pairs.wall_ns.tolist() == [CREATED_NS, CREATED_NS + 18]
    assert trial.statistics[0][1]["unwritten_records"] == 0
    assert 200 in trial.records.kind


def test_the_golden_samples_are_the_packets_in_si_units():
    block = open_trial(GOLDEN).imu("imu")
    number = np.arange(SAMPLES)
    assert block.counter.tolist() == number.tolist()
    g = STANDARD_GRAVITY
    expected = np.column_stack([0 * number, number * g / 4096, 0 * number + g])
    np.testing.assert_allclose(block.accel, expected, atol=1e-12)
    assert np.allclose(block.gyro[:, 1], np.radians(10.0))
    assert np.allclose(np.diff(block.t), 0.01, atol=1e-3)
    assert np.all(block.t <= block.host_s + 1e-9)


def test_a_recording_and_the_live_stream_decode_alike():
    trial = open_trial(GOLDEN)
    wire = trial.wire("imu")
    stream = ImuStream(PacketLayout.from_dict(LAYOUT))
    starts = [0, *wire.stops[:-1].tolist()]
    pieces = [
        (round(t * 1e9), wire.data[a:b])
        for t, a, b in zip(wire.t.tolist(), starts, wire.stops.tolist(), strict=True)
    ]
    live = stream.feed_many(pieces)
    recorded = trial.imu("imu")
    for name in ("accel", "gyro", "counter", "device_s", "host_s"):
        np.testing.assert_array_equal(getattr(live, name), getattr(recorded, name))


def test_the_reader_in_the_description_reads_the_golden_file(tmp_path):
    """What docs/trial-file.md shows is enough to read a trial without imu-rig."""
    code = re.search(r"```python\n(.*?)```", DESCRIPTION.read_text(encoding="utf-8"), re.DOTALL)
    shown = tmp_path / "shown.py"
    shown.write_text(code[1], encoding="utf-8")
    read_trial = runpy.run_path(str(shown))["read_trial"]
    trial = open_trial(GOLDEN)
    records = trial.records
    described = list(read_trial(GOLDEN.read_bytes()))
    assert len(described) == len(records)
    for row, (kind, source, sequence, time_ns, payload) in enumerate(described):
        offset, length = int(records.offset[row]), int(records.length[row])
        assert payload == GOLDEN.read_bytes()[offset : offset + length]
        assert (kind, source, sequence, time_ns) == (
            records.kind[row],
            records.source[row],
            records.sequence[row],
            records.time_ns[row],
        )
