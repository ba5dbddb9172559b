"""A magnetometer in whole calibrations: beside the others, alone, in certificates and tables."""

import json
from dataclasses import replace

import numpy as np
import pytest
from simulated_fields import DEG, FIELD, Compass, jig_matrices, pose_list, session
from simulated_sessions import random_sensor, record, spread_attitudes
from typer.testing import CliRunner

from imu_rig import rotation
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.certificate import apply_certificate, certificate_of, load_certificate
from imu_rig.calibration.magnetic import calibrate_from_samples
from imu_rig.calibration.magnetometer import FieldReadings, fit_field
from imu_rig.calibration.model import sensor_frame
from imu_rig.calibration.session import CommandedPoses
from imu_rig.calibration.solve import solve
from imu_rig.cli.commands import app
from imu_rig.errors import DataError, InputError
from imu_rig.importing.column_map import make_column_map
from imu_rig.importing.read_table import read_table
from imu_rig.report.calibration import calibration_report
from simulators.config import RigConfig
from simulators.quick_session import quick_session

POSES = pose_list(8)
SPHERE = np.random.default_rng(0).standard_normal((200, 3))
SPHERE /= np.linalg.norm(SPHERE, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def on_jig():
    """A session on a simulated hobby jig, with the whole error budget of an MPU-9150."""
    return quick_session(RigConfig.random(4), POSES)


def by_gravity(block, session):
    commanded = CommandedPoses(POSES)
    return solve(block, session.windows, method="multi-position", commanded=commanded)


@pytest.fixture(scope="module")
def by_dip(on_jig):
    return by_gravity(on_jig.block, on_jig)


def error_deg(result, truth):
    """Angle between calibrated readings and the field in the accelerometer's axes, rms."""
    Q = sensor_frame(truth.accel.K)[0]
    raw = (FIELD * SPHERE + truth.mag.b) @ np.linalg.inv(truth.mag.K).T
    up = SPHERE @ Q
    seen = result.mag.affine.apply(raw)
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    return np.sqrt(np.mean(np.sum(np.cross(up, seen) ** 2, axis=1))) / DEG


def test_a_jig_session_calibrates_the_magnetometer_beside_the_others(on_jig, by_dip):
    assert by_dip.gyro is not None
    assert by_dip.mag.alignment == "dip"
    assert by_dip.mag.warnings == ()
    assert error_deg(by_dip, on_jig.truth) < 0.12
    assert by_dip.mag.dip_rad == pytest.approx(np.arctan2(45, 22), abs=0.1 * DEG)
    assert by_dip.mag.left_out_percent < 0.2


def test_the_joint_fit_hands_on_its_attitudes(on_jig):
    result = solve(on_jig.block, on_jig.windows, method="joint", commanded=CommandedPoses(POSES))
    assert result.mag.alignment == "attitudes"
    assert result.mag.warnings == ()
    assert error_deg(result, on_jig.truth) < 0.08


@pytest.mark.parametrize("method", ["paper", "paper-diagonal"])
def test_errors_that_trust_in_a_jig_leaves_are_not_taken_for_iron(on_jig, method):
    """The angles of a hobby servo spoil the accelerometer's axes, not the magnetic field."""
    block, commanded = on_jig.block, CommandedPoses(POSES)
    clean = solve(block, on_jig.windows, method=method, commanded=commanded)
    assert not any("iron, magnets or currents" in w for w in clean.warnings)
    magnet = np.where(block.t > np.median(block.t), 2.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    near = replace(block, mag=block.mag + magnet)
    disturbed = solve(near, on_jig.windows, method=method, commanded=commanded)
    assert any("iron, magnets or currents" in w for w in disturbed.warnings)


@pytest.mark.parametrize("hertz", [10, 50])
def test_a_compass_without_gyroscope_is_told_the_method_that_works(hertz):
    """Turned slowly and never at rest; the rate stated may be any."""
    rng = np.random.default_rng(3)
    t = np.arange(4000) / hertz
    turned = rotation.from_rotation_vector(
        np.cumsum(0.012 * np.array([1.0, 0.7, 0.4]) * np.sin(0.002 * np.arange(4000))[:, None], 0)
        + np.array([0.3, 0.0, 0.0]) * np.arange(4000)[:, None] * 0.01
    )
    down = rotation.to_matrix(turned)
    accel = 9.8 * down[:, 2] + 0.05 * rng.standard_normal((4000, 3))
    mag = 48.0 * down[:, 0] + 0.3 * rng.standard_normal((4000, 3))
    block = ImuBlock(t, accel, np.zeros((4000, 3)), t, mag=mag)
    with pytest.raises(DataError) as caught:
        solve(block)
    sentence = str(caught.value)
    assert "--method magnetometer" in sentence
    assert "sample rate" not in sentence


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda mag: np.where(np.arange(len(mag))[:, None] == 9, np.nan, mag), "not numbers"),
        (lambda mag: mag * [1, 0.001, 1], "in a plane"),
        (lambda mag: mag[:, [1, 0, 2]], "correct the order and signs"),
    ],
)
def test_a_bad_magnetometer_leaves_the_others_as_they_are(on_jig, by_dip, spoil, words):
    block = replace(on_jig.block, mag=spoil(on_jig.block.mag))
    result = by_gravity(block, on_jig)
    assert result.mag is None
    assert np.array_equal(result.accel.K, by_dip.accel.K)
    assert np.array_equal(result.gyro.K, by_dip.gyro.K)
    (said,) = [w for w in result.warnings if "magnetometer was not calibrated" in w]
    assert words in said


