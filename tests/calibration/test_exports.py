"""Exports, applied as their readers apply them, against the calibration they came from.

The formulas of PX4 and ArduPilot are written down here once more, from their documentation.
"""

import csv
import dataclasses
import io
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from simulated_sessions import random_sensor

from imu_rig import rotation
from imu_rig.calibration.certificate import load_certificate
from imu_rig.calibration.certificate_magnetometer import MagEntry
from imu_rig.calibration.certificate_parts import AffineEntry
from imu_rig.calibration.exports import TARGETS, export_certificate
from imu_rig.calibration.exports.ardupilot import ardupilot
from imu_rig.calibration.exports.c_header import c_header
from imu_rig.calibration.exports.matlab import matlab
from imu_rig.calibration.exports.numpy_code import numpy_code
from imu_rig.calibration.exports.options import ExportOptions, parse_device_ids
from imu_rig.calibration.exports.px4 import px4
from imu_rig.calibration.exports.reduced import Reduced, diagonal, symmetric
from imu_rig.calibration.exports.source import Source
from imu_rig.calibration.exports.table import table
from imu_rig.calibration.model import Affine
from imu_rig.errors import InputError

G = 9.80665
DEG = np.pi / 180
STORED = Path(__file__).parents[1] / "data" / "certificate-v1.json"
NASTY = 'x */ #error "boom"\n#define B 1\r\\\u2028"""\n1\t1\tCAL_ACC0_XOFF\t9\t9 \u202e'


def exact(K, b):
    return Affine(np.asarray(K, float), np.asarray(b, float), np.zeros((12, 12)))


def symmetric_gain(rng):
    A = 0.1 * rng.standard_normal((3, 3))
    return np.eye(3) + (A + A.T) / 2


def storable(rng) -> Source:
    """A calibration that an autopilot holds without loss."""
    scale = 1 + 0.05 * rng.standard_normal(3)
    accel = exact(np.diag(scale), 0.3 * rng.standard_normal(3))
    gyro = exact(np.eye(3), 0.02 * rng.standard_normal(3))
    mag = exact(symmetric_gain(rng), 30 * rng.standard_normal(3))
    return Source(("a test",), accel, gyro, mag)


def ordinary(rng) -> Source:
    sensor = random_sensor(rng)
    return Source(("a test",), sensor.accel, sensor.gyro)


def px4_parameters(text):
    """Read as QGroundControl does: comments, or five columns by tabs."""
    found = {}
    for line in text.splitlines():
        if not line.startswith("#"):
            vehicle, component, name, value, kind = line.split("\t")
            assert (vehicle, component) == ("1", "1")
            assert kind in {"6", "9"}
            found[name] = int(value) if kind == "6" else np.float32(value)
    return found


def ardupilot_parameters(text):
    """Read as pymavlink's mavparm does."""
    found = {}
    for line in text.splitlines():
        if line and line[0] != "#":
            name, value = line.replace(",", " ").split()
            found[name] = np.float32(value)
    return found


def triple(parameters, pattern):
    return np.array([parameters[pattern.format(axis)] for axis in "XYZ"], dtype=float)


def px4_matrix(p):
    x, y, z = (p[f"CAL_MAG0_{a}ODIAG"] for a in "XYZ")
    sx, sy, sz = triple(p, "CAL_MAG0_{}SCALE")
    return np.array([[sx, x, y], [x, sy, z], [y, z, sz]], dtype=float)


@pytest.mark.parametrize("seed", range(5))
def test_px4_applies_what_the_calibration_says(seed):
    rng = np.random.default_rng(seed)
    source = storable(rng)
    p = px4_parameters(px4(source, ExportOptions()).text)
    raw = 20 * rng.standard_normal((50, 3))
    corrected = (raw - triple(p, "CAL_ACC0_{}OFF")) * triple(p, "CAL_ACC0_{}SCALE")
    assert corrected == pytest.approx(source.accel.apply(raw), abs=2e-5)
    rate = raw / 10 - triple(p, "CAL_GYRO0_{}OFF")
    assert rate == pytest.approx(source.gyro.apply(raw / 10), abs=1e-8)
    gauss = raw / 40  # of some 50 uT, which are 0.5 gauss
    field = (gauss - triple(p, "CAL_MAG0_{}OFF")) @ px4_matrix(p).T
    assert field == pytest.approx(source.mag.apply(gauss * 100) / 100, abs=1e-6)
    assert "CAL_GYRO0_XSCALE" not in p


