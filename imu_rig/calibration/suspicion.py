"""Suspicions about the data themselves: range limits, units, sample rate, axes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.calibration.moves import Moves, integrate
from imu_rig.units import DEG

AGREES = 15.0 * DEG
"""Median gravity-direction error below which an uncalibrated gyroscope is the right one: its gain
is a few percent off and its axes a few degrees."""
ENOUGH_TURN = 20.0 * DEG
"""Least turn that tells whether gyroscope and gravity agree."""
SATURATED_SHARE = 0.05
"""Part of a still's samples at the range limit beyond which its mean is worthless."""
MOVED = 8.0
"""Drift within a still, in its own standard errors, that means it moved."""
FEWEST_HELD = 5
"""Samples at an extreme that are no chance even where the signal nears it slowly."""
FACTORS = (0.5, 2.0, 0.25, 4.0, 0.1, 10.0, 1.0 / DEG, DEG)


def at_limit(x: FloatArray, limit: float | None = None) -> BoolArray:
    """Mark samples at the range limit of their axis, shapes (n, 3).

    Parameters
    ----------
    x : shape (n, 3)
        Readings.
    limit : float, optional
        The known range limit. Without it a limit shows as an extreme that repeats exactly in
        neighbouring samples, where no other value does.
    """
    if limit is not None:
        return np.abs(x) >= limit * (1.0 - 1e-3)
    bad = np.zeros(x.shape, dtype=bool)
    found: list[float] = []
    for shortest in (3, 2):
        for axis in range(3):
            for sign in (1.0, -1.0):
                value = sign * x[:, axis]
                extreme = float(value.max()) if len(value) else 0.0
                known = any(abs(extreme - f) < 2e-4 * f for f in found)
                if extreme <= 0.0 or (shortest == 2 and not known):
                    continue
                if _repeats(value, extreme, shortest):
                    bad[:, axis] |= value == extreme
                    found.append(extreme)
    return bad


def _repeats(value: FloatArray, extreme: float, shortest: int) -> bool:
    at = value == extreme
    runs = np.convolve(at.astype(int), np.ones(shortest, dtype=int), mode="valid")
    if not np.any(runs == shortest):
        return False
    # A coarse or noiseless signal repeats itself everywhere; a repeated extreme says nothing then.
    free = ~at[1:] & ~at[:-1]
    if np.any(free) and float(np.mean(value[1:][free] == value[:-1][free])) > 0.5:
        return False
    # A smooth peak in coarse steps leaves more samples just below its top than on it.
    levels = np.unique(value[value > 0.5 * extreme])
    step = float(np.diff(levels).min()) if len(levels) > 1 else 0.0
    below = (value < extreme) & (value > extreme - 10.5 * step)
    held, near = int(np.sum(at)), int(np.sum(below))
    # A few samples on a steep peak may agree by chance; a clipped one leaps to its limit.
    return held > near and (held >= FEWEST_HELD or near == 0)


@dataclass(frozen=True, eq=False)
class Match:
    """How well an uncalibrated gyroscope explains the gravity directions.

    Attributes
    ----------
    error : float
        Median angle between predicted and measured gravity [rad].
    factor : float
        The factor on the rates that explains them best; 1 where none is clearly better.
    axes : shape (3, 3)
        The signed permutation of the gyroscope's axes that explains them best; the identity
        where none is clearly better.
    best_error : float
        Median angle with that factor and permutation [rad].
    conclusive : bool
        Whether enough moves turned far enough to tell.
    """

    error: float
    factor: float
    axes: FloatArray
    best_error: float
    conclusive: bool


def match_gyro(moves: Moves, bias: FloatArray, factors: tuple[float, ...] = FACTORS) -> Match:
    """Compare the gyroscope with the gravity directions, as it is and under wrong guesses.

    Parameters
    ----------
    moves : Moves
        The moves.
    bias : shape (m, 3)
        Raw bias at every still [rad/s].
    factors : tuple of float
        Factors on the rate to try, where the rate as it is does not fit; with none, neither
        factors nor axes are tried.
    """
    eye = np.eye(3)
    begin, end = (g / np.linalg.norm(g, axis=1, keepdims=True) for g in _ends(moves))
    tilts = np.arctan2(np.linalg.norm(np.cross(begin, end), axis=1), np.sum(begin * end, axis=1))
    conclusive = int(np.sum(tilts > ENOUGH_TURN)) >= 3
    error = _median_error(moves, eye, bias, begin, end)
    if not conclusive or error < AGREES or not factors:
        return Match(error, 1.0, eye, error, conclusive)
    scaled = {f: _median_error(moves, f * eye, bias, begin, end) for f in factors}
    factor = min(scaled, key=lambda f: scaled[f])
    if scaled[factor] < min(AGREES, 0.5 * error):
        return Match(error, factor, eye, scaled[factor], conclusive)
    turned = [(P, _median_error(moves, P, bias, begin, end)) for P in _signed_permutations()]
    axes, best = min(turned, key=lambda pair: pair[1])
    if best < min(AGREES, 0.5 * error):
        return Match(error, 1.0, axes, best, conclusive)
    return Match(error, 1.0, eye, error, conclusive)


def describe_axes(P: FloatArray) -> str:
    """Say which accelerometer axis each gyroscope axis looks like, e.g. ``-y, x, z``."""
    columns = np.argmax(np.abs(P), axis=0)
    return ", ".join(
        ("-" if P[row, axis] < 0 else "") + "xyz"[row] for axis, row in enumerate(columns)
    )


def _ends(moves: Moves) -> tuple[FloatArray, FloatArray]:
    return moves.gravity_before, moves.gravity_after


def _median_error(
    moves: Moves, K: FloatArray, bias: FloatArray, begin: FloatArray, end: FloatArray
) -> float:
    if not len(moves):
        return 0.0
    predicted = rotation.rotate(rotation.conjugate(integrate(moves, K, bias)), begin)
    across = np.linalg.norm(np.cross(predicted, end), axis=1)
    return float(np.median(np.arctan2(across, np.sum(predicted * end, axis=1))))


def _signed_permutations() -> list[FloatArray]:
    return [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
