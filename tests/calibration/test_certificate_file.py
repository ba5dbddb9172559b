"""The certificate on disk: written whole, read back, refused with one sentence."""

import json
import os
from datetime import UTC, datetime

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
from imu_rig.calibration.result import DeviceInfo
from imu_rig.calibration.solve import solve
from imu_rig.errors import InputError, StorageError

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
    assert content["version"] == 1
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


ZERO = [[0.0, 0.0, 0.0]] * 3


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (put("schema", value="other"), "schema"),
        (put("version", value=2), "version 2.*upgrade"),
        (put("version", value="new"), "version"),
        (without("accel"), "accel.*required"),
        (without("accel", "b"), r"accel\.b.*required"),
        (put("accel", "K", 0, 0, value=float("nan")), r"accel\.K\.0\.0.*finite"),
        (put("gyro", "b", 1, value=float("inf")), r"gyro\.b\.1.*finite"),
        (put("accel", "K", value=ZERO), "singular"),
        (put("gyro", "K", value=[[1, 0, 0], [1, 0, 0], [0, 0, 1]]), "singular"),
        (put("accel", "covariance", 3, 4, value=7.0), "not symmetric"),
        (put("accel", "covariance", 0, 0, value=-1.0), "negative"),
        (put("accel", "covariance", value=[[0.0] * 12] * 11), r"covariance"),
        (put("surprise", value=1), "surprise"),
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
    with pytest.raises(InputError, match="no such file"):
        load_certificate(tmp_path)


def test_a_certificate_cannot_be_changed(certificate):
    assert isinstance(certificate, Certificate)
    with pytest.raises(ValueError, match="frozen"):
        certificate.method = "other"
