"""Sensors' samples out of trials: every one, only those, at their times, and what is missing."""

import json
import math
import re
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_record import encode_record
from one_stream import PacketStream
from rows_of_trials import FEW_NOTES

import imu_rig
from firmware_protocols.known import load_protocol
from firmware_protocols.layout import load_layout
from firmware_protocols.packets import encode
from imu_rig.calibration.certificate import load_certificate
from imu_rig.clock import SteppedClock
from imu_rig.errors import DataError, InputError
from imu_rig.recording import TrialWriter
from imu_rig.recording.format import HEADER_SIZE, Kind, decode_file_header
from imu_rig.timing import alignment_sigma_s

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "docs" / "reading-trials.md"
CERTIFICATE = ROOT / "tests" / "data" / "certificate-v1.json"

MPU = load_layout("mpu9150-28")
BARE = replace(MPU, name="bare", checksum=None)  # nothing proves that a packet is whole
BARO = load_layout("baro-16")
UNNUMBERED = replace(BARE, name="unnumbered", counter=None, clock=None)

FINE = {"deadline": None, "max_examples": 30}


def counts(layout, number, rate_hz=100.0, seed=0):
    """What a device counts, field by field."""
    rng = np.random.default_rng(seed)
    columns = {}
    for field in layout.fields:
        if field.name == layout.counter:
            columns[field.name] = np.arange(number) % (1 << field.bits)
        elif field.name == layout.clock:
            ticks = np.arange(number) / (rate_hz * layout.clock_tick_s)
            columns[field.name] = np.rint(ticks).astype(np.int64) % (1 << field.bits)
        else:
            low, high = field.limits
            shape = (number, field.count) if field.count > 1 else number
            columns[field.name] = rng.integers(low, high, shape, endpoint=True)
    return columns


def packets(layout, columns):
    data = encode(layout, columns)
    edges = range(0, len(data) + 1, layout.length)
    return [data[a:b] for a, b in pairwise(edges)]


class Desk:
    """Writes a trial record by record, at trial times of its own."""

    def __init__(self, path, **sources):
        self.path = path
        self.writer = TrialWriter.create(path, {}, clock=SteppedClock(), options=FEW_NOTES)
        self.numbers = {
            name: self.writer.add_source(name, "imu", {"layout": layout.to_dict()})
            for name, layout in sources.items()
        }

    def send(self, name, t, data):
        self.writer.bytes_in(self.numbers[name], round(t * 1e9), data)

    def gap(self, name, t, reason, **fields):
        self.writer.gap(self.numbers[name], round(t * 1e9), reason, **fields)

    def trial(self):
        self.writer.close()
        return imu_rig.open_trial(self.path)


@pytest.fixture
def desk(tmp_path):
    desks = []

    def make(**sources):
        desks.append(Desk(tmp_path / f"{len(desks)}.imu-trial", **sources))
        return desks[-1]

    yield make
    for made in desks:
        made.writer.close()


def sent_times(number, rate_hz=100.0):
    return (np.arange(number) / rate_hz + 0.002).tolist()


# --- what was sent is what is read ---------------------------------------------------------------


