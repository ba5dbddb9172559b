"""Verification: poses and moves that the fit never saw, judged against stated limits.

A residual of a fit proves nothing. Here every check pose says how far the calibrated magnitude of
gravity is off, every move to or from one how far the gyroscope leads gravity's direction astray;
each with its predicted standard uncertainty, from the parameters and the noise of the check.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Literal

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.direction import direction_residuals, gravity_directions
from imu_rig.calibration.gyro_bias import BiasTrack, track_bias
from imu_rig.calibration.magnitude import FLICKER, UNKNOWNS
from imu_rig.calibration.model import Affine
from imu_rig.calibration.moves import Moves, moves_between
from imu_rig.calibration.result import ErrorStages
from imu_rig.calibration.stills import Stills, frozen_rows, summarize, unbroken_windows
from imu_rig.calibration.suspicion import MOVED, SATURATED_SHARE, at_limit
from imu_rig.units import DEG, MILLI_G

LEAST_LEVER = 20.0 * DEG
"""Turn about level axes below which gravity sees too little of a move to judge it."""
NO_CHANCE = 1.4
"""Typical left-out errors this many times the prediction show that it is too small."""
RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector of two normal errors, in their standard deviation."""
NORMAL_MEDIAN = 0.6745
NOISE_ALLOWED = 2.0
"""Standard deviations of a check's own noise by which it may exceed a limit: a limit shorter than
the noise of a check would fail every other good sensor."""
MOST_SIGMAS = 37.0
"""Beyond, a probability is zero to a computer."""

State = Literal["passed", "failed", "not verified"]


@dataclass(frozen=True)
class Limits:
    """Largest errors with which a calibration passes.

    Attributes
    ----------
    accel : float
        Error of gravity's magnitude in a check pose [m/s^2].
    turn : float
        Error of gravity's direction after a check move [rad].
    sigma : float
        Either error, in predicted standard deviations.
    """

    accel: float = 1.0 * MILLI_G
    turn: float = 0.3 * DEG
    sigma: float = 4.0


@dataclass(frozen=True)
class CheckRow:
    """One check.

    Attributes
    ----------
    kind : str
        ``"pose"`` (magnitude of gravity, m/s^2) or ``"move"`` (its direction, rad).
    name : str
        The pose, or the two poses of the move.
    error, sigma : float or None
        Error and its predicted standard uncertainty (of a direction: per axis); None if void.
    sigmas : float or None
        The error in predicted standard deviations, as those of a normal error that is just as
        improbable; few degrees of freedom and the two axes of a direction are allowed for.
    noise : float or None
        Part of ``sigma`` that is the check's own: no calibration makes it smaller.
    limit, sigma_limit : float
        Limits of ``error`` and ``sigmas``.
    void : str
        Why the check counts for nothing; empty if it counts.
    """

    kind: Literal["pose", "move"]
    name: str
    error: float | None
    sigma: float | None
    sigmas: float | None
    noise: float | None
    limit: float
    sigma_limit: float
    void: str = ""

    @property
    def allowed(self) -> float:
        """Largest error that passes: the limit, and beyond it what the check's noise explains."""
        return self.limit + NOISE_ALLOWED * (self.noise or 0.0)

    @property
    def state(self) -> Literal["passed", "failed", "void"]:
        """How the check ended."""
        if self.error is None or self.sigmas is None:
            return "void"
        inside = abs(self.error) <= self.allowed and self.sigmas <= self.sigma_limit
        return "passed" if inside else "failed"


@dataclass(frozen=True)
class Verification:
    """All checks of a calibration, in time order, poses before moves.

    Attributes
    ----------
    rows : tuple of CheckRow
        The checks.
    limits : Limits
        What they were judged by.
    has_gyro : bool
        Whether there is a gyroscope's calibration to verify.
    """

    rows: tuple[CheckRow, ...]
    limits: Limits
    has_gyro: bool

    @property
    def passed(self) -> bool:
        """Whether everything that was calibrated was verified and no check failed."""
        return self.state == "passed"

    @property
    def state(self) -> State:
        """``"not verified"`` where nothing failed, but some sensor has no check that counts."""
        states = [row.state for row in self.rows]
        if "failed" in states:
            return "failed"
        return "not verified" if self._unchecked() else "passed"

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        counted = [row for row in self.rows if row.state != "void"]
        failed = [row for row in counted if row.state == "failed"]
        if failed:
            return f"Verification FAILED: {len(failed)} of {len(counted)} checks beyond limits."
        if self.state == "passed":
            return f"Verified: all {len(counted)} checks are within limits."
        return f"NOT verified: no check of the {' or the '.join(self._unchecked())} counts."

    @property
    def reasons(self) -> tuple[str, ...]:
        """One sentence per check that failed or is void."""
        return tuple(_reason(row) for row in self.rows if row.state != "passed")

    def _unchecked(self) -> list[str]:
        counts = {row.kind for row in self.rows if row.state != "void"}
        sensors = {"pose": "accelerometer"} | ({"move": "gyroscope"} if self.has_gyro else {})
        return [name for kind, name in sensors.items() if kind not in counts]


