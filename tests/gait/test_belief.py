"""A sensor is thought of as badly as it shows itself to be."""

from dataclasses import replace

import numpy as np
import pytest

from imu_rig.gait.belief import believed_grade, contradicts
from imu_rig.gait.bias import GyroBias
from imu_rig.gait.grade import SensorGrade
from imu_rig.units import DEG
from imu_rig.units import STANDARD_GRAVITY as G

CALIBRATED = SensorGrade(
    raw_odds=0.05, gyro_matrix=0.001, accel_matrix=0.001, accel_bias=0.03, late_s=0.001
)


def found(*bias_dps):
    return GyroBias(np.array(bias_dps) * DEG, np.eye(3) * (0.02 * DEG) ** 2, 0.5)


def test_a_sensor_in_order_is_what_it_was():
    assert believed_grade(SensorGrade(), found(0.02, 0.0, -0.05), 0.001, G) == SensorGrade()


@pytest.mark.parametrize(("bias", "misfit"), [((2.0, 0.1, -0.3), 0.0), ((0.0, 0.0, 0.0), 0.1)])
def test_a_raw_chip_is_as_its_data_sheet_allows(bias, misfit):
    grade = believed_grade(SensorGrade(), found(*bias), misfit, G)
    assert 0.01 < grade.gyro_matrix < 0.02
    assert 0.01 < grade.accel_matrix < 0.03
    assert 0.2 < grade.accel_bias < 0.8


def test_what_gravity_shows_is_possible_by_the_grade():
    grade = believed_grade(SensorGrade(), found(1.0, 1.0, 1.0), 0.12, G)
    assert 2.0 * np.hypot(grade.accel_matrix, grade.accel_bias / G) == pytest.approx(0.12, rel=0.01)


def test_a_certificate_is_believed_unless_gravity_contradicts_it():
    assert not contradicts(CALIBRATED, 0.01, G)
    assert believed_grade(CALIBRATED, found(1.0, 1.0, 1.0), 0.01, G) == CALIBRATED
    assert contradicts(CALIBRATED, 0.09, G)
    another = believed_grade(CALIBRATED, found(1.0, 1.0, 1.0), 0.09, G)
    raw = believed_grade(SensorGrade(), found(1.0, 1.0, 1.0), 0.09, G)
    assert another == raw
    certain = replace(CALIBRATED, raw_odds=0.0)
    assert contradicts(certain, 0.09, G)