@settings(**FINE)
@given(st.integers(2, 60), st.sampled_from([MPU, BARE, BARO]), st.integers(1, 90), st.integers(0))
def test_arrays_come_back_however_the_bytes_were_cut_into_records(
    tmp_path_factory, number, layout, longest, seed
):
    random = Random(seed)
    sent = {name: counts(layout, number, seed=seed) for seed, name in enumerate("ab")}
    streams = {name: encode(layout, columns) for name, columns in sent.items()}
    path = tmp_path_factory.mktemp("trial") / "t.imu-trial"
    desk = Desk(path, a=layout, b=layout)
    place = dict.fromkeys(streams, 0)
    t = 0.0
    while any(place[name] < len(stream) for name, stream in streams.items()):
        name = random.choice("ab")
        piece = streams[name][place[name] : place[name] + random.randint(1, longest)]
        t += 0.01 * len(piece) / layout.length
        place[name] += len(piece)
        desk.send(name, t, piece)
    trial = desk.trial()
    for name, columns in sent.items():
        samples = trial.samples(name)
        assert len(samples) == number
        assert np.all(np.diff(samples.t) > 0)
        assert np.array_equal(samples.counter, np.arange(number))
        assert trial.missing(name) == []
        for field in layout.fields:
            if field.name in (layout.counter, layout.clock) or field.axes is not None:
                continue
            unit = (columns[field.name] - field.zero) / field.counts_per_unit
            factor = {"g": 9.80665, "deg/s": math.pi / 180}.get(field.unit, 1.0)
            assert samples.values[field.name] == pytest.approx(unit * factor, rel=1e-12)


def test_units_are_those_of_the_values(desk):
    made = desk(shoe=MPU, air=BARO)
    made.send("shoe", 0.1, packets(MPU, counts(MPU, 1))[0])
    made.send("air", 0.1, packets(BARO, counts(BARO, 1))[0])
    trial = made.trial()
    assert trial.samples("shoe").units == {
        "status": "",
        "accel": "m/s2",
        "gyro": "rad/s",
        "mag": "uT",
    }
    units = trial.samples("air").units
    assert units["pressure"] == BARO.field("pressure").unit
    assert units["temperature"] == "degC"
    assert trial.sensors == ["shoe", "air"]


def test_two_devices_are_aligned_within_what_is_stated(desk):
    """Crystals 80 ppm apart, delays of up to 30 ms: rows made at one moment have one time."""
    made, rng = desk(left=MPU, right=MPU), np.random.default_rng(5)
    arrivals = []
    for name, skew, started in (("left", 40e-6, 3.0), ("right", -40e-6, 900.0)):
        columns = counts(MPU, 6000)
        true_s = np.arange(6000) / 100.0
        ticks = np.rint(1e6 * (started + true_s * (1 + skew))).astype(np.int64)
        data = packets(MPU, {**columns, "time": ticks})
        arrival = np.maximum.accumulate(true_s + rng.uniform(0.0, 0.03, 6000))
        arrivals += zip(arrival.tolist(), [name] * 6000, data, strict=True)
    for t, name, data in sorted(arrivals):
        made.send(name, t, data)
    trial = made.trial()
    left, right = trial.imu("left"), trial.imu("right")
    sigma_s = alignment_sigma_s(*map(trial.time_uncertainty_s, ("left", "right")))
    assert sigma_s < 0.002
    assert np.sqrt(np.mean((left.t - right.t) ** 2)) < 3 * sigma_s
    assert np.sqrt(np.mean((left.t - np.arange(6000) / 100.0) ** 2)) < 0.002


# --- what is missing -----------------------------------------------------------------------------


@settings(**FINE)
@given(st.sets(st.integers(0, 99)), st.sampled_from([MPU, replace(MPU, counter=None)]))
def test_every_lost_packet_is_told_by_number_and_place(tmp_path_factory, lost, layout):
    desk = Desk(tmp_path_factory.mktemp("trial") / "t.imu-trial", shoe=layout)
    data = packets(layout, counts(layout, 100))
    kept = [number for number in range(100) if number not in lost]
    for number in kept:
        desk.send("shoe", number / 100 + 0.002, data[number])
    trial = desk.trial()
    samples, missing = trial.samples("shoe"), trial.missing("shoe")
    jumps = [(a, b) for a, b in pairwise(kept) if b - a > 1]
    if layout.counter is None and len(kept) < 60:
        return  # the usual distance of packets is not told by so few of them
    assert [gap.samples for gap in missing] == [b - a - 1 for a, b in jumps]
    assert {gap.reason for gap in missing} <= {"lost on the way"}
    for gap, (a, b) in zip(missing, jumps, strict=True):
        assert gap.start_s == samples.t[kept.index(a)]
        assert gap.stop_s == samples.t[kept.index(b)]
    assert sum(gap.samples for gap in missing) == trial.stream_statistics("shoe").lost