@dataclass(frozen=True)
class Scatter:
    """How far poses and moves left out of the fit were off: no check is expected to be better.

    Attributes
    ----------
    accel : float
        Standard deviation of the magnitude error of left-out poses [m/s^2]; 0 if unknown.
    turn : float
        The same of the direction error of left-out moves, per axis [rad].
    """

    accel: float = 0.0
    turn: float = 0.0

    @staticmethod
    def of(accel: ErrorStages, gyro: ErrorStages) -> Scatter:
        """Take the typical left-out errors of a result.

        A left-out pose loses a parameter's worth of knowledge more than a check does: with n
        residuals and p parameters its variance is ``1 / (1 - (p/n)^2)`` times as large.
        """

        def typical(errors: ErrorStages, median: float, per_row: int) -> float:
            held = errors.held_out
            if held is None:
                return 0.0
            share = min(0.9, UNKNOWNS / (per_row * held.count))
            return held.median / median * math.sqrt(1.0 - share**2)

        return Scatter(typical(accel, NORMAL_MEDIAN, 1), typical(gyro, RAYLEIGH_MEDIAN, 2))


@dataclass(frozen=True, eq=False)
class Checks:
    """What was measured to check a calibration.

    Attributes
    ----------
    stills : Stills
        Usable stills, also those of the fit: ``m`` of them in time order.
    names : tuple of str
        A name per still.
    check : shape (m,)
        Which stills are checks.
    track : BiasTrack
        Gyroscope bias at every still.
    moves : Moves
        Moves that begin or end at a check.
    void : tuple of CheckRow
        Checks that count for nothing.
    """

    stills: Stills
    names: tuple[str, ...]
    check: BoolArray
    track: BiasTrack
    moves: Moves
    void: tuple[CheckRow, ...]

    def without_moves(self) -> Checks:
        """Return the same of a sensor without a gyroscope."""
        void = tuple(row for row in self.void if row.kind == "pose")
        return replace(self, moves=self.moves.only(np.zeros(len(self.moves), bool)), void=void)

    def move_name(self, j: int) -> str:
        """Names of both ends of move ``j``."""
        return _between(self.names, int(self.moves.first[j]), int(self.moves.last[j]))


def checks_of(
    block: ImuBlock,
    windows: FloatArray,
    names: tuple[str, ...],
    check: BoolArray,
    limits: Limits,
    *,
    mounting: tuple[int, ...] = (),
    accel_limit: float | None = None,
    gyro_limit: float | None = None,
) -> Checks:
    """Collect the checks of a recording; what cannot be used is kept as void, with the reason.

    Parameters
    ----------
    block : ImuBlock
        The recording.
    windows : shape (m, 2)
        Begin and end of every still [s], settling cut off, in time order.
    names : tuple of str
        A name per window.
    check : shape (m,)
        Which of them are checks.
    limits : Limits
        What the checks will be judged by.
    mounting : tuple of int, optional
        Mounting of the sensor in every still; no move leads from one mounting to another.
    accel_limit, gyro_limit : float, optional
        Range limits [m/s^2, rad/s]; recognized by repeated extremes where not given.
    """
    spans = np.asarray(windows, dtype=float).reshape(-1, 2)
    whole = unbroken_windows(block, spans)
    stills = summarize(block, spans[whole])
    frozen, accel_bad = frozen_rows(block), at_limit(block.accel, accel_limit)
    reasons = ["samples are missing inside it"] * len(spans)
    for i, row in enumerate(np.flatnonzero(whole).tolist()):
        reasons[row] = _unusable(stills, i, frozen, accel_bad)
    usable = np.array([not reason for reason in reasons], dtype=bool)
    void = [
        _void_pose(name, reason, limits)
        for name, reason, is_check in zip(names, reasons, check, strict=True)
        if reason and is_check
    ]
    kept = stills.only(usable[whole])
    kept_names = tuple(name for name, keep in zip(names, usable, strict=True) if keep)
    mounted = np.array(mounting or (0,) * len(spans))[usable]
    track = _track(kept)
    bad = at_limit(block.gyro, gyro_limit) | frozen[:, None]
    remounted = mounted[1:] != mounted[:-1]
    for i in np.flatnonzero(remounted).tolist():
        bad[kept.stop[i] : kept.start[i + 1]] = True
    moves = moves_between(block, kept, track.at_stills, bad)
    concerned = check[usable][:-1] | check[usable][1:]
    found = np.isin(np.arange(len(concerned)), moves.first)
    void += [
        _void_move(_between(kept_names, i, i + 1), _broken_move(block, kept, i, bad), limits)
        for i in np.flatnonzero(concerned & ~found & ~remounted).tolist()
    ]
    judged = moves.only(concerned[moves.first])
    return Checks(kept, kept_names, check[usable], track, judged, tuple(void))


