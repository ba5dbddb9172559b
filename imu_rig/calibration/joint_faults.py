"""Finds what is wrong with a jig session: wrong labels, servos that slipped, bumped poses.

Such faults hardly touch the sensor's parameters, for these rest on gravity's magnitude and the
gyroscope; but they spoil the jig's frame, and a person should know. So the jig is first
given no more trust than `DISTRUST`, and what its axes then did is judged axis by axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.calibration.findings import Finding
from imu_rig.calibration.joint_data import JointData
from imu_rig.calibration.joint_fit import JointFit, unit
from imu_rig.calibration.joint_model import SERVO_GAIN, TILT_ZERO, JointState, attitudes
from imu_rig.calibration.model import Affine
from imu_rig.units import DEG

DISTRUST = 6.0 * DEG
"""Standard deviation of a servo's angle while faults are looked for [rad]."""
FAR_OFF = 12.0 * DEG
"""Angle between gravity and its label beyond anything a servo does."""
OTHER_LABEL = 10.0 * DEG
"""Angle within which gravity fits the label of another pose."""
AXES = ("pan", "tilt", "roll")
LOCKED = 0.3
"""Cosine of tilt below which pan and roll turn about nearly the same axis."""
SERVO_SPREAD = 0.7 * DEG
"""Error that a hobby servo makes anew whenever it is driven: repeatability, backlash, gears."""
POSE_SPREAD = 0.4 * DEG
"""Error from pose to pose of a servo that was not driven."""
USUAL_GAIN = 0.03
SLIP_GAIN = 20.0
"""Drop of the weighted square sum, over that of noise, that makes a step or a single pose count."""
MOST_STEPS = 5
NORMAL_MEDIAN = 0.6745
SMALLEST_SLIP = 1.5 * DEG
BUMP_SIGMAS = 4.5
"""Deviation of a pose, in the typical one per axis, that no servo makes once in five thousand poses
(chi with three degrees of freedom)."""
SMALLEST_BUMP = 3.2 * DEG
"""What the dead band of a winch servo can do to a pose without being a fault [rad]."""
CHI3_MEDIAN = 1.538


@dataclass(frozen=True, eq=False)
class Labels:
    """Commanded angles (m, 3) [rad] put right, the poses to leave out, and what was found."""

    angles: FloatArray
    usable: BoolArray
    findings: tuple[Finding, ...]


