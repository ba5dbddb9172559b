"""What is taken from a trial file to be played again, also from files that nobody would write."""

import numpy as np
import pytest

from imu_rig.clock import NS_PER_S, SteppedClock
from imu_rig.errors import InputError
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial
from imu_rig.recording import replay as replay_module
from imu_rig.recording.replay import RecordedWires, TimedChunk

FEW_NOTES = RecordingOptions(note_s=3600.0, sync_s=3600.0)
S = NS_PER_S


def written(path, pieces, descriptors=None, gaps=()):
    """Write a trial: pieces of (time [ns], source, direction, bytes)."""
    names = dict.fromkeys([*(descriptors or {}), *(name for _, name, _, _ in pieces)])
    clock = SteppedClock()
    with TrialWriter.create(path, {"kind": "trial"}, clock=clock, options=FEW_NOTES) as trial:
        numbers = {
            name: trial.add_source(name, "test", (descriptors or {}).get(name, {}))
            for name in names
        }
        for t_ns, name, direction, data in pieces:
            write = trial.bytes_in if direction == "in" else trial.bytes_out
            write(numbers[name], t_ns, data)
        for name, t_ns, fields in gaps:
            trial.gap(numbers[name], t_ns, **fields)
        clock.advance(1.0)
    return open_trial(path)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.imu-trial"


def test_pieces_come_in_the_order_of_time_with_the_end_last(path):
    pieces = [
        (0, "b", "in", b"1"),
        (5, "a", "in", b"3"),
        (3, "b", "in", b"2"),  # a recorder's threads hand in what they stamped before
        (7, "a", "in", b"4"),
    ]
    chunks = list(RecordedWires(written(path, pieces)))
    assert chunks[:-1] == [TimedChunk(*piece) for piece in sorted(pieces)]
    assert chunks[-1].what == "end"
    assert chunks[-1].t_ns == 1 * S


def test_it_can_be_iterated_again_and_by_parts(path):
    pieces = [(n, "ab"[n % 2], "in", bytes([n])) for n in range(200)]
    trial = written(path, pieces)
    wires = RecordedWires(trial, ["b"])
    assert [source.name for source in wires.sources] == ["b"]
    assert b"".join(chunk.data for chunk in wires) == bytes(range(1, 200, 2))
    assert list(wires) == list(wires)


def test_a_large_trial_is_read_in_windows(path, monkeypatch):
    monkeypatch.setattr(replay_module, "_BLOCK_ROWS", 7)
    monkeypatch.setattr(replay_module, "_BLOCK_BYTES", 3000)
    rng = np.random.default_rng(1)
    pieces = [(n, "a", "in", rng.bytes(int(rng.integers(0, 2000)))) for n in range(300)]
    chunks = list(RecordedWires(written(path, pieces)))
    assert [chunk.data for chunk in chunks[:-1]] == [data for *_, data in pieces]


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([0, S, 10**18, 2 * S, 3 * S], [0, S, 2 * S, 2 * S, 3 * S]),
        ([5 * S, 6 * S, 0, 7 * S], [5 * S, 6 * S, 6 * S, 7 * S]),
        ([-5, -(2**63), 2 * S], [0, 0, 2 * S]),
    ],
)
def test_times_that_no_recorder_writes_are_put_right_and_told(path, times, expected):
    pieces = [(t, "a", "in", bytes([n])) for n, t in enumerate(times)]
    wires = RecordedWires(written(path, pieces))
    chunks = list(wires)[:-1]
    assert [chunk.t_ns for chunk in chunks] == expected
    assert [chunk.data for chunk in chunks] == [data for *_, data in pieces]
    assert "go back" in wires.notes[0]


def test_a_silence_of_years_is_shortened_and_told(path):
    pieces = [(0, "a", "in", b"x"), (10**18, "a", "in", b"y"), (10**18 + S, "a", "in", b"z")]
    wires = RecordedWires(written(path, pieces), longest_silence_s=30.0)
    assert [chunk.t_ns for chunk in wires][:-1] == [0, 30 * S, 31 * S]
    assert wires.duration_ns <= 61 * S
    (note,) = wires.notes
    assert "2.78e+05 h" in note
    assert "30 s" in note


def test_two_hundred_and_fifty_five_sources_of_wild_times_end(path):
    rng = np.random.default_rng(2)
    pieces = [
        (int(rng.integers(-(2**62), 2**62)), f"s{n % 255}", "in", bytes([n % 256]))
        for n in range(1020)
    ]
    wires = RecordedWires(written(path, pieces))
    chunks = list(wires)
    assert len(wires.sources) == 255
    times = [chunk.t_ns for chunk in chunks]
    assert times == sorted(times)
    for name in ("s0", "s254"):
        sent = b"".join(data for _, source, _, data in pieces if source == name)
        assert b"".join(chunk.data for chunk in chunks if chunk.source == name) == sent


