"""Finds what is wrong with a jig session: wrong labels, servos that slipped, bumped poses.

Such faults hardly touch the sensor's parameters, for these rest on gravity's magnitude and the
gyroscope; but they spoil the jig's frame, and a person should know. Labels are compared with
gravity and with the gyroscope's turns. Slips and bumps are looked for by score tests: how much
better would the whole fit be if an axis had jumped there, or a pose stood turned?
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.calibration.findings import Finding
from imu_rig.calibration.joint_data import JointData
from imu_rig.calibration.joint_fit import JointFit, default_prior, fit_joint, unit
from imu_rig.calibration.joint_model import (
    ROWS_OF,
    JointState,
    Prior,
    attitudes,
    offsets,
)
from imu_rig.calibration.model import Affine
from imu_rig.calibration.moves import integrate
from imu_rig.errors import DataError
from imu_rig.units import DEG

FAR_OFF = 12.0 * DEG
"""Angle between gravity and its label beyond anything a servo does."""
OTHER_LABEL = 10.0 * DEG
"""Angle within which gravity fits the label of another pose."""
WRONG_TURN = 25.0 * DEG
"""Angle between a turn by the gyroscope and the one between two labels that is no servo's error."""
AXES = ("pan", "tilt", "roll")
USUAL_SPREAD = 0.7 * DEG
"""What a hobby servo errs by anew whenever it is driven: repeatability, backlash, gears."""
SURPRISE = 16.0
"""Drop of the weighted square sum, over that of usual scatter, that makes a fault: four standard
deviations, beside the size that it must have."""
SMALLEST_SLIP = 2.0 * DEG
CLEAR = 1.3 * DEG
"""Standard uncertainty of a slip's size above which it is not called one."""
SMALLEST_BUMP = 2.5 * DEG
"""What the dead band of a winch servo can do to a pose without being a fault [rad]."""
MANY_WRONG = 0.25
"""Share of wrong turns beyond which it is not single labels that are wrong."""
LARGEST_FAULT = 90.0 * DEG
"""A fault beyond it is none: the linearized fit does not reach that far."""
TURNED_OVER = 25.0 * DEG
"""Angle between the sensor and its nominal place on the plate that is no sloppy mounting."""
MOST_FAULTS = 4
NO_TRUST = 180.0 * DEG
"""Standard deviation of the servos in a pose whose label counts for nothing."""
NORMAL_MEDIAN = 0.6745


@dataclass(frozen=True, eq=False)
class Labels:
    """Commanded angles (m, 3) [rad] put right, the poses to leave out, and what was found."""

    angles: FloatArray
    usable: BoolArray
    findings: tuple[Finding, ...]


def check_labels(data: JointData, accel: Affine, state: JointState, names: Sequence[str]) -> Labels:
    """Compare gravity and the turns between poses with what the commanded angles say.

    Parameters
    ----------
    data : JointData
        The session.
    accel : Affine
        Accelerometer from gravity's magnitude alone.
    state : JointState
        The start of the fit: nominal jig, mounting as found.
    names : sequence of str
        Names of the poses.
    """
    seen = unit(accel.apply(data.accel))
    A = attitudes(data, state).A
    told = A[:, 2, :]
    off = _angle(seen, told)
    if float(np.median(off)) > FAR_OFF:
        raise DataError(
            f"gravity and the jig's angles disagree by {np.median(off) / DEG:.0f} degrees in a "
            "typical pose: the angles belong to another session, are in another unit or order, or "
            "axes of the accelerometer are exchanged or mirrored; put that right, or take "
            "--method multi-position, which needs no angles"
        )
    far = np.flatnonzero(off > max(6.0 * float(np.median(off)), FAR_OFF))
    match = np.array([_angle(seen[i], told) for i in far]).reshape(len(far), len(data))
    match[data.mounting[far][:, None] != data.mounting] = np.inf
    fits = _relabelled(far, match)
    fits |= _turned_pairs(data, state, A, fits)
    angles, usable = data.angles.copy(), np.ones(len(data), dtype=bool)
    findings: list[Finding] = []
    for i, j in fits.items():
        if j is not None:
            angles[i] = data.angles[j]
            continue
        usable[i] = False
        text = (
            f"{_name(names, i)} stands {off[i] / DEG:.0f} degrees from where the jig was told to "
            "go; it was left out."
        )
        findings.append(Finding("bumped", text, (i,), size=float(off[i] / DEG)))
    return Labels(angles, usable, (*findings, *_mislabelled(fits, names)))


