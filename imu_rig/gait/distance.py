"""System 1's gait distance: gravity removal, zero velocity in stance, double integration.

The plain method of the paper, for comparison: one threshold for everybody, and what a swing's
velocity is wrong by at its end is forgotten, not shared out. `imu_rig.gait.smoother` does better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError, InputError
from imu_rig.gait.detectors import Detector, detector_named
from imu_rig.gait.fixed_threshold import FixedThreshold
from imu_rig.gait.footfalls import runs
from imu_rig.gait.gravity_removal import MADGWICK_GAIN, SEARCH_S, GravityRemoval
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.rotation import about_z, from_rotation_vector, multiply
from imu_rig.units import STANDARD_GRAVITY

LONG_SWING_S = 2.0
"""A foot is in the air for 0.3 to 0.6 s, that of a stroke patient for up to 1 s."""

GAP_S = 0.05
"""A foot may change its speed by a metre per second meanwhile."""

DOUBTFUL = 0.05
"""Share of the distance from which on its error is told of."""

WORLDLY = (0.7, 1.3)
"""Specific force at rest over gravity: with an uncalibrated sensor's scale and bias at worst."""


@dataclass(frozen=True)
class WalkOptions:
    """How a distance is found.

    Attributes
    ----------
    detector : str or Detector
        What tells stance from swing: eq. (9) by default, or another of `DETECTORS`.
    gain : float
        Speed at which the accelerometer corrects the attitude [rad/s of a quaternion].
    gravity : float
        Local gravity [m/s^2].
    magnetometer : bool
        Whether the magnetic field, where there is one, corrects the yaw.
    start_yaw : float or None
        Yaw of the sensor's x axis at the start against the line of the walk [rad], where it is
        known. With None x points to where the first `lead` metres went.
    lead : float
        [m]; two strides, of which a foot 2 cm to the side turns x by less than a degree.
    """

    detector: str | Detector = "threshold"
    gain: float = MADGWICK_GAIN
    gravity: float = STANDARD_GRAVITY
    magnetometer: bool = False
    start_yaw: float | None = None
    lead: float = 2.0


@dataclass(frozen=True, eq=False)
class WalkDistance:
    """A walk by double integration; x along the walk, y to the left, z up.

    Attributes
    ----------
    t : shape (n,)
        Times [s].
    quaternion : shape (n, 4)
        Attitude, sensor to navigation axes.
    acceleration : shape (n, 3)
        Without gravity [m/s^2].
    zero_velocity : ZeroVelocity
        Stance, and what it was told by.
    velocity : shape (n, 3)
        Zero in stance [m/s].
    position : shape (n, 3)
        From the first sample on [m].
    doubt : shape (3,)
        What the distance is likely to be wrong by [m]: see `unclosed`.
    notes : tuple of str
        What its reader should know: a sentence each.
    """

    t: FloatArray
    quaternion: FloatArray
    acceleration: FloatArray
    zero_velocity: ZeroVelocity
    velocity: FloatArray
    position: FloatArray
    doubt: FloatArray
    notes: tuple[str, ...] = ()

    @property
    def distance(self) -> FloatArray:
        """From the begin to the end along each axis, (3,) [m]."""
        return np.asarray(self.position[-1] - self.position[0])

    @property
    def norm(self) -> FloatArray:
        """Norm of the acceleration, eq. (9), (n,) [m/s^2]."""
        return np.asarray(np.linalg.norm(self.acceleration, axis=1))


def walk_distance(
    block: ImuBlock,
    options: WalkOptions = WalkOptions(),
    *,
    zero_velocity: ZeroVelocity | None = None,
) -> WalkDistance:
    """Measure how far a foot went.

    Parameters
    ----------
    block : ImuBlock
        Of a sensor on a foot, calibrated or not.
    options : WalkOptions
    zero_velocity : ZeroVelocity, optional
        Stance of each sample, in place of what the options' detector finds.

    Returns
    -------
    WalkDistance

    Raises
    ------
    DataError
        Readings that are not finite, times that go back, a specific force at rest that is not
        gravity in m/s^2, or a foot that never stands or never swings.
    InputError
        There is no such detector, or ``zero_velocity`` is of another recording.
    """
    _check(block)
    detector = detector_named(options.detector)
    removal = GravityRemoval(options.gain, options.gravity, magnetometer=options.magnetometer)
    parts = removal.update(block), removal.finish()
    if not WORLDLY[0] < removal.rest_force / options.gravity < WORLDLY[1]:
        raise DataError(
            f"the specific force at rest is {removal.rest_force:.3g} m/s^2 and should be near "
            f"{options.gravity:.2f}; name the right unit of the accelerometer"
        )
    quaternion = np.concatenate([part.quaternion for part in parts])
    acceleration = np.concatenate([part.acceleration for part in parts])
    if zero_velocity is None:
        if isinstance(detector, FixedThreshold):
            zero_velocity = detector.of_acceleration(block.t, acceleration)
        else:
            zero_velocity = detector.detect(block)
    elif len(zero_velocity) != len(block):
        raise InputError(
            f"stance of {len(zero_velocity)} samples was given for a recording of {len(block)}; "
            "detect it on this recording"
        )
    still = zero_velocity.still
    _check_phases(block, still, zero_velocity)
    velocity, position = integrated(block.t, acceleration, still)
    doubt = unclosed(block.t, velocity, still)
    yaw = _yaw_of_walk(quaternion, position, options)
    turn = from_rotation_vector(np.array([0.0, 0.0, yaw]))
    axes = about_z(yaw).T
    return WalkDistance(
        block.t,
        multiply(turn, quaternion),
        acceleration @ axes,
        zero_velocity,
        velocity @ axes,
        position @ axes,
        axes.T @ doubt,
        (
            *_notes(block.t, still, still_start=bool(removal.still_start)),
            *_doubts(doubt, position),
        ),
    )


