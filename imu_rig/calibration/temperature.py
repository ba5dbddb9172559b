"""How a sensor depends on temperature, from a session during which it changed.

Works on what any method found: slopes are added, linearized, to a solved calibration. Drift in
time is estimated beside them, since a sensor that only warms up does both at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.magnitude import FLICKER, UPPER
from imu_rig.calibration.model import PARAMETERS, Affine
from imu_rig.calibration.session import AccelOutcome, Outcome, Session
from imu_rig.calibration.temperature_term import Slopes, TemperatureTerm, at_reference
from imu_rig.units import DEG, MILLI_G

POSSIBLE_C = (-100.0, 200.0)
"""What the temperature of a sensor that works may be."""
LEAST_SPAN_C = 3.0
"""Smaller changes of temperature tell too little."""
FEWEST_STILLS = 12
MOST_STILLS = 60
"""More of them cost time and tell nothing new about a slope."""
CLEAR = 2.0
"""A slope is offered from so many of its standard uncertainties on: then the correction, at
either end of the span, is sure to do more good than harm."""
BIAS_PRIOR = 5.0 * MILLI_G
"""Standard deviation of an accelerometer's slope before the data are seen [m/s^2 per degree]."""
SCALE_PRIOR = 2e-3
"""The same of its scale [1 per degree]."""
DRIFT_PRIOR = 5.0 * MILLI_G
"""Drift of the accelerometer's bias over the session, likewise: as large as temperature's."""
WEAK = 1.0
"""Standard deviation of the gyroscope's bias, slope and drift before the data are seen [rad/s]."""
WALKS = np.concatenate(([0.0], np.geomspace(2e-4, 0.1, 19) * DEG))
"""Candidates of the gyroscope's random walk [rad/s per sqrt(s)], finer than a slope's uncertainty
minds."""
SCATTERS = np.concatenate(([0.0], np.geomspace(2e-3, 0.2, 6) * DEG))
"""Candidates of the scatter of its bias from pose to pose [rad/s]."""
AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Temperature's part in a session.

    Attributes
    ----------
    term : TemperatureTerm
        The slopes.
    session : Session
        With the accelerometer's means as they would be at the reference temperature.
    outcome : Outcome
        The calibration at the reference temperature.
    notes : tuple of str
        One sentence each for the user.
    """

    term: TemperatureTerm
    session: Session
    outcome: Outcome
    notes: tuple[str, ...]


def believable(block: ImuBlock) -> tuple[ImuBlock, list[str]]:
    """Take temperatures that no sensor can have for unknown, and say so.

    Returns
    -------
    block : ImuBlock
        With NaN in their places.
    notes : list of str
        One sentence where there were any.
    """
    if block.temperature is None:
        return block, []
    low, high = POSSIBLE_C
    wrong = (block.temperature < low) | (block.temperature > high)
    count = int(np.sum(wrong))
    if not count:
        return block, []
    told = (
        f"{count} of {len(block)} temperatures lie outside {low:g} to {high:g} degC and are taken "
        "for unknown: a bad connection, or the unit or the column is wrong."
    )
    return replace(block, temperature=np.where(wrong, np.nan, block.temperature)), [told]


def _mean_known(temperature: FloatArray) -> float:
    known = temperature[np.isfinite(temperature)]
    return float(known.mean()) if len(known) else np.nan


def sensitivity(session: Session, outcome: Outcome) -> Sensitivity | None:
    """Estimate how accelerometer and gyroscope depend on temperature.

    Returns None where the session has no temperature, or too little change of it.
    """
    stills = session.stills
    if session.block.temperature is None or len(stills) < FEWEST_STILLS:
        return None
    rows = zip(stills.start, stills.stop, strict=True)
    temperature = np.array([_mean_known(session.block.temperature[i:j]) for i, j in rows])
    if not np.all(np.isfinite(temperature)) or np.ptp(temperature) < LEAST_SPAN_C:
        return None
    reference = float(temperature.mean())
    dT = temperature - reference
    time = (stills.t0 + stills.t1) / 2.0
    time = (time - time.mean()) / np.ptp(time)
    bias, scale, hidden, accel = _accelerometer(session, outcome.accel, dT, time)
    gyro, gyro_hidden = _gyroscope(session, outcome, dT)
    term = TemperatureTerm(
        reference_c=reference,
        low_c=float(temperature.min()),
        high_c=float(temperature.max()),
        accel_bias=bias,
        accel_scale=scale,
        gyro_bias=gyro,
    )
    found = replace(outcome, accel=accel)
    notes = [_said("accelerometer", bias, MILLI_G, "mg")]
    if gyro is not None:
        notes.append(_said("gyroscope", gyro, DEG, "deg/s"))
    mixed = [n for n, h in (("accelerometer", hidden), ("gyroscope", gyro_hidden)) if h]
    if mixed:
        notes.append(
            f"For the {' and the '.join(mixed)}, drift in time and change with temperature cannot "
            "be told apart, because the temperature changed steadily: let it rise and fall again, "
            "or record at several temperatures."
        )
    return Sensitivity(term, _at_reference(session, term, accel.affine, dT), found, tuple(notes))


def _at_reference(
    session: Session, term: TemperatureTerm, affine: Affine, dT: FloatArray
) -> Session:
    scale = np.zeros(3) if term.accel_scale is None else term.accel_scale.applied
    means = session.stills.accel_mean
    cold = at_reference(affine.apply(means), affine.b, dT[:, None], term.accel_bias.applied, scale)
    raw = np.asarray(np.linalg.solve(affine.K, (cold + affine.b).T).T, dtype=np.float64)
    return replace(session, stills=replace(session.stills, accel_mean=raw))


def _accelerometer(
    session: Session, accel: AccelOutcome, dT: FloatArray, time: FloatArray
) -> tuple[Slopes, Slopes | None, bool, AccelOutcome]:
    """Slopes of bias and scale, whether drift hides one, and the calibration beside them."""
    affine = accel.affine
    turned = session.stills.accel_mean @ affine.K.T
    calibrated = turned - affine.b
    size = np.linalg.norm(calibrated, axis=1)
    n = calibrated / size[:, None]
    # The means' own noise, not what the method made of it: temperature itself was noise to that.
    along = n @ affine.K
    noise = np.einsum("ij,ijk,ik->i", along, session.stills.accel_cov, along)
    weight = 1.0 / np.sqrt(noise + FLICKER**2)[:, None]
    error = (size - session.gravity.value) * weight[:, 0]
    fixed = np.concatenate((n[:, UPPER[0]] * turned[:, UPPER[1]], -n), axis=1) * weight
    slopes = np.concatenate((-n, n * turned), axis=1) * dT[:, None] * weight
    drift = -n * time[:, None] * weight
    prior = np.repeat((BIAS_PRIOR, SCALE_PRIOR), 3)
    drift_prior = np.repeat(DRIFT_PRIOR, 3)
    value, C = _regularized(error, fixed, slopes, drift, np.append(prior, drift_prior))
    plain, plain_C = _regularized(error, fixed, slopes, drift[:, :0], prior)
    sigma, plain_sigma = np.sqrt(np.diag(C)), np.sqrt(np.diag(plain_C))
    offered = np.abs(value) > CLEAR * sigma
    hidden = bool(np.any((np.abs(plain) > CLEAR * plain_sigma)[:3] & ~offered[:3]))
    bias = Slopes(value[:3], sigma[:3], offered[:3])
    told = (sigma[3:] < 0.5 * SCALE_PRIOR) & (not hidden)
    scale = Slopes(value[3:], sigma[3:], offered[3:] & told) if told.all() else None
    if scale is None:
        offered[3:] = False
    # What the slopes explain, the calibration without them had put into its own parameters.
    M = -np.linalg.pinv(fixed) @ (slopes * offered)
    shifted = _shifted(affine, M @ np.where(offered, value, 0.0), M @ C @ M.T)
    return bias, scale, hidden, replace(accel, affine=shifted)


def _regularized(
    error: FloatArray, fixed: FloatArray, slopes: FloatArray, drift: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Slopes (6,) and their covariance, for weighted errors (m,) and derivatives (m, k)."""
    A = np.concatenate((fixed, slopes, drift), axis=1)
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    N = (A / size).T @ (A / size)
    first = fixed.shape[1]
    N[np.arange(first, len(N)), np.arange(first, len(N))] += 1.0 / (prior * size[first:]) ** 2
    C = np.linalg.pinv(N, rcond=1e-13, hermitian=True)
    # error + A x = noise
    x = -C @ ((A / size).T @ error)
    rest = error + (A / size) @ x
    freedom = max(1.0, len(error) - float(np.trace(C @ (A / size).T @ (A / size))))
    scale = max(1.0, float(rest @ rest) / freedom)
    chosen = slice(first, first + slopes.shape[1])
    spread = np.outer(size[chosen], size[chosen])
    return np.asarray(x[chosen] / size[chosen]), np.asarray(scale * C[chosen, chosen] / spread)


