"""The certificate commands, run in process: what they print, write and refuse."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from imu_rig.calibration.accuracy import sphere_error
from imu_rig.calibration.certificate import Certificate, load_certificate
from imu_rig.calibration.certificate_magnetometer import MagEntry
from imu_rig.calibration.certificate_parts import (
    AffineEntry,
    CheckEntry,
    SlopesEntry,
    TemperatureEntry,
    VerificationEntry,
)
from imu_rig.calibration.compare import compare
from imu_rig.calibration.model import Affine
from imu_rig.calibration.noise_model import NoiseModel
from imu_rig.cli.commands import app
from imu_rig.errors import InputError
from imu_rig.units import MILLI_G

STORED = Path(__file__).parents[1] / "data" / "certificate-v1.json"


def run(*arguments: object) -> str:
    """Run `imu-rig certificate`; an error of the user's comes back as it was raised."""
    result = CliRunner().invoke(app, ["certificate", *map(str, arguments)])
    if result.exception is not None:
        raise result.exception
    return result.stdout


@pytest.fixture(scope="module")
def stored() -> Certificate:
    return load_certificate(STORED)


def changed(certificate, **parts) -> Certificate:
    return certificate.model_copy(update=parts)


def shifted(entry: AffineEntry, b=(0.0, 0.0, 0.0), factor=1.0) -> AffineEntry:
    model = entry.affine()
    covariance = factor**2 * model.covariance
    return AffineEntry.of(
        Affine(factor * model.K, factor * (model.b + np.array(b)), covariance, model.dof)
    )


def device(certificate, **fields):
    return changed(certificate, device=certificate.device.model_copy(update=fields))


def test_the_page_says_what_a_person_looks_for(stored):
    page = run("show", STORED)
    for words in (
        "foot, serial 007",
        "2026-11-22 09:00 UTC",
        "multi-position",
        "walk.imu-trial, 18 poses, 17 moves",
        "local gravity was not",
        "left out",
    ):
        assert words in page
    K, u = stored.accel.K[0][0], stored.accel.K_standard_uncertainty[0][0]
    assert f"{K:.5f} ± {u:.5f}" in page
    error = sphere_error(stored.accel.affine())
    assert f"{error.rms / MILLI_G:.2g} mg rms over all attitudes" in page
    assert f"{error.maximum / MILLI_G:.2g} mg at" in page
    assert max(map(len, page.splitlines())) <= 80
    assert run("show", STORED) == CliRunner().invoke(app, ["info", str(STORED)]).stdout


def test_the_page_shows_warnings_and_nothing_that_steers_a_terminal(stored, tmp_path):
    name = "foot\x1b[2J\n\u202egnp"
    file = tmp_path / "c.json"
    changed(device(stored, name=name), warnings=("Too\x07 warm.",), gyro=None).save(file)
    page = run("show", file)
    assert "! Too warm." in page
    assert "Gyroscope" not in page
    assert all(c.isprintable() or c == "\n" for c in page)


def test_the_page_names_angles_and_what_was_not_calibrated(stored, tmp_path):
    page = run("show", STORED)
    assert "lean" not in page
    assert "non-orthogonality [mrad]" in page
    assert "cross-axis [mrad]" in page
    nominal = AffineEntry.of(Affine(np.eye(3), np.zeros(3), 1e-4 * np.eye(12)))
    file = tmp_path / "c.json"
    changed(stored, accel=nominal, method="turntable").save(file)
    page = run("show", file)
    assert "Accelerometer: not calibrated" in page
    assert "Scaled to" not in page
    assert "non-orthogonality" not in page


def test_the_page_tells_how_checks_ended(stored, tmp_path):
    limits = {"limit": 0.01, "sigma_limit": 4.0}
    checks = (
        CheckEntry(kind="pose", name="a\x1b[2J", error=0.001, sigma=0.002, sigmas=0.5, **limits),
        CheckEntry(kind="move", name="a to b", error=0.001, sigma=0.002, sigmas=0.5, **limits),
        CheckEntry(kind="pose", name="c", error=0.05, sigma=0.002, sigmas=25.0, **limits),
    )
    verification = VerificationEntry(
        state="failed", accel_limit=0.01, turn_limit=0.01, sigma_limit=4.0, checks=checks
    )
    file = tmp_path / "c.json"
    changed(stored, verification=verification).save(file)
    page = run("show", file)
    assert "Verification FAILED: 1 of 3 checks" in page
    assert "5.099 mg, 25.0 std. dev. at most" in page  # 0.05 m/s^2
    assert "poses, magnitude: 1 of 2 FAILED" in page
    assert "moves, direction: 1 of 1 passed" in page
    assert max(map(len, page.splitlines())) <= 80
    assert all(c.isprintable() or c == "\n" for c in page)


