"""Whether what came out of a recording is the motion of a foot that steps."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.footfalls import runs
from imu_rig.gait.trajectory import FootTrack
from imu_rig.kernels.columns import rotated
from imu_rig.kernels.foot_backward import integrate
from imu_rig.kernels.rolling import moving_mean, moving_minimum
from imu_rig.rotation import from_rotation_vector, rotate
from imu_rig.units import STANDARD_GRAVITY

REST_ACCEL = 1.5
REST_SHARE, REST_SHARE_SPRINT = 0.15, 0.35
SPRINT_SWING = 30.0
"""At the quietest moment of a stance a foot is accelerated by less than this [m/s^2], or by less
than this share of its swings: a running foot, which rolls on, by 1.2 m/s^2 and 6 %. A sprinter's,
whose swings exceed `SPRINT_SWING` (root mean square, [m/s^2]), never rests and is accelerated by
17 m/s^2 and 25 %. What is waved or worn elsewhere turns around there: 40 % and more."""

FORCED_SHARE, FORCED = 0.2, 0.03
"""Between two stances the integral of the acceleration is the change of velocity, except for what a
smoother makes up for: 1 to 8 % of the highest speed in walks and runs, 16 % of a hand's width of
slow sliding with an uncalibrated sensor. Where "at rest" is not true, it makes up for the motion
itself: more than this share of the speed and this [m/s], by the upper quartiles of the strides."""

QUIET = 0.1
LONG_S, LAG_S, MEAN_S = 1.5, 1.0, 0.5
DRIFTS = 0.3
DRIFT_SHARE = 0.1
DRIFT_LEAST_S = 1.0
"""Where motion stays below `QUIET` [m/s] for longer than `LONG_S`, as it does not in swings but the
slowest, the mean specific force in two moments of rest differs by what the gyroscope says. If it
comes to differ by this [m/s^2] (1.8 deg) more within `LAG_S` for a tenth of the time, something
moves that does not step: a vehicle, a lift, another part of the body."""

LONGEST_STRIDE, FARTHEST = 5.0, 10.0
"""Sprinters' strides are up to 5 m long; two with a stance between that was missed, up to 10 m."""
LONGEST_SWING_S = 3.0
"""Without a stance for so long, integration drifts by some decimetres."""
EDGE_S = 0.3


