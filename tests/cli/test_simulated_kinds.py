"""Choosing a simulated IMU on the command line."""

import subprocess

import pytest
from program import PROGRAM


def test_an_unknown_kind_and_an_unspoken_layout_are_refused_with_what_there_is(inside):
    told = inside("simulate", "rig", "--imu", "gyroscope", code=2).stderr
    assert "--imu: there is no kind of IMU 'gyroscope'; take one of mpu9150, adis16405" in told
    told = inside("calibrate", "--simulate", "--layout", "baro-16", code=2).stderr
    assert "baro-16" in told


@pytest.mark.parametrize(
    ("kind", "options"),
    [("adis16405", "--layout adis16405-36"), ("two-imu-waist", "--layout two-imu --stream waist")],
)
def test_a_served_rig_says_how_to_calibrate_its_sensor(kind, options):
    with subprocess.Popen(
        [PROGRAM, "simulate", "rig", "--tcp", "--imu", kind], stdout=subprocess.PIPE, text=True
    ) as served:
        try:
            assert served.stdout is not None
            said = [served.stdout.readline() for _ in range(5)]
        finally:
            served.terminate()
    assert said[0].startswith("IMU      socket://")
    assert said[4].endswith(f"{options}\n")


def test_a_forecast_says_that_it_is_of_another_sensor(inside):
    words = "This is expected of an MPU-9150"
    plan = ("calibrate", "--dry-run", "--protocol", "quick")
    assert words in inside(*plan, "--layout", "adis16405-36").stdout
    assert words not in inside(*plan).stdout
