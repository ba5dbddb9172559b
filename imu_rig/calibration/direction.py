"""Gyroscope from gravity directions: what it turned must carry one still's gravity to the next.

The accelerometer, calibrated first, says where gravity is in both stills of a move. A turn about
the vertical shows it nothing, so every move gives two numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.calibration.gyro_bias import BiasTrack
from imu_rig.calibration.model import PARAMETERS, Affine
from imu_rig.calibration.moves import Moves, integrate, integrate_with_slopes
from imu_rig.calibration.stills import Stills
from imu_rig.errors import DataError

UNKNOWNS = 9
NOMINAL = np.concatenate((np.eye(3).ravel(), np.zeros(3)))
SCALE_DOF = 4.0
"""Weight of the predicted noise when the moves judge its size."""
FOLDS = 10
OUTLIER = 6.0
FEWEST_TO_JUDGE = 12
"""Moves below which none can be told to be an outlier."""


@dataclass(frozen=True, eq=False)
class DirectionFit:
    """A gyroscope fitted to gravity directions over ``n`` moves.

    Attributes
    ----------
    affine : Affine
        Full K in the accelerometer's output frame, b the mean bias of the session.
    error : shape (n,)
        Angle between predicted and measured gravity at the end of each move [rad].
    held_out : shape (n,)
        The same when the move was kept out of the fit [rad]; NaN where the others cannot
        determine it.
    sigma : shape (n,)
        Standard uncertainty of the direction, per axis [rad].
    excess : float
        Error per move and axis beyond the noise that stills show [rad]: what the linear model
        does not describe.
    used : shape (n,)
        Moves that the fit rests on; the others were set aside as outliers.
    """

    affine: Affine
    error: FloatArray
    held_out: FloatArray
    sigma: FloatArray
    excess: float
    used: BoolArray


@dataclass(frozen=True, eq=False)
class Directions:
    """Measured gravity directions at both ends of ``n`` moves, and how well they are known.

    Attributes
    ----------
    begin, end : shape (n, 3)
        Unit vectors in body axes.
    basis : shape (n, 2, 3)
        Two unit vectors at right angles to ``end``.
    variance : shape (n,)
        Variance per axis of predicted minus measured direction [rad^2], noise alone.
    """

    begin: FloatArray
    end: FloatArray
    basis: FloatArray
    variance: FloatArray


def gravity_directions(stills: Stills, moves: Moves, accel: Affine, track: BiasTrack) -> Directions:
    """Directions of calibrated gravity at both ends of the moves, and their noise."""
    begin, end = _unit(accel.apply(moves.gravity_before)), _unit(accel.apply(moves.gravity_after))
    size = np.linalg.norm(moves.gravity_after, axis=1)
    span = (stills.t1 - stills.t0)[:, None]
    # The quietest stills show the sensor's own noise, the others a table that trembles.
    white = float(np.quantile(np.mean(stills.gyro_sem**2 * span, axis=1), 0.25))
    T = moves.duration
    variance = (
        (moves.gravity_sem / size) ** 2
        + white * T
        + (track.local_sigma * T) ** 2
        + track.walk**2 * T**3 / 12.0
    )
    return Directions(begin, end, _tangents(end), variance)


def direction_errors(
    moves: Moves, where: Directions, K: FloatArray, bias: FloatArray
) -> FloatArray:
    """Angles (n,) between predicted and measured gravity at the end of every move [rad]."""
    return angles_off(integrate(moves, K, bias), where)


def angles_off(q: FloatArray, where: Directions) -> FloatArray:
    """Angles (n,) between gravity that turns (n, 4) predict and measured gravity [rad]."""
    predicted = rotation.rotate(rotation.conjugate(q), where.begin)
    across = np.linalg.norm(np.cross(predicted, where.end), axis=1)
    return np.asarray(np.arctan2(across, np.sum(predicted * where.end, axis=1)))


def direction_residuals(
    moves: Moves, where: Directions, accel: Affine, track: BiasTrack, K: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the direction errors as vectors, and what they owe to either sensor's parameters.

    Returns
    -------
    residual : shape (n, 2)
        Predicted minus measured direction along `Directions.basis` [rad].
    by_gain : shape (n, 2, 9)
        Derivative with respect to the gyroscope's K row by row.
    by_accel : shape (n, 2, 12)
        Derivative with respect to the accelerometer's ``[K, b]``.
    """
    p = np.concatenate((K.ravel(), np.zeros(3)))
    q, residual, J = _linearize(moves, where, track, p)
    return residual, J[:, :, :9], _accelerometer_slopes(moves, where, accel, q)


def errors_before(moves: Moves, stills: Stills, track: BiasTrack) -> FloatArray:
    """Return the direction errors (n,) of nominal gains, with the rest bias taken off [rad]."""
    nominal = Affine.identity()
    where = gravity_directions(stills, moves, nominal, track)
    return direction_errors(moves, where, nominal.K, track.at_stills)


def angles_turned(moves: Moves, K: FloatArray, bias: FloatArray) -> FloatArray:
    """Return the net angle (n,) of every move, the short way round [rad]."""
    vectors = rotation.to_rotation_vector(integrate(moves, K, bias))
    return np.asarray(np.linalg.norm(vectors, axis=1))