@pytest.mark.parametrize("seed", range(5))
def test_ardupilot_applies_what_the_calibration_says(seed):
    rng = np.random.default_rng(seed)
    source = storable(rng)
    p = ardupilot_parameters(ardupilot(source, ExportOptions()).text)
    raw = 20 * rng.standard_normal((50, 3))
    corrected = (raw - triple(p, "INS_ACCOFFS_{}")) * triple(p, "INS_ACCSCAL_{}")
    assert corrected == pytest.approx(source.accel.apply(raw), abs=2e-5)
    rate = raw / 10 - triple(p, "INS_GYROFFS_{}")
    assert rate == pytest.approx(source.gyro.apply(raw / 10), abs=1e-8)
    milligauss = 25 * raw
    x, y, z = triple(p, "COMPASS_ODI_{}")
    dx, dy, dz = triple(p, "COMPASS_DIA_{}")
    M = np.array([[dx, x, y], [x, dy, z], [y, z, dz]])
    field = (milligauss + triple(p, "COMPASS_OFS_{}")) @ M.T  # added: the compass alone
    assert field == pytest.approx(source.mag.apply(milligauss / 10) * 10, abs=1e-3)


def test_the_offsets_have_the_signs_and_units_of_each_stack():
    accel = exact(np.diag([1.0, 1.0, 1.0]), [0.5, -0.25, 0.125])
    mag = exact(np.eye(3), [20.0, -10.0, 5.0])  # uT: 0.2, -0.1, 0.05 gauss
    source = Source((), accel, exact(np.eye(3), [0.01, 0.0, -0.01]), mag)
    p = px4_parameters(px4(source, ExportOptions()).text)
    assert triple(p, "CAL_ACC0_{}OFF") == pytest.approx([0.5, -0.25, 0.125])
    assert triple(p, "CAL_GYRO0_{}OFF") == pytest.approx([0.01, 0.0, -0.01])
    assert triple(p, "CAL_MAG0_{}OFF") == pytest.approx([0.2, -0.1, 0.05])
    a = ardupilot_parameters(ardupilot(source, ExportOptions()).text)
    assert triple(a, "INS_ACCOFFS_{}") == pytest.approx([0.5, -0.25, 0.125])
    assert triple(a, "COMPASS_OFS_{}") == pytest.approx([-200.0, 100.0, -50.0])


@pytest.mark.parametrize("target", [px4, ardupilot])
def test_a_loss_is_refused_with_its_size(target):
    lean = exact([[1, 0.01, 0], [0, 1, 0], [0, 0, 1]], [0.1, 0, 0])
    with pytest.raises(InputError, match=r"(?s)up to (\S+) mg.*--nearest") as caught:
        target(Source((), lean), ExportOptions())
    size = float(re.search(r"up to (\S+) mg", str(caught.value)).group(1))
    assert size == pytest.approx(10.0, rel=0.02)  # 0.01 g along y read as x
    gain = exact(np.diag([1.02, 1, 1]), [0.01, 0, 0])
    with pytest.raises(InputError, match=r"90 deg turn by up to 1\.76 deg"):  # 90 / 1.02
        target(Source((), exact(np.eye(3), [0.1, 0, 0]), gain), ExportOptions())


def test_the_nearest_diagonal_is_better_than_any_other():
    rng = np.random.default_rng(7)
    accel = random_sensor(rng).accel
    directions = rng.standard_normal((4000, 3))
    truth = G * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    truth = np.concatenate((truth, -truth))
    raw = accel.undo(truth)

    def rms(model):
        return np.sqrt(np.mean((model.apply(raw) - truth) ** 2))

    best = diagonal(accel)
    fitted = [np.polyfit(raw[:, i], truth[:, i], 1) for i in range(3)]
    assert np.diag(best.M) == pytest.approx([f[0] for f in fitted], rel=2e-3)
    assert rms(best) <= rms(Reduced(np.diag(np.diag(accel.K)), best.offset))
    for _ in range(20):
        other = np.diag(np.diag(best.M) * (1 + 0.003 * rng.standard_normal(3)))
        assert rms(Reduced(other, best.offset)) > rms(best)
    errors = np.linalg.norm(best.apply(raw) - truth, axis=1)
    worst = best.worst_error(accel, G)
    assert errors.max() <= worst < 1.01 * errors.max()


