"""Foreign recordings as trial files: every number, time and gap comes back."""

import errno
import math
import os
from dataclasses import replace

import numpy as np
import pytest
from foreign_files import (
    broad_content,
    pyshoe_content,
    write_inertial,
    write_mat,
    write_table,
    write_xsens,
    xsens_rows,
)

from imu_rig.blocks import Samples
from imu_rig.errors import InputError, StorageError
from imu_rig.importing.foreign import ForeignRecording
from imu_rig.importing.formats import load_foreign
from imu_rig.importing.trial_file import write_trial
from imu_rig.recording.reader import open_trial
from imu_rig.recording.storage import OsFileSystem

TIME_S = 0.6e-6
"""Half a tick of the microsecond clock, and rounding."""


class FullDisk(OsFileSystem):
    """Takes so many writes and no more."""

    def __init__(self, taken):
        self.left = taken

    def write(self, descriptor, data):
        self.left -= 1
        if self.left < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(descriptor, data)


def trial_of(tmp_path, recording, **options):
    imported = write_trial(tmp_path / "out.imu-trial", recording, **options)
    return open_trial(tmp_path / "out.imu-trial"), imported


def require_same(samples, original, begin=0.0):
    assert len(samples) == len(original)
    assert np.abs(samples.t - (original.t - begin)).max() < TIME_S
    assert set(samples.values) == set(original.values)
    for name, numbers in original.values.items():
        assert np.array_equal(samples.values[name], numbers, equal_nan=True), name
        assert samples.units[name] == original.units[name]


def foreign(path, **samples):
    return ForeignRecording("table", (path,), samples)


def stream(t, counter=None, values=None):
    t = np.asarray(t, float)
    values = values or {"accel": np.random.default_rng(3).standard_normal((len(t), 3))}
    units = {"accel": "m/s2", "pressure": "hPa"}
    return Samples(t, t, t, counter, values, {name: units[name] for name in values})


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "in.csv"
    file.write_text("a recording\n")
    return file


def test_xsens_with_lost_packets_and_a_wrap(tmp_path):
    rows = xsens_rows(400, first=65_400)
    lost = {50, 51, 52, 137, 300}
    rows = [row for i, row in enumerate(rows) if i not in lost]
    recording = load_foreign(write_xsens(tmp_path / "a.txt", rows))
    trial, imported = trial_of(tmp_path, recording)
    (original,) = recording.streams.values()
    samples = trial.samples("a")
    require_same(samples, original)
    assert np.array_equal(np.diff(samples.counter), np.diff(original.counter))
    assert imported.missing == {"a": 5}
    gaps = trial.missing("a")
    assert [gap.samples for gap in gaps] == [3, 1, 1]
    assert gaps[0].start_s == pytest.approx(0.49)
    assert gaps[0].stop_s == pytest.approx(0.53)
    assert np.array_equal(trial.imu("a").gyro, recording.imu().gyro)
    assert trial.ended == "complete"


def test_a_reference_is_a_source_of_its_own(tmp_path):
    path = write_mat(tmp_path / "a.mat", broad_content())
    recording = load_foreign(path)
    trial, _ = trial_of(tmp_path, recording, name="shin")
    require_same(trial.samples("shin"), recording.streams["imu"])
    truth, reference = trial.samples("reference"), recording.reference
    assert np.array_equal(truth.values["orientation"], reference.orientation, equal_nan=True)
    assert np.array_equal(truth.values["position"], reference.position, equal_nan=True)
    assert np.array_equal(truth.values["moving"] == 1, reference.moving)
    assert truth.units["position"] == "m"
    assert trial.source("reference").kind == "reference"
    origin = trial.config["origin"]
    assert origin["format"] == "broad"
    assert origin["files"][0]["name"] == "a.mat"
    assert len(origin["files"][0]["sha256"]) == 64
    assert "magnetic" in origin["reference_frame"]


def test_pyshoe_times_that_jitter_come_back(tmp_path):
    recording = load_foreign(write_mat(tmp_path / "a.mat", pyshoe_content(2000)))
    trial, imported = trial_of(tmp_path, recording)
    require_same(trial.samples("foot"), recording.streams["foot"])
    assert trial.config["origin"]["start_known"] is False
    assert (trial.start_utc_ns, trial.utc()) == (None, None)  # the file tells no date
    assert imported.missing == {"foot": 0, "reference": 0}
    assert np.array_equal(
        trial.samples("reference").values["position"], recording.reference.position
    )