def fit_directions(
    moves: Moves,
    stills: Stills,
    accel: Affine,
    track: BiasTrack,
    K0: FloatArray,
) -> DirectionFit:
    """Fit the full gain matrix and the mean bias.

    Parameters
    ----------
    moves : Moves
        At least five; nine numbers need ten.
    stills : Stills
        The stills at their ends.
    accel : Affine
        Calibrated accelerometer.
    track : BiasTrack
        Bias at every still.
    K0 : shape (3, 3)
        Start, within some 30 % and 30 degrees of the truth.

    Raises
    ------
    DataError
        Too few moves. What they leave free shows as a huge uncertainty.
    """
    if 2 * len(moves) < UNKNOWNS:
        raise DataError(f"{len(moves)} moves cannot determine nine gyroscope parameters")
    where = gravity_directions(stills, moves, accel, track)
    used = np.ones(len(moves), dtype=bool)
    state = _converge(moves, where, track, K0, used)
    while used.sum() >= max(FEWEST_TO_JUDGE, 0.85 * len(moves) + 1):
        suspect = int(np.argmax(np.where(used, state.studentized(), 0.0)))
        others = used.copy()
        others[suspect] = False
        # The others judge it: an outlier may not excuse itself by the scatter it makes.
        without = _converge(moves, where, track, state.p[:9].reshape(3, 3), others)
        if without.surprise(suspect) < OUTLIER:
            break
        used, state = others, without
    return _finish(moves, where, accel, track, state)


@dataclass(frozen=True, eq=False)
class _State:
    """A converged fit: parameters (K, common bias shift), residuals, slopes, weights."""

    p: FloatArray
    q: FloatArray
    residual: FloatArray  # (n, 2)
    J: FloatArray  # (n, 2, 12)
    variance: FloatArray  # (n,)
    excess: float
    covariance: FloatArray  # (12, 12)
    prior: FloatArray  # (12,) information
    used: BoolArray

    def surprise(self, j: int) -> float:
        """Error of a move that was not used, in its own predicted sigmas."""
        S = np.eye(2) * self.variance[j] + self.J[j] @ self.covariance @ self.J[j].T
        return float(np.sqrt(self.residual[j] @ np.linalg.solve(S, self.residual[j])))

    def studentized(self) -> FloatArray:
        """Left-out error of every used move over its predicted sigma."""
        z = np.zeros(len(self.J))
        for j in np.flatnonzero(self.used):
            own = np.eye(2) * self.variance[j]
            hat = self.J[j] @ self.covariance @ self.J[j].T
            remainder = own - hat
            e = own @ np.linalg.pinv(remainder) @ self.residual[j]
            S = own @ np.linalg.pinv(remainder) @ own
            z[j] = np.sqrt(max(0.0, float(e @ np.linalg.pinv(S) @ e)) / 2.0)
        return z


def _converge(
    moves: Moves, where: Directions, track: BiasTrack, K0: FloatArray, used: BoolArray
) -> _State:
    p = np.concatenate((K0.ravel(), np.zeros(3)))
    # The stills know the mean bias; the moves may only refine it. The gain's own prior only keeps
    # what the moves leave free from running away.
    prior = np.concatenate((np.ones(9), 1.0 / np.maximum(track.mean_sigma, 1e-9) ** 2))
    scale, excess = 1.0, 0.0
    for _ in range(25):
        q, residual, J = _linearize(moves, where, track, p)
        variance = scale**2 * where.variance + excess**2
        step, covariance = _gauss_newton(residual, J, variance, prior, p, used)
        if np.max(np.abs(step[:9])) < 1e-6:
            break
        # A step beyond the range of the linearization is shortened, not refused.
        p = p + step * min(1.0, 0.3 / float(np.max(np.abs(step[:9]))))
        scale, excess = _size_of_errors((residual + J @ step)[used], where.variance[used])
    return _State(p, q, residual, J, variance, excess, covariance, prior, used)


def _linearize(
    moves: Moves, where: Directions, track: BiasTrack, p: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    q, slope = integrate_with_slopes(moves, p[:9].reshape(3, 3), track.at_stills + p[9:])
    predicted = rotation.rotate(rotation.conjugate(q), where.begin)
    across = np.cross(where.end, predicted)
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, np.sum(where.end * predicted, axis=1))
    stretch = angle / np.maximum(sine, 1e-12)
    vector = across * np.where(sine > 1e-9, stretch, 1.0)[:, None]
    residual = np.einsum("nij,nj->ni", where.basis, vector)
    # One shift of the bias is common to the begin and the end of every move.
    common = np.concatenate((slope[:, :, :9], slope[:, :, 9:12] + slope[:, :, 12:]), axis=2)
    # A small turn d of the end leaves the body's view of gravity behind by d, across gravity.
    return q, residual, -(where.basis @ common)