def check_track(
    track: FootTrack, block: ImuBlock, *, gravity: float = STANDARD_GRAVITY
) -> tuple[str, ...]:
    """Check what came out: whether it is the motion of a foot that steps.

    Parameters
    ----------
    track : FootTrack
        As smoothed.
    block : ImuBlock
        What it was made of.
    gravity : float
        [m/s^2]

    Returns
    -------
    tuple of str
        What its reader should know, a sentence each without its stop.

    Raises
    ------
    DataError
        If it is not.
    """
    rows = track.footfalls.quietest
    if not len(rows):
        raise DataError(_NOT_A_FOOT.format("it never comes to rest"))
    t = track.trajectory.t
    accel = np.ascontiguousarray(block.accel, dtype=float) - track.accel_bias
    _require_rest(track, t, accel, gravity)
    _require_consistent(track, t, accel, gravity)
    _require_steady(track, t, accel, block.gyro - track.gyro_bias)
    steps = np.diff(track.trajectory.position[rows], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if np.any(lengths > FARTHEST):
        at = int(np.argmax(lengths))
        raise DataError(
            _NOT_A_FOOT.format(f"a stride of {lengths[at]:.1f} m at {t[rows[at]]:.1f} s came out")
        )
    notes = _notes_of(track, t)
    if np.any(lengths > LONGEST_STRIDE):
        at = int(np.argmax(lengths))
        notes.append(
            f"the stride of {lengths[at]:.1f} m at {t[rows[at]]:.1f} s is longer than people's: a "
            "stance within it was probably missed"
        )
    return tuple(notes)


_NOT_A_FOOT = (
    "this is not a foot that steps: {}; fix the sensor to the foot, and if it was, check units, "
    "axes and range"
)


def _require_rest(track: FootTrack, t: FloatArray, accel: FloatArray, gravity: float) -> None:
    """Refuse what is accelerated in the moments that were taken for rest."""
    swings = ~track.zero_velocity.still
    if not swings.any():
        return
    mean = moving_mean(t, accel, 0.025)
    moved = rotated(track.trajectory.quaternion, mean) - np.array([0.0, 0.0, gravity])
    size = np.sqrt(np.einsum("ij,ij->i", moved, moved))
    at_rest = float(np.median(size[track.footfalls.quietest]))
    in_swing = float(np.sqrt(np.mean(size[swings] ** 2)))
    share = REST_SHARE if in_swing < SPRINT_SWING else REST_SHARE_SPRINT
    if at_rest > REST_ACCEL and at_rest > share * in_swing:
        raise DataError(
            _NOT_A_FOOT.format(f"where it seems to stand it is accelerated by {at_rest:.1f} m/s2")
        )


def _require_consistent(track: FootTrack, t: FloatArray, accel: FloatArray, gravity: float) -> None:
    """Refuse where the velocity at the ends of strides is forced upon the accelerations."""
    rows = track.footfalls.quietest
    if len(rows) < 2:
        return
    moved = rotated(track.trajectory.quaternion, accel) - np.array([0.0, 0.0, gravity])
    reached = np.empty_like(moved)
    integrate(np.diff(t, prepend=t[0]), moved[0], np.zeros(3), moved, reached)
    velocity = track.trajectory.velocity
    forced = np.diff(velocity[rows], axis=0) - np.diff(reached[rows], axis=0)
    square = np.einsum("ij,ij->i", velocity, velocity)
    speed = np.sqrt(np.maximum.reduceat(square[: rows[-1]], rows[:-1]))
    typical = float(np.percentile(speed, 75))
    most = float(np.percentile(np.linalg.norm(forced, axis=1), 75))
    if most > FORCED_SHARE * typical + FORCED:
        raise DataError(
            _NOT_A_FOOT.format(
                f"where it seems to stand it moves on, by {most:.1f} m/s more or less than before"
            )
        )


def _require_steady(track: FootTrack, t: FloatArray, accel: FloatArray, gyro: FloatArray) -> None:
    """Refuse what is accelerated slowly while it seems to stand."""
    begin, end = _moments(track.zero_velocity.statistic < QUIET, t)
    resting = moving_minimum(t, track.zero_velocity.still.astype(float), 0.5 * MEAN_S) > 0.0
    both = resting[begin] & resting[end]
    begin, end = begin[both], end[both]
    if not len(begin):
        return
    mean = moving_mean(t, accel, 0.5 * MEAN_S)
    dt = np.diff(t, prepend=t[0])[:, np.newaxis]
    turned = np.cumsum(gyro * dt, axis=0)
    before = rotate(from_rotation_vector(turned[begin] - turned[end]), mean[begin])
    off = np.linalg.norm(mean[end] - before, axis=1) > DRIFTS
    share = float(off.mean())
    if share > DRIFT_SHARE and off.sum() * 0.1 > DRIFT_LEAST_S:
        raise DataError(
            _NOT_A_FOOT.format(
                f"for {100 * share:.0f} % of the time that it seems to stand its acceleration "
                "changes, as in a vehicle or a lift"
            )
        )


def _moments(quiet: BoolArray, t: FloatArray) -> tuple[IntArray, IntArray]:
    """Return pairs of samples `LAG_S` apart in long quiet spans."""
    begins = []
    for first, last in zip(*runs(quiet), strict=True):
        if t[last] - t[first] >= LONG_S:
            half = 0.5 * MEAN_S
            begins.append(np.arange(t[first] + half, t[last] - half - LAG_S, 0.1))
    moments = np.concatenate(begins) if begins else np.empty(0)
    begin, end = np.searchsorted(t, moments), np.searchsorted(t, moments + LAG_S)
    return begin.astype(np.int64), end.astype(np.int64)


def _notes_of(track: FootTrack, t: FloatArray) -> list[str]:
    falls = track.footfalls
    notes = []
    if len(falls) == 1 and track.zero_velocity.still.all():
        notes.append("the foot stood all the time: no strides, distance 0")
    elif len(falls) < 2:
        notes.append("there is only one stance, so no stride can be measured")
    away = t[falls.first[1:]] - t[falls.last[:-1]]
    if len(away) and away.max() > LONGEST_SWING_S:
        at = int(np.argmax(away))
        notes.append(
            f"the foot does not rest for {away[at]:.1f} s from {t[falls.last[at]]:.1f} s on: that "
            "stride is uncertain"
        )
    for word, seconds in (
        ("before the first", t[falls.first[0]] - t[0]),
        ("after the last", t[-1] - t[falls.last[-1]]),
    ):
        if seconds > EDGE_S:
            notes.append(
                f"the foot moves for {seconds:.1f} s {word} stance, which is no whole stride; "
                "begin and end with two seconds of standing"
            )
    return notes
