"""Hard and soft iron of a magnetometer, and its axes in those of the accelerometer.

The field at a place is constant. So its magnitude is, which gives the ellipsoid; so is its dip,
the angle to gravity, which turns the ellipsoid into the accelerometer's axes; and where attitudes
are known, so is its azimuth. Each of the three is a row of one weighted least squares, with a
noise of its own that the data show: a magnitude needs the magnetometer alone, a dip the
accelerometer too, an azimuth whatever told the attitude.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.calibration.accuracy import sphere
from imu_rig.calibration.ellipsoid import ellipsoid_through
from imu_rig.calibration.model import PARAMETERS, Affine
from imu_rig.calibration.suspicion import describe_axes
from imu_rig.errors import DataError
from imu_rig.units import DEG

UNKNOWNS = PARAMETERS + 2
"""K row by row, b, dip and azimuth."""
MAGNITUDE, DIP, AZIMUTH = 0, 1, 2
"""The kinds of rows, in this order."""
FEWEST = 12
"""Fewest poses: nine for the ellipsoid, and some to show their own noise."""
WEAK = 1.0
"""Standard deviation of a prior on every unknown (gain, field, rad): it keeps what the data leave
free from running away, and is too wide to move anything else."""
PRIOR_DOF = 4.0
"""Weight of the stated noise when the rows of one kind judge the size of their errors."""
OUTLIER = 6.0
"""Residual, in its own standard deviations, that sets a pose aside."""
MOST_SET_ASIDE = 0.15
FEWEST_TO_JUDGE = 16
"""Poses below which none can be told to be an outlier."""
TUKEY = 6.0
"""Residual of one sample, in robust standard deviations, from which on it counts nothing."""
LEAST_SIGMA = 2e-4
"""Noise below that of any mean reading, over the field."""
WRONG_AXES = 0.5
"""Other axes fit the dip so much better, as a factor on its scatter, that they are the right."""
AXES_FIT = 0.2
"""Scatter of the dip [rad] below which axes can be the right ones at all."""
SPHERE = 64
"""Directions that stand for the sphere."""
SMALLEST_STEP = 1e-8
"""Step of any parameter, over the field, that ends the iteration: far below every noise."""
ROUNDS = 20
MOST_STEPS = 40
STEPS_PER_WEIGHTING = 2
"""With thousands of samples the weights move with every step or two."""


@dataclass(frozen=True, eq=False)
class FieldReadings:
    """What a magnetometer read over ``n`` still means or samples.

    Attributes
    ----------
    raw : shape (n, 3)
        Readings [uT].
    sem : shape (n, 3)
        Their standard errors [uT].
    up : shape (n, 3) or None
        Unit vector up in the accelerometer's axes; NaN where it is not known.
    attitudes : shape (n, 3, 3) or None
        Attitudes body to navigation, NaN where their heading is not known.
    cluster : shape (n,) or None
        Number of the stretch of time each sample belongs to, from 0; errors within one are not
        independent. None for still means, whose ``sem`` is trusted.
    up_errors : shape (k, n, 3) or None
        Errors of one standard deviation each that all of ``up`` have in common, as those of the
        accelerometer's calibration.
    """

    raw: FloatArray
    sem: FloatArray
    up: FloatArray | None = None
    attitudes: FloatArray | None = None
    cluster: IntArray | None = None
    up_errors: FloatArray | None = None

    def __len__(self) -> int:
        """Return the number of readings."""
        return int(self.raw.shape[0])

    def only(self, keep: BoolArray) -> FieldReadings:
        """Return the readings that ``keep`` (n,) marks."""

        def kept(x: FloatArray | None) -> FloatArray | None:
            return None if x is None else x[keep]

        cluster = None if self.cluster is None else self.cluster[keep]
        common = None if self.up_errors is None else self.up_errors[:, keep]
        return FieldReadings(
            self.raw[keep], self.sem[keep], kept(self.up), kept(self.attitudes), cluster, common
        )


@dataclass(frozen=True, eq=False)
class FieldFit:
    """A magnetometer fitted to ``n`` readings.

    Attributes
    ----------
    affine : Affine
        ``calibrated = K @ raw - b`` [uT], in the accelerometer's axes where ``dip_rad`` is known.
    field_ut : float
        Magnitude that the calibrated field has.
    dip_rad, dip_u : float or None
        Angle of the field below the horizontal and its standard uncertainty.
    symmetric : Affine
        The same with a symmetric K, which turns the axes least; ``affine`` itself where nothing
        tells the rotation.
    alignment_u : float or None
        Largest standard uncertainty, over all axes, of K's rotation [rad].
    error : shape (n,)
        ``|K u - b| / field - 1``.
    left_out : shape (n,)
        The same when the fit never saw the reading.
    dip_error : shape (n,)
        Angle to gravity off the common dip [rad]; NaN where not known.
    noise : tuple of float
        Size of the errors of magnitude, dip and azimuth against the stated noise.
    used : shape (n,)
        Readings that the fit rests on.
    """

    affine: Affine
    field_ut: float
    dip_rad: float | None
    dip_u: float | None
    symmetric: Affine
    alignment_u: float | None
    error: FloatArray
    left_out: FloatArray
    dip_error: FloatArray
    noise: tuple[float, float, float]
    used: BoolArray


@dataclass(frozen=True, eq=False)
class _Rows:
    """Residuals (k,), derivatives (k, 14), standard deviations, kinds and readings of rows."""

    residual: FloatArray
    J: FloatArray
    sigma: FloatArray
    kind: IntArray
    reading: IntArray


@dataclass(frozen=True, eq=False)
class _Solved:
    """Where the iteration ended: parameters, rows there, scale and slope per kind, weights.

    ``slope`` says how much less the residuals of a kind pull on the parameters, when those move,
    than their weights do: what a sample far out gains in weight it loses in distance.
    """

    p: FloatArray
    rows: _Rows
    scale: FloatArray
    slope: FloatArray
    weight: FloatArray
    prior: FloatArray

    @property
    def weighted(self) -> tuple[FloatArray, FloatArray]:
        """Residuals and derivatives in units of their standard deviation."""
        w = np.sqrt(self.weight) / (self.rows.sigma * self.scale[self.rows.kind])
        return w * self.rows.residual, w[:, None] * self.rows.J

    @property
    def normal(self) -> FloatArray:
        """Normal matrix (14, 14), prior included."""
        J = self.weighted[1]
        return np.asarray(J.T @ J + np.diag(self.prior))


def fit_field(readings: FieldReadings, field_ut: float | None = None) -> FieldFit:
    """Fit gain, offset and axes of a magnetometer.

    Parameters
    ----------
    readings : FieldReadings
        At least `FEWEST`.
    field_ut : float, optional
        Magnitude of the field [uT]; without it the mean gain is taken as 1.

    Raises
    ------
    DataError
        Too few readings, in one spot, line or plane; or axes that gravity contradicts.
    """
    if len(readings) < FEWEST:
        raise DataError(
            f"{len(readings)} readings of the field cannot determine gain, offset and axes: give "
            f"{FEWEST} or more, with every side up and two headings or more"
        )
    start = ellipsoid_through(readings.raw)
    if not (start.radius > 0 and np.all(np.isfinite(start.K))):
        raise DataError("its readings show no field")
    unit = replace(readings, raw=readings.raw / start.radius, sem=readings.sem / start.radius)
    p = np.concatenate((start.K.ravel(), start.K @ start.centre / start.radius, np.zeros(2)))
    if unit.up is not None:
        p = _aligned(p, unit)
    used = start.kept if unit.cluster is not None else np.ones(len(unit), dtype=bool)
    solved = _solve(p, unit.only(used))
    while unit.cluster is None:
        worst = _outlier(solved, used)
        if worst is None:
            break
        used = used.copy()
        used[worst] = False
        solved = _solve(p, unit.only(used))
    return _fit_of(solved, unit, used, start.radius, field_ut or start.radius)


def rotation_uncertainty(K: FloatArray, covariance: FloatArray) -> float:
    """Largest standard uncertainty, over all axes, of the rotation in K [rad].

    The rotation is that of the polar decomposition: what is left when a symmetric gain is taken
    out, so that it means the same for every choice of the gain's own axes.
    """
    J = np.zeros((3, 9))
    inverse = np.linalg.inv(K)
    for i in range(9):
        M = np.zeros(9)
        M[i] = 1.0
        turn = M.reshape(3, 3) @ inverse
        J[:, i] = _twice_axis(turn)
    C = J @ covariance[:9, :9] @ J.T / 4.0
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(C)[-1])))


def direction_uncertainty(affine: Affine, field_ut: float) -> float:
    """Return the standard uncertainty of the direction of a calibrated reading [rad].

    Root mean square over all directions of the field, per axis across it.
    """
    units = sphere(SPHERE)
    h = np.concatenate((affine.undo(units * field_ut), -np.ones((SPHERE, 1))), axis=1)
    rows = np.array([[3 * i, 3 * i + 1, 3 * i + 2, 9 + i] for i in range(3)])
    blocks = affine.covariance[rows[:, None, :, None], rows[None, :, None, :]]
    C = np.einsum("na,ijab,nb->nij", h, blocks, h)
    along = np.einsum("ni,nij,nj->n", units, C, units)
    across = (np.trace(C, axis1=1, axis2=2) - along) / 2.0
    return float(np.sqrt(max(0.0, float(across.mean()))) / field_ut)


def _aligned(p: FloatArray, readings: FieldReadings) -> FloatArray:
    """Return the start with its dip and azimuth, after a check of the axes."""
    K, b = p[:9].reshape(3, 3), p[9:12]
    h = readings.raw @ K.T - b
    n = h / np.linalg.norm(h, axis=1, keepdims=True)
    up = np.asarray(readings.up)
    known = np.isfinite(up[:, 0])
    if known.sum() < FEWEST:
        return p
    n, up = n[known], up[known]

    def scatter(P: FloatArray) -> float:
        sines = np.sum(up * (n @ P.T), axis=1)
        middle = float(np.median(sines))
        steep = max(0.2, float(np.sqrt(max(0.0, 1.0 - middle**2))))
        return 1.4826 * float(np.median(np.abs(sines - middle))) / steep

    turned = [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    best = min(turned, key=scatter)
    if scatter(best) < min(AXES_FIT, WRONG_AXES * scatter(np.eye(3))):
        raise DataError(
            f"its angle to gravity varies by {scatter(np.eye(3)) / DEG:.0f} degrees, and by "
            f"{scatter(best) / DEG:.0f} if its x, y, z are the accelerometer's "
            f"{describe_axes(best)}: correct the order and signs of its columns"
        )
    p = p.copy()
    p[12] = float(np.arcsin(np.clip(-np.median(np.sum(up * n, axis=1)), -1.0, 1.0)))
    if readings.attitudes is not None:
        attitudes = readings.attitudes[known]
        seen = np.isfinite(attitudes[:, 0, 0])
        level = _level(attitudes[seen], up[seen])
        east, north = np.einsum("nij,nj->i", level, n[seen])[:2]
        p[13] = float(np.arctan2(north, east))
    return p


def _level(attitudes: FloatArray, up: FloatArray) -> FloatArray:
    """Tilt attitudes (n, 3, 3) the short way until they agree with ``up``; headings stay."""
    seen = np.einsum("nij,nj->ni", attitudes, up)
    axis = np.cross(seen, np.array([0.0, 0.0, 1.0]))
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, seen[:, 2:])
    tilt = rotation.from_rotation_vector(axis * angle / np.maximum(sine, 1e-12))
    return np.asarray(rotation.to_matrix(tilt) @ attitudes)


def _rows(p: FloatArray, readings: FieldReadings) -> _Rows:
    """Residuals in units of the field; see the description of the module."""
    K, b, dip, azimuth = p[:9].reshape(3, 3), p[9:12], p[12], p[13]
    h = readings.raw @ K.T - b
    size = np.linalg.norm(h, axis=1)
    n = h / size[:, None]
    every = np.arange(len(readings))
    slopes, residuals, extra, kinds, rows = [n], [size - 1.0], [np.zeros((len(n), 2))], [0], [every]
    if readings.up is not None:
        at = every[np.isfinite(readings.up[:, 0])]
        up, m = readings.up[at], n[at]
        sine = np.linalg.norm(np.cross(up, m), axis=1)
        cosine = np.sum(up * m, axis=1)
        # At the pole of the angle its derivative has no direction; no reading stays there.
        t = (up - m * cosine[:, None]) / np.maximum(sine, 1e-6)[:, None]
        residuals.append(np.arctan2(sine, cosine) - (np.pi / 2 + dip))
        slopes.append(-t / size[at, None])
        extra.append(np.tile([-1.0, 0.0], (len(at), 1)))
        kinds.append(DIP)
        rows.append(at)
        if readings.attitudes is not None:
            seen = np.isfinite(readings.attitudes[at, 0, 0])
            at, up = at[seen], up[seen]
            level = _level(readings.attitudes[at], up)
            w = np.einsum("nij,nj->ni", level, h[at])
            flat = np.maximum(np.hypot(w[:, 0], w[:, 1]), 1e-6)
            off = np.arctan2(w[:, 1], w[:, 0]) - azimuth
            steep = np.cos(dip)
            residuals.append(steep * np.arctan2(np.sin(off), np.cos(off)))
            across = np.stack((-w[:, 1], w[:, 0], np.zeros(len(w))), 1) / flat[:, None] ** 2
            slopes.append(steep * np.einsum("nji,nj->ni", level, across))
            extra.append(np.tile([0.0, -steep], (len(at), 1)))
            kinds.append(AZIMUTH)
            rows.append(at)
    reading = np.concatenate(rows)
    slope = np.concatenate(slopes)
    gains = (slope[:, :, None] * readings.raw[reading, None, :]).reshape(-1, 9)
    noise = np.sqrt(np.sum(((slope @ K) * readings.sem[reading]) ** 2, axis=1))
    return _Rows(
        residual=np.concatenate(residuals),
        J=np.concatenate((gains, -slope, np.concatenate(extra)), axis=1),
        sigma=np.maximum(noise, LEAST_SIGMA),
        kind=np.repeat(kinds, [len(r) for r in rows]),
        reading=reading,
    )


def _solve(p: FloatArray, readings: FieldReadings) -> _Solved:
    """Iterate parameters, the noise of each kind of row, and the weights of single samples."""
    rows = _rows(p, readings)
    # Without an angle to gravity nothing tells K's rotation: the start's stays, to be symmetric.
    held = np.full(UNKNOWNS, WEAK**-2)
    solved = _Solved(p, rows, np.ones(3), np.ones(3), np.ones(len(rows.residual)), held)
    if readings.cluster is not None:
        solved = _reweighted(solved)
    nominal, cost = p, np.inf
    steps = MOST_STEPS if readings.cluster is None else STEPS_PER_WEIGHTING
    for _ in range(ROUNDS):
        solved = _descend(solved, readings, nominal, steps)
        scale = solved.scale
        solved = (_rescaled if readings.cluster is None else _reweighted)(solved)
        cost, before = float(np.sum(solved.weighted[0] ** 2)), cost
        if np.all(np.abs(solved.scale / scale - 1.0) < 1e-4) and abs(cost - before) < 1e-4 * cost:
            break
    return solved


def _descend(solved: _Solved, readings: FieldReadings, nominal: FloatArray, steps: int) -> _Solved:
    """Levenberg-Marquardt with weights that stay."""
    damping = 1e-6

    def cost_of(candidate: _Solved) -> float:
        r = candidate.weighted[0]
        return float(r @ r + np.sum(candidate.prior * (candidate.p - nominal) ** 2))

    cost = cost_of(solved)
    for _ in range(steps):
        r, J = solved.weighted
        N = solved.normal
        gradient = J.T @ r + solved.prior * (solved.p - nominal)
        while True:
            step = -np.linalg.solve(N + damping * np.diag(np.diag(N)), gradient)
            q = solved.p + step
            tried = replace(solved, p=q, rows=_rows(q, readings))
            there = cost_of(tried)
            if there <= cost or np.max(np.abs(step)) < SMALLEST_STEP:
                break
            damping *= 10.0
        if there > cost:
            break
        done = np.max(np.abs(step)) < SMALLEST_STEP
        solved, cost, damping = tried, there, max(damping / 10.0, 1e-12)
        if done:
            break
    return solved


def _rescaled(solved: _Solved) -> _Solved:
    """Let the rows of each kind judge the size of their errors, never below the stated noise."""
    r, J = solved.weighted
    hat = np.sum((J @ np.linalg.inv(solved.normal)) * J, axis=1)
    scale = solved.scale.copy()
    for kind in np.unique(solved.rows.kind):
        mine = solved.rows.kind == kind
        spare = float(np.sum(1.0 - hat[mine]))
        squares = float(np.sum(r[mine] ** 2)) * scale[kind] ** 2
        scale[kind] = max(1.0, float(np.sqrt((squares + PRIOR_DOF) / (spare + PRIOR_DOF))))
    return replace(solved, scale=scale)


def _reweighted(solved: _Solved) -> _Solved:
    """Robust size of the errors of each kind, and Tukey's weights."""
    z = solved.rows.residual / solved.rows.sigma
    scale, slope, weight = solved.scale.copy(), solved.slope.copy(), np.ones(len(z))
    for kind in np.unique(solved.rows.kind):
        mine = solved.rows.kind == kind
        scale[kind] = max(1e-3, 1.4826 * float(np.median(np.abs(z[mine]))))
        inside = np.clip(1.0 - (z[mine] / (TUKEY * scale[kind])) ** 2, 0.0, 1.0)
        weight[mine] = inside**2
        # The derivative of z times its weight, over the weight.
        slope[kind] = max(0.1, float(np.sum(inside * (5.0 * inside - 4.0)) / np.sum(inside**2)))
    return replace(solved, scale=scale, slope=slope, weight=weight)