def test_the_nearest_symmetric_matrix_is_better_than_any_other():
    rng = np.random.default_rng(8)
    turn = rotation.to_matrix(rotation.from_rotation_vector(np.array([0.02, -0.03, 0.05])))
    mag = exact(turn @ symmetric_gain(rng), [10, 20, -5])
    best = symmetric(mag)
    assert np.allclose(best.M, best.M.T, atol=1e-15)
    for _ in range(20):
        A = 0.003 * rng.standard_normal((3, 3))
        other = best.M + A + A.T
        S = np.linalg.inv(mag.K)
        assert np.linalg.norm(other @ S - np.eye(3)) > np.linalg.norm(best.M @ S - np.eye(3))
    plain = exact(symmetric_gain(rng), [1, 2, 3])
    assert np.allclose(symmetric(plain).M, plain.K, atol=1e-12)


@pytest.mark.parametrize("target", [px4, ardupilot])
def test_the_nearest_export_says_what_was_lost(target):
    source = ordinary(np.random.default_rng(9))
    done = target(source, ExportOptions(nearest=True))
    comment = " ".join(line[2:] for line in done.text.splitlines() if line.startswith("#"))
    lost = done.loss.figures()
    assert f"{lost['accel_mg']:.3g} mg" in comment
    assert f"{lost['turn_90_deg']:.3g} deg" in comment
    assert "cross terms" in comment
    # by hand: scale 3 % and lean 2 % of a random sensor
    assert 10 < lost["accel_mg"] < 100
    assert 1 < lost["turn_90_deg"] < 15


def test_a_jig_frame_loses_its_turn_and_nothing_of_the_sensor():
    rng = np.random.default_rng(10)
    source = ordinary(rng)
    Q = rotation.to_matrix(rotation.from_rotation_vector(np.array([0.05, -0.02, 0.01])))
    turned = Source((), source.accel.rotated(Q), source.gyro.rotated(Q))
    options = ExportOptions(nearest=True)
    ours, theirs = px4(source, options), px4(turned, options)
    assert px4_parameters(ours.text) == px4_parameters(theirs.text)
    assert re.search(r"3\.\d\d deg", theirs.text)


def test_other_axes_permute_and_flip():
    scale, bias = np.array([1.01, 1.02, 1.03]), np.array([0.1, 0.2, 0.3])
    source = Source((), exact(np.diag(scale), scale * bias))
    p = px4_parameters(px4(source, ExportOptions(axes_text="y,-x,z")).text)
    assert triple(p, "CAL_ACC0_{}OFF") == pytest.approx([0.2, -0.1, 0.3])
    assert triple(p, "CAL_ACC0_{}SCALE") == pytest.approx([1.02, 1.01, 1.03])
    for wrong in ("x,y", "x,y,-z", "x,x,z", "x,y,q", "", "x,y,z,z", "--x,y,z"):
        with pytest.raises(InputError, match="right-handed"):
            px4(source, ExportOptions(axes_text=wrong))


