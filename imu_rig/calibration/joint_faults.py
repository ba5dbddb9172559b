"""Finds what is wrong with a jig session: wrong labels, servos that slipped, bumped poses.

Such faults hardly touch the sensor's parameters, for these rest on gravity's magnitude and the
gyroscope; but they spoil the jig's frame, and a person should know. So the jig is first
given no more trust than `DISTRUST`, and what its axes then did is judged axis by axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import BoolArray, FloatArray
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
OTHER_LABEL = 6.0 * DEG
"""Angle within which gravity fits the label of another pose."""
AXES = ("pan", "tilt", "roll")
LOCKED = 0.3
"""Cosine of tilt below which pan and roll turn about nearly the same axis."""
SERVO_SPREAD = 0.5 * DEG
"""Repeatability that a slip is weighed against."""
TRUNCATED = 9.0
"""Largest cost of one pose, in squared repeatabilities: an outlier counts no more than this."""
SLIP_GAIN = 40.0
"""Drop of the cost that makes a step a slip."""
SMALLEST_SLIP = 1.5 * DEG
BUMP_SIGMAS = 5.0
"""Deviation of a pose, in the typical one per axis, that no servo makes once in ten thousand poses
(chi with three degrees of freedom)."""
SMALLEST_BUMP = 3.5 * DEG
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
    suspects = [int(i) for i in np.flatnonzero(off > limit)]
    fits = {i: _other_label(i, seen, told, data) for i in suspects}
    for i in suspects:
        j = fits[i]
        if j is None:
            usable[i] = False
            text = (
                f"{_name(names, i)} stands {off[i] / DEG:.0f} degrees from where the jig was told "
                "to go; it was left out."
            )
            findings.append(Finding("bumped", text, (i,), size=float(off[i] / DEG)))
            continue
        angles[i] = data.angles[j]
        if fits.get(j) == i:
            if i < j:
                text = (
                    f"{_name(names, i)} and {_name(names, j)} carry each other's angles; they were "
                    "exchanged."
                )
                findings.append(Finding("mislabelled", text, (i, j)))
        else:
            text = (
                f"{_name(names, i)} stands where {_name(names, j)} should; the angles of that pose "
                "were taken."
            )
            findings.append(Finding("mislabelled", text, (i, j)))
    return Labels(angles, usable, tuple(findings))


def _other_label(i: int, seen: FloatArray, told: FloatArray, data: JointData) -> int | None:
    off = _angle(seen[i], told)
    off[i] = np.inf
    off[data.mounting != data.mounting[i]] = np.inf
    j = int(np.argmin(off))
    return j if off[j] < OTHER_LABEL else None


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
    free = np.abs(np.cos(data.angles[:, 1])) > LOCKED
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
        angles[at:, axis] += step
        lines[at:, axis] += step
        text = (
            f"The {name} servo slipped by {step / DEG:+.1f} degrees on the way to "
            f"{_name(names, at)} and stayed there; its angles were corrected from there on."
        )
        findings.append(Finding("slip", text, (at,), axis=name, size=float(step / DEG)))
    off = np.linalg.norm(_deviation(fit, lines), axis=1)
    spread = float(np.median(off)) / CHI3_MEDIAN
    bumped = off > max(BUMP_SIGMAS * spread, SMALLEST_BUMP)
    for i in np.flatnonzero(bumped):
        text = (
            f"{_name(names, int(i))} stands {off[i] / DEG:.1f} degrees from where the servos put "
            "it, as if the plate was bumped there; its angles were not used."
        )
        findings.append(Finding("bumped", text, (int(i),), size=float(off[i] / DEG)))
    return JigFaults(angles, bumped, tuple(findings))


def _deviation(fit: JointFit, lines: FloatArray) -> FloatArray:
    """Rotation vectors (m, 3) from what servos on their lines would do to what was."""
    common = fit.state.common.copy()
    common[SERVO_GAIN] = 0.0
    common[TILT_ZERO] = 0.0
    on_line = replace(
        fit.state, common=common, deviation=lines, wobble=np.zeros_like(fit.state.wobble)
    )
    A, B = attitudes(fit.data, on_line).A, fit.attitudes().A
    turn = np.swapaxes(A, 1, 2) @ B
    return rotation.vector_of_matrix(turn)


def _line_and_step(
    x: FloatArray, y: FloatArray, judged: BoolArray
) -> tuple[FloatArray, float | None, int]:
    """Robust line through y(x), with the step that explains most; (m,), step or None, its pose."""
    rows = np.flatnonzero(judged)
    ones = np.ones(len(x))
    plain = np.stack((ones, x), axis=1)
    best, cost = _robust(plain, y, judged)
    start = float(cost)
    found: tuple[FloatArray, int] | None = None
    for k in rows[1:]:
        late = (np.arange(len(x)) >= k).astype(float)
        trial, tried = _robust(np.column_stack((plain, late)), y, judged)
        if tried < cost - 1e-9:
            cost, found = tried, (trial, int(k))
    if found is None or start - cost < SLIP_GAIN or abs(found[0][2]) < SMALLEST_SLIP:
        return plain @ best, None, 0
    return plain @ found[0][:2], float(found[0][2]), found[1]


def _robust(D: FloatArray, y: FloatArray, judged: BoolArray) -> tuple[FloatArray, float]:
    """Least truncated squares by reweighting; singular directions stay at zero."""
    weight = judged.astype(float)
    ridge = 1e-9 * np.eye(D.shape[1])
    p = np.zeros(D.shape[1])
    for _ in range(6):
        W = D * weight[:, None]
        p = np.linalg.solve(D.T @ W + ridge, W.T @ y)
        square = ((y - D @ p) / SERVO_SPREAD) ** 2
        weight = judged / (1.0 + square / TRUNCATED) ** 2
    square = ((y - D @ p)[judged] / SERVO_SPREAD) ** 2
    return p, float(np.sum(np.minimum(square, TRUNCATED)))


def _name(names: Sequence[str], i: int) -> str:
    name = names[i]
    return name[0].upper() + name[1:] if name.startswith("pose") else f"Pose {name}"


def _angle(u: FloatArray, v: FloatArray) -> FloatArray:
    across = np.linalg.norm(np.cross(u, v), axis=-1)
    return np.asarray(np.arctan2(across, np.sum(u * v, axis=-1)))