def _outlier(solved: _Solved, used: BoolArray) -> int | None:
    """Index among all readings of the worst one, if it stands out."""
    count = int(used.sum())
    if count < FEWEST_TO_JUDGE or count - 1 < (1.0 - MOST_SET_ASIDE) * len(used):
        return None
    r, J = solved.weighted
    hat = np.sum((J @ np.linalg.inv(solved.normal)) * J, axis=1)
    # The others judge: a row's own square is taken out of the size of the errors of its kind.
    spare = np.maximum(1.0 - hat, 1e-3)
    z = np.zeros(len(r))
    for kind in np.unique(solved.rows.kind):
        mine = solved.rows.kind == kind
        own = r[mine] ** 2 / spare[mine]
        s2 = solved.scale[kind] ** 2
        rest = float(np.sum(r[mine] ** 2)) - own
        freedom = float(np.sum(spare[mine])) - 1.0
        size = np.maximum((rest * s2 + PRIOR_DOF) / (freedom + PRIOR_DOF), 1.0)
        z[mine] = np.sqrt(own * s2 / size)
    worst = int(np.argmax(z))
    if z[worst] <= OUTLIER:
        return None
    return int(np.flatnonzero(used)[solved.rows.reading[worst]])


def _fit_of(
    solved: _Solved, unit: FieldReadings, used: BoolArray, radius: float, field: float
) -> FieldFit:
    cluster = np.arange(used.sum()) if unit.cluster is None else unit.cluster[used]
    omissions = _omissions(solved, cluster)
    C, dof = _covariance(solved, omissions, by_law=unit.cluster is None)
    C = C + _common_errors(solved, unit.only(used))
    p = solved.p
    has_dip = bool(np.any(solved.rows.kind == DIP))
    gain = field / radius
    units = np.concatenate((np.full(9, gain), np.full(3, field)))
    affine = Affine(
        p[:9].reshape(3, 3) * gain,
        p[9:12] * field,
        C[:PARAMETERS, :PARAMETERS] * np.outer(units, units),
        dof,
    )
    symmetric = _without_rotation(affine)
    affine = affine if has_dip else symmetric
    every = _rows(p, unit)
    left_out = every.residual[: len(unit)].copy()
    kept = unit.raw[used]
    K, b = omissions[cluster, :9].reshape(-1, 3, 3), omissions[cluster, 9:12]
    left_out[used] = np.linalg.norm(np.einsum("nij,nj->ni", K, kept) - b, axis=1) - 1.0
    error = every.residual[every.kind == MAGNITUDE]
    dip_error = np.full(len(unit), np.nan)
    at_dip = every.kind == DIP
    dip_error[every.reading[at_dip]] = every.residual[at_dip]
    return FieldFit(
        affine=affine,
        field_ut=field,
        dip_rad=float(p[12]) if has_dip else None,
        dip_u=float(np.sqrt(C[12, 12])) if has_dip else None,
        symmetric=symmetric,
        alignment_u=rotation_uncertainty(affine.K, affine.covariance) if has_dip else None,
        error=error,
        left_out=left_out,
        dip_error=dip_error,
        noise=(float(solved.scale[0]), float(solved.scale[1]), float(solved.scale[2])),
        used=used,
    )


