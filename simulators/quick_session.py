"""A whole jig session at once, without ports, threads or a world that steps through time.

For studies over hundreds of sessions. The physics is that of the simulated rig: the same servos,
joints, averaging and sensor, of any kind. What is left out is what happens between sensor and file:
filters and packets of the firmware, the radio, the device's clock.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.rotation import from_rotation_vector, to_matrix, to_rotation_vector
from imu_rig.units import DEG
from simulators.config import RigConfig
from simulators.inertial_sensor import InertialSensor, Readings, Vibration
from simulators.jig import JOINTS, Jig
from simulators.models import ZERO, JigModel, SensorModel, Vector3
from simulators.pose_errors import draw_pose_errors
from simulators.quick_motion import Way, joint_rows, way_steps
from simulators.rig import AffineTruth, RigTruth
from simulators.sampling import Means, Sampler
from simulators.servo import STEP_S, Servo
from simulators.straight_line import line_over_gravity

STAGES: tuple[tuple[int, ...], ...] = ((0, 1), (2,))
"""Axes that turn together: pan with tilt, then roll."""

OVERSHOOT_DEG = 6.0
"""How far a way down goes beyond the pose first, to arrive from below like a way up."""

LEAD_IN_S = 1.0
ARRIVAL_S = 0.15
PAUSE_S = 0.3
WOBBLE_S = 0.4
REMOUNT_S = 4.0
EDGE_S = 0.05
"""Cut off the end of every hold."""

MOUNTINGS_DEG: tuple[Vector3, ...] = ((0.0, 0.0, 0.0), (0.0, 90.0, 0.0))
"""Nominal rotations of the sensor on the plate: as it is, and turned about the tilt axis."""


@dataclass(frozen=True)
class SessionFaults:
    """What went wrong in a session; nothing by default. Poses count from 0.

    Attributes
    ----------
    swapped : (int, int), optional
        Two poses whose commanded angles were noted for each other.
    clipped : (int, float), optional
        Accelerometer axis, 0 to 2, and the reading [m/s^2] beyond which it does not go.
    time_factor : float
        Noted time over true time.
    slip : (int, int, float), optional
        Axis (0 is pan), the first pose after its servo slipped, and by how much [deg].
    bumped : int, optional
        Pose in which the plate stood turned by `bump_deg`.
    bump_deg : (float, float, float)
        Rotation about x, y and z [deg].
    """

    swapped: tuple[int, int] | None = None
    clipped: tuple[int, float] | None = None
    time_factor: float = 1.0
    slip: tuple[int, int, float] | None = None
    bumped: int | None = None
    bump_deg: Vector3 = (3.0, -4.0, 2.0)


@dataclass(frozen=True)
class DrivenTurn:
    """One stage of the move to a pose: commanded angles [deg] at its begin and end [s]."""

    pose: int
    t0: float
    t1: float
    start_deg: Vector3
    stop_deg: Vector3


@dataclass(frozen=True, eq=False)
class QuickSession:
    """What a session of ``m`` poses recorded, and the truth behind it.

    Attributes
    ----------
    block : ImuBlock
        The recording, in nominal SI units.
    windows : shape (m, 2)
        Begin and end of every still [s], settling cut off.
    angles_deg : shape (m, 3)
        Commanded pan, tilt and roll, as noted.
    turns : tuple of DrivenTurn
        The stages of all moves, the way from the park pose included.
    mounting : tuple of int
        Mounting in every pose.
    mountings_deg : tuple of rotation vectors
        Nominal rotation of the sensor on the plate in each mounting [deg].
    truth : RigTruth
        Gains and offsets as they were on average over the stills; the accelerometer's gain is the
        one at zero input.
    accel_line : AffineTruth
        The accelerometer's best straight line over gravity: the truth for whatever is found at
        rest. The same as ``truth.accel`` where it is linear.
    attitudes : shape (m, 3, 3)
        True rotation matrices, sensor to navigation axes, in the middle of every still.
    mounting_matrices : shape (k, 3, 3)
        True rotation of the sensor on the roll axis in each mounting.
    """

    block: ImuBlock
    windows: FloatArray
    angles_deg: FloatArray
    turns: tuple[DrivenTurn, ...]
    mounting: tuple[int, ...]
    mountings_deg: tuple[Vector3, ...]
    truth: RigTruth
    accel_line: AffineTruth
    attitudes: FloatArray
    mounting_matrices: FloatArray


def quick_session(
    config: RigConfig,
    angles_deg: Sequence[Sequence[float]] | FloatArray,
    *,
    hold_s: float | Sequence[float] = 2.0,
    settle_s: float = 0.3,
    rate_hz: float | None = None,
    speed_dps: float = 80.0,
    mounting: Sequence[int] = (),
    mountings_deg: tuple[Vector3, ...] = MOUNTINGS_DEG,
    remount_deg: float = 3.0,
    faults: SessionFaults | None = None,
) -> QuickSession:
    """Drive a session and record it; the same arguments give the same session.

    Parameters
    ----------
    config : RigConfig
    angles_deg : shape (m, 3)
        Commanded pan, tilt and roll of every pose [deg].
    hold_s : float or m numbers
        Time at every pose, settling included.
    settle_s : float
        What of a hold is not used.
    rate_hz : float, optional
        Samples per second, of which 1000 Hz must be a multiple; by default the nearest such rate
        to that of the kind of IMU.
    speed_dps : float
        Top speed of every axis.
    mounting : m integers
        Mounting in every pose, the first one everywhere where empty.
    mountings_deg : tuple of rotation vectors
        Nominal rotation of the sensor on the plate in each mounting [deg].
    remount_deg : float
        Standard deviation per axis of a mounting's own error, the first one's excepted: that
        one's comes from the configuration.
    faults : SessionFaults, optional

    Raises
    ------
    ValueError
        For a sample rate that is no part of 1000 Hz, or lists of different length.
    """
    poses = np.asarray(angles_deg, dtype=float)
    rate_hz = rate_hz or nearest_rate(config.kind.output_hz)
    per_sample = round(1.0 / (STEP_S * rate_hz))
    if abs(per_sample * STEP_S * rate_hz - 1.0) > 1e-9:
        raise ValueError(f"1000 Hz is no multiple of a sample rate of {rate_hz:g} Hz.")
    holds = np.broadcast_to(np.asarray(hold_s, dtype=float), (len(poses),))
    mounted = tuple(mounting) or (0,) * len(poses)
    if len(mounted) != len(poses):
        raise ValueError(f"{len(mounted)} mountings stand for {len(poses)} poses.")
    mountings_deg = mountings_deg[: max(mounted) + 1]
    seeds = np.random.SeedSequence([config.seed, 1]).spawn(9)
    rngs = [np.random.default_rng(seed) for seed in seeds]
    matrices = _mountings(config.jig, mountings_deg, remount_deg, rngs[8])
    drive = _Drive(config, rngs, faults or SessionFaults(), speed_dps, per_sample)
    for index, (pose, hold) in enumerate(zip(poses, holds.tolist(), strict=True)):
        if index and mounted[index] != mounted[index - 1]:
            drive.remount(matrices[mounted[index - 1]].T @ matrices[mounted[index]])
        drive.visit(index, pose, hold, mounted[index])
    motion = drive.motion()
    jigs = [_jig(config, matrix) for matrix in matrices]
    sensor = InertialSensor(config.sensor, config.kind.ranges, rngs[3])
    readings = [sensor.read(*sampled) for sampled in _sampled(motion, jigs, per_sample)]
    return _noted(
        _Recorded(readings, per_sample),
        motion,
        poses=poses,
        settle_s=settle_s,
        faults=faults or SessionFaults(),
        truth=RigTruth.of(config),
        sensor=config.sensor,
        jigs=jigs,
        mounting=mounted,
        mountings_deg=mountings_deg,
        mounting_matrices=matrices,
    )


def nearest_rate(hz: float) -> float:
    """Return the nearest rate of which 1000 Hz is a multiple, by how long its samples are."""
    return 1.0 / (STEP_S * max(1, round(1.0 / (STEP_S * hz))))


@dataclass(frozen=True)
class _Part:
    """Steps with one mounting and one vibration: the move to a pose and its hold."""

    start: int
    hold: int
    stop: int
    mounting: int
    vibration: Vibration | None


@dataclass(frozen=True)
class _Stage:
    """Steps from the begin of a stage to the begin of the next, or of the hold."""

    pose: int
    axes: tuple[int, ...]
    start: int
    stop: int


@dataclass(frozen=True, eq=False)
class _Motion:
    """The joints' rows (steps, 6, 3), in which steps any of them moves, and what happened."""

    table: FloatArray
    moves: BoolArray
    parts: list[_Part]
    holds: IntArray
    stages: list[_Stage]