def test_a_certificate_keeps_the_magnetometer_and_applies_it(on_jig, by_dip, tmp_path):
    certificate = certificate_of(by_dip)
    certificate.save(tmp_path / "c.json")
    again = load_certificate(tmp_path / "c.json")
    assert again == certificate
    assert again.mag.alignment == "dip"
    still = on_jig.block[slice(*np.searchsorted(on_jig.block.t, on_jig.windows[0]))]
    calibrated = apply_certificate(again, still)
    assert np.linalg.norm(calibrated.mag.mean(axis=0)) == pytest.approx(
        again.mag.field_ut, rel=2e-3
    )
    bare = ImuBlock(still.t, still.accel, still.gyro, still.t)
    assert apply_certificate(again, bare).mag is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"alignment_standard_uncertainty": None}, "without its uncertainty"),
        ({"alignment": "magic"}, "alignment"),
        ({"field_ut": -3.0}, "field_ut"),
    ],
)
def test_a_certificate_with_an_impossible_magnetometer_is_refused(by_dip, tmp_path, change, words):
    path = tmp_path / "c.json"
    certificate_of(by_dip).save(path)
    content = json.loads(path.read_text())
    content["mag"] |= change
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=words):
        load_certificate(path)


def test_the_report_shows_the_magnetometer(by_dip):
    page = calibration_report(by_dip)
    assert "<h2>Magnetometer</h2>" in page
    assert "Accelerometer, gyroscope and magnetometer calibrated" in page
    assert "more than any residual shows" in page


def test_a_table_states_the_axes_of_a_raw_chip(tmp_path):
    """The MPU-9150's magnetometer: x is its y, y its x, z its -z (devices.md, section 2.3)."""
    rng = np.random.default_rng(1)
    block, _ = session(jig_matrices(POSES[:4]), Compass.random(rng), rng, hold_s=0.5)
    chip = block.mag[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    rows = np.hstack((block.accel, chip))
    path = tmp_path / "t.csv"
    np.savetxt(path, rows, delimiter=",", header="ax,ay,az,mx,my,mz", comments="", fmt="%.6f")
    stated = {"rate_hz": 100, "accel_unit": "m/s2", "mag_unit": "uT", "mag": "my,mx,-mz"}
    read = read_table(path, make_column_map(stated, "options"))
    assert np.allclose(read.mag, block.mag, atol=1e-5)
    assert np.all(read.gyro == 0.0)


def test_the_magnetometer_alone_claims_nothing_of_the_accelerometer(on_jig):
    block = ImuBlock(on_jig.block.t, on_jig.block.accel, on_jig.block.gyro * 0, on_jig.block.t)
    with pytest.raises(DataError, match="no magnetometer"):
        solve(block, method="magnetometer")
    result = solve(replace(block, mag=on_jig.block.mag), method="magnetometer")
    assert np.array_equal(result.accel.K, np.eye(3))
    assert result.accel.K_uncertainty[0, 0] >= 0.03
    assert result.accel.b_uncertainty[0] > 0.5
    assert result.gyro is None
    assert result.accel_errors.after is None
    assert "Only the magnetometer was calibrated" in result.warnings[0]


@pytest.fixture(scope="module")
def real(imu_rig_data):
    path = imu_rig_data / "calibration" / "ck_explorer_mag" / "acc_mag_log.csv"
    if not path.is_file():
        pytest.skip(f"no {path}")
    return path


def test_a_real_recording_of_slow_tumbling_in_one_command(real):
    options = ["--rate", "100", "--accel-unit", "g", "--mag-unit", "gauss"]
    done = CliRunner().invoke(
        app, ["solve", str(real), *options, "--method", "magnetometer", "--json"]
    )
    assert done.exit_code == 0, done.output
    mag = json.loads(done.stdout)["certificate"]["mag"]
    assert mag["before_percent"] > 25
    assert mag["residual_percent"] < 1.3
    assert mag["left_out_percent"] < 1.4
    assert mag["alignment"] == "dip"


def test_alternate_seconds_of_a_real_recording_agree(real):
    stated = {"rate_hz": 100, "accel_unit": "g", "mag_unit": "gauss"}
    raw = read_table(real, make_column_map(stated, "options")).mag
    second = np.arange(len(raw)) // 100
    off = np.empty(len(raw))
    for odd in (0, 1):
        seen = second % 2 != odd
        readings = FieldReadings(raw[seen], np.full((seen.sum(), 3), 0.2), None, None)
        readings = replace(readings, cluster=np.arange(seen.sum()) * 40 // seen.sum())
        fit = fit_field(readings)
        size = np.linalg.norm(fit.affine.apply(raw[~seen]), axis=1)
        off[~seen] = size / fit.field_ut - 1.0
    assert 100 * np.std(off) <= 1.3


def test_a_real_recording_by_halves_agrees_within_its_stated_uncertainties(real):
    stated = {"rate_hz": 100, "accel_unit": "g", "mag_unit": "gauss"}
    block = read_table(real, make_column_map(stated, "options"))
    first, last = (calibrate_from_samples(part) for part in (block[:6000], block[6000:]))
    centres = [np.linalg.solve(r.affine.K, r.affine.b) for r in (first, last)]
    sigma = np.hypot(*(r.affine.b_uncertainty for r in (first, last)))
    assert np.all(np.abs(centres[0] - centres[1]) < 4 * sigma)


@pytest.mark.parametrize("value", [0.0, 31.5])
def test_a_magnetometer_that_never_changes_is_told(value):
    rng = np.random.default_rng(4)
    block = record(spread_attitudes(12, rng), random_sensor(rng), rng).block
    result = solve(replace(block, mag=np.full_like(block.accel, value)))
    assert result.mag is None
    assert any("magnetometer was not calibrated" in warning for warning in result.warnings)
