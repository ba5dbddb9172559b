"""Six faces and three turns by hand, with a square block on a table (Ferraris and others 1995).

Nothing is redundant here: 18 equations determine 12 accelerometer unknowns only because each face
is taken to stand level on a square block, and nine gyroscope gains rest on three turns taken to be
whole. So the magnitude of gravity decides scale and bias, and gravity is the axis of every turn,
as the accelerometer saw it; what is left to trust carries an assumed uncertainty.
"""

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
from imu_rig.calibration.earth import EARTH_RATE
from imu_rig.calibration.faces import PLACEMENT, SQUARENESS, FaceFit, faces_of, fit_faces
from imu_rig.calibration.gyro_bias import BiasTrack, track_bias
from imu_rig.calibration.magnitude import jacobian, pack
from imu_rig.calibration.model import AXES, Affine, physical_figures
from imu_rig.calibration.moves import Moves, moves_between
from imu_rig.calibration.multi_position import refuse_wrong_gyro
from imu_rig.calibration.session import AccelOutcome, GyroOutcome, Outcome, Session
from imu_rig.errors import DataError
from imu_rig.units import DEG, MILLI_G

FACE_WITHIN = 30.0 * DEG
"""A still further from every axis stands on no face."""
SAME_ATTITUDE = 5.0 * DEG
"""A turn on the table leaves gravity where it was."""
LEAST_TURN = 60.0 * DEG
ALONG = np.cos(25.0 * DEG)
"""A turn about the vertical shows on the gyroscope axis that is vertical."""
WHOLE = 1.2
"""How far, as a factor, a raw turn may be from the angle it should have."""
TURN_SIGMA = 1.0 * DEG
"""How well a hand brings the block back to where a turn began."""
AXIS_SIGMA = 1.0 * DEG
"""How upright the axis of a turn on a table is taken to be."""
TURN_DOF = 10.0
"""Degrees of freedom that the assumptions about turns are granted."""


def ferraris(session: Session) -> Outcome:
    """Solve a session of six faces and three turns.

    Parts of `Session.known` are used where there are any; otherwise every still on a face counts,
    and every whole turn on the spot. Stills on no face or outside the parts are checks.

    Raises
    ------
    DataError
        A face or a turn that is missing, or a turn that was not whole, with what to record.
    """
    stills, g = session.stills, session.gravity.value
    axis, sign, on_face = faces_of(stills.accel_mean, FACE_WITHIN)
    used = on_face & _in_parts(session)
    _require_faces(axis[used], sign[used])
    fit = _fit(session, axis, sign, used)
    sigma = np.full(len(stills), np.median(fit.sigma))
    sigma[used] = fit.sigma
    left_out, left_out_sigma = _left_out(session, axis, sign, used, fit)
    accel = AccelOutcome(fit.affine, sigma, left_out, left_out_sigma)
    warnings = [_what_is_trusted(session, fit, int(np.isfinite(left_out).sum()))]
    if not session.has_gyro:
        warnings.append("No gyroscope shows anything, so only the accelerometer was calibrated.")
        return Outcome("sensor", accel, None, tuple(warnings))
    gyro = _solve_gyro(session, fit.affine, axis, sign, g)
    return Outcome("sensor", accel, gyro, tuple(warnings))


def _in_parts(session: Session) -> BoolArray:
    parts = session.known.face_parts
    if not session.known.parts:
        return np.ones(len(session.stills), dtype=bool)
    middle = (session.stills.t0 + session.stills.t1) / 2
    return np.array([any(p.t0 <= t <= p.t1 for p in parts) for t in middle], dtype=bool)


def _require_faces(axis: IntArray, sign: FloatArray) -> None:
    there = {(int(a), float(s)) for a, s in zip(axis, sign, strict=True)}
    missing = [
        f"{'+' if s > 0 else '-'}{AXES[a]}"
        for a in range(3)
        for s in (1.0, -1.0)
        if (a, s) not in there
    ]
    if missing:
        raise DataError(
            f"no still pose has {_list(missing)} on top: hold the sensor still on all six faces, "
            "two seconds or more each"
        )