def _omissions(solved: _Solved, cluster: IntArray) -> FloatArray:
    """Parameters (k, 14) that the fit would give without each cluster of readings."""
    r, J = solved.weighted
    pull = J * np.sqrt(solved.slope[solved.rows.kind])[:, None]
    N = pull.T @ pull + np.diag(solved.prior)
    mine_of = cluster[solved.rows.reading]
    ends = []
    for name in range(int(cluster.max()) + 1):
        mine = mine_of == name
        left = N - pull[mine].T @ pull[mine]
        ends.append(solved.p + np.linalg.solve(left, J[mine].T @ r[mine]))
    return np.array(ends)


def _covariance(
    solved: _Solved, omissions: FloatArray, *, by_law: bool
) -> tuple[FloatArray, float]:
    """Covariance (14, 14) and its degrees of freedom.

    ``by_law``, as for still means, it is the law of errors'. Else it is what leaving out one
    stretch of time after another changes: errors of samples go on for longer than a sample.
    """
    reach = np.linalg.inv(solved.normal)
    if by_law:
        r, J = solved.weighted
        return np.asarray(reach), len(r) - float(np.sum((J @ reach) * J)) + PRIOR_DOF
    count = len(omissions)
    moved = omissions - omissions.mean(axis=0)
    # What no sample determines no omission changes either: there the prior's own width stands.
    C = (count - 1) / count * moved.T @ moved + reach @ np.diag(solved.prior) @ reach
    return np.asarray(C), float(count - 1)