def test_what_answers_a_request_is_no_part_of_the_stream(path):
    pieces = [
        (0, "maestro", "in", b"stale"),
        (1 * S, "maestro", "out", b"ask"),
        (1 * S + 5, "maestro", "in", b"re"),
        (1 * S + 9, "maestro", "in", b"ply"),
        (2 * S, "maestro", "out", b"command"),
        (3 * S, "maestro", "out", b"ask"),
        (5 * S, "maestro", "in", b"late"),
    ]
    wires = RecordedWires(written(path, pieces))
    assert wires.answering == ("maestro",)
    assert list(wires.exchanges("maestro")) == [
        (1 * S, b"ask", ((5, b"re"), (9, b"ply"))),
        (2 * S, b"command", ()),
        (3 * S, b"ask", ()),
    ]
    streamed = [(chunk.t_ns, chunk.data) for chunk in wires if chunk.what == "in"]
    assert streamed == [(0, b"stale"), (5 * S, b"late")]


def test_a_sensor_that_was_configured_still_streams(path):
    pieces = [(0, "imu", "out", b"rate 100"), (5, "imu", "in", b"packet")]
    wires = RecordedWires(written(path, pieces, {"imu": {"layout": {"name": "any"}}}))
    assert wires.answering == ()
    assert [chunk.what for chunk in wires] == ["out", "in", "end"]


def test_the_port_vanishes_and_returns_as_the_last_record_of_a_gap_says(path):
    pieces = [(0, "a", "in", b"x"), (8 * S, "a", "in", b"y")]
    gaps = [
        ("a", 1 * S, {"reason": "unplugged"}),
        ("a", 1 * S, {"reason": "unplugged", "until_s": 7.5}),
        ("a", 3 * S, {"reason": "silent"}),
    ]
    wires = RecordedWires(written(path, pieces, gaps=gaps))
    assert [(chunk.t_ns, chunk.what) for chunk in wires] == [
        (0, "in"),
        (1 * S, "unplug"),
        (round(7.5 * S), "plug"),
        (8 * S, "in"),
        (8 * S, "end"),
    ]


def test_a_gap_without_an_end_lasts_until_the_next_bytes_or_for_ever(path):
    pieces = [(0, "a", "in", b"x"), (8 * S, "a", "in", b"y")]
    gaps = [("a", t_s * S, {"reason": "unplugged", "until_s": "soon"}) for t_s in (1, 9)]
    wires = RecordedWires(written(path, pieces, gaps=gaps))
    events = [(chunk.t_ns, chunk.what) for chunk in wires if chunk.what not in ("in", "end")]
    assert events == [(1 * S, "unplug"), (8 * S, "plug"), (9 * S, "unplug")]


def test_a_source_that_said_nothing_gets_a_port_and_silence(path):
    wires = RecordedWires(written(path, [(0, "a", "in", b"x")], {"mute": {}}))
    assert [source.name for source in wires.sources] == ["mute", "a"]
    assert wires.answering == ()


def test_nothing_to_replay_is_said_in_one_sentence(path, tmp_path):
    with pytest.raises(InputError, match="no sources"):
        RecordedWires(written(path, []))
    trial = written(tmp_path / "b.imu-trial", [(0, "a", "in", b"x")], {"mute": {}})
    with pytest.raises(InputError, match="chosen sources sent nothing"):
        RecordedWires(trial, ["mute"])
    with pytest.raises(InputError, match="no source 'other'; it has"):
        RecordedWires(trial, ["other"])


def test_damage_costs_what_it_hit_and_a_trial_under_way_is_played_so_far(path):
    pieces = [(n, "a", "in", bytes([n]) * 40) for n in range(100)]
    trial = written(path, pieces)
    file = bytearray(path.read_bytes())
    file[int(trial.records.offset[trial.records.kind == 3][50]) + 3] ^= 0xFF
    path.write_bytes(file[: int(trial.records.offset[trial.records.kind == 3][90])])
    damaged = open_trial(path)
    assert damaged.ended is None
    kept = [chunk.data[0] for chunk in RecordedWires(damaged) if chunk.data]
    assert kept == [n for n in range(90) if n != 50]


def test_a_file_that_shrinks_meanwhile_is_an_error_in_one_sentence(path):
    wires = RecordedWires(written(path, [(0, "a", "in", bytes(5000))]))
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match="became shorter"):
        list(wires)