def test_ids_and_slots_take_their_names():
    source = storable(np.random.default_rng(1))
    ids = parse_device_ids(["1310988", "mag=396825"])
    assert ids == {"accel": 1310988, "gyro": 1310988, "mag": 396825}
    p = px4_parameters(px4(source, ExportOptions(device_ids=ids, slot=2)).text)
    assert (p["CAL_ACC2_ID"], p["CAL_GYRO2_ID"], p["CAL_MAG2_ID"]) == (1310988, 1310988, 396825)
    a = ardupilot_parameters(ardupilot(source, ExportOptions(device_ids=ids, slot=1)).text)
    names = {"INS_ACC2_ID", "INS_GYR2_ID", "INS_ACC2OFFS_X", "INS_ACC2SCAL_Z", "INS_GYR2OFFS_Y"}
    names |= {"COMPASS_DEV_ID2", "COMPASS_OFS2_X", "COMPASS_DIA2_Y", "COMPASS_ODI2_Z"}
    assert names <= set(a)
    without = px4(source, ExportOptions())
    assert "_ID" not in "".join(px4_parameters(without.text))
    assert "CAL_ACC0_ID" in without.notes[0]
    for slot, target in ((4, px4), (3, ardupilot), (-1, px4)):
        with pytest.raises(InputError, match="sensors 0 to"):
            target(source, ExportOptions(slot=slot))


@pytest.mark.parametrize("text", ["0", "x", "baro=3", "accel=", "3000000000", "1e3", "=", "٣"])
def test_an_id_that_is_none_is_refused(text):
    with pytest.raises(InputError, match="--device-id"):
        parse_device_ids([text])


def test_values_that_a_stack_refuses_are_refused_here():
    wide = Source((), exact(np.diag([1.25, 1, 1]), [0.1, 0, 0]))
    assert "CAL_ACC0_XSCALE" in px4(wide, ExportOptions()).text
    with pytest.raises(InputError, match=r"INS_ACCSCAL_X from 0\.8 to 1\.2.*1\.25"):
        ardupilot(wide, ExportOptions())
    far = Source((), exact(np.eye(3), [0, -3.6, 0]))
    assert "CAL_ACC0_YOFF" in px4(far, ExportOptions()).text
    with pytest.raises(InputError, match=r"INS_ACCOFFS_Y.*-3\.5"):
        ardupilot(far, ExportOptions())
    with pytest.raises(InputError, match="CAL_ACC0_ZSCALE"):
        px4(Source((), exact(np.diag([1, 1, 3.2]), [0, 0, 0])), ExportOptions())


def test_ardupilot_never_gets_offsets_that_mean_not_calibrated():
    done = ardupilot(Source((), exact(np.diag([1.01, 1, 1]), [0, 0, 0])), ExportOptions())
    assert triple(ardupilot_parameters(done.text), "INS_ACCOFFS_{}") == pytest.approx([0.001, 0, 0])
    assert any("not calibrated" in note for note in done.notes)


def nasty_certificate():
    certificate = load_certificate(STORED)
    device = certificate.device.model_copy(update={"name": f"???/ {NASTY}", "serial": NASTY * 40})
    return certificate.model_copy(
        update={"device": device, "method": NASTY, "software": "coding: utf-7"}
    )


