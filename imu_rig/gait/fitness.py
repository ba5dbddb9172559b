"""Whether a recording can give a true answer about a foot, before and after it is worked out.

What cannot is refused with what to do; what makes an answer less certain is said. Every bound is
one that no foot, or no sensor, keeps to, with a margin; simulated gait from shuffling to sprints
stays far on the right side of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.axes import (
    AxesAgreement,
    StrideSample,
    compare_axes,
    gravity_at_rest,
    sample_strides,
)
from imu_rig.gait.cut_off import cut_spans
from imu_rig.gait.form import check_form
from imu_rig.gait.stamps import spread_repeats
from imu_rig.gait.stepping import check_track
from imu_rig.gait.stills import Stills, find_stills
from imu_rig.gait.unseen import (
    STEP_S,
    SWING_S,
    Gaps,
    Holes,
    find_holes,
)
from imu_rig.kernels.columns import extent
from imu_rig.kernels.rolling import moving_mean
from imu_rig.units import DEG, STANDARD_GRAVITY

__all__ = ["Inspection", "check_recording", "check_track", "inspect_recording"]

MANY = 20_000
"""Samples that are enough for percentiles of a recording."""

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

MISSING_REFUSED = 0.3
"""With a third of the moving time in gaps, swings are guessed. What single lost samples leave open
is in the uncertainty."""

CUT_REFUSED, CUT_MUCH, CUT_LITTLE = 0.5, 0.05, 0.005
"""With a fifth of the moving time beyond the range of the sensor, most of every strike or swing is
lost. From a twentieth on, any contradiction of the sensors may come from there, and small ones
sooner."""


@dataclass(frozen=True, eq=False)
class Inspection:
    """What was found in a recording that can give a true answer.

    Attributes
    ----------
    notes : tuple of str
        What its reader should know, a sentence each without its stop.
    stills : Stills
    holes : Holes
    strides : StrideSample or None
        Of which gyroscope and accelerometer can be compared further; None where too much is cut
        off for that.
    """

    notes: tuple[str, ...]
    stills: Stills
    holes: Holes
    strides: StrideSample | None


def check_recording(block: ImuBlock, *, gravity: float = STANDARD_GRAVITY) -> tuple[str, ...]:
    """Return the notes of `inspect_recording`, which see."""
    return inspect_recording(block, gravity=gravity).notes


def inspect_recording(block: ImuBlock, *, gravity: float = STANDARD_GRAVITY) -> Inspection:
    """Check a recording of a foot before anything is worked out from it.

    Parameters
    ----------
    block : ImuBlock
        As it was read, no bias taken off.
    gravity : float
        Local gravity [m/s^2].

    Returns
    -------
    Inspection

    Raises
    ------
    DataError
        If it cannot give a true answer: what is wrong and what to do.
    """
    notes = [*check_form(block)]
    accel = np.ascontiguousarray(block.accel, dtype=float)
    gyro = np.ascontiguousarray(block.gyro, dtype=float)
    block = ImuBlock(np.asarray(block.t, dtype=float), accel, gyro, block.host_s)
    some = gyro[:: 1 + len(gyro) // MANY]
    rate = np.sqrt(np.einsum("ij,ij->i", some, some))
    usual, most = np.percentile(rate, (99.0, 99.5))
    if usual > MOST_RATE:
        raise DataError(
            f"the gyroscope reads {usual:.0f} rad/s, faster than any foot turns; it is probably in "
            "deg/s: state its unit (--gyro-unit deg/s)"
        )
    stills = find_stills(spread_repeats(block.t), accel, gyro)
    holes = find_holes(block)
    notes += _check_gravity(block, stills, gravity)
    cut, told = _check_ranges(block, holes)
    notes += told
    notes += _check_gaps(block, holes.gaps)
    strides = None
    if cut < CUT_MUCH:
        strides = _check_agreement(block, stills, gravity, float(most), whole=cut < CUT_LITTLE)
    return Inspection(tuple(notes), stills, holes, strides)


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
                "uncertainties allow for a sensor that was not calibrated: calibrate it"
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


def _check_agreement(
    block: ImuBlock, stills: Stills, gravity: float, turns: float, *, whole: bool
) -> StrideSample | None:
    """Compare gyroscope and accelerometer by the strides; return them where they are whole."""
    strides = sample_strides(block, stills, gravity)
    axes = compare_axes(strides)
    shakes = float(np.sqrt(extent(block.accel)[3].sum()))
    lazy = shakes > SHAKES and turns < TURNS and axes.best[0, 0] > 1.0  # of few strides too
    if lazy or not axes.agree:
        raise DataError(_disagreement(axes))
    return strides if whole else None


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


def _check_gaps(block: ImuBlock, gaps: Gaps) -> list[str]:
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
    # The sample at the end of a gap stands for its own interval.
    usual = float(np.median(np.diff(block.t)))
    missing = float(np.maximum(gaps.length[swing] - usual, 0.0).sum())
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


def _check_ranges(block: ImuBlock, holes: Holes) -> tuple[float, list[str]]:
    most, notes = 0.0, list[str]()
    if not (holes.gyro.any or holes.accel.any):
        return most, notes
    moving = np.einsum("ij,ij->i", block.gyro, block.gyro) > TURNS**2
    for clipping, word, unit, factor in (
        (holes.gyro, "gyroscope", "deg/s", 1.0 / DEG),
        (holes.accel, "accelerometer", "g", 1.0 / STANDARD_GRAVITY),
    ):
        if not clipping.any:
            continue
        cut = clipping.cut[:, 0] | clipping.cut[:, 1] | clipping.cut[:, 2]
        share = float(cut.sum() / max(1, np.count_nonzero(moving | cut)))
        axis = int(np.argmin(clipping.limit))
        text = (
            f"the {word} is at the end of its range ({clipping.limit[axis] * factor:.3g} {unit}) "
            f"for {100 * share:.1f} % of the moving time"
        )
        most = max(most, share)
        if share > CUT_REFUSED:
            raise DataError(f"{text}; set a wider range and record again")
        notes.append(
            f"{text}, {cut_spans(block.t, clipping)}: lengths and heights there are uncertain"
        )
    return most, notes