def test_the_page_shows_temperature_and_noise(stored, tmp_path):
    slopes = SlopesEntry(value=(0.00980665, 0, 0), standard_uncertainty=(0.000980665,) * 3)
    term = TemperatureEntry(reference_c=25.0, low_c=20.0, high_c=31.5, accel_bias=slopes)
    one = {"value": 0.01, "standard_uncertainty": 0.001, "low": 0.008, "high": 0.012}
    names = ("white", "instability", "walk", "quantization", "ramp")
    axis = {**dict.fromkeys(names, one), "floor": 0.001, "floor_s": 100.0}
    noise = NoiseModel.model_validate(
        {
            "date": stored.date,
            "software": "test",
            "device": {"name": "foot\x1b[2J"},
            "rate_hz": 100.0,
            "duration_s": 3600.0,
            "accel": {"x": axis, "y": axis, "z": axis},
        }
    )
    file = tmp_path / "c.json"
    changed(stored, temperature=term, noise=noise).save(file)
    page = run("show", file)
    assert "hold at 25.0 degC" in page
    assert re.search(r"bias \[mg\] +x +1\.00 ± 0\.10 +y +0\.00 ± 0\.10", page)
    assert "Noise of foot" in page
    assert all(c.isprintable() or c == "\n" for c in page)
    answer = json.loads(run("export", file, "--to", "csv", "-o", tmp_path / "foot.csv", "--json"))
    assert ["25.0 degC" in note for note in answer["notes"]] == [True]


@pytest.mark.parametrize("alignment", ["dip", "none"])
def test_the_magnetometer_is_shown_and_compared(stored, tmp_path, alignment):
    aligned = alignment != "none"
    covariance = np.diag([1e-6] * 9 + [0.01] * 3)

    def magnetometer(bias):
        return MagEntry(
            affine=AffineEntry.of(Affine(np.eye(3), bias, covariance)),
            alignment=alignment,
            field_ut=48.0,
            field_known=False,
            dip=1.0 if aligned else None,
            dip_standard_uncertainty=0.01 if aligned else None,
            alignment_standard_uncertainty=0.005 if aligned else None,
            from_stills=True,
            count=24,
            before_percent=30.0,
            residual_percent=0.5,
            left_out_percent=0.625,
            notes=("Look\x1b out.",),
        )

    first = changed(stored, mag=magnetometer(np.array([20.0, 0.0, 0.0])))
    file = tmp_path / "c.json"
    first.save(file)
    page = run("show", file)
    assert "48.00 uT where the mean gain is taken as 1, from 24 still poses" in page
    assert "30.00 % raw, 0.50 % fitted, 0.62 % left out" in page
    assert ("57.30 ± 0.57 deg" in page) == aligned
    assert ("not aligned" in page) != aligned
    assert all(c.isprintable() or c == "\n" for c in page)
    assert json.loads(run("show", file, "--json"))["derived"]["mag"]["bias"][0] == 20.0
    found = compare(first, changed(stored, mag=magnetometer(np.array([20.0, 2.0, 0.0]))))
    assert [d.name for d in found.drifted if d.sensor == "magnetometer"] == ["bias y"] * aligned
    assert any("not aligned" in note for note in found.notes) != aligned


def test_json_holds_the_certificate_and_its_derived_figures(stored):
    answer = json.loads(run("show", STORED, "--json"))
    assert Certificate.model_validate(answer["certificate"]) == stored
    assert answer["derived"]["reading_at_rest"]["rms"] == sphere_error(stored.accel.affine()).rms
    assert len(answer["derived"]["gyro"]["cross_rad"]) == 6


def test_a_drift_is_found_and_named(stored, tmp_path):
    """The bias of y moves by ten of its standard uncertainties, and nothing else does."""
    sigma = stored.accel.b_standard_uncertainty[1]
    later = changed(stored, accel=shifted(stored.accel, (0.0, 10 * sigma * 2**0.5, 0.0)))
    later.save(tmp_path / "later.json")
    page = run("compare", STORED, tmp_path / "later.json")
    assert re.search(r"chance explains \(3 standard deviations\):\s+accelerometer bias y\.", page)
    assert page.count(" !\n") == 1
    answer = json.loads(run("compare", STORED, tmp_path / "later.json", "--json"))
    assert answer["drifted"] == ["accelerometer bias y"]
    row = next(p for p in answer["parameters"] if p["name"] == "bias y")
    assert row["standard_deviations"] == pytest.approx(10.0, rel=0.1)
    moved = 10 * sigma * 2**0.5
    assert answer["reading_at_rest_change"] == pytest.approx(moved, rel=1e-6)


def test_the_same_certificate_has_not_drifted(stored):
    found = compare(stored, stored)
    assert len(found.differences) == 21
    assert not found.drifted
    assert found.reading < 1e-9
    assert any("one recording" in note for note in found.notes)