@pytest.mark.parametrize("target", TARGETS)
def test_texts_of_a_certificate_stay_in_their_comments(target):
    """What a name holds changes no line of an export but its comments."""
    options = ExportOptions(nearest=True)
    nice = export_certificate(load_certificate(STORED), target, options).text
    nasty = export_certificate(nasty_certificate(), target, options).text
    mark = {"c": " *", "matlab": "%"}.get(target, "#")

    def code(text):
        return [line for line in text.splitlines() if not line.startswith(mark)]

    assert code(nasty) == code(nice)
    assert nasty.isascii() or "\u2028" not in nasty
    if target == "c":
        assert nasty.count("*/") == nice.count("*/")


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
@pytest.mark.parametrize("real", ["float", "double"])
def test_the_c_header_compiles_and_calibrates(tmp_path, real):
    certificate = nasty_certificate()
    header = export_certificate(certificate, "c", ExportOptions(name="foot"))
    (tmp_path / "foot.h").write_text(header.text)
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "foot.h"\n#include "foot.h"\n'
        "int main(void) {\n"
        "    foot_real v[3] = {1.5, -9.25, 3.0};\n"
        "    foot_accel(v, v);\n"
        '    printf("%.17g %.17g %.17g ", (double)v[0], (double)v[1], (double)v[2]);\n'
        "    foot_gyro(v, v);\n"
        '    printf("%.17g %.17g %.17g", (double)v[0], (double)v[1], (double)v[2]);\n'
        "    return 0;\n}\n"
    )
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", f"-DFOOT_REAL={real}"]
    subprocess.run(["cc", *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    printed = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)
    first = certificate.accel.affine().apply(np.array([1.5, -9.25, 3.0]))
    second = certificate.gyro.affine().apply(first)
    tolerance = 1e-14 if real == "double" else 1e-6
    numbers = [float(number) for number in printed.stdout.split()]
    assert numbers == pytest.approx([*first, *second], rel=tolerance, abs=tolerance)


def test_the_numpy_module_runs_and_calibrates(tmp_path):
    certificate = nasty_certificate()
    (tmp_path / "foot.py").write_text(export_certificate(certificate, "numpy").text)
    program = (
        "import foot\n"
        "print(*foot.calibrate_accel([1.5, -9.25, 3.0]), end=' ')\n"
        "print(*foot.calibrate_gyro([[1, 2, 3]] * 2)[1])\n"
        "print(foot.accel_b_uncertainty.shape, foot.gyro_K_uncertainty.shape)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    numbers, shapes = done.stdout.splitlines()
    expected = [
        *certificate.accel.affine().apply(np.array([1.5, -9.25, 3.0])),
        *certificate.gyro.affine().apply(np.array([1.0, 2.0, 3.0])),
    ]
    assert [float(n) for n in numbers.split()] == pytest.approx(expected, rel=1e-14)
    assert shapes == "(3,) (3, 3)"


def test_the_matlab_script_holds_every_number():
    source = storable(np.random.default_rng(2))
    text = matlab(source, ExportOptions()).text
    for sensor, model in source.sensors.items():
        rows = re.search(rf"^{sensor}_K = \[(.*)\];$", text, re.M).group(1).split(";")
        assert np.array([row.split() for row in rows], float) == pytest.approx(model.K, abs=0)
        column = re.search(rf"^{sensor}_b = \[(.*)\];$", text, re.M).group(1).split(";")
        assert np.array(column, float) == pytest.approx(model.b, abs=0)
        assert f"calibrate_{sensor} = @(raw)" in text
    for line in text.splitlines():
        assert not line or line[0] == "%" or line.endswith(";")


def test_the_table_has_value_unit_and_uncertainty():
    certificate = load_certificate(STORED)
    rows = list(csv.DictReader(io.StringIO(export_certificate(certificate, "csv").text)))
    found = {row["parameter"]: row for row in rows}
    assert len(found) == len(rows)
    for sensor, unit in (("accel", "m/s^2"), ("gyro", "rad/s")):
        entry = getattr(certificate, sensor)
        for i, a in enumerate("xyz"):
            row = found[f"{sensor}_b_{a}"]
            assert (float(row["value"]), row["unit"]) == (entry.b[i], unit)
            assert float(row["standard_uncertainty"]) == entry.b_standard_uncertainty[i]
            for j, c in enumerate("xyz"):
                assert float(found[f"{sensor}_K_{a}{c}"]["value"]) == entry.K[i][j]
    assert found["accel_non_orthogonality_xy"]["unit"] == "rad"


def test_every_target_takes_an_accelerometer_alone():
    source = dataclasses.replace(storable(np.random.default_rng(3)), gyro=None, mag=None)
    for target in (px4, ardupilot, c_header, numpy_code, matlab, table):
        text = target(source, ExportOptions()).text
        assert "gyro" not in text.replace("gyro_calibrated,0.0", "").lower()


def with_nominal_accelerometer(certificate, method):
    """Its accelerometer as a method leaves it that did not calibrate it: data-sheet covariance."""
    nominal = Affine(np.eye(3), np.zeros(3), np.diag([0.03**2] * 9 + [0.5**2] * 3))
    return certificate.model_copy(update={"accel": AffineEntry.of(nominal), "method": method})


@pytest.mark.parametrize("method", ["turntable", "magnetometer"])
@pytest.mark.parametrize("target", TARGETS)
def test_what_was_not_calibrated_is_left_alone(method, target):
    certificate = with_nominal_accelerometer(with_magnetometer("dip", 0.0), method)
    if method == "magnetometer":
        certificate = certificate.model_copy(update={"gyro": None})
    options = ExportOptions(nearest=target in ("px4", "ardupilot"))
    done = export_certificate(certificate, target, options)
    assert not re.search(r"CAL_ACC|INS_ACC|accel_K|accel_b|accel\(|accel_bias", done.text)
    assert re.search(r"CAL_MAG|COMPASS|mag_K", done.text)
    assert bool(re.search(r"CAL_GYRO|INS_GYR|gyro_K", done.text)) == (method == "turntable")
    said = "accelerometer was not calibrated"
    assert sum(said in note for note in done.notes) == 1
    assert said in re.sub(r"\s[#*%]?\s*", " ", done.text) or "accel_calibrated,0.0," in done.text
    assert done.loss.accel is None
    assert "readings at rest" not in done.text


def test_a_certificate_of_nothing_is_refused():
    certificate = with_nominal_accelerometer(load_certificate(STORED), "turntable")
    with pytest.raises(InputError, match="nothing to export"):
        export_certificate(certificate.model_copy(update={"gyro": None}), "px4")


@pytest.mark.parametrize("target", [px4, ardupilot])
def test_what_is_not_lost_is_not_among_the_losses(target):
    source = storable(np.random.default_rng(5))  # a loss of the gyroscope alone
    source = dataclasses.replace(source, gyro=exact(np.diag([1.02, 1, 1]), [0.01, 0, 0]))
    with pytest.raises(InputError) as caught:
        target(source, ExportOptions())
    assert "falsify a 90 deg turn by up to" in str(caught.value)
    assert "mg" not in str(caught.value)
    assert "field" not in str(caught.value)


def with_magnetometer(alignment, turn):
    """The stored certificate with a magnetometer beside it, turned by ``turn`` rad about z."""
    certificate = load_certificate(STORED)
    R = rotation.about_z(np.array(turn))
    model = exact(R @ symmetric_gain(np.random.default_rng(4)), R @ [20.0, -10.0, 5.0])
    mag = MagEntry(
        affine=AffineEntry.of(model),
        alignment=alignment,
        field_ut=48.0,
        field_known=True,
        alignment_standard_uncertainty=None if alignment == "none" else 0.001,
        from_stills=True,
        count=24,
        before_percent=30.0,
        residual_percent=0.5,
        left_out_percent=0.6,
    )
    return certificate.model_copy(update={"mag": mag})


def test_the_magnetometer_of_a_certificate_is_exported():
    options = ExportOptions(nearest=True)
    held = export_certificate(with_magnetometer("dip", 0.0), "px4", options)
    assert "field_percent" in held.loss.figures()
    certificate = with_magnetometer("dip", 0.05)
    done = export_certificate(certificate, "px4", options)
    p = px4_parameters(done.text)
    model = certificate.mag.affine.affine()
    assert triple(p, "CAL_MAG0_{}OFF") == pytest.approx(np.linalg.solve(model.K, model.b) / 100)
    assert done.loss.field == pytest.approx(0.05, rel=0.1)  # the turn that no symmetry holds
    assert "turn of the magnetometer" in re.sub(r"\n# ", " ", done.text)
    for target, words in (
        ("c", "_mag("),
        ("numpy", "def calibrate_mag"),
        ("csv", "mag_cross_axis_zy"),
    ):
        assert words in export_certificate(certificate, target).text


def test_a_magnetometer_that_was_not_aligned_stays_in_its_own_axes():
    certificate = with_magnetometer("none", 0.0)
    done = export_certificate(certificate, "ardupilot", ExportOptions(nearest=True))
    assert done.loss.field == pytest.approx(0.0, abs=1e-9)
    assert any("not aligned" in note for note in done.notes)
    assert "mag_cross_axis_zy" not in export_certificate(certificate, "csv").text
    turned = Source.of(certificate)
    Q = rotation.about_z(np.array(0.1))
    turned = dataclasses.replace(turned, accel=turned.accel.rotated(Q))
    assert np.allclose(turned.in_sensor_frame()[0].mag.K, turned.mag.K)


def test_an_unknown_target_is_refused_with_those_there_are():
    with pytest.raises(InputError, match="px4, ardupilot"):
        export_certificate(load_certificate(STORED), "betaflight")
