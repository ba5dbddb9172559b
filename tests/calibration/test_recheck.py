"""A sensor against its certificate weeks later: what is unchanged passes, what drifted is named."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated_sessions import (
    DEG,
    MILLI_G,
    Recording,
    Truth,
    exact,
    jig_attitudes,
    random_sensor,
    record,
    spread_attitudes,
)

from imu_rig.calibration.certificate import Certificate, certificate_of
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.recheck import Recheck, other_device, recheck
from imu_rig.calibration.result import DeviceInfo
from imu_rig.calibration.solve import solve
from imu_rig.calibration.verification import Limits
from imu_rig.devices.jig import load_jig
from imu_rig.errors import InputError
from imu_rig.session.plan import plan_session
from imu_rig.session.protocol import load_protocol

CHECK = plan_session(load_protocol("check"), load_jig("paper-jig"))
POSES = [tuple(step.pose.angles().values()) for step in CHECK.steps]


@cache
def calibrated(seed: int, known_gravity: bool = True) -> tuple[Truth, Certificate]:
    rng = np.random.default_rng([seed, 3])
    sensor = random_sensor(rng)
    recording = record(spread_attitudes(24, rng), sensor, rng, rate=50.0, walk=0.004 * DEG)
    gravity = 9.80665 if known_gravity else None
    device = DeviceInfo("shoe", "17", "mpu9150-28")
    result = solve(recording.block, recording.holds, gravity=gravity, device=device)
    return sensor, certificate_of(result)


def later(
    sensor: Truth,
    seed: int = 0,
    *,
    bias: tuple[float, float, float] = (0, 0, 0),
    scale: tuple[float, float, float] = (0, 0, 0),
    gyro_scale: tuple[float, float, float] = (0, 0, 0),
    gyro_bias: tuple[float, float, float] = (0, 0, 0),
    poses: object = POSES,
) -> Recording:
    """Record the check on a sensor of which a bias [m/s^2, rad/s] or scale [1] changed."""

    def changed(gain: np.ndarray, share: tuple[float, float, float]) -> np.ndarray:
        return np.linalg.inv((np.eye(3) + np.diag(share)) @ np.linalg.inv(gain))

    now = Truth(
        exact(changed(sensor.accel.K, scale), sensor.accel.b + np.array(bias)),
        exact(changed(sensor.gyro.K, gyro_scale), sensor.gyro.b + np.array(gyro_bias)),
    )
    rng = np.random.default_rng([seed, 4])
    return record(jig_attitudes(poses), now, rng, rate=50.0, hold_s=1.7, walk=0.004 * DEG)


def found(certificate: Certificate, recording: Recording, **options: object) -> Recheck:
    return recheck(certificate, recording.block, recording.holds, **options)


def test_an_unchanged_sensor_passes_and_chance_is_called_chance() -> None:
    results = []
    for seed in range(6):
        sensor, certificate = calibrated(seed)
        results.append(found(certificate, later(sensor, seed)))
    assert all(result.verification.passed for result in results)
    rows = [row for result in results for row in result.drift]
    assert all(row.determined for row in rows)
    for sensor_name in ("accelerometer", "gyroscope"):
        z = np.array([row.change / row.sigma for row in rows if row.sensor == sensor_name])
        assert 0.5 < np.sqrt(np.mean(z**2)) < 1.35
    assert sum(row.drifted for row in rows) <= 1


@pytest.mark.parametrize(
    ("change", "name", "size"),
    [
        ({"bias": (0, 0, 5 * MILLI_G)}, "accelerometer bias z", 5 * MILLI_G),
        ({"bias": (-5 * MILLI_G, 0, 0)}, "accelerometer bias x", -5 * MILLI_G),
        ({"scale": (0, 0.003, 0)}, "accelerometer scale y", 0.003),
        ({"gyro_scale": (0.01, 0, 0)}, "gyroscope scale x", 0.01),
        ({"gyro_scale": (0, 0, -0.01)}, "gyroscope scale z", -0.01),
    ],
)
def test_a_drifted_sensor_fails_and_the_parameter_is_named(
    change: dict[str, tuple[float, float, float]], name: str, size: float
) -> None:
    sensor, certificate = calibrated(1)
    result = found(certificate, later(sensor, 1, **change))
    assert result.verification.state == "failed"
    drifted = {row.name: row for row in result.drift if row.drifted and not row.usual}
    assert set(drifted) == {name}
    row = drifted[name]
    assert row.change == pytest.approx(size, abs=4 * row.sigma + 0.1 * abs(size))
    assert row.sigmas > 5
    assert any(name in note and "more than" in note for note in result.notes)


def test_a_drift_that_sensors_usually_show_is_said_to_be_usual() -> None:
    sensor, certificate = calibrated(2)
    changed = later(sensor, 2, bias=(2 * MILLI_G, 0, 0), gyro_bias=(0, 0.1 * DEG, 0))
    result = found(certificate, changed, limits=Limits(accel=3 * MILLI_G))
    assert result.verification.passed
    drifted = {row.name for row in result.drift if row.drifted}
    assert drifted == {"accelerometer bias x", "gyroscope bias y"}
    assert any("within what sensors" in note for note in result.notes)
    # the default limit is tighter than what such sensors do
    assert found(certificate, changed).verification.state == "failed"


def test_what_the_poses_do_not_show_is_said_to_be_unknown() -> None:
    sensor, certificate = calibrated(3)
    flat = later(sensor, poses=[(0, 0, 0), (0, 30, 0), (0, 0, 0)])
    result = found(certificate, flat)
    unknown = {row.name for row in result.drift if not row.determined}
    assert {"accelerometer scale z", "gyroscope scale z", "gyroscope scale x"} <= unknown
    assert any("does not tell" in note and "gyroscope scale z" in note for note in result.notes)


def test_stills_of_a_recording_by_hand_are_found() -> None:
    sensor, certificate = calibrated(1)
    result = recheck(certificate, later(sensor, 1).block)
    assert result.verification.passed
    assert sum(row.kind == "pose" for row in result.verification.rows) == len(POSES)


def test_a_gyroscope_that_cannot_be_checked_is_no_pass() -> None:
    sensor, certificate = calibrated(1)
    recording = later(sensor, 1)
    silent = replace(recording.block, gyro=np.zeros_like(recording.block.gyro))
    result = recheck(certificate, silent, recording.holds)
    assert result.verification.state == "not verified"
    assert any("gyroscope shows nothing" in note for note in result.notes)
    accel_only = certificate.model_copy(update={"gyro": None})
    result = found(accel_only, recording)
    assert result.verification.passed
    assert {row.sensor for row in result.drift} == {"accelerometer"}


def test_another_temperature_is_mentioned() -> None:
    sensor, certificate = calibrated(1)
    recording = later(sensor, 1)
    warm = certificate.model_copy(update={"temperature_c": (20.0, 22.0)})
    temperature = np.full(len(recording.block), np.nan)
    temperature[::10] = 35.0  # as sensors send that measure it seldom
    block = replace(recording.block, temperature=temperature)
    result = recheck(warm, block, recording.holds)
    assert any("21 degC" in note and "35 degC" in note for note in result.notes)


def test_gravity_of_another_place_needs_a_certificate_that_knows_its_own() -> None:
    sensor, relative = calibrated(1, known_gravity=False)
    with pytest.raises(InputError, match="standard gravity"):
        found(relative, later(sensor, 1), gravity=Gravity.given(9.81))
    assert found(relative, later(sensor, 1)).verification.passed


@pytest.mark.parametrize(
    ("device", "words"),
    [
        (DeviceInfo("shoe", "18", "mpu9150-28"), "serial number 17"),
        (DeviceInfo("waist", "", "mpu9150-28"), "name shoe"),
        (DeviceInfo("shoe", "17", "mpu9150-burst-30"), "layout"),
        (DeviceInfo("shoe", "17", "mpu9150-28"), None),
        (DeviceInfo("renamed", "17", "mpu9150-28"), None),
        (DeviceInfo(), None),
    ],
)
def test_another_device_is_told_by_what_both_state(device: DeviceInfo, words: str | None) -> None:
    said = other_device(calibrated(1)[1].device, device)
    assert said is None if words is None else said is not None and words in said