def test_streams_of_different_rates_and_the_start_of_the_wall_clock(tmp_path):
    start = 1_700_000_000_000_000
    write_inertial(tmp_path / "Inertial.csv", start + 2_500 * np.arange(400))
    field = np.random.default_rng(2).standard_normal((40, 3))
    header = "Timestamp (us),X (a.u.),Y (a.u.),Z (a.u.)"
    write_table(tmp_path / "Magnetometer.csv", header, start + 700 + 25_000 * np.arange(40), field)
    recording = load_foreign(tmp_path)
    trial, _ = trial_of(tmp_path, recording)
    for name, original in recording.streams.items():
        require_same(trial.samples(name), original)
    assert trial.samples("Magnetometer").t[0] == pytest.approx(0.0007, abs=1e-9)
    assert trial.start_utc_ns == start * 1000
    assert trial.source("Magnetometer").kind == "magnetometer"


def test_gaps_of_hours_and_clocks_that_wrap(tmp_path, path):
    t = np.concatenate((np.arange(200), 500_000 + np.arange(200), 1_700_000 + np.arange(200))) / 100
    recording = foreign(path, imu=stream(t))
    trial, imported = trial_of(tmp_path, recording)
    require_same(trial.samples("imu"), recording.streams["imu"])
    assert imported.missing["imu"] == 1_700_200 - 600
    assert [gap.samples for gap in trial.missing("imu")] == [499_800, 1_199_800]


def test_a_recording_longer_than_the_clock_counts(tmp_path, path):
    t = np.arange(0, 5000, 0.5)
    recording = foreign(path, imu=stream(t))
    trial, _ = trial_of(tmp_path, recording)
    require_same(trial.samples("imu"), recording.streams["imu"])


@pytest.mark.parametrize("rate", [3.0, 60.0, 2000 / 7, 1000.0, 8000.0])
def test_times_come_back_at_every_rate(tmp_path, path, rate):
    t = 17.125 + np.arange(round(12 * min(rate, 1500.0))) / rate  # not from 0 on
    recording = foreign(path, imu=stream(t))
    trial, imported = trial_of(tmp_path, recording)
    require_same(trial.samples("imu"), recording.streams["imu"], begin=17.125)
    samples = trial.samples("imu")
    assert np.allclose(samples.host_s, samples.device_s, rtol=0, atol=1e-9)
    assert math.isnan(trial.time_uncertainty_s("imu"))  # the file's times are all there is
    assert imported.missing == {"imu": 0}
    assert trial.config["origin"]["time_zero_s"] == 17.125


def test_a_sensor_that_is_no_imu(tmp_path, path):
    pressure = stream(np.arange(50) / 10, values={"pressure": 1000 + np.arange(50.0)})
    recording = foreign(path, baro=pressure, imu=stream(np.arange(99) / 100))
    trial, _ = trial_of(tmp_path, recording, name="waist")
    assert list(trial.sources) == ["waist-baro", "waist-imu"]
    samples = trial.samples("waist-baro")
    assert samples.units == {"pressure": "Pa"}  # SI, whatever the file's unit was
    in_pascal = replace(
        pressure,
        values={"pressure": 100.0 * pressure.values["pressure"]},
        units={"pressure": "Pa"},
    )
    require_same(samples, in_pascal)
    assert trial.source("waist-baro").kind == "pressure"


def test_nothing_is_overwritten_and_nothing_half_written_is_left(tmp_path, path):
    recording = foreign(path, imu=stream(np.arange(5000) / 100))
    out = tmp_path / "out.imu-trial"
    out.write_bytes(b"precious")
    with pytest.raises(InputError, match="exists"):
        write_trial(out, recording)
    assert out.read_bytes() == b"precious"
    out.unlink()
    for taken in (0, 1, 4):
        with pytest.raises(StorageError):
            write_trial(out, recording, file_system=FullDisk(taken))
        assert not out.exists()


def test_an_interrupted_import_leaves_no_file(tmp_path, path):
    def interrupt(share):
        raise KeyboardInterrupt

    recording = foreign(path, imu=stream(np.arange(60_000) / 1000))
    with pytest.raises(KeyboardInterrupt):
        write_trial(tmp_path / "out.imu-trial", recording, progress=interrupt)
    assert not (tmp_path / "out.imu-trial").exists()


def test_what_cannot_be_a_trial(tmp_path, path):
    out = tmp_path / "out.imu-trial"
    with pytest.raises(InputError, match="unit of time"):
        write_trial(out, foreign(path, imu=stream(np.arange(100) * 1e6)))
    two = stream(np.arange(9))
    alike = replace(foreign(path), streams={"a": two, "a ": two})
    with pytest.raises(InputError, match="named alike"):
        write_trial(out, alike)
    with pytest.raises(InputError, match="no samples"):
        write_trial(out, foreign(path))
    assert not out.exists()


def test_progress_runs_up_to_the_whole(tmp_path, path):
    shares = []
    recording = foreign(path, imu=stream(np.arange(100_000) / 1000))
    write_trial(tmp_path / "out.imu-trial", recording, progress=shares.append)
    assert shares == sorted(shares)
    assert len(shares) >= 4
    assert all(0 <= share <= 1 for share in shares)