def integrated(
    t: FloatArray, acceleration: FloatArray, still: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Integrate twice, eq. (7), with zero velocity in stance.

    By the trapezoid rule over the measured time stamps. The velocity at each sample in swing is
    what was gained since the last sample in stance; before the first one, which ends a swing that
    the recording begins in, it is what leads to zero there.

    Parameters
    ----------
    t : shape (n,)
        [s]
    acceleration : shape (n, 3)
        Navigation axes, without gravity [m/s^2].
    still : shape (n,)
        At least one is True.

    Returns
    -------
    velocity, position : shape (n, 3)
    """
    dt = np.diff(t)[:, np.newaxis]
    gained = np.zeros_like(acceleration)
    np.cumsum(0.5 * dt * (acceleration[1:] + acceleration[:-1]), axis=0, out=gained[1:])
    rows = np.arange(len(t))
    last = np.maximum.accumulate(np.where(still, rows, -1))
    velocity = gained - gained[np.where(last < 0, int(np.argmax(still)), last)]
    position = np.zeros_like(velocity)
    np.cumsum(0.5 * dt * (velocity[1:] + velocity[:-1]), axis=0, out=position[1:])
    return velocity, position


def unclosed(t: FloatArray, velocity: FloatArray, still: BoolArray) -> FloatArray:
    """Return how far the foot went too far because its velocity did not come back to zero, (3,).

    What a swing's velocity still is when the foot stands was gained by errors. Of a constant one
    the way is half of that velocity times the swing's duration [m], summed over all swings.

    Parameters
    ----------
    t : shape (n,)
        [s]
    velocity : shape (n, 3)
        With zero in stance [m/s].
    still : shape (n,)
    """
    first, last = runs(~still)
    whole = (first > 0) & (last < len(t) - 1)
    first, last = first[whole], last[whole]
    lasted = (t[last] - t[first - 1])[:, np.newaxis]
    return np.asarray(0.5 * np.sum(velocity[last] * lasted, axis=0))


def _yaw_of_walk(quaternion: FloatArray, position: FloatArray, options: WalkOptions) -> float:
    """Return by what all is to be turned so that x is along the walk [rad]."""
    if options.start_yaw is not None:
        w, x, y, z = quaternion[0]
        yaw = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
        return float(options.start_yaw - yaw)
    gone = np.hypot(position[:, 0], position[:, 1])
    beyond = gone >= min(options.lead, 0.9 * float(gone.max()))
    x, y = position[int(np.argmax(beyond)), :2]
    return float(-np.arctan2(y, x))


def _check(block: ImuBlock) -> None:
    if len(block) < 3:
        raise DataError(f"a recording of {len(block)} samples is no walk; record at least a stride")
    if not all(np.isfinite(column).all() for column in (block.t, block.accel, block.gyro)):
        raise DataError(
            "the recording has readings or times that are not finite numbers; repair or cut it"
        )
    if np.any(np.diff(block.t) < 0.0):
        raise DataError("the time stamps go back; sort the recording or cut it there")


def _check_phases(block: ImuBlock, still: BoolArray, found: ZeroVelocity) -> None:
    if not still.any():
        least = float(np.min(found.statistic))
        raise DataError(
            f"the foot never stands by this detector, whose statistic is {least:.3g} at least and "
            f"must be below {float(found.threshold[0]):.3g}; take another detector"
        )
    if still.all():
        raise DataError(
            "the foot never swings by this detector; take another one, or a recording of a walk"
        )


def _doubts(doubt: FloatArray, position: FloatArray) -> list[str]:
    walked = float(np.max(np.linalg.norm(position - position[0], axis=1)))
    wrong = float(np.linalg.norm(doubt))
    if wrong <= DOUBTFUL * walked:
        return []
    return [
        f"The velocity does not come back to zero at the ends of the swings; the distance is "
        f"likely to be wrong by {wrong:.1f} m: calibrate the sensor, or take another detector."
    ]


def _notes(t: FloatArray, still: BoolArray, *, still_start: bool) -> list[str]:
    notes = []
    if not still_start:
        notes.append(
            f"The foot stood still for no second of the first {SEARCH_S:g} s: the attitude begins "
            "with that of a stance, and may be wrong by a degree or two for some strides."
        )
    first, last = runs(~still)
    longest = float(np.max(t[last] - t[first]))
    if longest > LONG_SWING_S:
        notes.append(
            f"No stance was found for {longest:.1f} s: the velocity went astray meanwhile, so that "
            "the distance is not to be trusted; take another detector."
        )
    moving = ~(still[1:] & still[:-1])
    lost = np.diff(t)[moving & (np.diff(t) > GAP_S)]
    if len(lost):
        notes.append(
            f"{len(lost)} gaps of up to {lost.max():.2f} s in the middle of a swing: its distance "
            "is a guess."
        )
    return notes
