"""Real recordings in the formats that are read, where they are at hand."""

import json

import numpy as np
import pytest
from scipy.io import loadmat

from imu_rig.importing.column_map import ColumnMap
from imu_rig.importing.formats import load_foreign
from imu_rig.importing.joined import join_recordings
from imu_rig.importing.trial_file import write_trial
from imu_rig.recording.reader import open_trial
from imu_rig.rotation import rotate

G = 9.81


@pytest.fixture
def walking(imu_rig_data):
    return imu_rig_data / "walking" / "waist_feet_10m"


@pytest.mark.parametrize("name", ["1-2_lb", "12-3_lf", "18-1_rf"])
def test_xsens_counts_place_every_row(walking, name):
    samples = next(iter(load_foreign(walking / f"{name}.txt").streams.values()))
    raw = np.loadtxt(walking / f"{name}.txt", skiprows=2)
    assert np.array_equal(samples.counter, raw[:, 0])
    assert np.allclose(samples.t, (raw[:, 0] - raw[0, 0]) / 100)
    assert np.array_equal(samples.values["accel"], raw[:, 1:4])
    assert np.array_equal(samples.values["gyro"], raw[:, 4:7])


def test_feet_and_waist_of_one_walk_become_one_trial(walking, tmp_path):
    """Both feet stand still while the other one swings, by annotations in counts of packets."""
    files = [walking / f"12-3_{place}.txt" for place in ("lb", "lf", "rf")]
    write_trial(tmp_path / "walk.imu-trial", join_recordings([load_foreign(f) for f in files]))
    trial = open_trial(tmp_path / "walk.imu-trial")
    annotated = json.loads((walking / "12-3.json").read_text())
    first = min(trial.samples(s).counter[0] for s in trial.sensors)
    for foot, key, file in (("12-3_lf", "Left", files[1]), ("12-3_rf", "Right", files[2])):
        samples = trial.samples(foot)
        turning = np.linalg.norm(samples.values["gyro"], axis=1)
        swings = (np.array(annotated[f"{key}FootEvents"]) - first) / 100
        swinging = np.zeros(len(samples), bool)
        for start, stop in swings:
            swinging |= (samples.t >= start) & (samples.t <= stop)
        assert np.median(turning[swinging]) > 5 * np.median(turning[~swinging])
        assert np.array_equal(samples.counter, np.loadtxt(file, skiprows=2)[:, 0])
    missing = sum(gap.samples for gap in trial.missing("12-3_lf"))
    assert missing == 3116 - 2471


@pytest.mark.parametrize("name", ["short_walk", "long_walk"])
def test_an_ngimu_repeats_rows_where_it_misses_some(imu_rig_data, tmp_path, name):
    recording = load_foreign(imu_rig_data / "foot" / "xio_loop" / f"{name}.csv")
    assert recording.format == "ngimu"
    raw = np.loadtxt(imu_rig_data / "foot" / "xio_loop" / f"{name}.csv", delimiter=",", skiprows=1)
    fresh = np.append(True, np.any(np.diff(raw, axis=0) != 0, axis=1))
    samples = recording.streams[name]
    assert np.array_equal(samples.t, raw[fresh, 0] - raw[0, 0])
    imported = write_trial(tmp_path / "a.imu-trial", recording)
    # by the nominal rate of 400 Hz, with the clock's error of 0.4 %
    expected = (raw[-1, 0] - raw[0, 0]) / np.median(np.diff(samples.t)) + 1 - len(samples)
    assert imported.missing[name] == pytest.approx(expected, abs=6)


@pytest.mark.parametrize(
    ("name", "way"), [("2017-11-22-11-22-03", "down"), ("2018-02-22-10-09-36", "up")]
)
def test_pyshoe_says_which_way_its_z_points(imu_rig_data, name, way):
    file = imu_rig_data / "foot" / "pyshoe_vicon" / f"{name}.mat"
    recording = load_foreign(file)
    content = loadmat(file)
    assert np.array_equal(recording.imu().gyro, content["imu"][:, 3:])
    assert np.array_equal(recording.reference.position, content["gt"] * [1, -1, 1])
    assert any(f"z points {way}" in note for note in recording.notes)
    assert len(recording.reference) == len(recording.imu())


def test_a_broad_reference_turns_gravity_up(imu_rig_data, tmp_path):
    """At rest before the movement specific force turned by the reference points up, 9.8 m/s2."""
    file = next((imu_rig_data / "orientation").glob("02_*.mat"))
    recording = load_foreign(file)
    write_trial(tmp_path / "a.imu-trial", recording)
    trial = open_trial(tmp_path / "a.imu-trial")
    block, truth = trial.imu("imu"), trial.samples("reference")
    content = loadmat(file)
    assert np.array_equal(block.accel, content["imu_acc"])
    assert np.array_equal(block.mag, content["imu_mag"])
    assert np.array_equal(truth.values["orientation"], content["opt_quat"], equal_nan=True)
    orientation = truth.values["orientation"]
    rest = (truth.t < 20) & np.isfinite(orientation[:, 0])
    up = rotate(orientation[rest], block.accel[rest]).mean(axis=0)
    assert up == pytest.approx([0, 0, G], abs=0.25)


def test_gaitmap_holds_two_feet_under_two_header_rows(imu_rig_data):
    columns = ColumnMap(rate_hz=204.8, accel_unit="m/s2", gyro_unit="deg/s")
    file = imu_rig_data / "foot" / "gaitmap_mocap" / "imu_sample.csv"
    recording = load_foreign(file, columns=columns)
    assert recording.sensors == ["left_sensor", "right_sensor"]
    raw = np.loadtxt(file, delimiter=",", skiprows=2)
    left, right = (recording.imu(s) for s in recording.sensors)
    assert np.array_equal(left.accel, raw[:, [1, 3, 5]])
    assert np.allclose(right.gyro, np.deg2rad(raw[:, [8, 10, 12]]), rtol=1e-14)


def test_a_node_of_sensorconnect_needs_its_units_only(imu_rig_data):
    file = imu_rig_data / "foot" / "gcp_footprints" / "SensorConnectData_34.csv"
    stated = ColumnMap(accel_unit="g", gyro_unit="rad/s", mag_unit="gauss")
    block = load_foreign(file, columns=stated).imu()
    assert block.mag is not None
    assert np.median(block.accel[:1000, 2]) < -8  # its z points down
