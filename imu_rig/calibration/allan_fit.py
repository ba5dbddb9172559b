"""Noise coefficients from an Allan curve: weighted least squares of the variance model.

Neighbouring points of the curve share their data, so the uncertainty of the coefficients is
carried from the joint covariance of all points. Averaging times at which the sensor's own
low-pass filter has smoothed the noise do not follow the model and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.special import gammaincinv

from imu_rig.arrays import FloatArray
from imu_rig.calibration.allan import KINDS, AllanCurve, Correlation, terms

CORE = (1, 2, 3)
"""White noise, flicker and random walk: in every fit."""
CLEAR = 3.0
"""A coefficient's square counts as seen from so many of the standard deviations on that chance
gives it in noise without it."""
KNOWN = 1.3
"""... and as known where it is so many of its own standard uncertainties: within a factor of 2."""
RARE = 4.0
"""The same for terms that are in the model only where the data ask for them."""
FILTER_SHARE = 100.0
"""A low-pass filter may hide averaging times up to this part of the longest."""
MODEL_ERROR = 0.02
"""Relative error of the model's variance that bounds the weight of very well known points."""
OFF_MODEL = 0.05
"""Relative difference between variance and model that matters, beside chance."""
LEVEL = 0.95


@dataclass(frozen=True)
class Coefficient:
    """One coefficient.

    Attributes
    ----------
    value : float or None
        None where the record does not determine it.
    sigma : float or None
        Standard uncertainty, likewise.
    low, high : float
        95 % interval; where nothing is determined, from 0 to what it is at most.
    """

    value: float | None
    sigma: float | None
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class AllanFit:
    """Noise of one axis as the sum of up to five kinds.

    Attributes
    ----------
    coefficients : tuple of Coefficient
        In the order of `imu_rig.calibration.allan.KINDS`.
    squares : shape (5,)
        Estimated squares of the coefficients, whether determined or not.
    freedom : shape (k,)
        Degrees of freedom of the curve's variances.
    period : float
        Time from sample to sample [s].
    used : shape (2,)
        First and last averaging time of the fit [s].
    off_model : tuple of float or None
        Shortest and longest averaging time at which the curve contradicts the model, among those
        used [s].
    """

    coefficients: tuple[Coefficient, ...]
    squares: FloatArray
    freedom: FloatArray
    period: float
    used: tuple[float, float]
    off_model: tuple[float, float] | None

    def variance(self, tau: FloatArray) -> FloatArray:
        """Return the model's variance (k,) at averaging times (k,)."""
        return np.asarray(terms(tau, self.period) @ self.squares)

    def interval(self, curve: AllanCurve) -> tuple[FloatArray, FloatArray]:
        """95 % interval (k,), (k,) of the curve's deviations."""
        low, high = _interval(curve.variance, self.freedom)
        return np.sqrt(low), np.sqrt(high)


def fit_curve(curve: AllanCurve, correlation: Correlation | None = None) -> AllanFit:
    """Fit the coefficients of one axis.

    Parameters
    ----------
    curve : AllanCurve
    correlation : Correlation, optional
        Of a curve with the same averaging times and stretches, not to compute it again.
    """
    return _Fit(curve, correlation or Correlation(curve)).whole()