def _fit(session: Session, axis: IntArray, sign: FloatArray, used: BoolArray) -> FaceFit:
    stills = session.stills
    return fit_faces(
        stills.accel_mean[used],
        stills.accel_cov[used],
        axis[used],
        sign[used],
        session.gravity.value,
    )


def _left_out(
    session: Session, axis: IntArray, sign: FloatArray, used: BoolArray, fit: FaceFit
) -> tuple[FloatArray, FloatArray]:
    """Magnitude error (m,) of every still by a fit that never saw it, and its predicted sigma."""
    means, g = session.stills.accel_mean, session.gravity.value
    error, sigma = np.full(len(means), np.nan), np.full(len(means), np.nan)
    for i in range(len(means)):
        others, judge = used.copy(), fit
        if used[i]:
            others[i] = False
            twin = others & (axis == axis[i]) & (sign == sign[i])
            if not twin.any():
                continue
            judge = _fit(session, axis, sign, others)
        p = pack(judge.affine.K, judge.affine.b)
        size, row = jacobian(p, means[i : i + 1])
        free = np.diag(judge.affine.covariance) > 0
        C = judge.affine.covariance[np.ix_(free, free)]
        error[i] = size[0] - g
        sigma[i] = np.sqrt((row @ C @ row.T)[0, 0] + np.median(judge.sigma) ** 2)
    return error, sigma


def _solve_gyro(
    session: Session, accel: Affine, axis: IntArray, sign: FloatArray, gravity: float
) -> GyroOutcome:
    stills = session.stills
    track = track_bias((stills.t0 + stills.t1) / 2, stills.gyro_mean, stills.gyro_sem)
    moves = moves_between(session.block, stills, track.at_stills, session.gyro_bad)
    refuse_wrong_gyro(moves.with_gravity(accel.apply), track.at_stills)
    if session.known.turn_parts:
        turns = _given_turns(session, accel, track)
    else:
        turns = _found_turns(session, accel, moves, track, axis, sign)
    _refuse_partial(turns, session.known.turn_angle)
    affine = _fit_turns(turns, session.known.turn_angle, accel, track, gravity)
    where = gravity_directions(stills, moves, accel, track)
    after = direction_errors(moves, where, affine.K, track.at_stills)
    return GyroOutcome(
        affine=affine,
        first=moves.first,
        last=moves.last,
        angle=angles_turned(moves, affine.K, track.at_stills),
        before=errors_before(moves, stills, track),
        after=after,
        held_out=np.where(np.isin(moves.first, turns.first), np.nan, after),
        sigma=np.sqrt(where.variance + _by_gain(affine, _integrals(moves, track))),
    )


@dataclass(frozen=True, eq=False)
class _Turns:
    """``n`` turns about the vertical.

    ``integral`` (n, 3) of the raw rate less bias, ``up`` (n, 3) raw mean specific force,
    ``duration`` (n,), ``axis`` (n,) that was vertical, ``first`` (n,): the still before.
    """

    integral: FloatArray
    up: FloatArray
    duration: FloatArray
    axis: IntArray
    first: IntArray

    @property
    def size(self) -> FloatArray:
        return np.asarray(np.linalg.norm(self.integral, axis=1))

    def only(self, keep: BoolArray) -> _Turns:
        return _Turns(
            self.integral[keep],
            self.up[keep],
            self.duration[keep],
            self.axis[keep],
            self.first[keep],
        )


