"""Whether a recording can give a true answer about a foot, before and after it is worked out.

What cannot is refused with what to do; what makes an answer less certain is said. Every bound is
one that no foot, or no sensor, keeps to, with a margin; simulated gait from shuffling to sprints
stays far on the right side of them.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.axes import (
    FEWEST_STRIDES,
    AxesAgreement,
    ClockAgreement,
    compare_axes,
    compare_clocks,
    gravity_at_rest,
    sample_strides,
)
from imu_rig.gait.footfalls import runs
from imu_rig.gait.form import check_form
from imu_rig.gait.stills import Stills, find_stills
from imu_rig.gait.trajectory import FootTrack
from imu_rig.gait.unseen import (
    CLIP_ABOVE_ACCEL,
    CLIP_ABOVE_GYRO,
    STEP_S,
    SWING_S,
    find_clipping,
    find_gaps,
)
from imu_rig.kernels.rolling import moving_mean
from imu_rig.rotation import from_rotation_vector, rotate
from imu_rig.units import DEG, STANDARD_GRAVITY

MOST_RATE = 35.0
"""2000 deg/s [rad/s], the range of most gyroscopes. A foot reaches it in a sprint only, and never
for 1 % of the time; the slowest steps in deg/s do."""

SHAKES = 1.5
"""Feet that step are accelerated by more than this, root mean square [m/s^2]..."""
TURNS = 1.0
"""... and turn faster than this at times [rad/s]: lifting the heel takes 60 deg/s at least."""

SCALE_TOLD = 0.01
"""An accelerometer that is off by 1 % at rest is told: distances may be off by as much."""
SCALE_REFUSED = 0.15
"""Beyond what uncalibrated sensors are off at rest, scale and offset together (3 %, 0.08 g)."""
LIKELY_G, LIKELY_MG = (0.5, 2.0), (500.0, 2000.0)
ANY_REST = (0.4, 3.0)
"""Sizes of specific force in the quietest moments of a recording without any rest, over g."""

GAIN_TOLD = 0.02
MISSING_REFUSED = 0.05
"""With a twentieth of the moving time in gaps, every other stride has one."""

CUT_REFUSED, CUT_MUCH = 0.2, 0.05
"""With a fifth of the moving time beyond the range of the sensor, most of every strike or swing is
lost. From a twentieth on, contradictions of the sensors may come from there."""

REST_ACCEL = 1.5
REST_SHARE, REST_SHARE_SPRINT = 0.15, 0.35
SPRINT_SWING = 30.0
"""At the quietest moment of a stance a foot is accelerated by less than this [m/s^2], or by less
than this share of its swings: a running foot, which rolls on, by 1.2 m/s^2 and 6 %. A sprinter's,
whose swings exceed `SPRINT_SWING` (root mean square, [m/s^2]), never rests and is accelerated by
17 m/s^2 and 25 %. What is waved or worn elsewhere turns around there: 40 % and more."""

LONG_S, LAG_S, MEAN_S = 1.5, 1.0, 0.5
DRIFTS = 0.3
DRIFT_SHARE = 0.1
DRIFT_LEAST_S = 1.0
"""In stances longer than `LONG_S` the mean specific force follows the gyroscope; if it comes to
differ by this [m/s^2] (1.8 deg) within `LAG_S` for a tenth of the time, something moves that does
not step: a vehicle, a lift, another part of the body."""

LONGEST_STRIDE, FARTHEST = 5.0, 10.0
"""Sprinters' strides are up to 5 m long; two with a stance between that was missed, up to 10 m."""
LONGEST_SWING_S = 3.0
"""Without a stance for so long, integration drifts by some decimetres."""
EDGE_S = 0.3