class _Fit:
    """Fits to one curve with different terms of the model."""

    def __init__(self, curve: AllanCurve, correlation: Correlation) -> None:
        self.curve = curve
        self.correlation = correlation
        self.H = terms(curve.tau, curve.period)
        self.start = 0

    def whole(self) -> AllanFit:
        curve = self.curve
        kinds = self._choose_terms()
        squares, freedom = self.solve(kinds)
        sigma = self.sigma(kinds, squares)
        coefficients = []
        for kind in range(len(KINDS)):
            if kind in kinds and self._is_clear(kinds, squares, sigma, kind):
                coefficients.append(_determined(squares[kind], sigma[kind]))
            else:
                coefficients.append(self._bounded(kinds, kind))
        bad = np.flatnonzero(self.off(squares)[self.start :]) + self.start
        return AllanFit(
            coefficients=tuple(coefficients),
            squares=squares,
            freedom=freedom,
            period=curve.period,
            used=(float(curve.tau[self.start]), float(curve.tau[-1])),
            off_model=(float(curve.tau[bad[0]]), float(curve.tau[bad[-1]])) if len(bad) else None,
        )

    def _choose_terms(self) -> tuple[int, ...]:
        tau = self.curve.tau
        kinds: tuple[int, ...] = CORE
        last_start = int(np.searchsorted(tau, tau[-1] / FILTER_SHARE))
        while True:
            off = self.off(self.solve(kinds)[0])[self.start]
            if off > 0.0 and 0 not in kinds and self._asked_for(kinds, 0):
                kinds = (0, *kinds)
            elif off != 0.0 and self.start < last_start:
                self.start += 1
            else:
                break
        return (*kinds, 4) if self._asked_for(kinds, 4) else kinds

    def solve(self, kinds: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Squares of the coefficients (5,), none negative, and degrees of freedom (k,)."""
        curve, start = self.curve, self.start
        model = curve.variance
        shares = np.tile(np.eye(len(KINDS))[1], (len(model), 1))
        squares = np.zeros(len(KINDS))
        for _ in range(12):
            freedom = curve.freedom(shares)
            sigma = model * np.sqrt(2.0 / freedom + MODEL_ERROR**2)
            rows = (self.H[:, kinds] / sigma[:, None])[start:]
            size = np.linalg.norm(rows, axis=0)
            before, squares = squares, np.zeros(len(KINDS))
            squares[list(kinds)] = nnls(rows / size, (curve.variance / sigma)[start:])[0] / size
            parts = self.H * squares
            model = parts.sum(axis=1)
            shares = parts / model[:, None]
            if np.allclose(squares, before, rtol=1e-5, atol=0.0):
                break
        return squares, curve.freedom(shares)

    def sigma(self, kinds: tuple[int, ...], truth: FloatArray) -> FloatArray:
        """Return standard uncertainties (5,) of the squares for noise of squares ``truth`` (5,).

        Terms of ``kinds`` that are zero count as free all the same.
        """
        start = self.start
        parts = self.H * truth
        model = parts.sum(axis=1)
        free = self.curve.freedom(parts / model[:, None])[start:]
        model = model[start:]
        deviation = model * np.sqrt(2.0 / free)
        weight = 1.0 / (model**2 * (2.0 / free + MODEL_ERROR**2))
        H = self.H[start:, kinds]
        size = np.linalg.norm(H * np.sqrt(weight)[:, None], axis=0)
        scaled = H / size
        normal = scaled.T @ (weight[:, None] * scaled)
        P = np.linalg.pinv(normal) @ (scaled * weight[:, None]).T / size[:, None] * deviation
        R = self.correlation.matrix(truth)[start:, start:]
        sigma = np.zeros(len(KINDS))
        sigma[list(kinds)] = np.sqrt(np.einsum("ij,jk,ik->i", P, R, P))
        return sigma

    def _is_clear(
        self, kinds: tuple[int, ...], squares: FloatArray, sigma: FloatArray, kind: int
    ) -> bool:
        """Whether a term is more than chance makes of noise that lacks it, and known well."""
        if not squares[kind] > KNOWN * sigma[kind]:
            return False
        rest = tuple(k for k in kinds if k != kind)
        without = self.solve(rest)[0]
        return bool(squares[kind] > CLEAR * self.sigma(kinds, without)[kind])

    def _asked_for(self, kinds: tuple[int, ...], kind: int) -> bool:
        more = (*kinds, kind)
        squares = self.solve(more)[0]
        return bool(squares[kind] > RARE * self.sigma(more, squares)[kind])

    def _bounded(self, kinds: tuple[int, ...], kind: int) -> Coefficient:
        more = kinds if kind in kinds else (*kinds, kind)
        squares = self.solve(more)[0]
        sigma = self.sigma(more, squares)[kind]
        return Coefficient(None, None, 0.0, float(np.sqrt(squares[kind] + 2.0 * sigma)))

    def off(self, squares: FloatArray) -> FloatArray:
        """Relative difference of variance and model (k,) where it is more than chance, else 0."""
        parts = self.H * squares
        model = parts.sum(axis=1)
        relative = self.curve.variance / model - 1.0
        # As uncertain as the model makes it; few degrees of freedom are far from normal, upward.
        freedom = self.curve.freedom(parts / model[:, None])
        allowed = OFF_MODEL + 4.0 * np.sqrt(2.0 / freedom)
        return np.asarray(np.where(np.abs(relative) > allowed, relative, 0.0))


def _determined(square: float, sigma: float) -> Coefficient:
    # A variance from so many degrees of freedom has this interval; it is far from symmetric.
    free = 2.0 * (square / sigma) ** 2
    low, high = _interval(np.array([square]), np.array([free]))
    value = float(np.sqrt(square))
    return Coefficient(
        value, float(sigma / (2.0 * value)), float(np.sqrt(low[0])), float(np.sqrt(high[0]))
    )


def _interval(variance: FloatArray, freedom: FloatArray) -> tuple[FloatArray, FloatArray]:
    """95 % interval of variances estimated with degrees of freedom (chi-square)."""
    ends = (0.5 + LEVEL / 2, 0.5 - LEVEL / 2)
    low, high = (variance * freedom / (2.0 * gammaincinv(freedom / 2.0, p)) for p in ends)
    return low, high
