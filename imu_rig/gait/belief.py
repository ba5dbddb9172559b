"""What to think of a sensor after a walk: what it showed of its errors, beside what was known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.gait.bias import GyroBias
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.trajectory import Footfalls
from imu_rig.kernels.foot_types import FootInputs
from imu_rig.units import DEG

CALIBRATED_BIAS = 0.1 * DEG
CALIBRATED_FORCE = 0.005
CALIBRATED_MATRIX = 0.003
CALIBRATED_ACCEL_BIAS = 0.03
"""A gyroscope's bias [rad/s], by which part of gravity an accelerometer errs at rest, elements of
gain and alignment, and an accelerometer's bias [m/s^2] of an industrial unit from its maker."""

RAW_MATRIX = 0.015
RAW_ACCEL_BIAS = 0.35
"""The same of chips as they are delivered: data sheets allow gains 3 percent, cross-axis
sensitivities 2 percent, and biases 50 to 80 mg, as limits; these are standard deviations."""

MATRIX_POWER = 0.55
"""Biases of a hundred times that go with gains and axes that are a dozen times worse: from
industrial units to chips as their data sheets allow them (3 deg/s and 3 percent)."""

USUAL = 2.0
"""What shows at rest may be so many standard deviations before these are taken to be larger."""

CERTAIN = 4.0
"""A certificate is doubted where gravity is wrong by so many of its standard uncertainties..."""
CREEPS = 0.01
"""... and by this part: a foot at rest is still accelerated by some hundredths of m/s^2, and local
gravity differs by a quarter of a percent from the standard one."""

ANOTHER = (
    "the accelerometer contradicts the certificate at rest: is it of another sensor, or its frame "
    "another one? The uncertainty is that of a sensor that was not calibrated"
)

REST_S = 0.05
"""The accelerometer at rest is averaged so far to either side [s]: a tenth of a second is quiet in
every stance of walking."""
RESTS = 3


def contradicts(grade: SensorGrade, misfit: float, gravity: float) -> bool:
    """Tell whether a calibrated sensor reads gravity so wrongly that it is hardly that sensor.

    Parameters
    ----------
    grade : SensorGrade
        Before the recording.
    misfit : float
        By which part of gravity the accelerometer errs at rest, as `force_misfit` finds it.
    gravity : float
        [m/s^2]
    """
    if grade.raw_odds >= SensorGrade().raw_odds:
        return False
    own = float(np.hypot(grade.accel_matrix, grade.accel_bias / gravity))
    return misfit > CREEPS + CERTAIN * own


def believed_grade(
    grade: SensorGrade, bias: GyroBias, misfit: float, gravity: float
) -> SensorGrade:
    """Return what to think of a sensor that showed itself worse than was thought of it.

    Of gains and axes a recording says little, and of an accelerometer's bias only what points up;
    but a sensor that is badly off in what does show is so in what does not. One that was
    calibrated is what its certificate says, unless it contradicts that: then it is another one, of
    which nothing is known.

    Parameters
    ----------
    grade : SensorGrade
        Before the recording.
    bias : GyroBias
    misfit : float
        By which part of gravity the accelerometer errs at rest, as `force_misfit` finds it. It may
        be gain, bias, or both.
    gravity : float
        [m/s^2]
    """
    if contradicts(grade, misfit, gravity):
        noises = grade.gyro_noise, grade.accel_noise
        grade = replace(SensorGrade(), gyro_noise=noises[0], accel_noise=noises[1])
    elif grade.raw_odds < SensorGrade().raw_odds:
        return grade
    turning = float(np.abs(bias.value).max())
    shown = max(1.0, turning / CALIBRATED_BIAS, misfit / CALIBRATED_FORCE) ** MATRIX_POWER
    matrix = min(shown * CALIBRATED_MATRIX, RAW_MATRIX)
    # From the one to the other the bias goes as the gains do.
    share = (matrix - CALIBRATED_MATRIX) / (RAW_MATRIX - CALIBRATED_MATRIX)
    offset = CALIBRATED_ACCEL_BIAS + share * (RAW_ACCEL_BIAS - CALIBRATED_ACCEL_BIAS)
    more = max(1.0, misfit / (USUAL * float(np.hypot(matrix, offset / gravity))))
    return replace(
        grade,
        gyro_matrix=max(grade.gyro_matrix, matrix),
        accel_matrix=max(grade.accel_matrix, more * matrix),
        accel_bias=max(grade.accel_bias, more * offset),
    )


def force_misfit(t: FloatArray, inputs: FootInputs, footfalls: Footfalls, gravity: float) -> float:
    """Return by which part of gravity the accelerometer errs where the foot rests.

    The middle of those `RESTS` footfalls around which it turns the least.
    """
    rows = footfalls.quietest
    if len(rows) == 0:
        return 0.0
    begin = np.searchsorted(t, t[rows] - REST_S)
    end = np.searchsorted(t, t[rows] + REST_S, side="right")

    def around(values: FloatArray) -> FloatArray:
        total = np.concatenate((np.zeros((1, 3)), np.cumsum(values, axis=0)))
        return np.asarray((total[end] - total[begin]) / (end - begin)[:, np.newaxis])

    turning = np.sqrt(around(np.square(inputs.gyro)).sum(axis=1))
    read = np.linalg.norm(around(inputs.accel), axis=1) / gravity
    return float(abs(np.median(read[np.argsort(turning)[:RESTS]]) - 1.0))