class _Drive:
    """Moves the joints from pose to pose and keeps their ways."""

    def __init__(
        self,
        config: RigConfig,
        rngs: list[np.random.Generator],
        faults: SessionFaults,
        speed_dps: float,
        per_sample: int,
    ) -> None:
        self._jig = config.jig
        self._pose_rng = rngs[7]
        self._faults = faults
        self._speed = speed_dps * DEG
        self._per_sample = per_sample
        models = (self._jig.pan, self._jig.tilt, self._jig.roll)
        self._servos = [Servo(model, rng) for model, rng in zip(models, rngs[:3], strict=True)]
        for servo in self._servos:
            servo.hear(servo.pulse_us(0.0), 0.0)
        self._rest = [*(servo.target for servo in self._servos), 0.0, 0.0, 0.0]
        self._at = list(self._rest)
        self._ways: list[list[Way]] = [[] for _ in range(JOINTS)]
        self._commanded = np.zeros(3)
        self._slip = np.zeros(3)
        self._now = round(LEAD_IN_S / STEP_S)
        self._mounting = 0
        self._parts = [_Part(0, 0, self._now, 0, None)]
        self._holds: list[tuple[int, int]] = []
        self._stages: list[_Stage] = []

    def visit(self, index: int, pose: FloatArray, hold_s: float, mounting: int) -> None:
        """Go to a pose stage by stage and hold it."""
        start = self._now
        self._mounting = mounting
        slip = self._faults.slip
        if slip is not None and index == slip[1]:
            self._slip_servo(
                slip[0], slip[2] * DEG, driven=pose[slip[0]] != self._commanded[slip[0]]
            )
        errors = draw_pose_errors(self._jig, self._pose_rng)
        bump = self._faults.bump_deg if self._faults.bumped == index else ZERO
        for joint, angle in enumerate((errors.wobble + np.array(bump) * DEG).tolist(), start=3):
            self._go(joint, angle, round(WOBBLE_S / STEP_S))
        begins: list[tuple[int, tuple[int, ...]]] = []
        for axes in STAGES:
            # From the park pose every axis is approached anew.
            turning = [a for a in axes if index == 0 or pose[a] != self._commanded[a]]
            if turning:
                self._wait(PAUSE_S if begins else 0.0)
                begins.append((self._now, axes))
                self._drive_stage(turning, pose)
        self._now = max(self._now, start + round(WOBBLE_S / STEP_S))
        hold = self._aligned()
        stops = [*(begin for begin, _ in begins[1:]), hold]
        for (begin, axes), stop in zip(begins, stops, strict=False):
            self._stages.append(_Stage(index, axes, begin, stop))
        self._wait(hold_s)
        stop = self._aligned()
        self._holds.append((hold, stop))
        self._parts.append(_Part(start, hold, stop, mounting, errors.vibration))

    def remount(self, turn: FloatArray) -> None:
        """Let a hand turn the sensor on the plate by a rotation matrix, out of its last pose.

        The joints of the wobble do it. The next pose begins with them at zero and the new
        mounting, which is the same attitude.
        """
        start, steps = self._now, round(REMOUNT_S / STEP_S)
        for joint, angle in enumerate(_joint_angles(turn), start=3):
            self._go(joint, angle, steps)
            self._at[joint] = 0.0
        self._now += steps
        self._parts.append(_Part(start, self._now, self._now, self._mounting, None))

    def motion(self) -> _Motion:
        """Return the rows of all joints."""
        rings = (self._jig.pan, self._jig.tilt, self._jig.roll, None, None, None)
        table = np.empty((self._now, JOINTS, 3))
        for joint, (ways, rest, ring) in enumerate(zip(self._ways, self._rest, rings, strict=True)):
            table[:, joint] = joint_rows(ways, rest, self._now, ring)
        moves = np.any(table[:, :, 1:] != 0.0, axis=(1, 2))
        return _Motion(table, np.asarray(moves), self._parts, np.array(self._holds), self._stages)

    def _drive_stage(self, turning: list[int], pose: FloatArray) -> None:
        """Turn some axes together; those that turn down go beyond and come back."""
        beyond = [axis for axis in turning if pose[axis] <= self._commanded[axis]]
        first = pose.copy()
        first[beyond] -= OVERSHOOT_DEG
        self._leg(turning, first)
        self._leg(beyond, pose)
        self._commanded[turning] = pose[turning]

    def _leg(self, axes: list[int], goal: FloatArray) -> None:
        longest = 0
        for axis in axes:
            servo = self._servos[axis]
            servo.hear(servo.pulse_us(float(goal[axis])), self._now * STEP_S)
            target = servo.target + float(self._slip[axis])
            steps = way_steps(target - self._at[axis], self._speed)
            self._go(axis, target, steps)
            longest = max(longest, steps)
        self._now += longest
        self._wait(ARRIVAL_S if axes else 0.0)

    def _go(self, joint: int, target: float, steps: int) -> None:
        if target != self._at[joint]:
            self._ways[joint].append(Way(self._now, steps, self._at[joint], target))
            self._at[joint] = target

    def _slip_servo(self, axis: int, angle: float, *, driven: bool) -> None:
        """Shift an axis, on its way where it is driven, at the begin of the move where not."""
        self._slip[axis] = angle
        if not driven:
            target = self._at[axis] + angle
            self._go(axis, target, way_steps(angle, self._speed))

    def _wait(self, seconds: float) -> None:
        self._now += round(seconds / STEP_S)

    def _aligned(self) -> int:
        """Wait for the next sample and return its step."""
        self._now += -self._now % self._per_sample
        return self._now


