"""What the foot filter reads, made of readings, a detector's word and the options."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.level import FREE_M
from imu_rig.gait.options import FootOptions
from imu_rig.gait.unseen import Unseen
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.kernels.foot_types import FootInputs, FootModel
from imu_rig.units import DEG

WIDE_BIAS = 1.0 * DEG
"""Prior of the gyroscope's bias in the first pass [rad/s]: what is left of one found in stills,
or that of an uncalibrated sensor in a recording without stills."""


def foot_inputs(
    t: FloatArray,
    accel: FloatArray,
    gyro: FloatArray,
    zero_velocity: ZeroVelocity,
    first: FloatArray,
    options: FootOptions,
    unseen: Unseen | None = None,
) -> FootInputs:
    """Return what the filter reads, without any floor.

    Parameters
    ----------
    t : shape (n,)
        Times [s], at least two, never decreasing.
    accel, gyro : shape (n, 3)
        [m/s^2], and [rad/s] without bias.
    zero_velocity : ZeroVelocity
    first : shape (4,)
        Attitude at the first sample.
    options : FootOptions
    unseen : Unseen, optional
        Of gaps and clipped readings.
    """
    n = len(t)
    dt = np.diff(t, prepend=t[0])
    nothing = np.full(n, np.inf)
    step = np.zeros(n)
    step[0] = FREE_M
    return FootInputs(
        dt=dt,
        gyro=gyro,
        accel=accel,
        velocity_sigma=zero_velocity.sigma * np.sqrt(_share(t, options.correlated_s)),
        rest_sigma=nothing,
        floor_sigma=nothing,
        floor_step=step,
        q0=first,
        v0=np.zeros(3),
        unseen_turn=None if unseen is None else unseen.turn,
        unseen_velocity=None if unseen is None else unseen.velocity,
    )


def foot_model(options: FootOptions, grade: SensorGrade, up: FloatArray) -> FootModel:
    """Return physics and noise of the filter; ``up`` (3,) is the vertical in sensor axes."""
    return FootModel(
        gravity=options.gravity,
        gyro_noise=options.gyro_noise if grade.gyro_noise is None else grade.gyro_noise,
        gyro_motion=options.gyro_motion,
        accel_noise=options.accel_noise if grade.accel_noise is None else grade.accel_noise,
        accel_motion=options.accel_motion,
        tilt_prior=options.tilt_sigma,
        velocity_prior=options.speed_sigma,
        gyro_bias_prior=np.full(3, WIDE_BIAS),
        gyro_bias_walk=0.0,
        accel_bias_prior=grade.accel_bias,
        accel_bias_walk=options.accel_bias_walk,
        pivot_prior=options.pivot_m * up,
        pivot_sigma=options.pivot_sigma_m,
        gate=options.gate,
        gate_cap=options.gate_cap,
    )


def _share(t: FloatArray, correlated_s: float) -> FloatArray:
    """Return by how many samples each is outnumbered within the time that errors last, (n,)."""
    spacing = np.empty(len(t))
    spacing[1:-1] = 0.5 * (t[2:] - t[:-2])
    spacing[0], spacing[-1] = t[1] - t[0], t[-1] - t[-2]
    return np.asarray(correlated_s / np.clip(spacing, 1e-6, correlated_s))


def thinned(t: FloatArray, sigma: FloatArray, spacing_s: float, kept: IntArray) -> FloatArray:
    """Return uncertainties with those of neighbouring samples joined in one of them, (n,).

    Errors of a stance last longer than a sample: measuring its zero velocity less often, and as
    much more surely, says the same and takes less time.

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    sigma : shape (n,)
        Of independent measurements; infinite where there is none.
    spacing_s : float
        Samples within the same interval of this length [s] are joined in the surest one.
    kept : shape (k,)
        Samples that are preferred to surer ones.
    """
    rows = np.flatnonzero(np.isfinite(sigma))
    if len(rows) == 0:
        return sigma
    interval = np.floor((t[rows] - t[0]) / spacing_s + 1e-6)
    begins = np.flatnonzero(np.diff(interval, prepend=-1.0) > 0.0)
    information = 1.0 / np.square(sigma[rows])
    total = np.add.reduceat(information, begins)
    preferred = np.zeros(len(sigma), dtype=bool)
    preferred[kept] = True
    worth = np.where(preferred[rows], np.inf, information)
    best = np.maximum.reduceat(worth, begins)
    owner = np.repeat(np.arange(len(begins)), np.diff(begins, append=len(rows)))
    is_best = np.flatnonzero(worth >= best[owner])
    chosen = np.flatnonzero(np.diff(owner[is_best], prepend=-1) > 0)
    joined = np.full(len(sigma), np.inf)
    joined[rows[is_best[chosen]]] = 1.0 / np.sqrt(total)
    return joined