def _given_turns(session: Session, accel: Affine, track: BiasTrack) -> _Turns:
    block, stills = session.block, session.stills
    middle = (stills.t0 + stills.t1) / 2
    integral, up, duration = [], [], []
    for part in session.known.turn_parts:
        a, b = (int(i) for i in np.searchsorted(block.t, (part.t0, part.t1)))
        if b - a < 3:
            raise DataError(f"the part {part.name} holds no samples")
        if np.any(session.gyro_bad[a:b]):
            raise DataError(
                f"the gyroscope is at its range limit in the part {part.name}: turn more slowly"
            )
        t, w = block.t[a:b], block.gyro[a:b]
        bias = np.array([np.interp(t.mean(), middle, track.at_stills[:, k]) for k in range(3)])
        steps = np.diff(t)[:, None]
        integral.append(np.sum((0.5 * (w[1:] + w[:-1]) - bias) * steps, axis=0))
        up.append(block.accel[a:b].mean(axis=0))
        duration.append(float(t[-1] - t[0]))
    axis = np.array([AXES.index(p.name[0]) for p in session.known.turn_parts])
    turns = _Turns(np.array(integral), np.array(up), np.array(duration), axis, _spanned(session))
    for name, seen in zip(axis, faces_of(accel.apply(turns.up), FACE_WITHIN)[0], strict=True):
        if name != seen:
            raise DataError(
                f"in the part {AXES[name]}_rot the axis {AXES[seen]} is vertical: the turn about "
                f"{AXES[name]} must be made while {AXES[name]} points up or down"
            )
    return turns


def _spanned(session: Session) -> IntArray:
    """Return the still (n,) that ends last before the middle of each given turn."""
    middle = [(p.t0 + p.t1) / 2 for p in session.known.turn_parts]
    return np.asarray(np.searchsorted(session.stills.t1, middle) - 1)


def _found_turns(
    session: Session,
    accel: Affine,
    moves: Moves,
    track: BiasTrack,
    axis: IntArray,
    sign: FloatArray,
) -> _Turns:
    """Find moves that end in the attitude in which they began: turned on the spot."""
    up = accel.apply(session.stills.accel_mean)
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    same = np.sum(up[moves.first] * up[moves.last], axis=1) > np.cos(SAME_ATTITUDE)
    same &= axis[moves.first] == axis[moves.last]
    integral = _integrals(moves, track)
    keep = same & (np.linalg.norm(integral, axis=1) > LEAST_TURN)
    raw = session.stills.accel_mean
    turns = _Turns(
        integral[keep],
        0.5 * (raw[moves.first] + raw[moves.last])[keep],
        moves.duration[keep],
        axis[moves.first][keep],
        moves.first[keep],
    )
    # Putting the block the other way round on the same face is no turn to measure by.
    ratio = turns.size / session.known.turn_angle
    whole = (ratio < WHOLE) & (ratio > 1.0 / WHOLE)
    better = np.array([bool(np.any(whole & (turns.axis == k))) for k in range(3)])
    return turns.only(whole | ~better[turns.axis])


def _integrals(moves: Moves, track: BiasTrack) -> FloatArray:
    """Integral (n, 3) of the raw rate less bias over every move [rad]."""
    low, high = track.at_stills[moves.first], track.at_stills[moves.last]
    total = np.zeros((len(moves), 3))
    move = np.repeat(np.arange(len(moves)), moves.length)
    np.add.at(total, move, moves.rate * moves.dt[:, None])
    return np.asarray(total - 0.5 * (low + high) * moves.duration[:, None])


def _by_gain(affine: Affine, integral: FloatArray) -> FloatArray:
    """Variance (n,) per axis that an uncertain gain leaves in a move [rad^2]."""
    C = affine.covariance[:9, :9].reshape(3, 3, 3, 3)
    return np.asarray(np.einsum("ijik,nj,nk->n", C, integral, integral) / 3.0)