def test_the_frame_of_a_calibration_is_no_drift(stored):
    c, s = np.cos(0.1), np.sin(0.1)
    Q = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned = changed(
        stored,
        frame="jig",
        accel=AffineEntry.of(stored.accel.affine().rotated(Q)),
        gyro=AffineEntry.of(stored.gyro.affine().rotated(Q)),
    )
    found = compare(stored, turned)
    assert max(abs(d.deviations) for d in found.differences) < 1e-3
    assert found.reading < 1e-6
    assert found.turn < 1e-9


def test_an_assumed_gravity_is_said_and_taken_out(stored):
    factor = 9.79 / stored.gravity.value
    gravity = stored.gravity.model_copy(
        update={"value": 9.79, "known": True, "source": "given\x1b[0m"}
    )
    local = changed(stored, gravity=gravity, accel=shifted(stored.accel, factor=factor))
    found = compare(stored, local)
    assert not found.drifted
    assert any("9.79000" in note for note in found.notes)
    both = compare(changed(stored, gravity=gravity), local)
    assert [d.name for d in both.drifted][:3] == ["scale x", "scale y", "scale z"]


def test_a_parameter_that_one_method_fixed_is_not_judged(stored):
    covariance = np.zeros((12, 12))
    fixed = changed(
        stored, accel=AffineEntry.of(Affine(np.eye(3), np.zeros(3), covariance)), method="paper"
    )
    found = compare(stored, fixed)
    assert not [d for d in found.drifted if d.sensor == "accelerometer"]
    assert any("different methods" in note for note in found.notes)


def test_two_devices_are_not_compared_unasked(stored, tmp_path):
    device(stored, serial="008").save(tmp_path / "other.json")
    with pytest.raises(InputError, match=r"two devices.*'007' and '008'"):
        run("compare", STORED, tmp_path / "other.json")
    page = run("compare", STORED, tmp_path / "other.json", "--any-device")
    assert "! They are of two devices" in page
    device(stored, serial="").save(tmp_path / "nameless.json")
    assert "! A serial number is missing" in run("compare", STORED, tmp_path / "nameless.json")
    assert any("names" in note for note in compare(stored, device(stored, name="hip")).notes)


@pytest.mark.parametrize("to", ["c", "numpy", "matlab", "csv"])
def test_export_writes_a_file_once(tmp_path, to):
    output = tmp_path / "foot_imu.out"
    answer = json.loads(run("export", STORED, "--to", to, "-o", output, "--json"))
    assert answer == {"file": str(output), "to": to, "lost": {}, "notes": []}
    if to == "c":
        assert "static inline void foot_imu_accel(" in output.read_text()
    before = output.read_bytes()
    with pytest.raises(InputError, match="never overwritten"):
        run("export", STORED, "--to", to, "-o", output)
    assert output.read_bytes() == before


def test_an_autopilot_gets_the_nearest_only_on_request(tmp_path):
    output = tmp_path / "foot.params"
    with pytest.raises(InputError, match="PX4 cannot hold cross terms"):
        run("export", STORED, "--to", "px4", "-o", output)
    assert not output.exists()
    answer = json.loads(
        run(
            "export", STORED, "--to", "px4", "-o", output, "--nearest", "--device-id", "1310988",
            "--slot", "1", "--axes", "x,-y,-z", "--json",
        )
    )  # fmt: skip
    assert answer["lost"]["accel_mg"] == pytest.approx(44.4, abs=0.1)
    text = output.read_text()
    assert "1\t1\tCAL_ACC1_ID\t1310988\t6\n" in text
    assert "1\t1\tCAL_GYRO1_ID\t1310988\t6\n" in text
    assert "x,-y,-z of the calibrated recording" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--to", "c", "--nearest"], "--nearest.*px4 and ardupilot"),
        (["--to", "csv", "--slot", "1"], "--slot"),
        (["--to", "betaflight"], "betaflight.*px4"),
        (["--to", "px4", "--nearest", "--device-id", "baro=1"], "--device-id 'baro=1'"),
        (["--to", "px4", "--nearest", "--slot", "9"], "0 to 3"),
        (["--to", "px4", "--nearest", "--axes", "x,y,-z"], "right-handed"),
    ],
)
def test_options_that_make_no_sense_are_refused(tmp_path, arguments, words):
    output = tmp_path / "out.txt"
    with pytest.raises(InputError, match=words):
        run("export", STORED, "-o", output, *arguments)
    assert not output.exists()


def test_a_matlab_script_gets_a_name_that_matlab_runs(tmp_path):
    with pytest.raises(InputError, match="letters, digits"):
        run("export", STORED, "--to", "matlab", "-o", tmp_path / "my-foot.m")
    for word in ("end", "endfunction"):
        with pytest.raises(InputError, match="no word of its language"):
            run("export", STORED, "--to", "matlab", "-o", tmp_path / f"{word}.m")


def test_a_c_name_is_made_of_any_file_name(tmp_path):
    run("export", STORED, "--to", "c", "-o", tmp_path / "7 발.h")
    assert "#ifndef IMU_7___H\n" in (tmp_path / "7 발.h").read_text()