def _relabelled(far: IntArray, match: FloatArray) -> dict[int, int | None]:
    """Whose label fits each of the poses ``far``; None where nobody's does.

    Parameters
    ----------
    far : shape (f,)
        Poses that contradict their labels.
    match : shape (f, m)
        Angle between each of them and the place that each label tells [rad].
    """
    places = {int(i): row for row, i in enumerate(far)}
    fits: dict[int, int | None] = {}
    # Two poses that contradict their labels and fit each other's were exchanged, whatever else
    # may fit as well.
    pairs = sorted(
        (max(match[a, j], match[b, i]), i, j)
        for i, a in places.items()
        for j, b in places.items()
        if i < j
    )
    for off, i, j in pairs:
        if off < OTHER_LABEL and i not in fits and j not in fits:
            fits[i], fits[j] = j, i
    for i, row in places.items():
        if i not in fits:
            others = match[row].copy()
            others[i] = np.inf
            j = int(np.argmin(others))
            fits[i] = j if others[j] < OTHER_LABEL else None
    return fits


def _turned_pairs(
    data: JointData, state: JointState, A: FloatArray, known: dict[int, int | None]
) -> dict[int, int | None]:
    """Find poses with the same gravity whose labels were exchanged: their turns do not fit."""
    if not data.has_gyro or len(data.moves) == 0:
        return {}
    q = rotation.to_matrix(integrate(data.moves, state.K, offsets(data, state)))
    first, last = data.moves.first, data.moves.last
    label = np.arange(len(A))
    for i, j in known.items():
        label[i] = i if j is None else j

    def misfit(labels: IntArray) -> FloatArray:
        B = A[labels]
        return _turn(q, np.swapaxes(B[first], 1, 2) @ B[last])

    wrong = misfit(label) > WRONG_TURN
    if float(np.mean(wrong)) > MANY_WRONG:
        raise DataError(
            f"{int(wrong.sum())} of {len(wrong)} turns of the gyroscope contradict the jig's "
            "angles: an axis of the jig or of the gyroscope has the wrong sign, or the angles "
            "belong to another session; put that right, or take --method multi-position, which "
            "needs no angles"
        )
    ends = np.concatenate((first, last))
    moves = np.bincount(ends, minlength=len(A))
    bad = np.bincount(ends, weights=np.tile(wrong, 2).astype(float), minlength=len(A))
    suspects = np.flatnonzero((bad == moves) & (moves > 0))
    suspects = suspects[[int(i) not in known for i in suspects]]
    best: tuple[int, int] | None = None
    now = float(np.sum(misfit(label)))
    for a in suspects.tolist():
        for b in suspects.tolist():
            if a < b and data.mounting[a] == data.mounting[b]:
                trial = label.copy()
                trial[a], trial[b] = label[b], label[a]
                then = misfit(trial)
                if not np.any(then > WRONG_TURN) and float(then.sum()) < now:
                    now, best = float(then.sum()), (a, b)
    return {} if best is None else {best[0]: best[1], best[1]: best[0]}


def _mislabelled(fits: dict[int, int | None], names: Sequence[str]) -> list[Finding]:
    found = []
    for i, j in fits.items():
        if j is None:
            continue
        if fits.get(j) != i:
            text = (
                f"{_name(names, i)} stands where {_name(names, j)} should; the angles of that pose "
                "were taken."
            )
            found.append(Finding("mislabelled", text, (i,)))
        elif i < j:
            text = (
                f"{_name(names, i)} and {_name(names, j)} carry each other's angles; they were "
                "exchanged."
            )
            found.append(Finding("mislabelled", text, (i, j)))
    return found


