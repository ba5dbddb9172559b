"""Accelerometer from the magnitude of gravity alone: no direction needs to be known.

In every still pose ``|T u - o| = g`` with T upper triangular, nine unknowns. It holds for a sensor
that is linear over +-1 g; the fit is the best line over that range.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.calibration.model import PARAMETERS, Affine
from imu_rig.errors import DataError
from imu_rig.units import MILLI_G

UNKNOWNS = 9
UPPER = np.triu_indices(3)
NAMES = (
    "scale x",
    "non-orthogonality xy",
    "non-orthogonality xz",
    "scale y",
    "non-orthogonality yz",
    "scale z",
)
"""The six elements of T in the order of `UPPER`; bias x, y and z follow."""
FLICKER = 0.05 * MILLI_G
"""Wander of an accelerometer's bias that no averaging in one pose removes [m/s^2]."""
WEAK = np.array([1.0] * 6 + [10.0] * 3)
"""Standard deviation of a prior about the nominal sensor (gain, m/s^2): it keeps what the poses
leave free from running away, and is too wide to move anything else."""
NOMINAL = np.array([1.0, 0, 0, 1.0, 0, 1.0, 0, 0, 0])
SCALE_DOF = 4.0
"""Weight of the still's own scatter when the poses judge the size of the errors."""
OUTLIER = 6.0
"""Left-out error, in its own predicted sigmas, that sets a pose aside."""
FEWEST_TO_JUDGE = 16
"""Poses below which none can be told to be an outlier."""


@dataclass(frozen=True, eq=False)
class MagnitudeFit:
    """An accelerometer fitted to the magnitude of gravity over ``m`` poses.

    Attributes
    ----------
    affine : Affine
        K upper triangular.
    error : shape (m,)
        ``|K u - b| - g`` [m/s^2].
    sigma : shape (m,)
        Standard uncertainty of each mean along gravity, scaled by ``noise_scale`` [m/s^2].
    left_out, left_out_sigma : shape (m,)
        Error when the fit never saw the pose, and its predicted sigma [m/s^2]; NaN where the
        other poses are fewer than nine.
    noise_scale : float
        Size of the residuals against the noise within the stills.
    used : shape (m,)
        Poses that the fit rests on; the others were set aside as outliers.
    """

    affine: Affine
    error: FloatArray
    sigma: FloatArray
    left_out: FloatArray
    left_out_sigma: FloatArray
    noise_scale: float
    used: BoolArray


def fit_magnitude(means: FloatArray, covs: FloatArray, gravity: float) -> MagnitudeFit:
    """Fit scale, non-orthogonality and bias to still means.

    Parameters
    ----------
    means : shape (m, 3)
        Mean raw specific force of each pose [m/s^2], m at least 9.
    covs : shape (m, 3, 3)
        Their covariances [m^2/s^4].
    gravity : float
        Magnitude of gravity [m/s^2].

    Raises
    ------
    DataError
        Fewer than nine poses. What nine or more poses leave free shows as a huge uncertainty.
    """
    if len(means) < UNKNOWNS:
        raise DataError(f"{len(means)} poses cannot determine nine parameters")
    used = np.ones(len(means), dtype=bool)
    while True:
        fit = _fit(means, covs, gravity, used)
        if used.sum() < FEWEST_TO_JUDGE:
            return fit
        z = np.abs(fit.left_out / fit.left_out_sigma)
        worst = int(np.argmax(np.where(used, z, 0.0)))
        if not z[worst] > OUTLIER or used.sum() <= 0.85 * len(means):
            return fit
        used = used.copy()
        used[worst] = False


