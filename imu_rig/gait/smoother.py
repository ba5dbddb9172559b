"""Our smoother of a foot's trajectory, with one default for slow gait, walking, stairs, running."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.adaptive import stance, stride_threshold
from imu_rig.gait.bias import GyroBias, fuse_gyro_bias
from imu_rig.gait.footfalls import find_footfalls
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.level import FREE_M, floor_steps
from imu_rig.gait.mounting import find_foot_axes, first_heading
from imu_rig.gait.options import FootOptions
from imu_rig.gait.start import first_attitude
from imu_rig.gait.statistic import motion_statistic
from imu_rig.gait.stills import find_stills, rough_gyro_bias
from imu_rig.gait.trajectory import Footfalls, FootTrack, Trajectory
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.kernels.foot_filter import smooth_foot_states
from imu_rig.kernels.foot_types import FootInputs, FootModel, FootStates
from imu_rig.units import DEG

WIDE_BIAS = 1.0 * DEG
"""Prior of the gyroscope's bias in the first pass [rad/s]: what is left of one found in stills,
or that of an uncalibrated sensor in a recording without stills."""


class Detects(Protocol):
    """What finds zero velocity in place of our own detector."""

    def detect(self, block: ImuBlock) -> ZeroVelocity:
        """Return when the foot of a recording stands."""
        ...


def smooth_foot(
    block: ImuBlock,
    options: FootOptions = FootOptions(),  # noqa: B008  (frozen)
    *,
    grade: SensorGrade | None = None,
    covariance: bool = False,
    detector: Detects | str | None = None,
) -> FootTrack:
    """Find the trajectory of a sensor on a foot.

    Two passes of an error-state smoother over the whole recording. The first estimates the
    gyroscope's bias along with the motion and the heights of the footfalls; the second runs with
    the bias fused from strides, stills and the grade of the sensor, and with the floor level where
    the heights say so.

    Parameters
    ----------
    block : ImuBlock
        Any mounting on the foot, any constant or varying sample rate.
    options : FootOptions
    grade : SensorGrade or None
        What is known of the sensor; None: nothing.
    covariance : bool
        Whether to work out the uncertainty of the trajectory.
    detector : Detects, str or None
        Another detector of zero velocity, or its name; None is the adaptive one.

    Returns
    -------
    FootTrack

    Raises
    ------
    DataError
        If there are too few samples, a reading is no number, or the foot never stands.
    """
    grade = SensorGrade() if grade is None else grade
    _require_usable(block)
    t, accel = block.t, np.ascontiguousarray(block.accel, dtype=float)
    stills = find_stills(t, accel, block.gyro)
    rough = rough_gyro_bias(stills)
    gyro = np.ascontiguousarray(block.gyro - rough)
    motion = motion_statistic(t, accel, gyro, options.stance, options.gravity)
    if detector is None:
        threshold = stride_threshold(t, motion, options.stance)
        zero_velocity = stance(motion, threshold, options.stance)
    else:
        zero_velocity = _detected(replace(block, gyro=gyro), detector)
    footfalls = find_footfalls(zero_velocity, t)
    if len(footfalls) == 0:
        raise DataError(
            "the foot never stands in this recording; record with the sensor on a foot, and begin "
            "and end with a second of standing"
        )
    first, quietest = first_attitude(t, accel, gyro, motion)
    inputs = _inputs(t, accel, gyro, zero_velocity, first, options)
    up = accel[quietest] / np.linalg.norm(accel[quietest])
    model = _model(options, grade, up)

    free = smooth_foot_states(inputs, model, estimate_gyro_bias=True)
    bias = fuse_gyro_bias(rough, free.gyro_bias[-1], free.gyro_bias_covariance, stills, grade)
    inputs = inputs._replace(gyro=gyro - (bias.value - rough))
    if options.level != "never":
        inputs = _with_floor(inputs, footfalls, free.position[:, 2], options)
    states = smooth_foot_states(inputs, model, estimate_gyro_bias=False)
    return _track(t, states, zero_velocity, footfalls, bias)


def _require_usable(block: ImuBlock) -> None:
    if len(block) < 3:
        raise DataError("the recording has fewer than 3 samples; nothing can be said of a foot")
    for name, values in (("times", block.t), ("accel", block.accel), ("gyro", block.gyro)):
        if not np.isfinite(values).all():
            raise DataError(f"{name} of the recording hold values that are no numbers; remove them")
    if (np.diff(block.t) < 0.0).any():
        raise DataError("the recording's times go back; sort its samples or mend the clock")


def _detected(block: ImuBlock, detector: Detects | str) -> ZeroVelocity:
    if isinstance(detector, str):
        from imu_rig.gait.detectors import detector_named

        detector = detector_named(detector)
    return detector.detect(block)


def _inputs(
    t: FloatArray,
    accel: FloatArray,
    gyro: FloatArray,
    zero_velocity: ZeroVelocity,
    first: FloatArray,
    options: FootOptions,
) -> FootInputs:
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
    )


def _share(t: FloatArray, correlated_s: float) -> FloatArray:
    """Return by how many samples each is outnumbered within the time that errors last, (n,)."""
    spacing = np.empty(len(t))
    spacing[1:-1] = 0.5 * (t[2:] - t[:-2])
    spacing[0], spacing[-1] = t[1] - t[0], t[-1] - t[-2]
    return np.asarray(correlated_s / np.clip(spacing, 1e-6, correlated_s))


def _model(options: FootOptions, grade: SensorGrade, up: FloatArray) -> FootModel:
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


def _with_floor(
    inputs: FootInputs, footfalls: Footfalls, height: FloatArray, options: FootOptions
) -> FootInputs:
    rows = footfalls.quietest
    sigma = np.full(len(inputs.dt), np.inf)
    sigma[rows] = options.flat_m
    step = np.zeros(len(inputs.dt))
    step[rows] = floor_steps(height[rows], options)
    step[0] = FREE_M
    return inputs._replace(floor_sigma=sigma, floor_step=step)


def _track(
    t: FloatArray,
    states: FootStates,
    zero_velocity: ZeroVelocity,
    footfalls: Footfalls,
    bias: GyroBias,
) -> FootTrack:
    whole = Trajectory(t, states.quaternion, states.velocity, states.position)
    axes = find_foot_axes(whole, footfalls)
    whole = whole.turned(-first_heading(whole, footfalls, axes))
    whole = whole.moved(-whole.position[0])
    notes = () if axes.note is None else (axes.note,)
    return FootTrack(
        whole,
        zero_velocity,
        footfalls,
        gyro_bias=bias.value,
        accel_bias=states.accel_bias.mean(axis=0),
        pivot=states.pivot,
        notes=notes,
    )