def verify(
    accel: Affine,
    gyro: Affine | None,
    checks: Checks,
    gravity: float,
    *,
    limits: Limits,
    scatter: Scatter,
) -> Verification:
    """Judge a calibration by checks that it never saw.

    Parameters
    ----------
    accel, gyro : Affine
        The calibration, the gyroscope's in the accelerometer's output frame or None.
    checks : Checks
        What was measured.
    gravity : float
        Magnitude of gravity [m/s^2].
    limits : Limits
        What is allowed.
    scatter : Scatter
        What left-out poses and moves of the fit were off by.
    """
    rows = _pose_rows(accel, checks, gravity, limits, scatter)
    rows += [row for row in checks.void if row.kind == "pose"]
    if gyro is not None:
        rows += _move_rows(accel, gyro, checks, limits, scatter)
        rows += [row for row in checks.void if row.kind == "move"]
    return Verification(tuple(rows), limits, has_gyro=gyro is not None)


def pose_errors(
    accel: Affine, means: FloatArray, covs: FloatArray, gravity: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors of the magnitude of gravity in ``m`` poses.

    Parameters
    ----------
    accel : Affine
        Calibrated accelerometer.
    means, covs : shape (m, 3), (m, 3, 3)
        Mean raw specific force of each pose and its covariance.
    gravity : float
        Magnitude of gravity [m/s^2].

    Returns
    -------
    error : shape (m,)
        ``|K u - b| - g`` [m/s^2].
    J : shape (m, 12)
        Its derivative with respect to ``[K, b]``.
    variance : shape (m,)
        What the noise of the check itself adds.
    """
    c = accel.apply(means)
    size = np.linalg.norm(c, axis=1)
    n = c / size[:, None]
    J = np.concatenate(((n[:, :, None] * means[:, None, :]).reshape(-1, 9), -n), axis=1)
    along = n @ accel.K
    variance = np.einsum("mi,mij,mj->m", along, covs, along) + FLICKER**2
    return size - gravity, J, np.asarray(variance)


def _pose_rows(
    accel: Affine, checks: Checks, gravity: float, limits: Limits, scatter: Scatter
) -> list[CheckRow]:
    stills = checks.stills.only(checks.check)
    names = [name for name, is_check in zip(checks.names, checks.check, strict=True) if is_check]
    if not names:
        return []
    error, J, noise = pose_errors(accel, stills.accel_mean, stills.accel_cov, gravity)
    variance = noise + np.einsum("ia,ab,ib->i", J, accel.covariance, J)
    variance = variance + excess(scatter.accel, variance)
    sigma = np.sqrt(variance)
    return [
        CheckRow(
            "pose",
            names[i],
            float(error[i]),
            float(sigma[i]),
            as_normal(abs(float(error[i] / sigma[i])), accel.dof),
            math.sqrt(float(noise[i])),
            limits.accel,
            limits.sigma,
        )
        for i in range(len(names))
    ]


def _move_rows(
    accel: Affine, gyro: Affine, checks: Checks, limits: Limits, scatter: Scatter
) -> list[CheckRow]:
    moves = checks.moves
    if not len(moves):
        return []
    where = gravity_directions(checks.stills, moves, accel, checks.track)
    residual, by_gain, by_accel = direction_residuals(moves, where, accel, checks.track, gyro.K)
    S = np.eye(2) * where.variance[:, None, None]
    S = S + by_gain @ gyro.covariance[:9, :9] @ np.swapaxes(by_gain, 1, 2)
    S = S + by_accel @ accel.covariance @ np.swapaxes(by_accel, 1, 2)
    own = np.trace(S, axis1=1, axis2=2) / 2.0
    S = S + np.eye(2) * excess(scatter.turn, own)
    lever = np.linalg.norm(by_gain @ gyro.K.ravel(), axis=1)
    rows = []
    for j in range(len(moves)):
        name = checks.move_name(j)
        if lever[j] < LEAST_LEVER:
            reason = f"gravity sees only {lever[j] / DEG:.0f} degrees of its turn"
            rows.append(_void_move(name, reason, limits))
            continue
        radius = math.sqrt(float(residual[j] @ np.linalg.solve(S[j], residual[j])))
        rows.append(
            CheckRow(
                "move",
                name,
                float(np.linalg.norm(residual[j])),
                math.sqrt(float(np.trace(S[j])) / 2.0),
                as_normal(_one_dimensional(radius), gyro.dof),
                math.sqrt(float(where.variance[j])),
                limits.turn,
                limits.sigma,
            )
        )
    return rows


def excess(left_out: float, variance: FloatArray) -> float:
    """Variance that left-out data of the fit show beyond what is predicted, if it is no chance."""
    predicted = float(np.mean(variance))
    return left_out**2 - predicted if left_out > NO_CHANCE * math.sqrt(predicted) else 0.0


def as_normal(t: float, dof: float) -> float:
    """Return the normal deviate that is as improbable as Student's ``t`` (Wallace 1959)."""
    if not math.isfinite(dof):
        return t
    shrink = (8.0 * dof + 1.0) / (8.0 * dof + 3.0)
    return shrink * math.sqrt(dof * math.log1p(t * t / dof))


def _one_dimensional(radius: float) -> float:
    """Return the normal deviate that is as improbable as a vector of two of this length."""
    if radius > MOST_SIGMAS:
        return radius
    return -NormalDist().inv_cdf(0.5 * math.exp(-0.5 * radius**2))


def _track(stills: Stills) -> BiasTrack:
    if not len(stills):
        nothing = np.zeros((0, 3))
        return BiasTrack(nothing, np.zeros(3), np.zeros(3), 0.0, 0.0, 0.0)
    return track_bias((stills.t0 + stills.t1) / 2, stills.gyro_mean, stills.gyro_sem)


def _unusable(stills: Stills, i: int, frozen: BoolArray, accel_bad: BoolArray) -> str:
    rows = slice(int(stills.start[i]), int(stills.stop[i]))
    if frozen[rows].any():
        return "the sensor hung"
    if accel_bad[rows].mean(axis=0).max() > SATURATED_SHARE:
        return "the accelerometer is at its range limit"
    if stills.drift[i] > MOVED:
        return "the sensor moved while it was held"
    return ""


def _broken_move(block: ImuBlock, stills: Stills, i: int, bad: BoolArray) -> str:
    a, b = int(stills.stop[i]) - 1, int(stills.start[i + 1])
    if bad[a : b + 1].any():
        return "the gyroscope is at its range limit or hung"
    return f"samples are missing, or its {block.t[b] - block.t[a]:.0f} s are too long"


def _between(names: tuple[str, ...], first: int, last: int) -> str:
    return f"{names[first]} → {names[last]}"


def _void_pose(name: str, reason: str, limits: Limits) -> CheckRow:
    return CheckRow("pose", name, None, None, None, None, limits.accel, limits.sigma, reason)


def _void_move(name: str, reason: str, limits: Limits) -> CheckRow:
    return CheckRow("move", name, None, None, None, None, limits.turn, limits.sigma, reason)


def _reason(row: CheckRow) -> str:
    told = row.kind == "pose" and row.name.startswith("pose ")
    where = f"Check {row.name}" if told else f"Check {row.kind} {row.name}"
    if row.error is None or row.sigmas is None:
        return f"{where} counts for nothing: {row.void}."
    unit, name = (MILLI_G, "mg") if row.kind == "pose" else (DEG, "deg")
    what = "gravity's size" if row.kind == "pose" else "gravity's direction"
    parts = []
    if abs(row.error) > row.allowed:
        extra = (row.allowed - row.limit) / unit
        parts.append(f"allowed are {row.limit / unit:.2g} {name} and {extra:.2g} {name} of noise")
    if row.sigmas > row.sigma_limit:
        parts.append(
            f"{row.sigmas:.1f} predicted standard deviations, allowed are {row.sigma_limit:g}"
        )
    return f"{where}: {what} is off by {row.error / unit:.2f} {name} ({'; '.join(parts)})."