def check_recording(block: ImuBlock, *, gravity: float = STANDARD_GRAVITY) -> tuple[str, ...]:
    """Check a recording of a foot before anything is worked out from it.

    Parameters
    ----------
    block : ImuBlock
        As it was read, no bias taken off.
    gravity : float
        Local gravity [m/s^2].

    Returns
    -------
    tuple of str
        What its reader should know, a sentence each without its stop.

    Raises
    ------
    DataError
        If it cannot give a true answer: what is wrong and what to do.
    """
    notes = [*check_form(block)]
    accel = np.ascontiguousarray(block.accel, dtype=float)
    gyro = np.ascontiguousarray(block.gyro, dtype=float)
    block = ImuBlock(np.asarray(block.t, dtype=float), accel, gyro, block.host_s)
    rate = np.sqrt(np.einsum("ij,ij->i", gyro, gyro))
    usual, most = np.percentile(rate, (99.0, 99.5))
    if usual > MOST_RATE:
        raise DataError(
            f"the gyroscope reads {usual:.0f} rad/s, faster than any foot turns; it is probably in "
            "deg/s: state its unit (--gyro-unit deg/s)"
        )
    stills = find_stills(block.t, accel, gyro)
    notes += _check_gravity(block, stills, gravity)
    cut, told = _check_ranges(block)
    notes += told
    notes += _check_gaps(block)
    if cut < CUT_MUCH:
        _require_agreement(block, stills, gravity, float(most))
    return tuple(notes)


def _check_gravity(block: ImuBlock, stills: Stills, gravity: float) -> list[str]:
    """Compare the accelerometer with gravity where the sensor rests most."""
    if len(stills):
        size, bounds = gravity_at_rest(block, stills), (1 - SCALE_REFUSED, 1 + SCALE_REFUSED)
    else:
        columns = np.hstack((block.accel, np.sum(block.gyro**2, axis=1, keepdims=True)))
        mean = moving_mean(block.t, columns, 0.125)
        quiet = mean[:, 3] <= np.percentile(mean[:, 3], 10)
        size, bounds = float(np.median(np.linalg.norm(mean[quiet, :3], axis=1))), ANY_REST
    ratio = size / gravity
    if bounds[0] <= ratio <= bounds[1]:
        if len(stills) and abs(ratio - 1.0) > SCALE_TOLD:
            way = "much" if ratio > 1.0 else "little"
            return [
                f"at rest the accelerometer reads {100 * abs(ratio - 1.0):.1f} % too {way}; "
                "distances may be wrong by as much: calibrate the sensor"
            ]
        return []
    for unit, (low, high) in (("g", LIKELY_G), ("mg", LIKELY_MG)):
        if low < size < high:
            raise DataError(
                f"the accelerometer reads {size:.3g} at rest instead of {gravity:.2f} m/s2; it is "
                f"probably in {unit}: state its unit (--accel-unit {unit})"
            )
    if ratio < bounds[0]:
        raise DataError(
            f"the accelerometer reads {size:.2g} m/s2 at rest instead of {gravity:.2f}; if gravity "
            "was taken out of it, record it with gravity, else state its unit (--accel-unit)"
        )
    raise DataError(
        f"the accelerometer reads {size:.3g} m/s2 at rest instead of {gravity:.2f}; state its unit "
        "(--accel-unit, such as '16384 LSB/g'), or calibrate it"
    )


def _require_agreement(block: ImuBlock, stills: Stills, gravity: float, turns: float) -> None:
    """Refuse what gyroscope and accelerometer contradict each other in."""
    strides = sample_strides(block, stills, gravity)
    axes = compare_axes(strides)
    shakes = float(np.sqrt(np.var(block.accel, axis=0).sum()))
    lazy = shakes > SHAKES and turns < TURNS and axes.best[0, 0] > 1.0  # of few strides too
    if lazy or not axes.agree:
        raise DataError(_disagreement(axes))
    if axes.strides >= FEWEST_STRIDES:
        clocks = compare_clocks(strides)
        if not clocks.agree:
            raise DataError(_apart(clocks))


def _apart(clocks: ClockAgreement) -> str:
    late = 1e3 * clocks.late_s
    text = (
        "gyroscope and accelerometer contradict each other: strides would end at rest if the "
        f"gyroscope came {abs(late):.0f} ms {'earlier' if late > 0 else 'later'}"
    )
    if abs(clocks.gain - 1.0) > GAIN_TOLD:
        text += f" and its readings, or all intervals of time, were multiplied by {clocks.gain:.2f}"
    return f"{text}; correct the times or calibrate the gyroscope"