@dataclass(frozen=True, eq=False)
class Repaired:
    """A session with its faults taken into account.

    Attributes
    ----------
    data : JointData
        Commanded angles with slips added.
    prior : Prior
        Assumptions that trust no angle of a bumped pose.
    state : JointState
        Where to start from.
    findings : tuple of Finding
        What was found.
    """

    data: JointData
    prior: Prior
    state: JointState
    findings: tuple[Finding, ...]


def repair(data: JointData, begin: JointState, names: Sequence[str]) -> Repaired:
    """Take slips and bumps out of a session, the most telling first."""
    findings: list[Finding] = []
    prior, state = default_prior(data, servo=USUAL_SPREAD), begin
    for _ in range(MOST_FAULTS + 1):
        fit = fit_joint(data, prior, state, components=False)
        state = fit.state
        fault = _most_telling(fit) if len(findings) < MOST_FAULTS else None
        if fault is None or fault.size**2 > LARGEST_FAULT**2:
            break
        if any(f.poses == (fault.pose,) and f.axis == _axis(fault) for f in findings):
            break
        pose, name = fault.pose, _name(names, fault.pose)
        if fault.axis is None:
            text = (
                f"{name} stands {fault.size / DEG:.1f} degrees from where the servos put it, as if "
                "the plate was bumped there; its angles were not used."
            )
            findings.append(Finding("bumped", text, (pose,), size=fault.size / DEG))
            servo, wobble = prior.servo.copy(), prior.wobble.copy()
            servo[pose], wobble[pose] = NO_TRUST, NO_TRUST
            prior = replace(prior, servo=servo, wobble=wobble)
            continue
        text = (
            f"The {AXES[fault.axis]} servo slipped by {fault.size / DEG:+.1f} degrees on the way "
            f"to {name[0].lower() + name[1:]} and stayed there; its angles were corrected from "
            "there on."
        )
        slip = Finding("slip", text, (pose,), axis=AXES[fault.axis], size=fault.size / DEG)
        findings.append(slip)
        angles = data.angles.copy()
        angles[pose:, fault.axis] += fault.size
        data = replace(data, angles=angles)
    usual = default_prior(data)
    trusted = prior.servo < NO_TRUST
    prior = replace(prior, servo=np.where(trusted, usual.servo, prior.servo))
    return Repaired(data, prior, state, tuple(findings))


def _axis(fault: _Fault) -> str:
    return "" if fault.axis is None else AXES[fault.axis]


def remounted(state: JointState) -> list[Finding]:
    """Say where the sensor sits otherwise than the protocol says.

    Parameters
    ----------
    state : JointState
        The start of the fit, with the mountings that gravity shows.
    """
    found = []
    for k, turn in enumerate(state.mounting):
        angle = float(_turn(np.eye(3), turn))
        if angle > TURNED_OVER:
            which = f" in mounting {k + 1}" if len(state.mounting) > 1 else ""
            text = (
                f"The sensor sits on the plate turned by {angle / DEG:.0f} degrees from where the "
                f"protocol says{which}: its own parameters do not depend on it, but directions "
                "that were to be seen twice may not be seen at all."
            )
            found.append(Finding("remounted", text, size=angle / DEG))
    return found


@dataclass(frozen=True)
class _Fault:
    """A slip of an axis from a pose on, or a pose that stands turned (no axis); size [rad]."""

    pose: int
    axis: int | None
    size: float