def test_the_recorder_says_why(desk):
    made = desk(shoe=MPU)
    data = packets(MPU, counts(MPU, 300))
    for number, t in enumerate(sent_times(300)):
        if number == 100:
            made.gap("shoe", 1.0, "silent")
            made.gap("shoe", 1.0, "unplugged", counter_before=99)
        if not 100 <= number < 180:
            made.send("shoe", t, data[number])
        if number == 185:  # the recorder looks at what came a little later
            made.gap("shoe", 1.0, "unplugged", until_s=1.802, counter_before=99, counter_after=180)
    trial = made.trial()
    assert len(trial.gaps) == 1
    assert trial.gaps[0].fields["counter_after"] == 180
    [gap] = trial.missing("shoe")
    assert (gap.samples, gap.reason) == (80, "unplugged")
    assert gap.stop_s - gap.start_s == pytest.approx(0.81, abs=0.002)
    assert len(trial.samples("shoe")) == 220


def test_what_comes_late_is_not_missing(desk):
    made = desk(shoe=MPU)
    data = packets(MPU, counts(MPU, 300))
    for number, t in enumerate(sent_times(300)):
        if number == 180:
            made.gap("shoe", 1.0, "silent", until_s=1.802)
        made.send("shoe", 1.802 if 100 <= number < 180 else t, data[number])
    trial = made.trial()
    assert len(trial.samples("shoe")) == 300
    assert trial.missing("shoe") == []
    assert len(trial.gaps) == 1


def test_a_device_that_never_came_back_is_missing_to_the_end(desk):
    made = desk(shoe=MPU, other=MPU)
    data = packets(MPU, counts(MPU, 300))
    for number, t in enumerate(sent_times(300)):
        if number < 100:
            made.send("shoe", t, data[number])
        if number == 100:
            made.gap("shoe", 1.0, "unplugged")
        made.send("other", t, data[number])
    trial = made.trial()
    [gap] = trial.missing("shoe")
    assert gap.reason == "unplugged"
    assert gap.samples is None
    assert gap.start_s == trial.samples("shoe").t[-1]
    assert gap.stop_s == trial.duration_s
    assert trial.missing("other") == []


def test_a_restart_is_told_and_not_counted(desk):
    made = desk(shoe=MPU)
    data = packets(MPU, counts(MPU, 200))
    for number, t in enumerate(sent_times(200)):
        made.send("shoe", t + (30.0 if number >= 120 else 0.0), data[number % 120])
    trial = made.trial()
    [gap] = trial.missing("shoe")
    assert (gap.samples, gap.reason) == (None, "restarted")
    assert gap.stop_s - gap.start_s == pytest.approx(30.01, abs=0.1)
    assert np.all(np.diff(trial.samples("shoe").t) > 0)


def test_a_computer_that_slept_is_told_from_a_restart(desk):
    """The device counts on for ten minutes in which the host's clock stands still."""
    made = desk(shoe=MPU)
    columns = counts(MPU, 400)
    columns["time"][200:] += 600_000_000
    for t, data in zip(sent_times(400), packets(MPU, columns), strict=True):
        made.send("shoe", t, data)
    [gap] = made.trial().missing("shoe")
    assert (gap.samples, gap.reason) == (None, "the computer slept")


def test_packets_that_come_twice_are_read_once(desk):
    made = desk(shoe=MPU)
    data = packets(MPU, counts(MPU, 100))
    for number, t in enumerate(sent_times(100)):
        made.send("shoe", t, data[number])
        if number % 7 == 3:
            made.send("shoe", t, data[number])
    trial = made.trial()
    assert np.array_equal(trial.samples("shoe").counter, np.arange(100))
    assert trial.missing("shoe") == []
    assert trial.stream_statistics("shoe").duplicates == len(range(3, 100, 7))


