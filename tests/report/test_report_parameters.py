"""Parameters in human units, judged against the truth whatever frame either is expressed in."""

from dataclasses import replace

import numpy as np
import pytest

from imu_rig import rotation
from imu_rig.calibration.model import Affine
from imu_rig.report.facts import Truth
from imu_rig.report.figures import pose_numbers
from imu_rig.report.parameters import compare_with_truth, sensors
from imu_rig.report.sphere import CENTRES, RADIUS, project
from imu_rig.units import DEG, MILLI_G


def test_the_truth_itself_has_no_error(make_result, truth):
    result = replace(
        make_result(),
        accel=replace(truth.accel, covariance=np.eye(12) * 1e-8),
        gyro=replace(truth.gyro, covariance=np.eye(12) * 1e-8),
    )
    found = sensors(result, truth)
    assert [len(sensor.parameters) for sensor in found] == [9, 12]
    for parameter in (p for sensor in found for p in sensor.parameters):
        assert parameter.truth == pytest.approx(parameter.value, abs=1e-9)
    assert compare_with_truth(found).inside == 21


def test_errors_do_not_depend_on_the_frame_of_the_estimate_or_of_the_truth(make_result, truth):
    result = make_result()
    Q = rotation.about_z(0.7) @ rotation.about_y(-1.1) @ rotation.about_x(2.0)
    turned = replace(result, accel=result.accel.rotated(Q), gyro=result.gyro.rotated(Q))
    turned_truth = Truth(truth.accel.rotated(Q.T), truth.gyro.rotated(Q.T))
    reference = [p.error_in_uncertainties for s in sensors(result, truth) for p in s.parameters]
    for other in (sensors(turned, truth), sensors(result, turned_truth)):
        ratios = [p.error_in_uncertainties for s in other for p in s.parameters]
        np.testing.assert_allclose(ratios, reference, atol=1e-4)


def test_units_are_those_of_the_sensor(make_result):
    """A sensor that reads 2 % too much on x, with 30 mg of bias, says so."""
    accel = Affine(
        np.diag([1 / 1.02, 1.0, 1.0]), np.array([0.0, 0.0, 30 * MILLI_G]), np.eye(12) * 1e-10
    )
    gyro = Affine(np.eye(3), np.array([0.0, 1.5 * DEG, 0.0]), np.eye(12) * 1e-10)
    accelerometer, gyroscope = sensors(replace(make_result(), accel=accel, gyro=gyro))
    assert accelerometer.scale.parameters[0].value == pytest.approx(2.0)
    assert accelerometer.bias.parameters[2].value == pytest.approx(30.0)
    # The bias is inverse(K) @ b, so the uncertain gain takes part by b times its uncertainty.
    expected = 1e-5 * np.hypot(1.0, 30 * MILLI_G) / MILLI_G
    assert accelerometer.bias.parameters[2].uncertainty == pytest.approx(expected)
    assert gyroscope.bias.parameters[1].value == pytest.approx(1.5)
    assert (accelerometer.bias.unit, gyroscope.bias.unit) == ("mg", "deg/s")


def test_what_a_method_fixed_is_neither_uncertain_nor_judged(make_result, truth):
    covariance = np.diag([1e-8, 0, 0, 0, 1e-8, 0, 0, 0, 1e-8, 1e-8, 1e-8, 1e-8])
    accel = Affine(np.diag([0.98, 1.01, 0.99]), np.zeros(3), covariance)
    found = sensors(replace(make_result(gyro=False), accel=accel), truth)
    leans = found[0].directions
    assert all(parameter.is_fixed for parameter in leans.parameters)
    assert all(parameter.holds_truth is None for parameter in leans.parameters)
    assert compare_with_truth(found).compared == 6


def test_intervals_widen_with_few_degrees_of_freedom(make_result):
    result = make_result(gyro=False)
    few = replace(result, accel=Affine(result.accel.K, result.accel.b, result.accel.covariance, 4))
    (wide,), (narrow,) = sensors(few), sensors(result)
    ratio = wide.scale.parameters[0].half_width / wide.scale.parameters[0].uncertainty
    assert ratio == pytest.approx(2.776, rel=0.01)
    assert wide.scale.parameters[0].half_width > narrow.scale.parameters[0].half_width


def test_poses_keep_the_numbers_of_their_names(make_result):
    poses = make_result(4).poses
    assert pose_numbers(poses) == [1, 2, 3, 4]
    assert pose_numbers(poses[1:]) == [2, 3, 4]
    assert pose_numbers((poses[2], poses[0])) == [1, 2]
    assert pose_numbers([replace(pose, name="z up") for pose in poses]) == [1, 2, 3, 4]


def test_the_projection_keeps_areas_and_hemispheres():
    z = np.linspace(-1.0, 1.0, 41)
    flat = np.sqrt(1.0 - z**2)
    places = project(np.stack((flat * np.cos(1.0), flat * np.sin(1.0), z), axis=1))
    centres = np.array(CENTRES)[np.where(z >= 0.0, 0, 1)]
    radius = np.hypot(*(places - centres).T)
    # A cap's share of the hemisphere is 1 - |z|; its share of the disc must be the same.
    np.testing.assert_allclose((radius / RADIUS) ** 2, 1.0 - np.abs(z), atol=1e-12)
    aside = project(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])) - CENTRES[0]
    np.testing.assert_allclose(aside, [[RADIUS, 0.0], [0.0, RADIUS]], atol=1e-9)