def _sampled(
    motion: _Motion, jigs: list[Jig], per_sample: int
) -> Iterator[tuple[Means, Vibration | None]]:
    """Average the motion over the sample intervals, piece by piece."""
    sampler: Sampler | None = None
    mounting = -1
    for part in motion.parts:
        if sampler is None or part.mounting != mounting:
            sampler = Sampler(jigs[part.mounting], part.start * STEP_S)
            mounting = part.mounting
        for start, stop in _pieces(part, motion.moves, per_sample):
            instants = STEP_S * np.arange(start + per_sample, stop + 1, per_sample, dtype=float)
            yield sampler.means_of(motion.table[start:stop], instants), part.vibration


def _pieces(part: _Part, moves: BoolArray, per_sample: int) -> Iterator[tuple[int, int]]:
    """Cut a part where the plate's wobble has ended and where the last joint has come to rest.

    Each piece is then as simple as can be: the last one is a single attitude.
    """
    wobbled = part.start + round(WOBBLE_S / STEP_S)
    moved = np.flatnonzero(moves[part.hold : part.stop])
    rests = max(wobbled, part.hold + (int(moved[-1]) + 1 if len(moved) else 0))
    cuts = (part.start, wobbled, rests, part.stop)
    places = [
        part.start + -(-(min(c, part.stop) - part.start) // per_sample) * per_sample for c in cuts
    ]
    for start, stop in itertools.pairwise(places):
        if start < stop:
            yield start, stop


class _Recorded:
    """The readings of a session, one row per sample."""

    def __init__(self, readings: list[Readings], per_sample: int) -> None:
        self.accel = np.concatenate([part.accel for part in readings])
        self.gyro = np.concatenate([part.gyro for part in readings])
        self.mag = np.concatenate([part.mag for part in readings])
        self.temperature = np.concatenate([part.temperature for part in readings])
        self.offsets = np.concatenate([part.offsets for part in readings])
        self.t = np.arange(1, len(self.accel) + 1, dtype=float) * (per_sample * STEP_S)

    def block(self, faults: SessionFaults) -> ImuBlock:
        """Return what was noted, with the faults of the noting."""
        accel = self.accel
        if faults.clipped is not None:
            axis, limit = faults.clipped
            accel[:, axis] = np.clip(accel[:, axis], -limit, limit)
        t = self.t * faults.time_factor
        return ImuBlock(t, accel, self.gyro, t, mag=self.mag, temperature=self.temperature)

    def truth(self, windows: FloatArray, sensor: SensorModel, truth: RigTruth) -> RigTruth:
        """Return the truth with gain and offsets as they were on average within windows (m, 2)."""
        start, stop = np.searchsorted(self.t, windows.T)
        still = np.concatenate([np.arange(a, b) for a, b in zip(start, stop, strict=True)])
        cold = self.temperature[still] - (sensor.ambient_c + sensor.warm_up_c)
        gain = 1.0 + cold * (sensor.accel_gain_percent_per_c / 100.0)
        offsets = self.offsets[still]
        accel = AffineTruth(
            truth.accel.K * np.mean(1.0 / gain),
            np.mean(offsets[:, :3] / gain[:, np.newaxis], axis=0),
        )
        return replace(
            truth, accel=accel, gyro=AffineTruth(truth.gyro.K, offsets[:, 3:].mean(axis=0))
        )


def _noted(
    recorded: _Recorded,
    motion: _Motion,
    *,
    poses: FloatArray,
    settle_s: float,
    faults: SessionFaults,
    truth: RigTruth,
    sensor: SensorModel,
    jigs: list[Jig],
    mounting: tuple[int, ...],
    mountings_deg: tuple[Vector3, ...],
    mounting_matrices: FloatArray,
) -> QuickSession:
    """Put together what a session leaves behind."""
    noted = poses.copy()
    if faults.swapped is not None:
        noted[list(faults.swapped)] = noted[list(faults.swapped)[::-1]]
    windows = motion.holds.astype(float) * STEP_S + (settle_s, -EDGE_S)
    middle = motion.holds.mean(axis=1).astype(np.int64)
    attitudes = [
        jigs[mounted].attitude(motion.table[[row], :, 0])[0]
        for mounted, row in zip(mounting, middle.tolist(), strict=True)
    ]
    true = recorded.truth(windows, sensor, truth)
    return QuickSession(
        block=recorded.block(faults),
        windows=windows * faults.time_factor,
        angles_deg=noted,
        turns=_turns(motion.stages, noted, faults.time_factor),
        mounting=mounting,
        mountings_deg=mountings_deg,
        truth=true,
        accel_line=line_over_gravity(
            true.accel, sensor.accel_quadratic, sensor.accel_cubic, true.gravity
        ),
        attitudes=np.array(attitudes),
        mounting_matrices=mounting_matrices,
    )


def _turns(stages: list[_Stage], noted: FloatArray, time_factor: float) -> tuple[DrivenTurn, ...]:
    """Return the stages with the angles that were noted for their poses."""
    turns: list[DrivenTurn] = []
    for place, stage in enumerate(stages):
        first = place == 0 or stages[place - 1].pose != stage.pose
        last = place + 1 == len(stages) or stages[place + 1].pose != stage.pose
        if first:
            current = noted[stage.pose - 1].copy() if stage.pose else np.zeros(3)
        before = current.copy()
        axes = [0, 1, 2] if last else list(stage.axes)
        current[axes] = noted[stage.pose, axes]
        t0, t1 = (step * STEP_S * time_factor for step in (stage.start, stage.stop))
        turns.append(DrivenTurn(stage.pose, t0, t1, _vector(before), _vector(current)))
    return tuple(turns)


def _mountings(
    model: JigModel, nominal_deg: tuple[Vector3, ...], spread_deg: float, rng: np.random.Generator
) -> FloatArray:
    """Return the true rotation of the sensor on the plate in each mounting, shape (k, 3, 3)."""
    errors = rng.normal(0.0, spread_deg, (len(nominal_deg), 3))
    errors[0] = model.mounting_deg
    return _rotation(np.array(nominal_deg)) @ _rotation(errors)


def _jig(config: RigConfig, mounting: FloatArray) -> Jig:
    vector = _vector(_rotation_vector(mounting) / DEG)
    return Jig(
        config.jig.model_copy(update={"mounting_deg": vector}),
        gravity=config.gravity,
        earth_rate=config.earth_rate,
        field=config.field_ut,
    )


def _rotation(vectors_deg: FloatArray) -> FloatArray:
    return to_matrix(from_rotation_vector(vectors_deg * DEG))


def _rotation_vector(matrix: FloatArray) -> FloatArray:
    """Rotation vector (3,) of a matrix that turns by less than a half turn."""
    axis = np.array(
        (matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1])
    )
    q = np.concatenate(((1.0 + np.trace(matrix),), axis))
    return to_rotation_vector(q / np.linalg.norm(q))


def _joint_angles(matrix: FloatArray) -> list[float]:
    """Angles about x, then y, then z [rad] that make up a rotation."""
    return [
        math.atan2(-matrix[1, 2], matrix[2, 2]),
        math.asin(min(1.0, max(-1.0, float(matrix[0, 2])))),
        math.atan2(-matrix[0, 1], matrix[0, 0]),
    ]


def _vector(values: FloatArray) -> Vector3:
    x, y, z = (float(v) for v in values)
    return x, y, z