def jacobian(p: FloatArray, means: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Magnitudes ``|T u - o|`` (m,) and their derivatives (m, 9) at parameters ``p`` (9,)."""
    T, o = unpack(p)
    c = means @ T.T - o
    size = np.linalg.norm(c, axis=1)
    n = c / size[:, None]
    return size, np.concatenate((n[:, UPPER[0]] * means[:, UPPER[1]], -n), axis=1)


def unpack(p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return T (3, 3) and o (3,) of parameters (9,)."""
    T = np.zeros((3, 3))
    T[UPPER] = p[:6]
    return T, p[6:]


def pack(T: FloatArray, o: FloatArray) -> FloatArray:
    """Return the parameters (9,) of an upper triangular T and o."""
    return np.concatenate((T[UPPER], o))


def full_covariance(C: FloatArray) -> FloatArray:
    """Covariance (12, 12) of ``[K row by row, b]`` from that of the nine parameters."""
    E = np.zeros((PARAMETERS, UNKNOWNS))
    E[3 * UPPER[0] + UPPER[1], range(6)] = 1.0
    E[9:, 6:] = np.eye(3)
    return np.asarray(E @ C @ E.T)


def _fit(means: FloatArray, covs: FloatArray, gravity: float, used: BoolArray) -> MagnitudeFit:
    p = _solve(_start(means[used], gravity), means[used], covs[used], gravity)
    sigma = _sigma(p, means, covs)
    size, J = jacobian(p, means)
    error = size - gravity
    C = _covariance(J[used] / sigma[used, None])
    scale = _noise_scale(error[used] / sigma[used])
    left_out = np.full(len(means), np.nan)
    left_out_sigma = np.full(len(means), np.nan)
    for i in range(len(means)):
        others = used.copy()
        others[i] = False
        if others.sum() < UNKNOWNS:
            continue
        q = _solve(p, means[others], covs[others], gravity)
        there, slope = jacobian(q, means[i : i + 1])
        sizes, slopes = jacobian(q, means[others])
        D = _covariance(slopes / sigma[others, None])
        # The others judge the size of the errors too: an outlier may not excuse itself.
        own = _noise_scale((sizes - gravity) / sigma[others])
        left_out[i] = there[0] - gravity
        left_out_sigma[i] = own * np.sqrt(sigma[i] ** 2 + (slope @ D @ slope.T)[0, 0])
    dof = float(used.sum() - UNKNOWNS)
    affine = Affine(*unpack(p), full_covariance(C * scale**2), dof=dof + SCALE_DOF)
    return MagnitudeFit(affine, error, sigma * scale, left_out, left_out_sigma, scale, used)


def _noise_scale(z: FloatArray) -> float:
    """Size of the residuals against the noise within the stills."""
    dof = len(z) - UNKNOWNS
    return float(np.sqrt((z @ z + SCALE_DOF) / (dof + SCALE_DOF)))


def _sigma(p: FloatArray, means: FloatArray, covs: FloatArray) -> FloatArray:
    T, o = unpack(p)
    c = means @ T.T - o
    along = (c / np.linalg.norm(c, axis=1, keepdims=True)) @ T
    return np.asarray(np.sqrt(np.einsum("mi,mij,mj->m", along, covs, along) + FLICKER**2))


def _start(means: FloatArray, gravity: float) -> list[FloatArray]:
    """Return starts: nominal, and the ellipsoid through the means by linear least squares."""
    starts = [pack(np.eye(3), np.zeros(3))]
    u = means / gravity
    x, y, z = u.T
    D = np.stack((x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, -2 * x, -2 * y, -2 * z), 1)
    a, _, rank, _ = np.linalg.lstsq(D, np.ones(len(u)), rcond=1e-9)
    A = np.array(((a[0], a[3], a[4]), (a[3], a[1], a[5]), (a[4], a[5], a[2])))
    if rank == UNKNOWNS and np.all(np.linalg.eigvalsh(A) > 0):
        centre = np.linalg.solve(A, a[6:])
        # u'Au - 2 a'u = 1 is (u - c)'A(u - c) = 1 + c'Ac, which T must turn into a sphere.
        T: FloatArray = np.linalg.cholesky(A / (1.0 + centre @ A @ centre)).T.astype(float)
        starts.append(pack(T, np.asarray(T @ centre * gravity)))
    return starts


def _solve(
    start: FloatArray | list[FloatArray], means: FloatArray, covs: FloatArray, gravity: float
) -> FloatArray:
    starts = start if isinstance(start, list) else [start]
    ends = [_descend(p, means, covs, gravity) for p in starts]
    return min(ends, key=lambda end: end[0])[1]


def _descend(
    p: FloatArray, means: FloatArray, covs: FloatArray, gravity: float
) -> tuple[float, FloatArray]:
    """Levenberg-Marquardt; weights follow the estimate, which only turns the noise axes."""
    damping = 1e-3
    for _ in range(60):
        sigma = _sigma(p, means, covs)
        size, J = jacobian(p, means)
        r = np.concatenate(((size - gravity) / sigma, (p - NOMINAL) / WEAK))
        J = np.concatenate((J * WEAK / sigma[:, None], np.eye(UNKNOWNS)))
        N = J.T @ J
        cost = float(r @ r)
        while True:
            step = -np.linalg.solve(N + damping * np.diag(np.diag(N)), J.T @ r)
            q = p + WEAK * step
            misfit = (jacobian(q, means)[0] - gravity) / sigma
            prior = (q - NOMINAL) / WEAK
            tried = float(misfit @ misfit + prior @ prior)
            if tried <= cost or damping > 1e8:
                break
            damping *= 10.0
        damping = max(damping / 30.0, 1e-12)
        p = q if tried <= cost else p
        if np.max(np.abs(step)) < 1e-10 or tried > cost:
            break
    return cost, p


def _covariance(J: FloatArray) -> FloatArray:
    """Covariance (9, 9) of unit-weight rows J (m, 9) and the weak prior."""
    scaled = J * WEAK
    return np.asarray(np.linalg.inv(scaled.T @ scaled + np.eye(UNKNOWNS)) * np.outer(WEAK, WEAK))
