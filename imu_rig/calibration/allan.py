"""Overlapping Allan deviation: how much means over equal times differ from one to the next.

The variance at an averaging time is half the mean square difference of neighbouring means. Its
uncertainty follows from the equivalent degrees of freedom, which depend on the kind of noise
(Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, 2008, table 5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray, IntArray

PER_DECADE = 10
LONGEST_SHARE = 3
"""The longest averaging time is this part of the longest unbroken stretch."""
STARTS = 64
"""Starts per averaging time beyond which more of them overlap so much that they tell nothing."""
ALL_UP_TO = 400
"""Frequencies of the record, from the lowest, that are all taken; above, ever fewer."""
KINDS = ("quantization", "white", "flicker", "walk", "ramp")
"""The terms of the variance model, in the order of `terms`."""
FLICKER_FLOOR = 2.0 * np.log(2.0) / np.pi
"""Allan variance of flicker noise over the square of its coefficient: 0.664 squared."""


@dataclass(frozen=True, eq=False)
class AllanCurve:
    """Allan variance of one axis at ``k`` averaging times.

    Attributes
    ----------
    tau : shape (k,)
        Averaging times [s], rising.
    variance : shape (k,)
        Overlapping Allan variance [unit^2].
    samples : shape (k,)
        Samples per averaging time.
    lengths : shape (p,)
        Samples of the unbroken stretches that were combined.
    """

    tau: FloatArray
    variance: FloatArray
    samples: IntArray
    lengths: IntArray

    @property
    def deviation(self) -> FloatArray:
        """Allan deviation (k,)."""
        return np.sqrt(self.variance)

    @property
    def period(self) -> float:
        """Time from sample to sample [s]."""
        return float(self.tau[0] / self.samples[0])

    def freedom(self, shares: FloatArray) -> FloatArray:
        """Equivalent degrees of freedom (k,) of the variances.

        Parameters
        ----------
        shares : shape (k, 5)
            Part of each variance that each of `KINDS` makes up.
        """
        terms = _terms_of(self.lengths, self.samples)
        weight = terms / terms.sum(axis=0)
        inverse = np.zeros(len(self.tau))
        for length, part in zip(self.lengths, weight, strict=True):
            fits = part > 0.0
            every = _freedom_of_kinds(int(length) + 1, self.samples[fits].astype(float))
            inverse[fits] += part[fits] ** 2 * np.sum(shares[fits] / every, axis=1)
        return np.asarray(1.0 / inverse)


def averaging_counts(lengths: IntArray) -> IntArray:
    """Choose samples per averaging time (k,), even in the logarithm, for stretches (p,)."""
    most = int(lengths.max()) // LONGEST_SHARE
    count = int(np.floor(PER_DECADE * np.log10(most))) + 1
    return np.unique(np.rint(10.0 ** (np.arange(count) / PER_DECADE)).astype(np.int64))


def allan_curve(stretches: Sequence[FloatArray], period: float) -> AllanCurve:
    """Overlapping Allan variance of one axis over one or more unbroken stretches.

    Parameters
    ----------
    stretches : sequence of arrays (n,)
        Evenly sampled readings; the longest has at least 30.
    period : float
        Time from sample to sample [s].
    """
    lengths = np.array([len(x) for x in stretches], dtype=np.int64)
    counts = averaging_counts(lengths)
    squares, terms = np.zeros(len(counts)), np.zeros(len(counts))
    for x in stretches:
        total = np.concatenate(([0.0], np.cumsum(x - x.mean())))
        for k, m in enumerate(counts.tolist()):
            if len(total) <= 2 * m:
                break
            step = max(1, m // STARTS)
            second = total[2 * m :: step] - 2.0 * total[m:-m:step] + total[: -2 * m : step]
            # Each start stands for ``step`` of them, so that stretches weigh by their length.
            squares[k] += step * float(second @ second)
            terms[k] += step * len(second)
    variance = np.asarray(squares / (2.0 * terms * counts**2), dtype=np.float64)
    return AllanCurve(counts.astype(np.float64) * period, variance, counts, lengths)


def terms(tau: FloatArray, period: float) -> FloatArray:
    """Allan variances (k, 5) of `KINDS` with coefficients of one (IEEE Std 952, annex C).

    The random walk is that of instantaneous samples, a ``period`` [s] apart.
    """
    flat = np.full(len(tau), FLICKER_FLOOR)
    walk = tau / 3.0 + period**2 / (6.0 * tau)
    return np.stack((3.0 / tau**2, 1.0 / tau, flat, walk, tau**2 / 2.0), axis=1)


class Correlation:
    """How the variances of a curve go together for a given mixture of noise.

    The variances are weighted means of one and the same periodogram, whose values at different
    frequencies are independent.

    Parameters
    ----------
    curve : AllanCurve
        All curves of the same averaging times and stretches may share the object.
    """

    def __init__(self, curve: AllanCurve) -> None:
        f, width = _frequencies(int(curve.lengths.max()), curve.period)
        w = 2.0 * np.pi * f
        # A ramp has no spectrum; power 1/f^4 stands for it.
        densities = np.stack((w**2, np.ones(len(w)), 1 / w, 1 / w**2, f[0] / w**4))
        # sin^4(pi f tau) / (m sin(pi f dt))^2, what the means of m samples let through
        passed = np.sin(np.pi * np.outer(curve.tau, f)) ** 4
        passed /= (curve.samples[:, None] * np.sin(np.pi * f * curve.period)) ** 2
        rows = (densities[:, None, :] * (passed * np.sqrt(width))).reshape(-1, len(f))
        shape = (len(densities), len(curve.tau)) * 2
        self._covariance = (rows @ rows.T).reshape(shape)

    def matrix(self, squares: FloatArray) -> FloatArray:
        """Correlation matrix (k, k) for squares of the coefficients (5,)."""
        covariance = np.einsum("a,b,aibj->ij", squares, squares, self._covariance)
        size = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / np.outer(size, size))


def _frequencies(count: int, period: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies [Hz] and the number that each stands for: all low ones, then ever fewer."""
    last = count // 2
    low = np.arange(1, min(last, ALL_UP_TO) + 1)
    if last <= ALL_UP_TO:
        return low / (count * period), np.ones(len(low))
    edges = np.unique(np.rint(np.geomspace(low[-1] + 1, last, 2 * ALL_UP_TO)).astype(np.int64))
    # One frequency from a different place in every interval, not to beat with the averaging.
    place = np.modf(np.arange(len(edges) - 1) * 0.6180339887)[0]
    width = np.diff(edges)
    high = edges[:-1] + np.floor(place * width)
    every = np.concatenate((low, high)) / (count * period)
    return every, np.concatenate((np.ones(len(low)), width))


def _terms_of(lengths: IntArray, samples: IntArray) -> FloatArray:
    return np.clip(lengths[:, None] + 1.0 - 2.0 * samples[None, :], 0.0, None)


def _freedom_of_kinds(N: int, m: FloatArray) -> FloatArray:
    """Degrees of freedom (k, 5) of `KINDS` for N integrated values and m samples (k,)."""
    quantization = (N + 1) * (N - 2 * m) / (2 * (N - m))
    white = (3 * (N - 1) / (2 * m) - 2 * (N - 2) / N) * 4 * m**2 / (4 * m**2 + 5)
    first = 2 * (N - 2) ** 2 / (2.3 * N - 4.9)
    flicker = np.where(m == 1, first, 5 * N**2 / (4 * m * (N + 3 * m)))
    walk = (N - 2) / m * ((N - 1) ** 2 - 3 * m * (N - 1) + 4 * m**2) / (N - 3) ** 2
    every = np.stack((quantization, white, flicker, walk, walk), axis=1)
    return np.asarray(np.maximum(every, 0.5))
