"""What is asked of samples and strides of a foot that is followed while it walks."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.bias import GyroBias
from imu_rig.gait.covariance import track_covariance
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.options import FootOptions
from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.trajectory import Footfalls, Trajectory
from imu_rig.gait.unseen import BESIDE_S, STEP_S, SWING_S, Unseen, find_gaps, widened
from imu_rig.kernels.foot_types import FootInputs, FootModel, FootStates

MOST_FORCE, MOST_RATE = 4000.0, 110.0
"""Beyond any sensor for feet: 400 g, 6300 deg/s [m/s^2, rad/s]."""

CHECKED_AT = (3, 10)
"""After so many strides what came so far is checked as a whole: gross errors of units show at once,
smaller contradictions of gyroscope and accelerometer in some strides."""
CHECKED_S, LEAST_CHECKED_S = 30.0, 5.0
"""So much of the past is kept for that [s], until the last check; and so much is needed without a
gap."""


def require_usable(block: ImuBlock, last: FloatArray) -> None:
    """Check samples before they are taken.

    Parameters
    ----------
    block : ImuBlock
    last : shape (1,)
        Time of the sample before [s], or of the first of the block.

    Raises
    ------
    DataError
        If their shape is wrong, a reading is no number or none of a sensor, or time goes back.
    """
    n = len(block)
    for name, values in (("accelerometer", block.accel), ("gyroscope", block.gyro)):
        if np.shape(values) != (n, 3):
            raise DataError(
                f"{n} readings of the {name} have the shape ({n}, 3), not {np.shape(values)}"
            )
    if not all(np.isfinite(a).all() for a in (block.t, block.accel, block.gyro)):
        raise DataError("some samples are no numbers; leave them out: a gap is handled")
    if np.abs(block.accel).max() > MOST_FORCE:
        raise DataError(
            f"the accelerometer reads {np.abs(block.accel).max():.3g} m/s^2, which no sensor does; "
            "leave broken samples out, or state the unit"
        )
    if np.abs(block.gyro).max() > MOST_RATE:
        raise DataError(
            f"the gyroscope reads {np.abs(block.gyro).max():.3g} rad/s, which no sensor does; "
            "leave broken samples out, or convert deg/s"
        )
    if (np.diff(np.concatenate((last, block.t))) < 0.0).any():
        raise DataError("time goes back; begin a new LiveFoot after the sensor was restarted")


def after_hidden(block: ImuBlock) -> IntArray:
    """Return the first sample after each gap that may hide a swing, shape (k,)."""
    gaps = find_gaps(block)
    hidden = np.where(gaps.resting, gaps.length >= STEP_S, gaps.length >= SWING_S)
    told = hidden & (block.t[-1] - block.t[gaps.row] >= BESIDE_S)
    return np.asarray(gaps.row[told])


def stride_sigma(
    t: FloatArray,
    states: FootStates,
    inputs: FootInputs,
    model: FootModel,
    ends: tuple[int, int],
    bias: FloatArray,
    grade: SensorGrade,
    unseen: Unseen,
) -> float:
    """Return the standard uncertainty of a stride's length [m].

    As `imu_rig.gait.covariance` has it for a whole trial, of the samples that the stride was
    smoothed with.

    Parameters
    ----------
    t : shape (n,)
    states : FootStates
    inputs : FootInputs
    model : FootModel
    ends : tuple of int
        Rows of the two stances.
    bias : shape (3,)
        Taken off the gyroscope in all [rad/s].
    grade : SensorGrade
    unseen : Unseen
    """
    rows = np.array(ends, dtype=np.int64)
    falls = Footfalls(rows, rows, rows)
    trajectory = Trajectory(t, states.quaternion, states.velocity, states.position)
    known = GyroBias(bias, states.gyro_bias_covariance, 1.0)
    covariance = track_covariance(trajectory, states, inputs, model, falls, known, grade)
    covariance = widened(covariance, unseen, falls)
    way = (trajectory.position[rows[1]] - trajectory.position[rows[0]])[:2]
    along = way / max(float(np.hypot(*way)), 1e-9)
    return float(np.sqrt(along @ covariance.strides[0, :2, :2] @ along))


class EarlyCheck:
    """Looks at the first strides together, as `smooth_foot` does at a whole trial.

    Parameters
    ----------
    options : FootOptions
    grade : SensorGrade
    """

    def __init__(self, options: FootOptions, grade: SensorGrade) -> None:
        self._options, self._grade = options, grade
        self._kept: list[ImuBlock] = []
        self._left = list(CHECKED_AT)

    def keep(self, block: ImuBlock) -> None:
        """Keep samples until the last check."""
        if not self._left:
            return
        self._kept.append(block)
        while len(self._kept) > 1 and block.t[-1] - self._kept[1].t[0] > CHECKED_S:
            del self._kept[0]

    def after(self, strides: int, until: float) -> None:
        """Check if it is time to.

        Parameters
        ----------
        strides : int
            That were told so far.
        until : float
            Samples that came later [s] are not looked at.

        Raises
        ------
        DataError
            If the samples so far cannot be those of a foot.
        """
        if not self._left or strides < self._left[0]:
            return
        block = ImuBlock.concatenate(self._kept)
        first, end = np.searchsorted(block.t, (until - CHECKED_S, np.nextafter(until, np.inf)))
        block = block[int(first) : int(end)]
        gaps = find_gaps(block)
        block = block[int(gaps.row[gaps.length >= SWING_S].max(initial=0)) :]
        if block.t[-1] - block.t[0] < LEAST_CHECKED_S:
            return  # soon after a gap, across which nothing can be compared
        del self._left[0]
        if not self._left:
            self._kept = []
        smooth_foot(block, self._options, grade=self._grade)
