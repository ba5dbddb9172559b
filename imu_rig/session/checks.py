"""Judgements about samples and jig during a session, each with its sentence. No state, no I/O."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.devices.imu import ImuDevice
from imu_rig.session.history import Visit
from imu_rig.session.protocol import Pose
from imu_rig.session.stillness import Quiet, has_gyro
from imu_rig.units import DEG, MILLI_G, STANDARD_GRAVITY

GRAVITY_TOLERANCE = 0.25  # of 1 g: beyond any uncalibrated sensor's scale and bias together
ANALOG_GRAVITY_TOLERANCE = 0.9  # of one without gyroscope, whose zero may be half a g off
TURN_TOLERANCE_DEG = 12.0  # servos of this class are off by degrees, a stuck one by a whole move
TURN_TOLERANCE = 0.15
LOST = 0.05  # share of packets that a hold or a turn may miss
HOLE_S = 0.1  # in their times
SAME_DIRECTION_DEG = 12.0
SAME_SIZE_MG = 25.0
SAME_BIAS_DPS = 1.0
MOUNTING_TOLERANCE_DEG = 30.0
ANALOG_MOUNTING_TOLERANCE_DEG = 60.0


@dataclass(frozen=True, eq=False)
class Reference:
    """What a sensor read at rest: mean (3,) [m/s^2], the jig's pose, and its mounting [rad]."""

    accel: FloatArray
    pose: Pose
    mounting: FloatArray


def attitude(pose: Pose) -> FloatArray:
    """Attitude matrix (3, 3), body to navigation, of an ideal jig in ``pose``."""
    turn: FloatArray = (
        rotation.about_z(pose.pan * DEG)
        @ rotation.about_y(pose.tilt * DEG)
        @ rotation.about_x(pose.roll * DEG)
    )
    return turn


def is_whole(block: ImuBlock) -> bool:
    """Whether a block misses at most few packets, by its counter, and has no hole in its times."""
    if len(block) < 2:
        return False
    if float(np.max(np.diff(block.t))) > HOLE_S:
        return False
    if block.counter is None:
        return True
    span = int(block.counter[-1] - block.counter[0]) + 1
    return len(block) >= (1.0 - LOST) * span


def wrong_gravity(name: str, block: ImuBlock) -> str | None:
    """Say what is wrong if a sensor at rest does not read about 1 g."""
    norm = float(np.linalg.norm(np.mean(block.accel, axis=0))) / STANDARD_GRAVITY
    tolerance = GRAVITY_TOLERANCE if has_gyro(block) else ANALOG_GRAVITY_TOLERANCE
    if abs(norm - 1.0) <= tolerance:
        return None
    return (
        f"{name} reads {norm:.2f} g at rest: its values are wrong or scaled by another layout "
        "than it sends; check the sensor's range and the packet layout."
    )


def no_rest(name: str, quiet: Quiet) -> str | None:
    """Say what is wrong if a parked sensor is not at rest."""
    if quiet.is_rest:
        return None
    return (
        f"{name} is not at rest in the park pose (accelerometer scatters "
        f"{quiet.accel / MILLI_G:.0f} mg, gyroscope {quiet.gyro / DEG:.1f} deg/s): "
        "stand the jig on a firm table and fix the sensor and its cable."
    )


def wrong_turn(way: ImuBlock, bias: FloatArray, before: Pose, after: Pose) -> str | None:
    """Say what is wrong if the gyroscope saw another turn than the commanded one.

    The angle of a rotation does not depend on how the sensor is mounted, so this needs no
    calibration. It tells a servo that did not turn, whatever its controller reports.

    Parameters
    ----------
    way : ImuBlock
        Samples from the end of one still interval to the beginning of the next.
    bias : shape (3,)
        Gyroscope bias in the first of them [rad/s].
    before, after : Pose
        Commanded poses at both ends.
    """
    small = rotation.from_rotation_vector((way.gyro[1:] - bias) * np.diff(way.t)[:, None])
    turned = rotation.to_rotation_vector(rotation.compose(small))
    seen = float(np.linalg.norm(turned)) / DEG
    relative = attitude(before).T @ attitude(after)
    cosine = np.clip((np.trace(relative) - 1.0) / 2.0, -1.0, 1.0)
    commanded = float(np.arccos(cosine)) / DEG
    if abs(seen - commanded) <= max(TURN_TOLERANCE_DEG, TURN_TOLERANCE * commanded):
        return None
    return (
        f"The gyroscope saw a turn of {seen:.0f} deg on the way to {after} where "
        f"{commanded:.0f} deg were commanded: a servo is stuck, slips or has no power, or the jig "
        "file's pulses belong to another jig."
    )


