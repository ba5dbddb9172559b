"""Gyroscope on a turntable: known rates, mean readings, and a straight line between them."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.earth import EARTH_RATE
from imu_rig.calibration.known import RateTable
from imu_rig.calibration.magnitude import UNKNOWNS, MagnitudeFit
from imu_rig.calibration.mean_noise import mean_variances, slow_terms
from imu_rig.calibration.model import AXES, Affine
from imu_rig.calibration.multi_position import solve_accelerometer
from imu_rig.calibration.session import AccelOutcome, GyroOutcome, Outcome, Session
from imu_rig.calibration.stills import gaps, sample_rate
from imu_rig.errors import DataError, InputError
from imu_rig.units import DEG, MILLI_G

RATE_SHARE = 1e-3
"""How well the rate of a table is known, unless its segments say better or worse."""
ALIGNMENT = 0.5 * DEG
"""How well the sensor is assumed to be aligned with the table, per axis [rad]."""
SHEET_GAIN = 0.03
"""Gain, on and off the diagonal, that a data sheet promises without any measurement."""
SHEET_BIAS = 80.0 * MILLI_G
PRIOR_DOF = 4.0
FEWEST_SAMPLES = 20
SPREAD = 2.0 * DEG
"""Least spread of the known rates about an axis that tells its gain [rad/s]."""
DISAGREES = 0.2
"""Part of the known rate by which a reading may be off before it is no reading of it."""


def turntable(session: Session) -> Outcome:
    """Solve the gyroscope from known rates, and the accelerometer where enough stills are there.

    Raises
    ------
    InputError
        No known rates.
    DataError
        Segments that are not in the recording, saturate, contradict the readings, or show no
        axis.
    """
    rates = session.known.rates
    if rates is None:
        raise InputError(
            "the method turntable needs the rates that the table had: give them with --rates FILE"
        )
    if not session.has_gyro:
        raise DataError("the recording has no gyroscope: there is nothing to calibrate on a table")
    raw, variance, omega = _segments(session, rates)
    varied = _varied(omega)
    _refuse_contradiction(raw, omega, varied)
    affine, warnings = _fit(raw, variance, omega, varied)
    accel, more = _accelerometer(session)
    none = np.empty(0)
    index = np.empty(0, dtype=np.int64)
    gyro = GyroOutcome(affine, index, index, none, none, none, none, none)
    return Outcome("sensor", accel, gyro, (*warnings, *more))


def _segments(session: Session, rates: RateTable) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean raw rates (n, 3), their variances (n, 3) and the known rates; rests are zeros."""
    block, holes = session.block, gaps(session.block.t)
    terms, means, count = [], [], []
    for i, (t0, t1) in enumerate(zip(rates.t0, rates.t1, strict=True)):
        a = int(np.searchsorted(block.t, t0, side="left"))
        b = int(np.searchsorted(block.t, t1, side="right"))
        where = f"segment {i + 1} of the rates ({t0:g} to {t1:g} s)"
        if b - a < FEWEST_SAMPLES:
            raise DataError(
                f"{where} holds {b - a} samples; the recording goes from {block.t[0]:g} to "
                f"{block.t[-1]:g} s"
            )
        if np.any((holes >= a) & (holes < b - 1)):
            raise DataError(f"{where} spans a gap in the samples: shorten it")
        if np.any(session.gyro_bad[a:b]):
            raise DataError(
                f"{where} is at the gyroscope's range limit: leave it out or choose a larger range"
            )
        terms.append(slow_terms(block.gyro[a:b], sample_rate(block.t)))
        means.append(block.gyro[a:b].mean(axis=0))
        count.append(b - a)
    variance = mean_variances(terms, np.array(count))
    stills = session.stills
    return (
        np.concatenate((np.array(means), stills.gyro_mean)),
        np.concatenate((variance, stills.gyro_sem**2)),
        np.concatenate((rates.rate, np.zeros((len(stills), 3)))),
    )


def _varied(omega: FloatArray) -> list[int]:
    """Return the axes about which the known rates tell the gain.

    Raises
    ------
    DataError
        None, or rates that do not part gains and bias.
    """
    varied = [k for k in range(3) if np.ptp(omega[:, k]) > SPREAD]
    if not varied:
        raise DataError(
            "all known rates are alike, so they tell no gain: record several rates about every "
            "axis, both ways, and a rest"
        )
    if np.linalg.matrix_rank(omega - omega.mean(axis=0), tol=SPREAD) < len(varied):
        raise DataError(
            f"the known rates do not part the gains about {_list([AXES[k] for k in varied])} from "
            "each other and from the bias: add a rest of a few seconds, or turn the other way too"
        )
    return varied