def _common_errors(solved: _Solved, readings: FieldReadings) -> FloatArray:
    """Covariance (14, 14) that errors common to all directions up add."""
    C = np.zeros((UNKNOWNS, UNKNOWNS))
    if readings.up_errors is None or readings.up is None:
        return C
    J, sigma = solved.weighted[1], solved.rows.sigma * solved.scale[solved.rows.kind]
    weight = np.sqrt(solved.weight) / sigma
    reach = np.linalg.inv(solved.normal) @ J.T
    for error in readings.up_errors:
        other = _rows(solved.p, replace(readings, up=readings.up + error))
        shift = reach @ (weight * (other.residual - solved.rows.residual))
        C += np.outer(shift, shift)
    return C


def _without_rotation(affine: Affine) -> Affine:
    """Make K symmetric and take its undetermined rotation out of the covariance."""
    U, _, V = np.linalg.svd(affine.K)
    Q = V.T @ U.T
    turned = affine.rotated(Q)
    K = turned.K
    # Of every change of K and b, the rotation that keeps K symmetric is added to it.
    J = np.eye(PARAMETERS)
    sums = np.trace(K) * np.eye(3) - K
    for i in range(9):
        dK = np.zeros(9)
        dK[i] = 1.0
        W = rotation.skew(np.linalg.solve(sums, _twice_axis(dK.reshape(3, 3))))
        J[:9, i] -= (W @ K).ravel()
        J[9:, i] -= W @ turned.b
    return Affine(K, turned.b, J @ turned.covariance @ J.T, affine.dof)


def _twice_axis(M: FloatArray) -> FloatArray:
    """Vector (3,) of the antisymmetric matrix ``M - M'``."""
    return np.array((M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]))
