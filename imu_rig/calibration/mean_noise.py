"""How well the mean of a still is known: from the slowest changes within it.

What disturbs a mean is the noise at the frequencies next to zero. A hand or a table that trembles
at several hertz scatters the samples but averages out faster than their number says; so neither
the samples nor short blocks of them tell the standard error, but the lowest terms of a cosine
transform do. They are few, so each still's figure is drawn toward that of all stills, as strongly
as the stills agree with each other (empirical Bayes).
"""

from __future__ import annotations

from math import lgamma

import numpy as np

from imu_rig.arrays import FloatArray, IntArray

HIGHEST_HZ = 1.0
"""Terms up to this frequency count: below the tremor of hands and tables."""
FEWEST_TERMS, MOST_TERMS = 4, 40
LONGEST = 8192
"""Samples beyond which neighbours are averaged first; the slow terms do not notice."""
PRIOR_DOF = np.concatenate((np.geomspace(1.0, 256.0, 17), [1e4]))
"""Candidates for how well the stills agree: degrees of freedom of the common variance."""
PRIOR_SHIFT = np.linspace(-1.5, 1.5, 31)
"""Candidates of the logarithm of the common variance, about the mean of all."""
BIAS_SHARE, SCALE_SHARE = 0.05, 0.03
"""What a data sheet promises: bias over gravity, scale."""


def slow_terms(x: FloatArray, rate_hz: float) -> FloatArray:
    """Lowest terms (k, 3) of the orthonormal cosine transform of samples (n, 3), mean left out.

    For white noise each has the variance of one sample, so the mean has theirs over ``n``. The
    first is a drift from begin to end.
    """
    count = int(np.clip(round(2.0 * HIGHEST_HZ * len(x) / rate_hz), FEWEST_TERMS, MOST_TERMS))
    count = min(count, len(x) - 1)
    size = -(-len(x) // LONGEST)
    y = x[: len(x) // size * size].reshape(-1, size, 3).mean(axis=1) - x.mean(axis=0)
    phase = np.pi * (np.arange(len(y)) + 0.5) / len(y)
    basis = np.cos(np.arange(1, count + 1)[:, None] * phase)
    return np.asarray(basis @ y * np.sqrt(2.0 * size / len(y)))


def mean_variances(terms: list[FloatArray], samples: IntArray) -> FloatArray:
    """Variances (m, 3) of the means of ``m`` stills, each axis on its own.

    Parameters
    ----------
    terms : list of shape (k, 3)
        The `slow_terms` of each still.
    samples : shape (m,)
        Samples averaged.
    """
    if not terms:
        return np.empty((0, 3))
    dof = np.array([float(len(c)) for c in terms])
    variance = np.array([np.mean(c**2, axis=0) for c in terms]).reshape(-1, 3)
    pooled = [drawn_together(variance[:, axis], dof)[0] for axis in range(3)]
    return np.asarray(np.stack(pooled, axis=1) / samples[:, None])


def mean_covariances(terms: list[FloatArray], samples: IntArray, means: FloatArray) -> FloatArray:
    """Covariances (m, 3, 3) of the mean specific forces of ``m`` stills.

    Tremor turns the sensor: it moves gravity between the axes and leaves its magnitude alone. So
    the noise along gravity is drawn together over the stills apart from that across it.

    Parameters
    ----------
    terms : list of shape (k, 3)
        The `slow_terms` of each still.
    samples : shape (m,)
        Samples averaged.
    means : shape (m, 3)
        Raw mean specific forces.
    """
    if not terms:
        return np.empty((0, 3, 3))
    dof = np.array([float(len(c)) for c in terms])
    S = np.array([c.T @ c / len(c) for c in terms])
    up = means - _centre(means)
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-300)
    radial = up[:, :, None] * up[:, None, :]
    level = np.eye(3) - radial
    along = np.einsum("mi,mij,mj->m", up, S, up)
    across = 0.5 * (np.trace(S, axis1=1, axis2=2) - along)
    drawn_along, own = drawn_together(along, dof)
    drawn_across, _ = drawn_together(across, 2.0 * dof)
    tiny = 1e-300
    tilted = (radial @ S @ level) * np.sqrt(
        drawn_along * drawn_across / np.maximum(along * across, tiny)
    )[:, None, None]
    # A correlation from a few terms is mostly chance: it counts as far as the still's own scatter.
    tilted *= own[:, None, None]
    C = drawn_along[:, None, None] * radial
    C += (drawn_across / np.maximum(across, tiny))[:, None, None] * (level @ S @ level)
    C += tilted + np.swapaxes(tilted, 1, 2)
    return np.asarray(C / samples[:, None, None])


def drawn_together(variance: FloatArray, dof: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Draw variances (m,) with ``dof`` (m,) toward a common one.

    Each true variance is taken as the common one times an inverse chi-square variable; common
    variance and degrees of freedom are those that make the data most likely.

    Returns
    -------
    drawn : shape (m,)
        The variances.
    own : shape (m,)
        How much of each is its own, 0 to 1.
    """
    level = float(np.average(variance, weights=dof))
    if len(variance) < 2 or not level > 0.0:
        return np.maximum(variance, 0.0), np.ones(len(variance))
    ratio = variance / level
    d0 = PRIOR_DOF[:, None]
    common = np.exp(PRIOR_SHIFT)[None, :]
    likely = np.zeros((len(PRIOR_DOF), len(PRIOR_SHIFT)))
    for d in np.unique(dof):
        r = ratio[dof == d][:, None, None]
        constant = np.array([lgamma((d + p) / 2) - lgamma(p / 2) for p in PRIOR_DOF])[:, None]
        constant = constant - (d / 2) * np.log(d0 * common)
        spread = np.sum(np.log1p(d * r / (d0 * common)), axis=0)
        likely += r.shape[0] * constant - (d + d0) / 2 * spread
    i, j = np.unravel_index(int(np.argmax(likely)), likely.shape)
    own = dof / (dof + PRIOR_DOF[i])
    drawn = level * (own * ratio + (1.0 - own) * float(common[0, j]))
    return np.asarray(drawn), np.asarray(own)


def _centre(means: FloatArray) -> FloatArray:
    """Bias (3,) of a nominal sensor by the sphere through the means, near zero where none shows.

    Gravity's direction must not be off by the bias, or tremor across it would count along it.
    """
    size = float(np.median(np.linalg.norm(means, axis=1)))
    if not size > 0.0:
        return np.zeros(3)
    u = means / size
    # |u|^2 = 2 u.c + r; what the scale leaves open is the noise of each row.
    A = np.concatenate((2.0 * u, np.ones((len(u), 1))), axis=1) / (2.0 * SCALE_SHARE)
    y = (np.sum(u**2, axis=1) - 1.0) / (2.0 * SCALE_SHARE)
    prior = np.diag(1.0 / np.array([BIAS_SHARE] * 3 + [2.0 * SCALE_SHARE]))
    rows = np.concatenate((A, prior))
    solved = np.linalg.lstsq(rows, np.concatenate((y, np.zeros(4))), rcond=None)[0]
    return np.asarray(solved[:3] * size)
