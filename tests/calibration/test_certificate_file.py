"""The certificate on disk: written whole, read back, refused with one sentence."""

import dataclasses
import json
import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from simulated_sessions import random_sensor, record, spread_attitudes

from imu_rig.blocks import ImuBlock
from imu_rig.calibration.certificate import (
    MAXIMUM_BYTES,
    Certificate,
    apply_certificate,
    certificate_of,
    load_certificate,
)
from imu_rig.calibration.model import Affine
from imu_rig.calibration.result import DeviceInfo
from imu_rig.calibration.solve import solve
from imu_rig.cli.certificate_page import certificate_lines
from imu_rig.errors import DataError, InputError, StorageError

SHA = "ab" * 32


@pytest.fixture(scope="module")
def result():
    rng = np.random.default_rng(8)
    recording = record(spread_attitudes(18, rng), random_sensor(rng), rng)
    return solve(recording.block, device=DeviceInfo("foot", "007", "mpu9150-28"))


@pytest.fixture
def certificate(result):
    return certificate_of(
        result, date=datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC), recording=("/some/where/a.log", SHA)
    )


def test_what_is_saved_is_what_is_loaded(certificate, result, tmp_path):
    certificate.save(tmp_path / "c.json")
    loaded = load_certificate(tmp_path / "c.json")
    assert loaded == certificate
    assert np.array_equal(loaded.accel.affine().K, result.accel.K)
    assert np.array_equal(loaded.gyro.affine().covariance, result.gyro.covariance)
    assert loaded.gyro.affine().dof == result.gyro.dof
    assert loaded.accel_errors.held_out.rms == result.accel_errors.held_out.rms


def test_the_file_says_what_a_reader_needs(certificate, tmp_path):
    certificate.save(tmp_path / "c.json")
    content = json.loads((tmp_path / "c.json").read_text())
    assert content["schema"] == "imu-rig/certificate"
    assert content["version"] == 2
    assert content["date"] == "2026-01-02T03:04:05Z"
    assert content["device"]["accel_raw_unit"] == "m/s^2"
    assert content["device"]["serial"] == "007"
    assert content["recording"] == {"file": "a.log", "sha256": SHA}
    assert content["gravity"]["known"] is False
    assert len(content["poses"]) == 18
    assert [p.name for p in tmp_path.iterdir()] == ["c.json"]


def test_applying_calibrates_both_sensors_and_leaves_the_rest(certificate, result):
    rng = np.random.default_rng(1)
    t = np.arange(5) / 100
    block = ImuBlock(t, rng.standard_normal((5, 3)), rng.standard_normal((5, 3)), t)
    calibrated = apply_certificate(certificate, block)
    assert np.allclose(calibrated.accel, block.accel @ result.accel.K.T - result.accel.b)
    assert np.allclose(calibrated.gyro, block.gyro @ result.gyro.K.T - result.gyro.b)
    assert calibrated.t is block.t
    without = certificate.model_copy(update={"gyro": None})
    assert apply_certificate(without, block).gyro is block.gyro


def test_a_file_of_version_1_is_read_and_becomes_the_present_one(tmp_path):
    """The file was written by the program when version 1 was its newest."""
    certificate = load_certificate(Path(__file__).parents[1] / "data" / "certificate-v1.json")
    assert certificate.version == 2
    assert certificate.device.serial == "007"
    assert certificate.accel.K[0][0] == pytest.approx(1.035764729485978, abs=0)
    assert certificate.gyro.affine().covariance.shape == (12, 12)
    assert len(certificate.poses) == 18
    certificate.save(tmp_path / "c.json")
    assert json.loads((tmp_path / "c.json").read_text())["version"] == 2
    assert load_certificate(tmp_path / "c.json") == certificate


def test_a_result_that_no_sensor_has_gets_no_certificate(result):
    mirrored = Affine(-result.accel.K, result.accel.b, result.accel.covariance)
    with pytest.raises(DataError, match=r"K: it mirrors.*wrong sign"):
        certificate_of(dataclasses.replace(result, accel=mirrored))


def test_an_existing_file_is_kept_unless_asked(certificate, tmp_path):
    path = tmp_path / "c.json"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists"):
        certificate.save(path)
    assert path.read_text() == "precious"
    certificate.save(path, overwrite=True)
    assert load_certificate(path) == certificate


def test_a_symbolic_link_is_replaced_not_followed(certificate, tmp_path):
    target = tmp_path / "elsewhere.json"
    target.write_text("precious")
    link = tmp_path / "c.json"
    link.symlink_to(target)
    certificate.save(link, overwrite=True)
    assert target.read_text() == "precious"
    assert not link.is_symlink()


def test_a_failing_disk_leaves_nothing_half_written(certificate, tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="No space left"):
        certificate.save(tmp_path / "c.json")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_named(certificate, tmp_path):
    with pytest.raises(InputError, match="not a folder"):
        certificate.save(tmp_path / "none" / "c.json")


def edited(certificate, edit):
    content = json.loads(certificate.model_dump_json())
    edit(content)
    return json.dumps(content).encode()