def _shifted(affine: Affine, change: FloatArray, covariance: FloatArray) -> Affine:
    """``(I + U) K`` and ``b + change`` for nine changes: U upper triangular, then b."""
    U = np.zeros((3, 3))
    U[UPPER] = change[:6]
    # How K, row by row, and b follow the nine numbers.
    E = np.zeros((PARAMETERS, 9))
    for k, (i, j) in enumerate(zip(*UPPER, strict=True)):
        E[3 * i : 3 * i + 3, k] = affine.K[j]
    E[9:, 6:] = np.eye(3)
    return replace(
        affine,
        K=affine.K + U @ affine.K,
        b=affine.b + change[6:],
        covariance=affine.covariance + E @ covariance @ E.T,
    )


def _gyroscope(session: Session, outcome: Outcome, dT: FloatArray) -> tuple[Slopes | None, bool]:
    """Slopes of the bias in the calibrated frame, and whether drift in time hides one."""
    if outcome.gyro is None:
        return None, False
    stills = session.stills
    every = np.unique(np.linspace(0, len(stills) - 1, MOST_STILLS).astype(np.int64))
    t = ((stills.t0 + stills.t1) / 2.0)[every]
    means, sems = stills.gyro_mean[every], stills.gyro_sem[every]
    K = outcome.gyro.affine.K
    drift = (t - t.mean()) / np.ptp(t)
    ones = np.ones(len(t))
    found = []
    for columns in ((ones, dT[every], drift), (ones, dT[every])):
        raw, sigma = _slopes_in_walk(t, means, sems, np.stack(columns, axis=1))
        found.append((K @ raw, np.sqrt(K**2 @ sigma**2)))
    (value, sigma), (plain, plain_sigma) = found
    offered = np.abs(value) > CLEAR * sigma
    hidden = bool(np.any((np.abs(plain) > CLEAR * plain_sigma) & ~offered))
    return Slopes(value, sigma, offered), hidden