def test_silence_of_a_device_without_counter_and_clock_is_told(desk):
    made = desk(shoe=UNNUMBERED)
    data = packets(UNNUMBERED, counts(UNNUMBERED, 100))
    for number, t in enumerate(sent_times(100)):
        made.send("shoe", t + (5.0 if number >= 50 else 0.0), data[number])
    trial = made.trial()
    [gap] = trial.missing("shoe")
    assert (gap.samples, gap.reason) == (None, "silent")
    assert gap.stop_s - gap.start_s == pytest.approx(5.0, abs=0.1)


# --- breaks --------------------------------------------------------------------------------------


def without_records(path, gone):
    """Take records out of the middle of a trial, as damage does."""
    file, trial = path.read_bytes(), imu_rig.open_trial(path)
    wires = np.flatnonzero(trial.records.kind == Kind.BYTES_IN)
    ends = trial.records.end.tolist()
    cut = b""
    at = 0
    for row in wires[list(gone)].tolist():
        cut += file[at : ends[row - 1]]
        at = ends[row]
    path.write_bytes(cut + file[at:])
    return imu_rig.open_trial(path)


@settings(**FINE)
@given(st.sampled_from([MPU, BARE]), st.integers(9, 47), st.sets(st.integers(3, 40), min_size=1))
def test_no_packet_is_made_of_two_halves(tmp_path_factory, layout, size, gone):
    """Records that end within packets are lost, so that halves of packets come to lie together."""
    path = tmp_path_factory.mktemp("trial") / "t.imu-trial"
    columns = counts(layout, 100)
    stream = encode(layout, columns)
    pieces = [stream[at : at + size] for at in range(0, len(stream), size)]
    gone = {number for number in gone if number < len(pieces) - 3}
    desk = Desk(path, shoe=layout)
    for number, piece in enumerate(pieces):
        desk.send("shoe", 0.01 * number * size / layout.length, piece)
    desk.trial()
    lost = {at // layout.length for n in gone for at in range(n * size, min((n + 1) * size, 2800))}
    trial = without_records(path, sorted(gone)) if gone else imu_rig.open_trial(path)
    samples = trial.samples("shoe")
    whole = np.array([n for n in range(100) if n not in lost])
    place = np.searchsorted(whole, samples.counter)
    assert np.array_equal(whole[place], samples.counter), "a row that nobody sent"
    gyro = np.deg2rad(columns["gyro"][samples.counter] / 32.8)
    assert samples.values["gyro"] == pytest.approx(gyro, rel=1e-12)
    if layout is MPU:
        assert len(samples) == len(whole), "a sound packet was lost"
    missing = trial.missing("shoe")
    began = int(samples.counter[0])
    assert [gap.samples is None for gap in missing] == [
        began > 0 and place == 0 for place in range(len(missing))
    ]
    assert sum(gap.samples or 0 for gap in missing) == 100 - began - len(samples)
    assert {gap.reason for gap in missing} <= {"lost in the file"}


@pytest.mark.parametrize("layout", [MPU, BARE])
def test_a_port_that_was_opened_anew_breaks_a_packet(desk, layout):
    made, live = desk(shoe=layout), PacketStream(layout)
    data = packets(layout, counts(layout, 40))
    before, after = b"".join(data[:20]) + data[20][:15], data[30][15:] + b"".join(data[31:])
    made.send("shoe", 0.2, before)
    made.gap("shoe", 0.2, "unplugged")
    made.send("shoe", 0.4, after)
    trial = made.trial()
    sent = [*range(20), *range(31, 40)]
    assert trial.samples("shoe").counter.tolist() == sent
    assert live.feed(200_000_000, before).counter.tolist() == sent[:20]
    live.cut()
    assert live.feed(400_000_000, after).counter.tolist() == sent[20:]
    [gap] = trial.missing("shoe")
    assert (gap.samples, gap.reason) == (11, "unplugged")


def test_a_silence_within_a_packet_costs_nothing_where_a_checksum_proves_it(desk):
    for layout, there in ((MPU, 40), (BARE, 39)):
        made = desk(shoe=layout)
        data = packets(layout, counts(layout, 40))
        made.send("shoe", 0.2, b"".join(data[:20]) + data[20][:15])
        made.gap("shoe", 0.2, "silent", until_s=2.4)
        made.send("shoe", 2.4, data[20][15:] + b"".join(data[21:]))
        trial = made.trial()
        assert len(trial.samples("shoe")) == there
        assert sum(gap.samples for gap in trial.missing("shoe")) == 40 - there


@pytest.mark.parametrize("layout", [MPU, BARE, BARO])
def test_live_and_recorded_rows_are_the_same(desk, layout):
    """Also where pauses and pieces of packets come together."""
    rng = np.random.default_rng(3)
    made, live = desk(shoe=layout), PacketStream(layout)
    stream = encode(layout, counts(layout, 400))
    rows = []
    t, at = 0.0, 0
    while at < len(stream):
        size = int(rng.integers(1, 60))
        t += float(rng.choice([0.01, 0.01, 0.01, 1.5]))
        made.send("shoe", t, stream[at : at + size])
        rows.append(live.feed(round(t * 1e9), stream[at : at + size]).rows)
        at += size
    _, recorded = made.trial()._packets("shoe")
    assert np.array_equal(np.concatenate(rows), recorded.block.rows)
    assert len(recorded.block) == 400 if layout.checksum else 100 < len(recorded.block) < 400


def test_a_source_that_is_called_like_a_stream_of_another_hides_neither(tmp_path):
    path, receiver = tmp_path / "t.imu-trial", load_protocol("two-imu")
    with TrialWriter.create(path, {}, clock=SteppedClock()) as writer:
        kept = {"layout": receiver.to_dict(), "certificate": {"of": "nobody knows which"}}
        writer.add_source("receiver", "imu", kept)
        other = writer.add_source("receiver/foot", "imu", {"layout": MPU.to_dict()})
        for number, packet in enumerate(packets(MPU, counts(MPU, 20))):
            writer.bytes_in(other, round(1e7 * number), packet)
    trial = imu_rig.open_trial(path)
    assert trial.sensors == ["receiver/foot", "receiver/waist", "source-2"]
    assert len(trial.imu("receiver/foot")) == 0
    assert len(trial.imu("source-2")) == 20
    assert trial.renamed == {"source-2": "receiver/foot"}
    # and one certificate without the name of a stream is that of neither of two
    assert trial.kept_certificate("receiver/foot") is None
    assert trial.kept_certificate("receiver/waist") is None


# --- calibrated, refused, lazy -------------------------------------------------------------------


def trial_with_certificate(path, certificate):
    writer = TrialWriter.create(path, {"subject": "S01"}, clock=SteppedClock(), options=FEW_NOTES)
    shoe = {"layout": MPU.to_dict(), "certificate": certificate}
    sources = {
        "left shoe": writer.add_source("left shoe", "imu", shoe),
        "right shoe": writer.add_source("right shoe", "imu", {"layout": MPU.to_dict()}),
        "barometer": writer.add_source("barometer", "sensor", {"layout": BARO.to_dict()}),
        "maestro": writer.add_source("maestro", "maestro", {}),
    }
    shoes = packets(MPU, counts(MPU, 300))
    air = packets(BARO, counts(BARO, 300))
    for number, t in enumerate(sent_times(300)):
        t_ns = round(t * 1e9)
        writer.bytes_in(sources["left shoe"], t_ns, shoes[number])
        writer.bytes_in(sources["barometer"], t_ns, air[number])
        if not 120 <= number < 180:
            writer.bytes_in(sources["right shoe"], t_ns, shoes[number])
    writer.bytes_out(sources["maestro"], 5_000_000, b"\x84\x00\x70\x2e")
    writer.event("marker", label="turn")
    writer.device_statistics(sources["left shoe"], {"rate_hz": 100.0, "lost": 0})
    writer.close()
    return imu_rig.open_trial(path)


def test_the_certificate_in_the_trial_calibrates(tmp_path):
    kept = json.loads(CERTIFICATE.read_text())
    trial = trial_with_certificate(tmp_path / "t.imu-trial", kept)
    raw, calibrated = trial.imu("left shoe"), trial.imu("left shoe", calibrated=True)
    affine = load_certificate(CERTIFICATE).accel
    expected = raw.accel @ np.array(affine.K).T - np.array(affine.b)
    assert calibrated.accel == pytest.approx(expected, rel=1e-9)
    assert not np.allclose(calibrated.accel, raw.accel)
    for name in ("t", "host_s", "device_s", "counter"):
        assert np.array_equal(getattr(calibrated, name), getattr(raw, name))
    with pytest.raises(InputError, match="holds no certificate of 'right shoe'"):
        trial.imu("right shoe", calibrated=True)
    with pytest.raises(InputError, match="holds no certificate of 'barometer'"):
        trial.imu("barometer", calibrated=True)


@pytest.mark.parametrize("kept", [7, [], {}, {"schema": "imu-rig/certificate", "version": 99}])
def test_a_certificate_that_is_none_is_refused(tmp_path, kept):
    trial = trial_with_certificate(tmp_path / "t.imu-trial", kept)
    with pytest.raises(InputError, match="the certificate of 'left shoe'"):
        trial.imu("left shoe", calibrated=True)
    assert len(trial.imu("left shoe")) == 300


def test_what_is_no_sensor_is_refused_by_name(tmp_path):
    trial = trial_with_certificate(tmp_path / "t.imu-trial", {})
    for ask in (trial.samples, trial.missing, trial.time_uncertainty_s, trial.imu):
        with pytest.raises(InputError, match=r"no source 'knee'; it has left shoe, "):
            ask("knee")
        with pytest.raises(InputError, match=r"'maestro' .* is no sensor"):
            ask("maestro")
    with pytest.raises(InputError, match="neither a field accel nor a field gyro"):
        trial.imu("barometer")


def test_a_source_whose_descriptor_is_lost_is_there_by_number(tmp_path):
    path = tmp_path / "t.imu-trial"
    trial_with_certificate(path, {})
    file = path.read_bytes()
    header = decode_file_header(file[:HEADER_SIZE], path)
    extra = encode_record(header.seed, Kind.BYTES_IN, 9, 10_000, 0, b"unheard of")
    path.write_bytes(file + extra)
    trial = imu_rig.open_trial(path)
    assert trial.wire("source-9").data == b"unheard of"
    assert "source-9" not in trial.sensors
    with pytest.raises(InputError, match="is no sensor"):
        trial.samples("source-9")


def test_nothing_is_decoded_before_samples_are_asked_for(tmp_path, monkeypatch):
    trial = trial_with_certificate(tmp_path / "t.imu-trial", {})

    def refuse(*_):
        raise AssertionError("decoded")

    monkeypatch.setattr("imu_rig.recording.reader.assemble_packets", refuse)
    assert trial.config == {"subject": "S01"}
    assert trial.sensors == ["left shoe", "right shoe", "barometer"]
    assert trial.duration_s == pytest.approx(2.992)
    assert [marker.label for marker in trial.markers] == ["turn"]
    assert trial.ended == "complete"
    assert trial.device_statistics("left shoe")[0][1]["rate_hz"] == 100.0
    assert trial.device_statistics("right shoe") == []
    with pytest.raises(AssertionError, match="decoded"):
        trial.samples("barometer")


def test_the_package_offers_open_trial_and_loads_nothing_for_it():
    code = (
        "import sys, imu_rig; assert 'numpy' not in sys.modules; "
        "imu_rig.open_trial; assert 'imu_rig.calibration' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    with pytest.raises(AttributeError, match="open_trail"):
        imu_rig.open_trail  # noqa: B018


def test_reading_takes_few_times_the_memory_of_its_arrays(desk):
    made = desk(shoe=MPU)
    data = packets(MPU, counts(MPU, 40_000, rate_hz=400.0))
    for number, t in enumerate(sent_times(40_000, 400.0)):
        made.send("shoe", t, data[number])
    trial = made.trial()
    tracemalloc.start()
    try:
        block = trial.imu("shoe")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    columns = (block.t, block.host_s, block.device_s, block.counter)
    axes = (block.accel, block.gyro, block.mag)
    assert peak < 4 * sum(column.nbytes for column in (*columns, *axes))


def test_what_came_of_nothing_has_no_time(desk):
    trial = desk(shoe=MPU).trial()
    assert len(trial.samples("shoe")) == 0
    assert trial.missing("shoe") == []
    assert trial.time_uncertainty_s("shoe") == math.inf


def test_the_examples_of_the_guide_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    kept = json.loads(CERTIFICATE.read_text())
    trial_with_certificate(tmp_path / "walk.imu-trial", kept)
    (tmp_path / "left-shoe.json").write_text(CERTIFICATE.read_text())
    code = re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(code) > 5
    names = {}
    for block in code:
        exec(block, names)  # noqa: S102
    said = capsys.readouterr().out
    assert "['left shoe', 'right shoe', 'barometer']" in said
    assert "[120, 120]" in said


# --- what is told of sources ---------------------------------------------------------------------


def test_a_clock_that_cannot_be_right_is_told_of_any_device(desk):
    made = desk(good=MPU, wrong=MPU, baro=BARO)
    sent = {"good": (MPU, 1.0), "wrong": (MPU, 1.05), "baro": (BARO, 1.05)}
    for name, (layout, pace) in sent.items():
        pieces = packets(layout, counts(layout, 1500))
        for t, piece in zip(sent_times(1500), pieces, strict=True):
            made.send(name, pace * t, piece)
    trial = made.trial()
    assert trial.time_problem("good") is None
    assert len(trial.imu_in_time("good")) == 1500
    for name in ("wrong", "baro"):  # by 5 %, which no crystal errs
        assert re.search(r"disagree by \+5 %", trial.time_problem(name))
        assert np.isinf(trial.time_uncertainty_s(name))
    with pytest.raises(DataError, match="disagree by"):
        trial.imu_in_time("wrong")


def test_inertial_sensors_are_known_by_their_packets_not_by_what_they_are_called(desk):
    trial = desk(foot=MPU, imu=BARO).trial()  # both of the kind "imu"
    assert (trial.sensors, trial.imus) == (["foot", "imu"], ["foot"])


def test_names_reach_a_message_without_what_a_terminal_obeys(desk):
    with pytest.raises(InputError, match="has no source") as caught:
        desk(**{"\x1b[2Jfoot\n": MPU}).trial().source("\x1b[31m")
    assert str(caught.value).isprintable()


def test_utc_is_that_of_the_start_whatever_the_wall_clock_does_later(tmp_path):
    path, clock = tmp_path / "t.imu-trial", SteppedClock()
    start_ns = 1_790_000_000_123_456_000
    options = replace(FEW_NOTES, wall_ns=lambda: start_ns + (clock.now_ns() > 0) * 10**15)
    with TrialWriter.create(path, {}, clock=clock, options=options):
        clock.advance(5.0)
    trial = imu_rig.open_trial(path)
    assert trial.utc(1.5).isoformat() == "2026-09-21T14:13:21.623456+00:00"
    path.write_bytes(path.read_bytes()[:HEADER_SIZE])  # no clock pair is left
    assert imu_rig.open_trial(path).utc() is None