def put(*keys, value):
    def edit(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return edit


def without(*keys):
    def edit(content):
        for key in keys[:-1]:
            content = content[key]
        del content[keys[-1]]

    return edit


def warming(slope, sigma=1e-4):
    slopes = {"value": [slope, 0.0, 0.0], "standard_uncertainty": [sigma, 1e-4, 1e-4]}
    return {"reference_c": 25.0, "low_c": 20.0, "high_c": 30.0, "accel_bias": slopes}


ZERO = [[0.0, 0.0, 0.0]] * 3


def diagonal(x, y, z):
    return [[x, 0, 0], [0, y, 0], [0, 0, z]]


def over_correlated(content):
    """Correlate two offsets twice as much as two equal numbers are."""
    covariance = content["gyro"]["covariance"]
    both = 2 * max(covariance[9][9], covariance[10][10])
    covariance[9][10] = covariance[10][9] = both


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (put("schema", value="other"), "schema"),
        (put("version", value=3), "version 3.*upgrade"),
        (put("version", value=10**400), "version 1000.*upgrade"),
        (put("version", value=0), "version"),
        (put("version", value="new"), "version"),
        (without("accel"), "accel is missing"),
        (without("accel", "b"), r"accel\.b is missing"),
        (put("accel", "K", 0, 0, value=float("nan")), r"accel\.K\.1\.1.*finite"),
        (put("gyro", "b", 1, value=float("inf")), r"gyro\.b\.2.*finite"),
        (put("accel", "K", value=ZERO), r"accel\.K.*between 0\.2 and 5"),
        (put("gyro", "K", value=[[1, 0, 0], [1, 0, 0], [0, 0, 1]]), "between"),
        (put("gyro", "K", value=diagonal(1, 1, 5.5)), "between"),
        (put("accel", "K", value=diagonal(1, 0.19, 1)), "between"),
        (put("accel", "K", value=diagonal(1e308, 1e308, 1)), "between"),
        (put("accel", "K", value=diagonal(1, 1, -1)), "wrong sign"),
        (put("accel", "b", 2, value=-25.0), r"accel: .*25.*m/s\^2"),
        (put("gyro", "b", 0, value=180.0), "gyro: .*180.*rad/s"),
        (put("accel", "covariance", 3, 4, value=7.0), "not symmetric"),
        (put("accel", "covariance", 3, 4, value=1e308), "not symmetric"),
        (put("accel", "covariance", 0, 0, value=-1.0), "negative variance"),
        (over_correlated, "negative in some direction"),
        (put("accel", "b_standard_uncertainty", 0, value=0.5), "not those of its covariance"),
        (put("accel", "covariance", value=[[0.0] * 12] * 11), r"covariance"),
        (put("surprise", value=1), "surprise"),
        (put("version", value=2.0), "version.*whole"),
        (put("version", value=True), "version.*whole"),
        (put("gyro", "b", 0, value=True), r"gyro\.b\.1"),
        (put("rate_hz", value="100"), "rate_hz"),
        (put("temperature_c", value=[50, -50]), "temperature_c: .*lower"),
        (put("poses", 0, "sigma", value=-1.0), r"poses\.1\.sigma"),
        (put("temperature", value=warming(1e300)), "temperature: .*per degree"),
        (put("temperature", value=warming(0.01, -1.0)), "standard_uncertainty"),
        (put("recording", "sha256", value="../../etc"), "sha256"),
        (put("date", value="2026-01-02T03:04:05"), "date"),
        (put("gravity", "value", value=1.0), "gravity"),
    ],
)
def test_a_wrong_content_is_refused_in_one_sentence(certificate, tmp_path, edit, words):
    path = tmp_path / "c.json"
    path.write_bytes(edited(certificate, edit))
    with pytest.raises(InputError, match=words) as caught:
        load_certificate(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not JSON"),
        (b"\x00\xff garbage", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b"[]", "schema"),
        (b"3", "schema"),
        (b" " * (MAXIMUM_BYTES + 1), "too large for"),
    ],
)
def test_what_is_no_certificate_is_refused(tmp_path, data, words):
    path = tmp_path / "c.json"
    path.write_bytes(data)
    with pytest.raises(InputError, match=words):
        load_certificate(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.json"):
        load_certificate(tmp_path / "none.json")
    with pytest.raises(InputError, match="no ordinary file"):
        load_certificate(tmp_path)


def test_a_certificate_cannot_be_changed(certificate):
    assert isinstance(certificate, Certificate)
    with pytest.raises(ValueError, match="frozen"):
        certificate.method = "other"


def test_whole_numbers_are_numbers_and_a_pose_may_lack_its_sigma(certificate, tmp_path):
    def edit(content):
        content["rate_hz"] = 100
        content["temperature_c"] = [20, 30]
        content["poses"][0]["sigma"] = None
        content["temperature"] = warming(0.01)

    path = tmp_path / "c.json"
    path.write_bytes(edited(certificate, edit))
    loaded = load_certificate(path)
    assert loaded.poses[0].sigma is None
    assert loaded.temperature_c == (20.0, 30.0)
    assert certificate_lines(loaded)