def _slopes_in_walk(
    t: FloatArray, means: FloatArray, sems: FloatArray, X: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Coefficient (3,) of the second column of X (m, k) and its standard uncertainty.

    The noise is a random walk in time, a scatter from still to still and the means' own errors.
    The sizes of the first two are common to the axes and unknown: the estimate is the mean over
    them, weighted by their restricted likelihood.
    """
    since = t - t[0]
    walked = np.minimum(since[:, None], since[None, :])
    own = np.diag(np.mean(sems**2, axis=1))
    # Too wide to matter, but for a temperature that is a straight line in time.
    weak = np.eye(X.shape[1]) / WEAK**2
    values, variances, likelihood = [], [], []
    for walk in WALKS:
        for scatter in SCATTERS:
            L = np.linalg.cholesky(walk**2 * walked + own + scatter**2 * np.eye(len(t)))
            white = np.linalg.solve(L, np.column_stack((X, means)))
            A, y = white[:, : X.shape[1]], white[:, X.shape[1] :]
            N = A.T @ A + weak
            C = np.linalg.inv(N)
            x = C @ (A.T @ y)
            rest = y - A @ x
            values.append(x[1])
            variances.append(C[1, 1])
            chance = np.sum(np.log(np.diag(L))) + 0.5 * np.linalg.slogdet(N)[1]
            likelihood.append(-3.0 * chance - 0.5 * float(np.sum(rest**2)))
    weight = np.exp(np.array(likelihood) - max(likelihood))[:, None]
    weight /= weight.sum()
    mean = np.sum(weight * np.array(values), axis=0)
    spread = np.sum(
        weight * (np.array(variances)[:, None] + (np.array(values) - mean) ** 2), axis=0
    )
    return mean, np.sqrt(spread)


def _said(sensor: str, slopes: Slopes, factor: float, unit: str) -> str:
    parts = [
        f"{axis} {value / factor:+.4f} ± {sigma / factor:.4f}"
        for axis, value, sigma in zip(AXES, slopes.value, slopes.sigma, strict=True)
    ]
    axes = [axis for axis, yes in zip(AXES, slopes.offered, strict=True) if yes]
    use = f"the certificate corrects {', '.join(axes)}" if axes else "too uncertain to correct"
    return f"The {sensor}'s bias changes with temperature by {', '.join(parts)} {unit}/degC: {use}."