def _most_telling(fit: JointFit) -> _Fault | None:
    """Return the slip or bump that would explain most of what is left, if it is no chance."""
    m, places = len(fit.data), fit.places
    latent = [ROWS_OF[name] for name in ("pan", "tilt", "roll", "held", "wobble")]
    real = ~np.isin(fit.rows.kind, [*latent, ROWS_OF["prior"]])
    J = fit.rows.jacobian * fit.weight[:, None]
    by_angle = (J * real[:, None])[:, places.deviation].reshape(-1, m, 3)
    by_turn = (J * real[:, None])[:, places.wobble].reshape(-1, m, 3)
    # An axis that jumps at a pose takes all later ones of its mounting with it.
    late = np.cumsum(by_angle[:, ::-1], axis=1)[:, ::-1]
    steps = _Scores.of(fit, J, late[:, 1:].reshape(len(J), -1))
    turns = _Scores.of(fit, J, by_turn.reshape(len(J), -1))
    drops, sizes = steps.single()
    steps_drop, steps_size = drops.reshape(m - 1, 3), sizes.reshape(m - 1, 3)
    turn_drop, turn_size = turns.triple()
    # A jump of the outermost stops is hardly told from a servo's gain: its size says nothing.
    clear = steps.uncertainty().reshape(m - 1, 3) < CLEAR
    allowed = clear & (np.abs(steps_size) > SMALLEST_SLIP)
    steps_drop = np.where(allowed, steps_drop, 0.0)
    turn_drop = np.where(np.linalg.norm(turn_size, axis=1) > SMALLEST_BUMP, turn_drop, 0.0)
    k, axis = np.unravel_index(int(np.argmax(steps_drop)), steps_drop.shape)
    turn_drop = np.where(fit.prior.servo.max(axis=1) < NO_TRUST, turn_drop, 0.0)
    i = int(np.argmax(turn_drop))
    if steps_drop[k, axis] >= turn_drop[i]:
        drop, explained = steps_drop[k, axis], late[:, k + 1, axis] * steps_size[k, axis]
        fault = _Fault(int(k) + 1, int(axis), float(steps_size[k, axis]))
    else:
        drop, explained = turn_drop[i], by_turn[:, i] @ turn_size[i]
        fault = _Fault(i, None, float(np.linalg.norm(turn_size[i])))
    # The rest then tells how well this jig repeats, worse than usual perhaps.
    left = fit.rows.residual * fit.weight + explained
    left -= J @ (fit.covariance @ (J.T @ explained))
    return fault if drop > SURPRISE * _spread(fit, left) ** 2 else None


@dataclass(frozen=True, eq=False)
class _Scores:
    """Scores (c,) and information (c, c) of columns that a fit lacks."""

    score: FloatArray
    information: FloatArray

    @staticmethod
    def of(fit: JointFit, J: FloatArray, X: FloatArray) -> _Scores:
        reach = J.T @ X
        information = X.T @ X - reach.T @ fit.covariance @ reach
        return _Scores(X.T @ (fit.rows.residual * fit.weight), information)

    def single(self) -> tuple[FloatArray, FloatArray]:
        """Drop of the square sum by each column alone, and its value."""
        size = np.maximum(np.diag(self.information), 1e-9)
        return self.score**2 / size, -self.score / size

    def uncertainty(self) -> FloatArray:
        """Return the standard uncertainty of each column's value."""
        return np.asarray(1.0 / np.sqrt(np.maximum(np.diag(self.information), 1e-9)))

    def triple(self) -> tuple[FloatArray, FloatArray]:
        """Drop by each three columns together, and their values (c / 3, 3)."""
        count = len(self.score) // 3
        drops, sizes = np.zeros(count), np.zeros((count, 3))
        for i in range(count):
            part = slice(3 * i, 3 * i + 3)
            sizes[i] = -np.linalg.pinv(self.information[part, part], 1e-6) @ self.score[part]
            drops[i] = -float(self.score[part] @ sizes[i])
        return drops, sizes


def _spread(fit: JointFit, residual: FloatArray) -> float:
    """How much more than usual the servos scatter by weighted residuals (r,), at least 1."""
    servo = np.isin(fit.rows.kind, [ROWS_OF[name] for name in AXES])
    return max(1.0, float(np.median(np.abs(residual[servo]))) / NORMAL_MEDIAN)


def _turn(A: FloatArray, B: FloatArray) -> FloatArray:
    """Angle [rad] between attitudes (..., 3, 3)."""
    cosine = 0.5 * (np.sum(A * B, axis=(-2, -1)) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _name(names: Sequence[str], i: int) -> str:
    name = names[i]
    return name[0].upper() + name[1:] if name.startswith("pose") else f"Pose {name}"


def _angle(u: FloatArray, v: FloatArray) -> FloatArray:
    across = np.linalg.norm(np.cross(u, v), axis=-1)
    return np.asarray(np.arctan2(across, np.sum(u * v, axis=-1)))