def _refuse_contradiction(raw: FloatArray, omega: FloatArray, varied: list[int]) -> None:
    """Refuse a wrong unit, sense or axis before a gain absorbs it."""
    design = np.concatenate((omega[:, varied], np.ones((len(omega), 1))), axis=1)
    slopes = np.linalg.lstsq(design, raw, rcond=None)[0]
    for axis, slope in zip(varied, slopes, strict=False):
        seen = int(np.argmax(np.abs(slope)))
        gain = float(slope[axis])
        about = f"turns about {AXES[axis]}"
        if seen != axis:
            raise DataError(
                f"{about} show on the gyroscope's {AXES[seen]}: correct the order of its columns "
                "or the axes of the rates"
            )
        if gain < 0.0:
            raise DataError(
                f"{about} are read with the opposite sign: the table turned the other way, or the "
                "column's sign is wrong"
            )
        if abs(gain - 1.0) > DISAGREES:
            unit = ""
            if abs(gain * DEG - 1.0) < DISAGREES:
                unit = " (as if they were in deg/s, not rad/s)"
            elif abs(gain / DEG - 1.0) < DISAGREES:
                unit = " (as if they were in rad/s, not deg/s)"
            raise DataError(
                f"{about} are read {gain:.3g} times as fast as the rates say{unit}: the unit, the "
                "range setting or the rates are wrong"
            )


def _fit(
    raw: FloatArray, variance: FloatArray, omega: FloatArray, varied: list[int]
) -> tuple[Affine, list[str]]:
    """Fit ``raw = S omega + r``; what the rates leave open keeps the data sheet's uncertainty."""
    design = np.concatenate((omega, np.ones((len(omega), 1))), axis=1)
    S, r = np.empty((3, 3)), np.empty(3)
    C = np.zeros((12, 12))  # of [S row by row, r]
    level = np.linalg.norm(omega, axis=1)
    scales = []
    for axis in range(3):
        own = variance[:, axis] + (RATE_SHARE * omega[:, axis]) ** 2 + (1e-5 * level) ** 2
        nominal = np.concatenate((np.eye(3)[axis], [0.0]))
        weight = np.concatenate((1.0 / np.sqrt(own), np.full(3, 1.0 / SHEET_GAIN), [0.0]))
        rows = np.concatenate((design, np.eye(4))) * weight[:, None]
        y = np.concatenate((raw[:, axis], nominal)) * weight
        N = np.linalg.inv(rows.T @ rows)
        p = N @ (rows.T @ y)
        misfit = (raw[:, axis] - design @ p) / np.sqrt(own)
        dof = max(len(raw) - len(varied) - 1, 0)
        scale = (PRIOR_DOF + float(misfit @ misfit)) / (PRIOR_DOF + dof)
        scales.append(scale)
        S[axis], r[axis] = p[:3], p[3]
        index = np.array([3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis])
        # What the rates leave open does not become better known by a small misfit.
        C[np.ix_(index, index)] = N * max(scale, 1.0)
    K: FloatArray = np.asarray(np.linalg.inv(S), dtype=float)
    by_S = np.hstack((-np.kron(K, K.T), np.zeros((9, 3))))
    by_K = np.kron(np.eye(3), r)
    by_b = by_K @ by_S + np.hstack((np.zeros((3, 9)), K))
    J = np.concatenate((by_S, by_b))
    covariance: FloatArray = np.asarray(J @ C @ J.T)
    lean = np.concatenate((np.eye(9), by_K))
    off = np.where(np.eye(3) > 0, 0.0, ALIGNMENT**2).ravel()
    covariance += lean @ np.diag(off) @ lean.T
    covariance[9:, 9:] += EARTH_RATE**2 / 3.0 * np.eye(3)
    open_axes = [AXES[k] for k in range(3) if k not in varied]
    warnings = [
        f"The gyroscope's cross-axis terms rest on a sensor aligned with the table to "
        f"{ALIGNMENT / DEG:g} degrees, its scale on rates known to {100 * RATE_SHARE:g} %."
    ]
    if open_axes:
        warnings.append(
            f"No rate about {_list(open_axes)} is known: the gain of {_list(open_axes)} is the "
            f"nominal one with the {100 * SHEET_GAIN:g} % that a data sheet promises; turn it "
            "about every axis."
        )
    if max(scales) > 9.0:
        warnings.append(
            f"The readings scatter {np.sqrt(max(scales)):.0f} times as much about the known rates "
            "as noise and table explain: segments that are not steady, or wrong rates."
        )
    return Affine(K, K @ r, covariance, dof=PRIOR_DOF + max(len(raw) - 4, 0)), warnings


def _accelerometer(session: Session) -> tuple[AccelOutcome, list[str]]:
    stills = session.stills
    if len(stills) >= UNKNOWNS:
        try:
            fit, warnings = solve_accelerometer(session)
        except DataError:
            pass
        else:
            return _outcome(fit), warnings
    sigma = np.full(len(stills), np.nan)
    spread = np.diag([SHEET_GAIN**2] * 9 + [SHEET_BIAS**2] * 3)
    spread[[3, 6, 7], [3, 6, 7]] = 0.0
    nominal = Affine(np.eye(3), np.zeros(3), spread)
    text = (
        "The accelerometer was not calibrated: its gain and bias are the nominal ones with the "
        f"uncertainty of a data sheet ({100 * SHEET_GAIN:g} %, {SHEET_BIAS / MILLI_G:.0f} mg)."
    )
    return AccelOutcome(nominal, sigma, sigma, sigma), [text]


def _outcome(fit: MagnitudeFit) -> AccelOutcome:
    return AccelOutcome(fit.affine, fit.sigma, fit.left_out, fit.left_out_sigma)


def _list(words: list[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