def _disagreement(agreement: AxesAgreement) -> str:
    best = agreement.best
    size = abs(best).max()
    if size != 1.0:
        unit = "deg/s" if size < 1.0 else "rad/s, taken for deg/s"
        return (
            "the gyroscope does not turn as much as the accelerometer tilts; it is probably in "
            f"{unit}: state its unit (--gyro-unit)"
        )
    order = ",".join(
        f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}" for row in best
    )
    what = (
        "axes are exchanged or reversed"
        if np.linalg.det(best) > 0
        else "axes are left-handed where the accelerometer's are right-handed"
    )
    return (
        f"gyroscope and accelerometer contradict each other: the gyroscope's {what}; strides end "
        f"at rest when it is read as {order}: correct its columns (--gyro {order}) or those of "
        "the accelerometer"
    )


def _check_gaps(block: ImuBlock) -> list[str]:
    gaps = find_gaps(block)
    if not len(gaps):
        return []
    start = block.t[gaps.row] - gaps.length
    swing = ~gaps.resting
    for hidden, what in (
        (gaps.length >= STEP_S, "long enough for a step"),
        (swing & (gaps.length >= SWING_S), "while the foot swung"),
    ):
        if hidden.any():
            at = int(np.argmax(hidden))
            raise DataError(
                f"{gaps.length[at]:.2f} s are missing at {start[at]:.2f} s, {what}; cut the "
                "recording there and work out its parts"
            )
    moving = np.linalg.norm(block.gyro[:-1], axis=1) > TURNS
    missing = float(gaps.length[swing].sum())
    time = float(np.diff(block.t)[moving].sum())
    if missing > MISSING_REFUSED * time:
        raise DataError(
            f"{100 * missing / max(time, missing):.0f} % of the time in which the foot moved is "
            "missing; see that the sensor loses fewer samples"
        )
    notes = []
    if swing.any():
        worst = int(np.argmax(np.where(swing, gaps.length, 0.0)))
        notes.append(
            f"while the foot moved, samples are missing {int(swing.sum())} times, the longest "
            f"{1e3 * gaps.length[worst]:.0f} ms at {start[worst]:.2f} s: such strides are less "
            "certain"
        )
    if gaps.resting.any():
        notes.append(f"{int(gaps.resting.sum())} times samples are missing of a foot that stands")
    return notes


def _check_ranges(block: ImuBlock) -> tuple[float, list[str]]:
    most, notes = 0.0, []
    moving = np.linalg.norm(block.gyro, axis=1) > TURNS
    for values, least, word, unit, factor in (
        (block.gyro, CLIP_ABOVE_GYRO, "gyroscope", "deg/s", 1.0 / DEG),
        (block.accel, CLIP_ABOVE_ACCEL, "accelerometer", "g", 1.0 / STANDARD_GRAVITY),
    ):
        clipping = find_clipping(values, least)
        cut = clipping.cut.any(axis=1)
        if not cut.any():
            continue
        share = float(cut.sum() / max(1, np.count_nonzero(moving | cut)))
        axis = int(np.argmin(clipping.limit))
        text = (
            f"the {word} is at the end of its range ({clipping.limit[axis] * factor:.3g} {unit}) "
            f"for {100 * share:.1f} % of the moving time"
        )
        most = max(most, share)
        if share > CUT_REFUSED:
            raise DataError(f"{text}; set a wider range and record again")
        notes.append(f"{text}: strides are less certain")
    return most, notes


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
    moved = rotate(track.trajectory.quaternion, mean) - np.array([0.0, 0.0, gravity])
    size = np.linalg.norm(moved, axis=1)
    at_rest = float(np.median(size[track.footfalls.quietest]))
    in_swing = float(np.sqrt(np.mean(size[swings] ** 2)))
    share = REST_SHARE if in_swing < SPRINT_SWING else REST_SHARE_SPRINT
    if at_rest > REST_ACCEL and at_rest > share * in_swing:
        raise DataError(
            _NOT_A_FOOT.format(f"where it seems to stand it is accelerated by {at_rest:.1f} m/s2")
        )


def _require_steady(track: FootTrack, t: FloatArray, accel: FloatArray, gyro: FloatArray) -> None:
    """Refuse what is accelerated slowly while it seems to stand."""
    begin, end = _moments(track.zero_velocity.still, t)
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


def _moments(still: BoolArray, t: FloatArray) -> tuple[IntArray, IntArray]:
    """Return pairs of samples `LAG_S` apart in long stances."""
    begins = []
    for first, last in zip(*runs(still), strict=True):
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