def another_sensor(name: str, before: Visit, now: ImuBlock) -> str | None:
    """Say what is wrong if a pose held again does not read as it did.

    Sensors differ by degrees per second and tens of mg in their offsets; one sensor hardly does
    from day to day. Servos come back to a pose within degrees.
    """
    if before.accel_mean is None:
        return None
    accel = np.mean(now.accel, axis=0)
    then = np.array(before.accel_mean)
    size, size_then = float(np.linalg.norm(accel)), float(np.linalg.norm(then))
    cosine = float(accel @ then) / (size * size_then)
    tilted = float(np.arccos(np.clip(cosine, -1.0, 1.0))) / DEG
    bias = _bias_change_dps(before, now)
    differs = [
        (tilted > SAME_DIRECTION_DEG, f"gravity stands {tilted:.0f} deg from where it stood"),
        (
            abs(size - size_then) > SAME_SIZE_MG * MILLI_G,
            f"gravity's size differs by {abs(size - size_then) / MILLI_G:.0f} mg",
        ),
        (bias > SAME_BIAS_DPS, f"the gyroscope's bias differs by {bias:.1f} deg/s"),
    ]
    found = [text for yes, text in differs if yes]
    if not found:
        return None
    return (
        f"{name} does not read in {before.name} what the session's sensor read there "
        f"({', '.join(found)}): this is another sensor, or it is mounted in another way; begin a "
        "new session for it."
    )


def wrong_mounting(
    name: str, reference: Reference, now: ImuBlock, pose: Pose, mounting: FloatArray
) -> str | None:
    """Say what is wrong if gravity does not stand where another mounting should have brought it.

    Parameters
    ----------
    name : str
        Of the sensor.
    reference : Reference
        What the sensor read in a known pose and mounting.
    now : ImuBlock
        The sensor at rest.
    pose : Pose
        Where the jig stands.
    mounting : shape (3,)
        Nominal rotation vector of the sensor on the plate that is wanted [rad].
    """
    up = _attitude_of(reference.pose, reference.mounting) @ reference.accel
    expected = _attitude_of(pose, mounting).T @ up
    seen = np.mean(now.accel, axis=0)
    cosine = float(expected @ seen) / float(np.linalg.norm(expected) * np.linalg.norm(seen))
    off = float(np.arccos(np.clip(cosine, -1.0, 1.0))) / DEG
    if off <= (MOUNTING_TOLERANCE_DEG if has_gyro(now) else ANALOG_MOUNTING_TOLERANCE_DEG):
        return None
    return (
        f"{name} does not sit as this mounting asks: up is its {_axis_of(seen)} axis and should "
        f"be its {_axis_of(expected)} axis ({off:.0f} deg off)."
    )


def other_readings(name: str, before: Visit, now: ImuBlock) -> str | None:
    """Say what is wrong if a sensor that was turned over reads as another one.

    Gravity stands elsewhere then; its size and the gyroscope's bias are the sensor's own. Its
    uncalibrated scale and bias make the size differ between attitudes, so only much counts.
    """
    bias = _bias_change_dps(before, now)
    if bias <= SAME_BIAS_DPS:
        return None
    return (
        f"{name}'s gyroscope bias differs by {bias:.1f} deg/s from that of the session's sensor: "
        "this is another sensor; begin a new session for it."
    )


def _bias_change_dps(before: Visit, now: ImuBlock) -> float:
    """Return the largest change of the gyroscope's bias; 0 where there is no gyroscope."""
    if before.gyro_mean is None or not has_gyro(now):
        return 0.0
    return float(np.max(np.abs(np.mean(now.gyro, axis=0) - before.gyro_mean))) / DEG


def _attitude_of(pose: Pose, mounting: FloatArray) -> FloatArray:
    mounted = rotation.to_matrix(rotation.from_rotation_vector(np.asarray(mounting)))
    turned: FloatArray = attitude(pose) @ mounted
    return turned


def _axis_of(direction: FloatArray) -> str:
    axis = int(np.argmax(np.abs(direction)))
    return ("+" if direction[axis] > 0 else "-") + "xyz"[axis]


def silence(imu: ImuDevice) -> str:
    """Say what to do about a sensor from which no packets come."""
    problem = imu.identify_problem()
    if problem is not None:
        return problem
    return (
        f"{imu.name} on {imu.url} sends nothing: check its power, its cable or Bluetooth link, "
        "and that this is its port."
    )


def angles(reported: Mapping[str, float]) -> str:
    """Write axis angles [deg] for a sentence."""
    return ", ".join(f"{axis} {angle:+.1f} deg" for axis, angle in reported.items())
