"""Units nobody stated: asked for with a good guess; stated wrongly: refused."""

import re

import numpy as np
import pytest

from imu_rig import rotation
from imu_rig.calibration.solve import solve
from imu_rig.errors import InputError
from imu_rig.importing.column_map import make_column_map
from imu_rig.importing.read_table import read_table

DEG = np.pi / 180
G = 9.80665
NAMES = "ax,ay,az,gx,gy,gz"


@pytest.fixture(scope="module")
def session():
    """Rests in ten attitudes with turns between them, 100 Hz, m/s^2 and rad/s, shape (n, 6)."""
    rng = np.random.default_rng(3)
    q, rows = np.array([1.0, 0, 0, 0]), []
    for _ in range(10):
        up = rotation.rotate(rotation.conjugate(q), np.array([0, 0, G]))
        rows += [np.r_[up, 0, 0, 0]] * 250
        axis = rng.standard_normal(3)
        theta = axis / np.linalg.norm(axis) * rng.uniform(60, 120) * DEG
        for share in (1 - np.cos(2 * np.pi * (np.arange(100) + 0.5) / 100)) / 100:
            q = rotation.multiply(q, rotation.from_rotation_vector(theta * share))
            up = rotation.rotate(rotation.conjugate(q), np.array([0, 0, G]))
            rows.append(np.r_[up, theta * share * 100])
    bias = np.array([0.3, -0.2, 0.1, 0.02, -0.01, 0.03])
    table = np.array(rows) + bias
    return table + rng.standard_normal(table.shape) * np.repeat([0.02, 0.001], 3)


def table(tmp_path, data):
    path = tmp_path / "log.csv"
    np.savetxt(path, data, fmt="%.7g", delimiter=",", header=NAMES, comments="")
    return path


def refusal(path, **options):
    with pytest.raises(InputError) as caught:
        read_table(path, make_column_map({"rate_hz": 100} | options, "options"))
    return str(caught.value)


@pytest.mark.parametrize(
    ("accel", "gyro"),
    [
        (("m/s2", 1), ("rad/s", 1)),
        (("g", G), ("deg/s", DEG)),
        (("mg", G / 1000), ("mdps", DEG / 1000)),
        (("'16384 LSB/g'", G / 16384), ("'131 LSB/(deg/s)'", DEG / 131)),
        (("'4096 LSB/g'", G / 4096), ("'32.8 LSB/(deg/s)'", DEG / 32.8)),
        (("'2048 LSB/g'", G / 2048), ("'16.4 LSB/(deg/s)'", DEG / 16.4)),
    ],
)
def test_the_guess_is_right_and_following_it_works(tmp_path, session, accel, gyro):
    path = table(tmp_path, session / np.repeat([accel[1], gyro[1]], 3))
    message = refusal(path)
    assert message.endswith(f"add --accel-unit {accel[0]} --gyro-unit {gyro[0]}")
    stated = {"accel_unit": accel[0].strip("'"), "gyro_unit": gyro[0].strip("'"), "rate_hz": 100}
    block = read_table(path, make_column_map(stated, "options"))
    assert np.allclose(block.accel, session[:, :3], atol=2e-3)
    assert np.allclose(block.gyro, session[:, 3:], atol=2e-4)


def test_only_what_is_missing_is_asked_for(tmp_path, session):
    path = table(tmp_path, session)
    assert refusal(path, accel_unit="m/s2").endswith("add --gyro-unit rad/s")
    message = refusal(path, gyro_unit="rad/s")
    assert message.endswith("add --accel-unit m/s2")
    assert "at rest the accelerometer reads 9." in message


def test_what_cannot_be_guessed_is_asked_for_all_the_same(tmp_path, session):
    still = table(tmp_path, session[:250])
    message = refusal(still)
    assert "--accel-unit m/s2 --gyro-unit <unit>" in message
    assert re.search(r"\(one of .*rad/s.*deg/s.*LSB", message)
    strange = table(tmp_path, session * np.repeat([37.0, 1.0], 3))
    assert "no usual unit" in refusal(strange)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"accel_unit": "g", "gyro_unit": "rad/s"},
            ["stated in g", "reads 9.", "--accel-unit m/s2"],
        ),
        ({"accel_unit": "mg", "gyro_unit": "rad/s"}, ["stated in mg", "--accel-unit m/s2"]),
        ({"accel_unit": "m/s2", "gyro_unit": "deg/s"}, ["in deg/s", "--gyro-unit rad/s"]),
        ({"accel_unit": "m/s2", "gyro_unit": "rad/s", "rate_hz": 50}, ["50 Hz", "rate were 100"]),
        ({"accel_unit": "m/s2", "gyro_unit": "rad/s", "rate_hz": 200}, ["200 Hz", "rate were 100"]),
    ],
)
def test_a_stated_unit_or_rate_that_gravity_contradicts_is_refused(
    tmp_path, session, options, words
):
    message = refusal(table(tmp_path, session), **options)
    assert all(word in message for word in words), message


def test_a_wrong_range_setting_is_refused(tmp_path, session):
    path = table(tmp_path, session / np.repeat([1.0, DEG / 131], 3))
    message = refusal(path, accel_unit="m/s2", gyro_unit="65.5 LSB/(deg/s)")
    assert "--gyro-unit '131 LSB/(deg/s)'" in message


def imported(path, **options):
    return read_table(path, make_column_map(options, "options"))


def test_public_recordings(imu_rig_data):
    folder = imu_rig_data / "calibration"
    log = folder / "mikoff_mpu9150" / "imu0.log"
    with pytest.raises(InputError, match="--columns ax,ay,az,gx,gy,gz"):
        imported(log)
    with pytest.raises(InputError, match="--accel-unit m/s2 --gyro-unit rad/s"):
        imported(log, columns=NAMES, rate_hz=100)
    block = imported(log, columns=NAMES, rate_hz=100, accel_unit="m/s2", gyro_unit="rad/s")
    assert len(block) == 15969
    assert len(solve(block).poses) >= 20

    counts = folder / "tomisuarez2_mpu6050" / "example_data_calibration.csv"
    with pytest.raises(InputError, match="preamble says 'Fs,100'"):
        imported(counts)
    with pytest.raises(InputError, match="'16384 LSB/g' --gyro-unit '131 LSB"):
        imported(counts, rate_hz=100)
    block = imported(counts, rate_hz=100, accel_unit="16384 LSB/g", gyro_unit="131 LSB/(deg/s)")
    assert len(block) == 10245

    ferraris = folder / "imucal" / "example_ferraris_session.csv"
    units = {"accel_unit": "m/s2", "gyro_unit": "deg/s"}
    assert len(imported(ferraris, rate_hz=102.4, **units)) == 10376
    # An old example of its tool states twice the true rate.
    with pytest.raises(InputError, match=r"rate were 102\.4 Hz"):
        imported(ferraris, rate_hz=204.8, **units)

    annotated = folder / "imucal" / "annotated_session.csv"
    block = imported(
        annotated, rate_hz=204.8, accel_unit="2048 LSB/g", gyro_unit="16.4 LSB/(deg/s)"
    )
    assert len(block) == 9414
    field = imported(
        folder / "ck_explorer_mag" / "acc_mag_log.csv",
        rate_hz=100,
        accel_unit="g",
        mag_unit="gauss",
    )
    assert field.mag is not None
    assert not np.any(field.gyro)
