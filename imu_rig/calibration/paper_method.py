"""The paper's solver as a method of the front door: commanded poses in, outcome out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.calibration.direction import (
    angles_turned,
    direction_errors,
    errors_before,
    gravity_directions,
)
from imu_rig.calibration.gyro_bias import track_bias
from imu_rig.calibration.model import Affine
from imu_rig.calibration.moves import moves_between
from imu_rig.calibration.paper import (
    Model,
    PaperFit,
    integrated_turn,
    paper_accelerometer,
    paper_gyroscope,
)
from imu_rig.calibration.session import (
    AccelOutcome,
    CommandedPoses,
    GyroOutcome,
    Outcome,
    Session,
)
from imu_rig.calibration.stills import gaps
from imu_rig.errors import DataError, InputError

FOLDS = 10


def paper(session: Session) -> Outcome:
    """Solve with the full gain matrix of equations (5) and (6)."""
    return _solve(session, "full")


def paper_diagonal(session: Session) -> Outcome:
    """Solve with gain and offset per axis only."""
    return _solve(session, "diagonal")


def _solve(session: Session, model: Model) -> Outcome:
    if session.commanded is None:
        raise InputError(
            "the paper's solver needs the angles that the jig was told to take; this recording "
            "has none, so use the method multi-position"
        )
    stills = session.stills
    gravity = session.commanded.gravity(session.gravity.value)
    fit = paper_accelerometer(stills.accel_mean, gravity, model)
    accel = _accel_outcome(session, fit, gravity, model)
    if not session.has_gyro:
        return Outcome("jig", accel, None)
    gyro, warnings = _gyro(session, session.commanded, fit.affine, model)
    return Outcome("jig", accel, gyro, warnings)


def _accel_outcome(
    session: Session, fit: PaperFit, gravity: FloatArray, model: Model
) -> AccelOutcome:
    means = session.stills.accel_mean
    along = gravity / session.gravity.value
    seen = along @ fit.affine.K
    sigma = np.sqrt(np.einsum("mi,mij,mj->m", seen, session.stills.accel_cov, seen))
    left_out = np.full(len(means), np.nan)
    left_out_sigma = np.full(len(means), np.nan)
    for i in range(len(means)):
        others = np.arange(len(means)) != i
        try:
            affine = paper_accelerometer(means[others], gravity[others], model).affine
        except DataError:
            continue
        left_out[i] = np.linalg.norm(affine.apply(means[i])) - session.gravity.value
        row = np.concatenate((np.kron(along[i], means[i]), -along[i]))
        left_out_sigma[i] = np.sqrt(row @ affine.covariance @ row + sigma[i] ** 2)
    return AccelOutcome(fit.affine, sigma, left_out, left_out_sigma, fit.residual)


def _gyro(
    session: Session, commanded: CommandedPoses, accel: Affine, model: Model
) -> tuple[GyroOutcome | None, tuple[str, ...]]:
    stills, block = session.stills, session.block
    track = track_bias((stills.t0 + stills.t1) / 2, stills.gyro_mean, stills.gyro_sem)
    moves = moves_between(block, stills, track.at_stills, session.gyro_bad)
    driven = _driven(session, commanded)
    try:
        fit = driven.fit(np.ones(len(driven.T), dtype=bool), model)
    except DataError as error:
        return None, (
            f"The gyroscope was not calibrated: {error}; turn one servo at a time, each of the "
            "three both ways.",
        )
    where = gravity_directions(stills, moves, accel, track)
    zero = np.zeros_like(track.at_stills)
    held_out = np.full(len(moves), np.nan)
    fold = np.arange(len(moves)) % FOLDS
    inside = driven.t > stills.t1[moves.first[:1]].min(initial=np.inf)
    move_of = np.where(inside, np.searchsorted(stills.t0[moves.last], driven.t), -1)
    for k in range(FOLDS):
        kept = ~np.isin(move_of, np.flatnonzero(fold == k))
        try:
            affine = driven.fit(kept, model).affine
        except DataError:
            continue
        errors = direction_errors(moves, where, affine.K, zero + raw_bias(affine))
        held_out[fold == k] = errors[fold == k]
    after = direction_errors(moves, where, fit.affine.K, zero + raw_bias(fit.affine))
    outcome = GyroOutcome(
        affine=fit.affine,
        first=moves.first,
        last=moves.last,
        angle=angles_turned(moves, fit.affine.K, zero + raw_bias(fit.affine)),
        before=errors_before(moves, stills, track),
        after=after,
        held_out=held_out,
        sigma=np.sqrt(where.variance),
        vector_error=_vector_errors(driven, fit, move_of, len(moves)),
    )
    return outcome, ()


@dataclass(frozen=True, eq=False)
class _Driven:
    """``n`` turns about one fixed axis each: raw integral, duration, known rotation, middle."""

    u: FloatArray
    T: FloatArray
    theta: FloatArray
    t: FloatArray

    def fit(self, kept: BoolArray, model: Model) -> PaperFit:
        return paper_gyroscope(self.u[kept], self.T[kept], self.theta[kept], model)


def _driven(session: Session, commanded: CommandedPoses) -> _Driven:
    """Collect the turns that can be integrated: one servo, no gap, no reading at the limit."""
    block, stills = session.block, session.stills
    holes = gaps(block.t)
    u, T, theta, middle = [], [], [], []
    for turn in commanded.driven(stills.t0, stills.t1, session.order):
        known = turn.rotation_vector()
        a, b = (int(i) for i in np.searchsorted(block.t, (turn.t0, turn.t1)))
        if known is None or b - a < 2 or np.any((holes >= a) & (holes < b)):
            continue
        if np.any(session.gyro_bad[a:b]):
            continue
        integral, duration = integrated_turn(block.t[a:b], block.gyro[a:b])
        u.append(integral)
        T.append(duration)
        theta.append(known)
        middle.append((turn.t0 + turn.t1) / 2)
    return _Driven(
        np.array(u).reshape(-1, 3), np.array(T), np.array(theta).reshape(-1, 3), np.array(middle)
    )


def _vector_errors(driven: _Driven, fit: PaperFit, move_of: IntArray, moves: int) -> FloatArray:
    """Error of the commanded rotation per move (moves, 3) [rad]; NaN where it was not one turn."""
    vector = np.full((moves, 3), np.nan)
    for move in range(moves):
        rows = np.flatnonzero(move_of == move)
        if len(rows) == 1:
            vector[move] = fit.residual[rows[0]]
    return vector


def raw_bias(affine: Affine) -> FloatArray:
    """Return the raw reading (3,) at zero input."""
    return affine.undo(np.zeros(3))
