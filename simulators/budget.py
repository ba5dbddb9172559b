"""Draws the truth of a rig from error budgets: which servos, which sensor, which clock."""

from __future__ import annotations

import numpy as np

from imu_rig.units import DEG, MILLI_G
from simulators.models import (
    FirmwareModel,
    JigModel,
    Matrix3,
    Model,
    NotNegative,
    SensorModel,
    ServoModel,
    Vector3,
)

CLOCK_RANGE_S = 2**32 * 1e-6  # a microsecond clock of 32 bits comes round after this time


class Budget(Model):
    """How wrong the parts of a rig may be.

    Jig errors are standard deviations of normal distributions, sensor errors the tolerances of a
    data sheet, taken as limits of uniform distributions.

    Attributes
    ----------
    servo_gain, servo_zero_deg, axis_skew_deg, base_tilt_deg, mounting_deg : float
        Standard deviations, per axis.
    scale, cross_axis : float
        Limits of the diagonal and the other elements of a sensor's sensitivity, less identity.
    accel_bias_mg : x, y, z
    gyro_bias_dps : float
        The data sheet allows 20.
    soft_iron, hard_iron_ut : float
        Limits of the magnetometer's errors.
    skew_ppm : float
        Standard deviation of the device clock's rate.
    """

    servo_gain: NotNegative = 0.02
    servo_zero_deg: NotNegative = 2.0
    axis_skew_deg: NotNegative = 1.0
    base_tilt_deg: NotNegative = 1.0
    mounting_deg: NotNegative = 3.0
    scale: NotNegative = 0.03
    cross_axis: NotNegative = 0.02
    accel_bias_mg: Vector3 = (50.0, 50.0, 80.0)
    gyro_bias_dps: NotNegative = 3.0
    soft_iron: NotNegative = 0.1
    hard_iron_ut: NotNegative = 50.0
    skew_ppm: NotNegative = 30.0


def draw_jig(rng: np.random.Generator, budget: Budget) -> JigModel:
    """Draw the geometry errors of a jig."""
    usual = JigModel()

    def servo(axis: ServoModel) -> ServoModel:
        return axis.model_copy(
            update={
                "gain_error": float(rng.normal(0.0, budget.servo_gain)),
                "zero_deg": float(rng.normal(0.0, budget.servo_zero_deg)),
                "sine_phase_deg": float(rng.uniform(-180.0, 180.0)),
            }
        )

    pan, tilt, roll = servo(usual.pan), servo(usual.tilt), servo(usual.roll)
    base = rng.normal(0.0, budget.base_tilt_deg, 2)
    skew = rng.normal(0.0, budget.axis_skew_deg, 2)
    return JigModel(
        pan=pan,
        tilt=tilt,
        roll=roll,
        base_tilt_deg=(float(base[0]), float(base[1])),
        tilt_skew_deg=float(skew[0]),
        roll_skew_deg=float(skew[1]),
        mounting_deg=_vector(rng.normal(0.0, budget.mounting_deg, 3)),
        lever_arm_m=_vector(rng.normal(0.0, 0.02, 3)),
    )


def draw_sensor(
    rng: np.random.Generator, budget: Budget, usual: SensorModel | None = None
) -> SensorModel:
    """Draw the gains and offsets of a sensor with the noise and drift of a usual one."""

    def triad(
        scale: float, cross: float, limits: np.ndarray[tuple[int], np.dtype[np.float64]]
    ) -> tuple[Matrix3, Vector3]:
        sensitivity = np.eye(3) + rng.uniform(-cross, cross, (3, 3))
        np.fill_diagonal(sensitivity, 1.0 + rng.uniform(-scale, scale, 3))
        gain = np.linalg.inv(sensitivity)
        offset = gain @ rng.uniform(-limits, limits)
        return (_vector(gain[0]), _vector(gain[1]), _vector(gain[2])), _vector(offset)

    accel = triad(budget.scale, budget.cross_axis, np.array(budget.accel_bias_mg) * MILLI_G)
    gyro = triad(budget.scale, budget.cross_axis, np.full(3, budget.gyro_bias_dps * DEG))
    mag = triad(budget.soft_iron, budget.soft_iron / 2, np.full(3, budget.hard_iron_ut))
    return (usual or SensorModel()).model_copy(
        update={
            "accel_gain": accel[0],
            "accel_offset": accel[1],
            "gyro_gain": gyro[0],
            "gyro_offset": gyro[1],
            "mag_gain": mag[0],
            "mag_offset": mag[1],
        }
    )


def draw_firmware(
    rng: np.random.Generator, budget: Budget, usual: FirmwareModel | None = None
) -> FirmwareModel:
    """Draw a device clock for a usual way from device to host."""
    return (usual or FirmwareModel()).model_copy(
        update={
            "skew_ppm": float(rng.normal(0.0, budget.skew_ppm)),
            "clock_offset_s": float(rng.uniform(0.0, CLOCK_RANGE_S)),
        }
    )


def _vector(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Vector3:
    x, y, z = (float(v) for v in values)
    return x, y, z