def _gauss_newton(
    residual: FloatArray,
    J: FloatArray,
    variance: FloatArray,
    prior: FloatArray,
    p: FloatArray,
    used: BoolArray,
) -> tuple[FloatArray, FloatArray]:
    weight = used / variance
    N = np.einsum("nia,n,nib->ab", J, weight, J) + np.diag(prior)
    g = np.einsum("nia,n,ni->a", J, weight, residual)
    g += prior * (p - NOMINAL)
    scale = np.sqrt(np.diag(N))
    covariance = np.linalg.inv(N / np.outer(scale, scale)) / np.outer(scale, scale)
    return -covariance @ g, covariance


def _size_of_errors(residual: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """Scale (at most 1) and excess per axis that bring chi-square to its degrees of freedom.

    Moves that agree better than predicted shrink the prediction (a table that trembles looks like
    noise in the stills); moves that agree worse have an error of their own on top.
    """
    dof = residual.size - UNKNOWNS
    square = np.sum(residual**2, axis=1)
    chi2 = float(np.sum(square / variance))
    if dof < 1:
        return 1.0, 0.0
    if chi2 <= dof:
        return float(np.sqrt((chi2 + SCALE_DOF) / (dof + SCALE_DOF))), 0.0
    low, high = 0.0, float(np.sum(square)) / dof
    for _ in range(50):
        middle = 0.5 * (low + high)
        if np.sum(square / (variance + middle)) > dof:
            low = middle
        else:
            high = middle
    return 1.0, float(np.sqrt(high))


def _finish(
    moves: Moves,
    where: Directions,
    accel: Affine,
    track: BiasTrack,
    state: _State,
) -> DirectionFit:
    K, beta = state.p[:9].reshape(3, 3), track.mean + state.p[9:]
    weighted = state.J * (state.used / state.variance)[:, None, None]
    slope = _accelerometer_slopes(moves, where, accel, state.q)
    gain = -state.covariance @ np.einsum("nia,nib->ab", weighted, slope)
    C = state.covariance + gain @ accel.covariance @ gain.T
    # b = K beta, in the output sense.
    D = np.eye(PARAMETERS)
    D[9:, :9] = np.kron(np.eye(3), beta)
    D[9:, 9:] = K
    dof = 2.0 * float(state.used.sum()) - UNKNOWNS
    affine = Affine(K, K @ beta, D @ C @ D.T, dof=max(1.0, dof))
    return DirectionFit(
        affine=affine,
        error=direction_errors(moves, where, K, track.at_stills + state.p[9:]),
        held_out=_held_out(moves, where, track, state),
        sigma=np.sqrt(state.variance),
        excess=state.excess,
        used=state.used,
    )


def _held_out(moves: Moves, where: Directions, track: BiasTrack, state: _State) -> FloatArray:
    errors = np.full(len(moves), np.nan)
    fold = np.arange(len(moves)) % min(FOLDS, len(moves))
    for k in range(int(fold.max()) + 1):
        away = fold == k
        kept = state.used & ~away
        if 2 * kept.sum() < UNKNOWNS:
            continue
        step, _ = _gauss_newton(state.residual, state.J, state.variance, state.prior, state.p, kept)
        p = state.p + step
        if np.max(np.abs(step[:9])) > 0.01:
            start = state.p[:9].reshape(3, 3)
            p = _converge(moves.only(~away), _rows(where, ~away), track, start, state.used[~away]).p
        errors[away] = direction_errors(
            moves.only(away), _rows(where, away), p[:9].reshape(3, 3), track.at_stills + p[9:]
        )
    return errors


def _rows(where: Directions, keep: BoolArray) -> Directions:
    return Directions(where.begin[keep], where.end[keep], where.basis[keep], where.variance[keep])


def _accelerometer_slopes(
    moves: Moves, where: Directions, accel: Affine, q: FloatArray
) -> FloatArray:
    """Differentiate the residual (n, 2, 12) with respect to the accelerometer's ``[K, b]``."""
    back = np.swapaxes(rotation.to_matrix(q), 1, 2)
    predicted = rotation.rotate(rotation.conjugate(q), where.begin)
    # The residual is end x predicted.
    begin = rotation.skew(where.end) @ back @ _unit_slopes(accel, moves.gravity_before)
    end = rotation.skew(predicted) @ _unit_slopes(accel, moves.gravity_after)
    return np.asarray(where.basis @ (begin - end))


def _unit_slopes(accel: Affine, raw: FloatArray) -> FloatArray:
    """Differentiate the calibrated unit vectors (n, 3, 12) with respect to ``[K, b]``."""
    up = accel.apply(raw)
    size = np.linalg.norm(up, axis=1)
    n = up / size[:, None]
    flat = (np.eye(3) - n[:, :, None] * n[:, None, :]) / size[:, None, None]
    lever = np.zeros((len(n), 3, PARAMETERS))
    for row in range(3):
        lever[:, row, 3 * row : 3 * row + 3] = raw
        lever[:, row, 9 + row] = -1.0
    return np.asarray(flat @ lever)


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _tangents(n: FloatArray) -> FloatArray:
    smallest = np.eye(3)[np.argmin(np.abs(n), axis=1)]
    first = np.cross(n, smallest)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack((first, np.cross(n, first)), axis=1)
