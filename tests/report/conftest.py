"""Synthetic calibrations whose truth, errors and uncertainties fit together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.model import Affine
from imu_rig.calibration.result import (
    CalibrationResult,
    DeviceInfo,
    ErrorStages,
    ErrorSummary,
    MoveRow,
    PoseRow,
)
from imu_rig.report.facts import Truth
from imu_rig.units import DEG, MILLI_G

NOISE = 0.15 * MILLI_G
MOVE_SIGMA = 0.08 * DEG


def true_sensor() -> Truth:
    return Truth(
        Affine(
            np.linalg.inv([[1.03, 0, 0], [0.012, 0.985, 0], [-0.008, 0.011, 1.021]]).T,
            np.array([0.41, -0.22, 0.63]),
            np.zeros((12, 12)),
        ),
        Affine(
            np.linalg.inv([[1.012, 0.013, -0.006], [0.004, 0.991, 0.009], [0.011, -0.015, 1.024]]),
            np.array([1.2, -2.8, 0.6]) * DEG,
            np.zeros((12, 12)),
        ),
    )


def estimate(
    rng: np.random.Generator, truth: Affine, gain: float, offset: float, *, upper: bool
) -> Affine:
    K_sigma = np.full((3, 3), gain)
    if upper:
        K_sigma = np.triu(K_sigma)
    sigma = np.concatenate((K_sigma.ravel(), np.full(3, offset)))
    error = rng.normal(size=12) * sigma
    return Affine(
        truth.K + error[:9].reshape(3, 3), truth.b + error[9:], np.diag(sigma**2), dof=38.0
    )


def spread_directions(count: int) -> np.ndarray:
    """Directions of a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    turn = np.pi * (1.0 + 5.0**0.5) * k
    flat = np.sqrt(1.0 - z**2)
    return np.stack((flat * np.cos(turn), flat * np.sin(turn), z), axis=1)


def synthetic_result(
    poses: int = 24,
    *,
    gyro: bool = True,
    held_out: bool = True,
    warnings: tuple[str, ...] = (),
    name: str = "foot-left",
    method: str = "multi-position",
    vector_errors: bool = False,
    directions: np.ndarray | None = None,
    seed: int = 3,
) -> CalibrationResult:
    rng = np.random.default_rng(seed)
    truth = true_sensor()
    assert truth.gyro is not None
    accel = estimate(rng, truth.accel, 7e-5, 0.06 * MILLI_G, upper=True)
    gravity = Gravity.at(47.37, 410.0)
    ups = spread_directions(poses)[rng.permutation(poses)] if directions is None else directions
    means = truth.accel.undo(gravity.value * ups) + rng.normal(size=(poses, 3)) * NOISE
    before = np.linalg.norm(means, axis=1) - gravity.value
    calibrated = accel.apply(means)
    after = np.linalg.norm(calibrated, axis=1) - gravity.value
    left_out_sigma = 1.6 * NOISE
    left_out = rng.normal(size=poses) * left_out_sigma
    pose_rows = tuple(
        PoseRow(
            name=f"pose {i + 1}",
            t0=100.0 + 3.4 * i,
            t1=102.0 + 3.4 * i,
            count=200,
            direction=calibrated[i] / np.linalg.norm(calibrated[i]),
            before=float(before[i]),
            after=float(after[i]),
            sigma=NOISE,
            left_out=float(left_out[i]) if held_out else None,
            left_out_sigma=left_out_sigma if held_out else None,
            commanded_deg=(0.0, float(i), -float(i)),
            vector_error=rng.normal(size=3) * 20 * MILLI_G if vector_errors else None,
        )
        for i in range(poses)
    )
    angles = rng.normal(size=(poses - 1, 2, 3)) * MOVE_SIGMA
    errors = np.linalg.norm(angles[:, :, :2], axis=2)
    move_rows = tuple(
        MoveRow(
            start=f"pose {i + 1}",
            stop=f"pose {i + 2}",
            angle_rad=float(rng.uniform(40.0, 170.0) * DEG),
            before_rad=float(rng.uniform(1.0, 6.0) * DEG),
            after_rad=float(errors[i, 0]),
            held_out_rad=float(errors[i, 1]) if held_out else None,
            sigma_rad=MOVE_SIGMA,
            vector_error=rng.normal(size=3) * DEG if vector_errors else None,
        )
        for i in range(poses - 1 if gyro else 0)
    )
    return CalibrationResult(
        method=method,
        device=DeviceInfo(name, "A-0417", "mpu9150-28"),
        gravity=gravity,
        frame="sensor",
        accel=accel,
        gyro=estimate(rng, truth.gyro, 9e-5, 0.0008 * DEG, upper=False) if gyro else None,
        poses=pose_rows,
        moves=move_rows,
        accel_errors=ErrorStages(
            ErrorSummary.of(before),
            ErrorSummary.of(after),
            ErrorSummary.of(left_out) if held_out else None,
        ),
        gyro_errors=ErrorStages(
            ErrorSummary.of(np.array([m.before_rad for m in move_rows])),
            ErrorSummary.of(np.array([m.after_rad for m in move_rows])),
            ErrorSummary.of(errors[:, 1]) if held_out else None,
        )
        if gyro
        else ErrorStages(),
        rate_hz=100.02,
        duration_s=3.4 * poses,
        temperature_c=(27.1, 28.4),
        warnings=warnings,
    )


@pytest.fixture(scope="session")
def make_result() -> Callable[..., CalibrationResult]:
    return synthetic_result


@pytest.fixture(scope="session")
def truth() -> Truth:
    return true_sensor()
