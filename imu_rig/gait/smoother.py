"""Our smoother of a foot's trajectory, with one default for slow gait, walking, stairs, running."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.adaptive import detect_stance, settled
from imu_rig.gait.belief import ANOTHER, believed_grade, contradicts, force_misfit
from imu_rig.gait.bias import GyroBias, fuse_gyro_bias, without_bias
from imu_rig.gait.clocks import clock_doubt, compare_clocks, with_doubt
from imu_rig.gait.coarse import coarse_inputs, joined_number, joined_rows
from imu_rig.gait.covariance import track_covariance
from imu_rig.gait.cut_off import with_cut_off
from imu_rig.gait.filter_inputs import WIDE_BIAS, foot_inputs, foot_model, thinned
from imu_rig.gait.fitness import check_track, inspect_recording
from imu_rig.gait.footfalls import find_footfalls, merge_unmoved
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.level import FREE_M, floor_steps
from imu_rig.gait.mounting import find_foot_axes, first_heading
from imu_rig.gait.options import FootOptions
from imu_rig.gait.stamps import spread_repeats
from imu_rig.gait.start import first_attitude
from imu_rig.gait.stills import rough_gyro_bias
from imu_rig.gait.trajectory import Footfalls, FootTrack, Trajectory
from imu_rig.gait.unseen import Unseen, unseen_motion, widened
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.kernels.foot_filter import smooth_foot_states
from imu_rig.kernels.foot_types import FootInputs, FootModel, FootStates
from imu_rig.kernels.tracks import turn_about_z

AGAIN = 2
"""How often the first pass begins anew with the bias that it found taken off: one as large as its
prior was pulled towards 0, as where nobody stood still before a walk with a raw sensor."""


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
    checked = inspect_recording(block, gravity=options.gravity)
    t, stills = spread_repeats(block.t), checked.stills
    accel = np.ascontiguousarray(block.accel, dtype=float)
    read = np.ascontiguousarray(block.gyro, dtype=float)
    unseen = unseen_motion(block, checked.holes)
    rough = rough_gyro_bias(stills)
    found = _first_pass(block, t, accel, rough, unseen, options, grade, detector)
    for _ in range(AGAIN):
        left = found.states.gyro_bias[-1]
        if np.linalg.norm(left) < WIDE_BIAS:
            break
        rough = rough + left
        found = _first_pass(block, t, accel, rough, unseen, options, grade, detector)
    zero_velocity, footfalls, up, inputs, model, free, number = found

    bias = fuse_gyro_bias(rough, free.gyro_bias[-1], free.gyro_bias_covariance, up, stills, grade)
    rows = joined_rows(footfalls.quietest, t, number)
    footfalls = merge_unmoved(
        footfalls, free.position[rows], free.quaternion[rows], zero_velocity.statistic
    )
    inputs = inputs._replace(gyro=without_bias(read, t, stills, bias.value))
    if options.level != "never":
        places = free.position[joined_rows(footfalls.quietest, t, number)]
        inputs = _with_floor(inputs, footfalls, places, options)
    states = smooth_foot_states(inputs, model, estimate_gyro_bias=False)
    track = _track(block.t, states, zero_velocity, footfalls, bias)
    misfit = force_misfit(t, inputs, footfalls, options.gravity)
    believed = believed_grade(grade, bias, misfit, options.gravity)
    clocks = None
    if checked.strides is not None:
        strides = replace(checked.strides, bias=bias.value)
        clocks = compare_clocks(strides, believed, options.gravity)
    doubt = clock_doubt(clocks, believed, misfit)
    believed = replace(believed, late_s=abs(doubt.late_s))
    notes = (
        *((ANOTHER,) if contradicts(grade, misfit, options.gravity) else ()),
        *doubt.notes,
        *checked.notes,
        *track.notes,
        *check_track(track, block, gravity=options.gravity, unseen=unseen, grade=believed),
    )
    if not covariance:
        return replace(track, notes=notes)
    uncertainty = track_covariance(
        track.trajectory, states, inputs, model, footfalls, bias, believed
    )
    uncertainty = with_cut_off(uncertainty, checked.holes, track.trajectory, footfalls)
    uncertainty = with_doubt(uncertainty, doubt, track.trajectory, footfalls)
    return replace(track, notes=notes, covariance=widened(uncertainty, unseen, footfalls))


class _FirstPass(NamedTuple):
    """What comes of a pass over readings without a rough bias, ``number`` of them joined."""

    zero_velocity: ZeroVelocity
    footfalls: Footfalls
    up: FloatArray
    inputs: FootInputs
    model: FootModel
    states: FootStates
    number: int


def _first_pass(
    block: ImuBlock,
    t: FloatArray,
    accel: FloatArray,
    rough: FloatArray,
    unseen: Unseen,
    options: FootOptions,
    grade: SensorGrade,
    detector: Detects | str | None,
) -> _FirstPass:
    gyro = np.ascontiguousarray(block.gyro, dtype=float)
    if rough.any():
        gyro = gyro - rough
    zero_velocity = detect_stance(t, accel, gyro, options.stance, options.gravity)
    first, quietest = first_attitude(t, accel, gyro, zero_velocity.statistic)
    if detector is None:
        zero_velocity = settled(zero_velocity, t, options.stance)
    else:
        zero_velocity = _detected(replace(block, gyro=gyro), detector)
    footfalls = find_footfalls(zero_velocity, t)
    if len(footfalls) == 0:
        raise DataError(
            "the foot never stands in this recording; record with the sensor on a foot, and begin "
            "and end with a second of standing"
        )
    up = accel[quietest] / np.linalg.norm(accel[quietest])
    inputs = foot_inputs(t, accel, gyro, zero_velocity, first, options, unseen)
    sigma = thinned(t, inputs.velocity_sigma, options.measured_every_s, footfalls.quietest)
    inputs = inputs._replace(velocity_sigma=sigma)
    model = foot_model(options, grade, up)
    number = joined_number(t)
    coarse = coarse_inputs(inputs, t, number)
    states = smooth_foot_states(coarse, model, estimate_gyro_bias=True)
    return _FirstPass(zero_velocity, footfalls, up, inputs, model, states, number)


def _detected(block: ImuBlock, detector: Detects | str) -> ZeroVelocity:
    if isinstance(detector, str):
        from imu_rig.gait.detectors import detector_named

        detector = detector_named(detector)
    return detector.detect(block)


def _with_floor(
    inputs: FootInputs, footfalls: Footfalls, places: FloatArray, options: FootOptions
) -> FootInputs:
    rows = footfalls.quietest
    sigma = np.full(len(inputs.dt), np.inf)
    sigma[rows] = options.flat_m
    step = np.zeros(len(inputs.dt))
    step[rows] = floor_steps(places, options)
    step[0] = FREE_M
    return inputs._replace(floor_sigma=sigma, floor_step=step)


def _track(
    t: FloatArray,
    states: FootStates,
    zero_velocity: ZeroVelocity,
    footfalls: Footfalls,
    bias: GyroBias,
) -> FootTrack:
    """Return the track of states, which are turned in place; they begin at the origin."""
    motion = (states.quaternion, states.velocity, states.position)
    whole = Trajectory(t, *motion)
    axes = find_foot_axes(whole, footfalls)
    turn_about_z(*motion, -first_heading(whole, footfalls, axes))
    notes = () if axes.note is None else (axes.note,)
    return FootTrack(
        whole,
        zero_velocity,
        footfalls,
        gyro_bias=bias.value,
        accel_bias=np.full(len(t), 1.0 / len(t)) @ states.accel_bias,
        pivot=states.pivot,
        notes=notes,
    )