def _refuse_partial(turns: _Turns, angle: float) -> None:
    """Refuse turns that are missing, on the wrong axis, or not whole."""
    missing = [AXES[k] for k in range(3) if not np.any(turns.axis == k)]
    text = f"{angle / DEG:.0f} degrees"
    if missing:
        raise DataError(
            f"no turn about {_list(missing)} is found: stand the block so that this axis is "
            f"vertical, rest two seconds, turn it by {text} on the table and rest again"
        )
    dominant = np.argmax(np.abs(turns.integral), axis=1)
    for k, seen in zip(turns.axis, dominant, strict=True):
        if seen != k:
            raise DataError(
                f"the turn with the accelerometer's {AXES[k]} vertical shows on the gyroscope's "
                f"{AXES[seen]}: correct the order of its columns"
            )
    along = np.abs(turns.integral[np.arange(len(turns.axis)), turns.axis]) / turns.size
    for k, part in zip(turns.axis, along, strict=True):
        if part < ALONG:
            raise DataError(
                f"the turn about {AXES[k]} was not about that axis: turn the block flat on the "
                "table"
            )
    ratio = turns.size / angle
    wrong = (ratio > WHOLE) | (ratio < 1.0 / WHOLE)
    if not wrong.any():
        return
    measured = ", ".join(
        f"{s / DEG:.0f} about {AXES[k]}" for k, s in zip(turns.axis, turns.size, strict=True)
    )
    if wrong.all() and float(np.ptp(ratio)) < 0.2 * float(np.median(ratio)):
        raise DataError(
            f"all turns measure another angle than {text} ({measured}): the sample rate, the "
            "gyroscope's unit or range, or the angle of the turns (--turn-angle) is wrong"
        )
    worst = int(np.argmax(np.abs(np.log(ratio))))
    raise DataError(
        f"the turn about {AXES[turns.axis[worst]]} measures {turns.size[worst] / DEG:.0f} degrees "
        f"instead of {text} (measured: {measured}): it was not whole, so record it again, or state "
        "the angle of all turns with --turn-angle"
    )


def _fit_turns(
    turns: _Turns, angle: float, accel: Affine, track: BiasTrack, gravity: float
) -> Affine:
    up = accel.apply(turns.up)
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    # The gyroscope's own sense of a turn is right: the moves between the faces were checked.
    sense = np.sign(np.sum(turns.integral * up, axis=1))
    theta = sense[:, None] * angle * up
    lever = np.linalg.pinv(turns.integral.T)  # (n, 3)
    K = theta.T @ lever
    bias = (track.mean_sigma**2).mean() + track.scatter**2
    C = np.zeros((9, 9))
    for n, row, T, raw in zip(up, lever, turns.duration, turns.up, strict=True):
        flat = np.eye(3) - np.outer(n, n)
        P = TURN_SIGMA**2 * np.outer(n, n) + (angle * AXIS_SIGMA) ** 2 * flat
        by_accel = angle / gravity * flat @ np.hstack((np.kron(np.eye(3), raw), -np.eye(3)))
        P += by_accel @ accel.covariance @ by_accel.T
        P += (bias * T**2 + track.walk**2 * T**3 / 3.0) * np.eye(3)
        C += np.kron(P, np.outer(row, row))
    mean = track.mean
    by_gain = np.kron(np.eye(3), mean)
    own = np.diag(track.mean_sigma**2) + EARTH_RATE**2 / 3.0 * np.eye(3)
    corner = by_gain @ C
    covariance = np.block([[C, corner.T], [corner, corner @ by_gain.T + K @ own @ K.T]])
    return Affine(K, K @ mean, covariance, dof=TURN_DOF)


def _what_is_trusted(session: Session, fit: FaceFit, checked: int) -> str:
    figures = physical_figures(fit.affine)
    opening = "Six faces and three turns leave nothing to check themselves by"
    if checked:
        rests = "one rest" if checked == 1 else f"{checked} rests"
        opening = f"The left-out errors of {rests} check scale and bias, not what is trusted"
    return (
        f"{opening}: the axes' non-orthogonality "
        f"(uncertain by {figures.cross_rad_u.max() * 1e3:.0f} mrad) rests on faces that stand "
        f"level to {fit.placement / DEG:.1f} degrees (taken as {PLACEMENT / DEG:g} before) on a "
        f"block that is square to {SQUARENESS / DEG:g} degrees, the gyroscope's gain on turns of "
        f"{session.known.turn_angle / DEG:.0f} degrees to {TURN_SIGMA / DEG:g} degree about an "
        f"axis upright to {AXIS_SIGMA / DEG:g} degree, and a scatter of "
        f"{float(np.median(fit.sigma)) / MILLI_G:.1f} mg from one placement to the next is "
        "assumed; 16 attitudes or more with the method multi-position need none of this."
    )


def _list(words: list[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
