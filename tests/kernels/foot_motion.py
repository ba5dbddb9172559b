"""Readings for the filter's tests: a smooth motion that rests now and then, with sensor errors."""

from __future__ import annotations

import numpy as np

from imu_rig.kernels.foot_types import FootInputs, FootModel, FootState

MODEL = FootModel(
    gravity=9.81,
    gyro_noise=5e-4,
    gyro_motion=3e-3,
    accel_noise=2e-2,
    accel_motion=1.5e-2,
    tilt_prior=0.02,
    velocity_prior=0.05,
    gyro_bias_prior=np.array([0.01, 0.012, 0.008]),
    gyro_bias_walk=1e-5,
    accel_bias_prior=0.05,
    accel_bias_walk=1e-4,
    pivot_prior=np.array([0.01, -0.02, 0.08]),
    pivot_sigma=0.03,
    gate=3.0,
)


def readings(seed: int = 1, n: int = 400, rate: float = 100.0, rest: bool = True) -> FootInputs:
    """Return plausible readings with jittery and equal stamps; every kind of update occurs."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.5, 1.5, n) / rate
    dt[0] = dt[n // 3] = 0.0
    t = np.cumsum(dt)
    swing = np.sin(np.pi * t) ** 2 > 0.5
    gyro = swing[:, None] * 3.0 * np.sin(2 * np.pi * t[:, None] + [0.0, 1.0, 2.0])
    accel = swing[:, None] * 8.0 * np.sin(2 * np.pi * t[:, None] + [2.0, 0.5, 1.0])
    gyro += [0.01, -0.01, 0.005] + 0.02 * rng.standard_normal((n, 3))
    accel += [0.3, -0.2, 9.8] + 0.05 * rng.standard_normal((n, 3))
    velocity_sigma = np.where(swing, np.inf, 0.02)
    rest_sigma = np.where(swing | (t > 1.0) | (not rest), np.inf, 0.01)
    floor_sigma = np.where(swing | (np.arange(n) % 7 != 0), np.nan, 0.005)
    floor_step = np.zeros(n)
    floor_step[1:] = np.where(swing[:-1] & ~swing[1:], 0.01, 0.0)
    gap = np.zeros(n)
    gap[n // 2] = 0.05
    q0 = np.array([0.999, 0.02, -0.01, 0.03])
    return FootInputs(
        dt, gyro, accel, velocity_sigma, rest_sigma, floor_sigma, floor_step,
        q0 / np.linalg.norm(q0), np.array([0.02, -0.01, 0.0]), gap, 2.0 * gap,
    )  # fmt: skip


def known(inputs: FootInputs, model: FootModel = MODEL) -> FootState:
    """Return a first state with a covariance that is full and can be inverted."""
    sigma = np.concatenate(
        (
            [model.tilt_prior, model.tilt_prior, 0.01],
            np.full(3, model.velocity_prior),
            [0.02],
            np.full(3, model.pivot_sigma),
            np.full(3, model.accel_bias_prior),
            model.gyro_bias_prior,
        )
    )
    mix = np.random.default_rng(5).standard_normal((16, 16))
    correlation = mix @ mix.T + 16 * np.eye(16)
    correlation /= np.sqrt(np.outer(np.diag(correlation), np.diag(correlation)))
    zero = np.zeros(3)
    return FootState(
        inputs.q0, inputs.v0, zero, 0.0, model.pivot_prior, zero, zero,
        correlation * np.outer(sigma, sigma), inputs.gyro[0], inputs.accel[0],
    )  # fmt: skip