def check_labels(data: JointData, accel: Affine, state: JointState, names: Sequence[str]) -> Labels:
    """Compare gravity in every pose with what the commanded angles say.

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
    told = attitudes(data, state).A[:, 2, :]
    off = _angle(seen, told)
    limit = max(6.0 * float(np.median(off)), FAR_OFF)
    angles, usable = data.angles.copy(), np.ones(len(data), dtype=bool)
    findings: list[Finding] = []
    far = np.flatnonzero(off > limit)
    match = np.array([_angle(seen[i], told) for i in far]).reshape(len(far), len(data))
    match[data.mounting[far][:, None] != data.mounting] = np.inf
    for i, j in _relabelled(far, match).items():
        if j is None:
            usable[i] = False
            text = (
                f"{_name(names, i)} stands {off[i] / DEG:.0f} degrees from where the jig was told "
                "to go; it was left out."
            )
            findings.append(Finding("bumped", text, (i,), size=float(off[i] / DEG)))
        else:
            angles[i] = data.angles[j]
    findings += _mislabelled(_relabelled(far, match), names)
    return Labels(angles, usable, tuple(findings))


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
class JigFaults:
    """Commanded angles with slips taken into account, poses whose servos count for nothing."""

    angles: FloatArray
    distrusted: BoolArray
    findings: tuple[Finding, ...]


def find_jig_faults(fit: JointFit, names: Sequence[str]) -> JigFaults:
    """Look for slips and bumps in a fit that gave the servos the freedom of `DISTRUST`."""
    data, p = fit.data, fit.state.common
    angles = data.angles.copy()
    free = ~locked(data)
    findings: list[Finding] = []
    lines = np.zeros((len(data), 3))
    for axis, name in enumerate(AXES):
        judged = np.ones(len(data), dtype=bool) if name == "tilt" else free
        y = fit.state.deviation[:, axis] + p[SERVO_GAIN][axis] * data.angles[:, axis]
        if name == "tilt":
            y = y + p[TILT_ZERO]
        line, step, at = _line_and_step(data.angles[:, axis], y, judged)
        lines[:, axis] = line
        if step is None:
            continue
        at = _slipped_from(fit, lines, axis, step, at, free)
        angles[at:, axis] += step
        lines[at:, axis] += step
        text = (
            f"The {name} servo slipped by {step / DEG:+.1f} degrees on the way to "
            f"{_name(names, at)} and stayed there; its angles were corrected from there on."
        )
        findings.append(Finding("slip", text, (at,), axis=name, size=float(step / DEG)))
    on_line = _on_line(fit, lines)
    off = _turn(fit.attitudes().A, on_line)
    spread = float(np.median(off)) / CHI3_MEDIAN
    bumped = off > max(BUMP_SIGMAS * spread, SMALLEST_BUMP)
    far = np.flatnonzero(off > max(BUMP_SIGMAS * spread, FAR_OFF))
    match = np.array([_turn(fit.attitudes().A[i], on_line) for i in far]).reshape(-1, len(data))
    match[data.mounting[far][:, None] != data.mounting] = np.inf
    fits = _relabelled(far, match)
    for i, j in fits.items():
        if j is not None:
            angles[i], bumped[i] = data.angles[j], False
    findings += _mislabelled(fits, names)
    for i in np.flatnonzero(bumped).tolist():
        text = (
            f"{_name(names, i)} stands {off[i] / DEG:.1f} degrees from where the servos put "
            "it, as if the plate was bumped there; its angles were not used."
        )
        findings.append(Finding("bumped", text, (i,), size=float(off[i] / DEG)))
    return JigFaults(angles, bumped, tuple(findings))


def _slipped_from(
    fit: JointFit, lines: FloatArray, axis: int, step: float, at: int, free: BoolArray
) -> int:
    """First pose that stands where the slip puts it, counting in those that could not be judged."""
    while at > 1 and not free[at - 1]:
        after = lines.copy()
        after[at - 1, axis] += step
        seen = fit.attitudes().A[at - 1]
        if _turn(seen, _on_line(fit, after)[at - 1]) > _turn(seen, _on_line(fit, lines)[at - 1]):
            break
        at -= 1
    return at


def locked(data: JointData) -> BoolArray:
    """Poses (m,) in which pan and roll turn about nearly the same axis."""
    return np.asarray(np.abs(np.cos(data.angles[:, 1])) < LOCKED)


def _on_line(fit: JointFit, lines: FloatArray) -> FloatArray:
    """Attitudes (m, 3, 3) of a jig whose servos err by ``lines`` (m, 3) only."""
    common = fit.state.common.copy()
    common[SERVO_GAIN] = 0.0
    common[TILT_ZERO] = 0.0
    still = np.zeros_like(fit.state.wobble)
    return attitudes(fit.data, replace(fit.state, common=common, deviation=lines, wobble=still)).A


def _turn(A: FloatArray, B: FloatArray) -> FloatArray:
    """Angle [rad] between attitudes (..., 3, 3)."""
    cosine = 0.5 * (np.sum(A * B, axis=(-2, -1)) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _line_and_step(
    x: FloatArray, y: FloatArray, judged: BoolArray
) -> tuple[FloatArray, float | None, int]:
    """Line through y(x), with the step that explains most; (m,), step or None, its pose.

    A servo errs anew whenever it is driven and stays as it is while the other axes move, so its
    errors are correlated from pose to pose. Steps and single poses that are off are taken up
    one by one, the most telling first: a bumped pose shall not look like half a slip.
    """
    driven = np.concatenate(([0], np.cumsum(np.abs(np.diff(x)) > 1e-9)))
    same = driven[:, None] == driven[None, :]
    noise = np.where(same, SERVO_SPREAD**2, 0.0) + POSE_SPREAD**2 * np.eye(len(x))
    keep = np.flatnonzero(judged)
    W = np.linalg.inv(np.linalg.cholesky(noise[np.ix_(keep, keep)]))
    late = (keep[:, None] >= keep[None, 1:]).astype(float)
    candidates = np.concatenate((late, np.eye(len(keep))), axis=1)
    chosen: list[int] = []
    D = W @ np.stack((np.ones(len(keep)), x[keep]), axis=1)
    target, trial = W @ y[keep], W @ candidates
    for _ in range(MOST_STEPS):
        residual = target - D @ _ridge(D, target)
        free = trial - D @ _ridge(D, trial)
        size = np.sum(free * trial, axis=0)
        gain = np.where(size > 1e-6, (free.T @ residual) ** 2 / np.maximum(size, 1e-6), 0.0)
        gain[chosen] = 0.0
        best = int(np.argmax(gain))
        with_it = np.column_stack((D, trial[:, best]))
        # What is left then tells how well this jig repeats, worse than usual perhaps.
        left = np.abs(target - with_it @ _ridge(with_it, target))
        spread = max(1.0, float(np.median(left)) / NORMAL_MEDIAN)
        if gain[best] < SLIP_GAIN * spread**2:
            break
        chosen.append(best)
        D = with_it
    p = _ridge(D, target)
    line = p[0] + p[1] * x
    steps = [(abs(p[2 + i]), i) for i, c in enumerate(chosen) if c < len(keep) - 1]
    if not steps or max(steps)[0] < SMALLEST_SLIP:
        return line, None, 0
    i = max(steps)[1]
    return line, float(p[2 + i]), int(keep[chosen[i] + 1])


def _ridge(D: FloatArray, y: FloatArray) -> FloatArray:
    """Least squares with a servo's usual gain error as prior of the second column."""
    prior = np.zeros(D.shape[1])
    prior[1] = 1.0 / USUAL_GAIN**2
    return np.asarray(np.linalg.solve(D.T @ D + np.diag(prior + 1e-12), D.T @ y))


def _name(names: Sequence[str], i: int) -> str:
    name = names[i]
    return name[0].upper() + name[1:] if name.startswith("pose") else f"Pose {name}"


def _angle(u: FloatArray, v: FloatArray) -> FloatArray:
    across = np.linalg.norm(np.cross(u, v), axis=-1)
    return np.asarray(np.arctan2(across, np.sum(u * v, axis=-1)))
