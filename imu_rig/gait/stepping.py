"""Whether what came out of a recording is the motion of a foot that steps."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.footfalls import runs
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.trajectory import FootTrack
from imu_rig.gait.unseen import Unseen
from imu_rig.kernels.columns import rotated
from imu_rig.kernels.foot_checks import means_around, stride_changes, turned_between
from imu_rig.rotation import from_rotation_vector, rotate
from imu_rig.units import STANDARD_GRAVITY

REST_ACCEL = 1.5
REST_SHARE, REST_SHARE_SPRINT = 0.15, 0.35
SPRINT_SWING = 30.0
"""At the quietest moment of a stance a foot is accelerated by less than this [m/s^2], or by less
than this share of its swings: a running foot, which rolls on, by 1.2 m/s^2 and 6 %. A sprinter's,
whose swings exceed `SPRINT_SWING` (root mean square, [m/s^2]), never rests and is accelerated by
17 m/s^2 and 25 %. What is waved or worn elsewhere turns around there: 40 % and more."""

SWING_EVERY = 7
"""So many samples of swings are one for their root mean square."""

FORCED_SHARE, FORCED, TILTED, SLOW_S = 0.2, 0.03, 0.5, 2.0
"""Between two stances the integral of the acceleration is the change of velocity, except for what a
smoother makes up for: 1 to 8 % of the highest speed in walks and runs, 16 % of a hand's width of
slow sliding with an uncalibrated sensor. Where "at rest" is not true, it makes up for the motion
itself: more than this share of the speed and this [m/s], by the upper quartiles of the strides.
What bias and axes of a raw accelerometer let slip of gravity adds up through a slide that takes
longer than `SLOW_S`; about half of it is made up for."""
UNSEEN = 2.0
"""What readings may have missed, a strike between two samples for one, counts up to so many of its
standard deviations."""

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
    track: FootTrack,
    block: ImuBlock,
    *,
    gravity: float = STANDARD_GRAVITY,
    unseen: Unseen | None = None,
    grade: SensorGrade | None = None,
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
    unseen : Unseen, optional
        What the recording does not tell of the motion.
    grade : SensorGrade, optional
        Of the sensor, after what it showed.

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
    t = np.ascontiguousarray(track.trajectory.t, dtype=float)
    accel = np.ascontiguousarray(block.accel, dtype=float)
    _require_rest(track, t, accel, gravity)
    missed = np.zeros(len(t)) if unseen is None else unseen.velocity
    grade = SensorGrade() if grade is None else grade
    tilted = TILTED * (grade.accel_bias + grade.accel_matrix * gravity)
    _require_consistent(track, t, accel, missed, gravity, tilted)
    _require_steady(track, t, accel, np.ascontiguousarray(block.gyro, dtype=float))
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
    swings = np.flatnonzero(~track.zero_velocity.still)
    if not len(swings):
        return
    quietest = track.footfalls.quietest
    rows = np.concatenate((quietest, swings[::SWING_EVERY]))
    mean = means_around(t, accel, rows, 0.025) - track.accel_bias
    moved = rotated(track.trajectory.quaternion[rows], mean) - np.array([0.0, 0.0, gravity])
    square = np.einsum("ij,ij->i", moved, moved)
    at_rest = float(np.sqrt(np.median(square[: len(quietest)])))
    in_swing = float(np.sqrt(np.mean(square[len(quietest) :])))
    share = REST_SHARE if in_swing < SPRINT_SWING else REST_SHARE_SPRINT
    if at_rest > REST_ACCEL and at_rest > share * in_swing:
        raise DataError(
            _NOT_A_FOOT.format(f"where it seems to stand it is accelerated by {at_rest:.1f} m/s2")
        )


def _require_consistent(
    track: FootTrack,
    t: FloatArray,
    accel: FloatArray,
    missed: FloatArray,
    gravity: float,
    tilted: float,
) -> None:
    """Refuse where the velocity at the ends of strides is forced upon the accelerations."""
    rows = track.footfalls.quietest
    if len(rows) < 2:
        return
    whole = track.trajectory
    told = stride_changes(
        t,
        accel,
        track.accel_bias,
        np.ascontiguousarray(whole.quaternion),
        np.ascontiguousarray(whole.velocity),
        rows,
        gravity,
    )
    forced = np.diff(whole.velocity[rows], axis=0) - told[:, :3]
    speed = told[:, 3]
    typical = float(np.percentile(speed, 75))
    most = float(np.percentile(np.linalg.norm(forced, axis=1), 75))
    variance = np.add.reduceat(np.square(missed[: rows[-1]]), rows[:-1])
    explained = UNSEEN * float(np.sqrt(np.percentile(variance, 75)))
    slipped = tilted * max(0.0, float(np.percentile(np.diff(t[rows]), 25)) - SLOW_S)
    if most > np.sqrt((FORCED_SHARE * typical + FORCED) ** 2 + explained**2 + slipped**2):
        raise DataError(
            _NOT_A_FOOT.format(
                f"where it seems to stand it moves on, by {most:.1f} m/s more or less than before"
            )
        )


def _require_steady(track: FootTrack, t: FloatArray, accel: FloatArray, gyro: FloatArray) -> None:
    """Refuse what is accelerated slowly while it seems to stand."""
    begin, end = _moments(track.zero_velocity.statistic < QUIET, t)
    if not len(begin):
        return
    both = _resting(track.zero_velocity.still, t, np.stack((begin, end))).all(axis=0)
    begin, end = begin[both], end[both]
    if not len(begin):
        return
    mean = means_around(t, accel, begin, 0.5 * MEAN_S) - track.accel_bias
    later = means_around(t, accel, end, 0.5 * MEAN_S) - track.accel_bias
    turned = turned_between(t, gyro, begin, end)
    turned -= (t[end] - t[begin])[:, np.newaxis] * track.gyro_bias
    before = rotate(from_rotation_vector(-turned), mean)
    off = np.linalg.norm(later - before, axis=1) > DRIFTS
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


def _resting(still: BoolArray, t: FloatArray, rows: IntArray) -> BoolArray:
    """Tell of samples whether the foot rests throughout the `MEAN_S` around each."""
    moving = np.concatenate(([0], np.cumsum(~still)))
    first = np.searchsorted(t, t[rows] - 0.5 * MEAN_S - 1e-9)
    last = np.searchsorted(t, t[rows] + 0.5 * MEAN_S + 1e-9, side="right")
    return np.asarray(moving[last] == moving[first])


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
