"""Power cuts, flipped bits and torn tails: a prefix or all but one record survive, none wrong.

``IMU_RIG_CUT_BYTES=65536 IMU_RIG_FLIPS=20000`` makes these tests as thorough as one has patience.
"""

import contextlib
import itertools
import json
import math
import os
import random
import struct
import zlib
from pathlib import Path

import pytest
from damage_harness import damage, parser, problems_of
from hypothesis import given
from hypothesis import strategies as st
from make_golden_trial import LAYOUT, packet
from one_record import encode_record
from rows_of_trials import CONFIG, DESCRIPTOR, SOURCE, numbers, write_trial

from imu_rig.errors import InputError
from imu_rig.recording import open_trial
from imu_rig.recording.format import HEADER_SIZE, MAGIC, FileHeader
from imu_rig.recording.repair import repair_trial

PAGE = 4096
CUT_BYTES = int(os.environ.get("IMU_RIG_CUT_BYTES", "1000"))
FLIPS = int(os.environ.get("IMU_RIG_FLIPS", "300"))
ROWS = 200 + max(0, CUT_BYTES - PAGE) // 50


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A sound trial file and its bytes."""
    path = tmp_path_factory.mktemp("sound") / "sound.imu-trial"
    return path, write_trial(path, ROWS)


@pytest.fixture
def changed(tmp_path):
    """Write changed bytes and open them."""
    path = tmp_path / "changed.imu-trial"

    def opened(content):
        path.write_bytes(content)
        return open_trial(path)

    return opened


def test_a_sound_file_has_no_damage(sound):
    trial = open_trial(sound[0])
    assert numbers(trial) == list(range(ROWS))
    assert not trial.damage
    assert str(trial.damage) == "none"


def test_flipped_bits_cost_one_record_at_most_and_alter_none(sound, changed):
    path, content = sound
    total = len(open_trial(path).records)
    chosen = random.Random(7)
    start = 600  # header, configuration and source: small, and needed to read all the rest
    early = [chosen.randrange(8 * start) for _ in range(FLIPS // 4)]
    for place in early + [chosen.randrange(8 * len(content)) for _ in range(FLIPS - len(early))]:
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        trial = changed(flipped)
        assert len(trial.records) >= total - 1
        assert ROWS - len(numbers(trial)) <= 1
        assert trial.damage, f"bit {place} went unnoticed"
        assert trial.config == CONFIG
        assert trial.sources[SOURCE].descriptor == DESCRIPTOR


def test_a_file_cut_anywhere_keeps_what_stands_before(sound, changed):
    path, content = sound
    whole = open_trial(path).records
    wire = whole.kind == 3
    for size in range(len(content) - CUT_BYTES, len(content)):
        trial = changed(content[:size])
        kept = int((whole.end <= size).sum())
        assert trial.records.offset.tolist() == whole.offset[:kept].tolist()
        assert trial.records.sequence.tolist() == list(range(kept))
        if size % 16 == 0:
            assert numbers(trial) == list(range(int((whole.end[wire] <= size).sum())))
            assert trial.ended is None
        assert trial.damage.tail_bytes == size - int(whole.end[kept - 1])


def test_a_tail_of_zeros_keeps_what_stands_before(sound, changed):
    path, content = sound
    whole = open_trial(path).records
    for zeros in range(1, PAGE, 37):
        trial = changed(content[:-zeros] + bytes(zeros))
        assert len(trial.records) == int((whole.end <= len(content) - zeros).sum())
        assert numbers(trial) == list(range(len(numbers(trial))))


def test_reordered_and_stale_pages_keep_the_prefix_and_alter_nothing(sound, changed):
    path, content = sound
    whole = open_trial(path).records
    chosen = random.Random(8)
    first_page = len(content) // PAGE - 2
    prefix = int((whole.end <= first_page * PAGE).sum())
    for _ in range(100):
        pages = [content[start : start + PAGE] for start in range(0, len(content), PAGE)]
        tail = pages[first_page:]
        if chosen.random() < 0.5:
            chosen.shuffle(tail)
        else:
            tail = [chosen.choice(pages) for _ in tail]
        trial = changed(b"".join(pages[:first_page] + tail))
        assert trial.records.sequence[:prefix].tolist() == list(range(prefix))
        found = numbers(trial)
        assert found == sorted(set(found))


def test_losing_the_middle_is_told_by_breaks(sound, changed):
    content = sound[1]
    middle = len(content) // 2
    trial = changed(content[:middle] + bytes(300) + content[middle + 300 :])
    found = numbers(trial)
    steps = [b - a for a, b in itertools.pairwise(found)]
    assert sum(step > 1 for step in steps) == 1
    breaks = trial.wire(SOURCE).breaks
    assert breaks.sum() == 1
    assert breaks[steps.index(max(steps)) + 1]
    assert trial.damage.records_lost == ROWS - len(found)
    assert trial.damage.bytes_skipped >= 300


def test_no_damage_alters_a_decoded_row(tmp_path):
    """The figures of damage_harness.py, in short."""
    short = "--seconds 2 --flips 40 --cut-bytes 8000 --cut-step 211 --zero-step 1201 --mixes 12"
    for what, figures in damage(tmp_path, parser().parse_args(short.split())).items():
        assert figures.rows > 500, what
        assert figures.wrong_rows == 0, what
        assert problems_of(figures) == []


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (bytes(10_000), "begins with zeros"),
        (b"t,ax,ay,az\n0.0,1,2,3\n" * 10, "is not a trial file"),
        (MAGIC, "both copies of the header are damaged"),
    ],
)
def test_files_that_are_no_trials_are_refused_by_name(changed, tmp_path, content, said):
    with pytest.raises(InputError, match=said) as caught:
        changed(content)
    assert str(tmp_path / "changed.imu-trial") in str(caught.value)


def test_a_newer_version_is_refused(sound, changed):
    fields = bytearray(sound[1][:28])
    fields[8:10] = struct.pack("<H", 2)
    header = bytes(fields) + struct.pack("<I", zlib.crc32(fields))
    with pytest.raises(InputError, match=r"version 2 .* install a newer imu-rig"):
        changed(2 * header + sound[1][HEADER_SIZE:])


def test_one_header_copy_is_enough_and_the_records_do_without(sound, changed):
    content = bytearray(sound[1])
    content[:32] = bytes(32)
    trial = changed(content)
    assert numbers(trial) == list(range(ROWS))
    assert trial.damage.header_damaged
    content[40] ^= 1
    trial = changed(content)
    assert numbers(trial) == list(range(ROWS))  # the records tell from what they start
    assert trial.damage.header_damaged


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path: None, "there is no such file"),
        (Path.mkdir, "it is a folder"),
        (os.mkfifo, "it is a pipe or a device"),
        (lambda path: path.symlink_to("/dev/zero"), "it is a pipe or a device"),
        (lambda path: path.symlink_to(path), "symbolic links"),
    ],
)
def test_what_is_no_file_is_refused_by_name_and_not_waited_for(tmp_path, make, said):
    path = tmp_path / "walk.imu-trial"
    make(path)
    with pytest.raises(InputError, match=f"cannot be read .*{said}") as caught:
        open_trial(path)
    assert str(path) in str(caught.value)


def test_a_name_that_no_file_has_is_refused():
    with pytest.raises(InputError, match="cannot be read"):
        open_trial("a\0b")


def test_what_is_added_while_a_file_is_read_is_left_for_the_next_reader(sound, changed, tmp_path):
    content = sound[1]
    trial = changed(content[:-5000])
    before = len(trial.records)
    with (tmp_path / "changed.imu-trial").open("ab") as file:
        file.write(content[-5000:])
    assert len(trial.records) == before
    assert numbers(trial) == list(range(len(numbers(trial))))
    assert len(open_trial(trial.path).records) == len(open_trial(sound[0]).records)


ABSURD_NS = (-(2**63), -1, 0, 2**62, 2**63 - 1)


@pytest.mark.parametrize("order", list(itertools.permutations(ABSURD_NS, 3)))
def test_absurd_times_and_sources_are_read_or_refused_in_one_sentence(tmp_path, order):
    path = tmp_path / "absurd.imu-trial"
    header = FileHeader(b"file id.", -(2**63))
    description = json.dumps({"name": "imu", "kind": "imu", "descriptor": {"layout": LAYOUT}})
    gap = json.dumps({"reason": "unplugged", "until_s": 1e300, "counter_before": -(2**63)})
    drafted = [(2, 255, 0, description.encode()), (2, 255, 2**63 - 1, description.encode())]
    for number, time_ns in enumerate(order):
        drafted += [
            (3, 255, time_ns, packet(2 * number) + packet(2 * number + 1)),
            (6, 255, time_ns, gap.encode()),
            (7, 0, time_ns, struct.pack("<qq", time_ns, -time_ns - 1)),
            (8, 255, time_ns, b'{"packets": 18446744073709551615}'),
        ]
    content = [header.encode()]
    for sequence, record in enumerate(drafted):
        content.append(encode_record(header.seed, *record[:2], sequence, *record[2:]))
    path.write_bytes(b"".join(content))
    trial = open_trial(path)
    assert math.isfinite(trial.duration_s)
    assert len(trial.device_statistics("imu")) == 3
    start = trial.start_utc_ns  # the pairs state ends of time, but for one of the permutations
    assert start is None or 0 <= start < 1 << 62
    assert (start is None) == (trial.utc(trial.duration_s) is None)
    for read in (trial.imu, trial.samples, trial.missing, trial.wire):
        with contextlib.suppress(InputError):
            read("imu")
    outcome = repair_trial(path)
    assert outcome.records == len(drafted)


HOSTILE_JSON = [
    b"[" * 500_000,
    b'{"a":' * 150_000,
    b'{"reason": 1e400}',
    b'{"reason": ' + b"9" * 5000 + b"}",
    b'{"reason": 18446744073709551616}',
    b'{"reason": NaN}',
    b'{"reason": "\xff"}',
]


@pytest.mark.parametrize("payload", HOSTILE_JSON)
def test_json_that_no_recorder_writes_is_left_out(tmp_path, payload):
    path = tmp_path / "hostile.imu-trial"
    header = FileHeader(b"file id.", 0)
    records = [encode_record(header.seed, kind, 1, kind, 0, payload) for kind in range(1, 10)]
    path.write_bytes(header.encode() + b"".join(records))
    trial = open_trial(path)
    assert len(trial.records) == 9
    assert (trial.config, trial.events, trial.gaps, trial.statistics) == ({}, [], [], [])
    assert trial.ended is None
    assert list(trial.sources) == ["source-1"]


def test_a_file_that_shrinks_while_it_is_read_is_told_so(sound, changed, tmp_path):
    trial = changed(sound[1])
    assert len(trial.records)
    (tmp_path / "changed.imu-trial").write_bytes(sound[1][:200])
    with pytest.raises(InputError, match="became shorter"):
        trial.wire(SOURCE)


@given(st.binary(max_size=300))
def test_whatever_follows_a_header_can_be_read(tmp_path_factory, content):
    path: Path = tmp_path_factory.getbasetemp() / "any.imu-trial"
    path.write_bytes(FileHeader(b"file id.", 0).encode() + content)
    trial = open_trial(path)
    assert (trial.config, trial.events, trial.sources, trial.ended) == ({}, [], {}, None)
    assert trial.damage.tail_bytes == len(content)
    path.unlink()


@given(st.binary(max_size=300))
def test_bytes_without_a_header_are_refused(tmp_path_factory, content):
    path: Path = tmp_path_factory.getbasetemp() / "foreign.imu-trial"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        open_trial(path)
    assert str(path) in str(caught.value)
    path.unlink()


json_keys = st.sampled_from(["name", "kind", "descriptor", "fields", "reason", "layout"])
foreign_values = st.recursive(
    st.none() | st.integers() | st.text(max_size=3) | st.just("resumed"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(json_keys, inner, max_size=3),
    max_leaves=6,
)


@given(st.lists(st.tuples(st.integers(1, 9), st.integers(0, 3), foreign_values | st.binary())))
def test_records_of_another_program_never_break_the_reader(tmp_path_factory, drafted):
    path: Path = tmp_path_factory.getbasetemp() / "other.imu-trial"
    header = FileHeader(b"file id.", 0)
    content = [header.encode()]
    for sequence, (kind, source, value) in enumerate(drafted):
        payload = value if isinstance(value, bytes) else json.dumps(value).encode()
        content.append(encode_record(header.seed, kind, source, sequence, 0, payload))
    path.write_bytes(b"".join(content))
    trial = open_trial(path)
    assert len(trial.records) == len(drafted)
    assert isinstance(trial.config, dict)
    assert isinstance(trial.ended, str | None)
    assert all(isinstance(event.name, str) for event in trial.events)
    for name in trial.sources:
        assert trial.source(name).name == name
        trial.wire(name, "in")
        trial.wire(name, "out")
        with pytest.raises(InputError):
            trial.imu(name)
    assert len(trial.gaps) + len(trial.statistics) + len(trial.clock_pairs.t) <= len(drafted)
    path.unlink()
