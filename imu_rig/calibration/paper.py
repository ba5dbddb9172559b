"""The solver of the jig paper, equations (5) and (6): commanded angles taken for the truth.

It is the reference the others are compared with. A servo's gain error goes straight into the
gyroscope's gain here, and its angle error into everything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.model import AXES, PARAMETERS, Affine
from imu_rig.errors import DataError

Model = Literal["full", "diagonal"]
WORST_CONDITION = 1e6


@dataclass(frozen=True, eq=False)
class PaperFit:
    """A linear least-squares fit.

    Attributes
    ----------
    affine : Affine
        K (full or diagonal) and b, covariance from the residuals.
    residual : shape (n, 3)
        ``K @ u - b * T - known`` in the unit of what was known (m/s^2 or rad).
    """

    affine: Affine
    residual: FloatArray


def paper_accelerometer(means: FloatArray, gravity: FloatArray, model: Model = "full") -> PaperFit:
    """Fit equation (5): minimize ``sum |g_i - (K u_i - o)|^2`` over K and o.

    Parameters
    ----------
    means : shape (n, 3)
        Mean raw specific force of each pose [m/s^2].
    gravity : shape (n, 3)
        Known gravity reaction in sensor axes, ``[0, 0, +g]`` turned by the commanded angles.
    model : {"full", "diagonal"}
        Nine gains or three.

    Raises
    ------
    DataError
        Poses that do not determine the parameters.
    """
    return _solve(means, np.ones(len(means)), gravity, model, "poses")


def paper_gyroscope(
    turns: FloatArray, durations: FloatArray, theta: FloatArray, model: Model = "full"
) -> PaperFit:
    """Fit equation (6) for turns about one fixed axis each: ``theta_j = K sum(w dt) - o T_j``.

    Parameters
    ----------
    turns : shape (n, 3)
        Raw rate integrated over each turn by the measured time stamps [rad].
    durations : shape (n,)
        Length of each turn [s].
    theta : shape (n, 3)
        Known rotation vector in sensor axes [rad].
    model : {"full", "diagonal"}
        Nine gains or three.

    Raises
    ------
    DataError
        Turns that do not determine the parameters.
    """
    return _solve(turns, durations, theta, model, "turns")


def integrated_turn(t: FloatArray, gyro: FloatArray) -> tuple[FloatArray, float]:
    """Integral of the raw rate (3,) over samples (n, 3) at ``t`` (n,), and the time they span.

    Trapezoids over the measured time stamps; a recording that averages the rate over each sample
    interval gives the same sum when the sensor rests at both ends.
    """
    steps = np.diff(t)
    return np.asarray(0.5 * (gyro[1:] + gyro[:-1]).T @ steps), float(t[-1] - t[0])


def _solve(
    u: FloatArray, duration: FloatArray, known: FloatArray, model: Model, what: str
) -> PaperFit:
    diagonal = model == "diagonal"
    unknowns = 2 if diagonal else 4
    if len(u) <= unknowns:
        raise DataError(
            f"{len(u)} {what} cannot determine {unknowns} parameters per axis and their "
            f"uncertainty; add {unknowns + 1 - len(u)} {what} or more"
        )
    K, b = np.zeros((3, 3)), np.zeros(3)
    blocks = []
    columns = []
    for axis in range(3):
        used = [axis] if diagonal else [0, 1, 2]
        A = np.column_stack((u[:, used], -duration))
        inverse = _inverse(A, axis, what)
        if not np.any(np.abs(known[:, axis]) > 1e-6 * np.abs(known).max()):
            raise DataError(_undetermined(axis, what))
        x = inverse @ (A.T @ known[:, axis])
        K[axis, used], b[axis] = x[:-1], x[-1]
        columns.append([3 * axis + j for j in used] + [9 + axis])
        blocks.append((A, inverse))
    residual = u @ K.T - duration[:, None] * b - known
    dof = len(u) - unknowns
    covariance = np.zeros((PARAMETERS, PARAMETERS))
    noise = residual.T @ residual / dof
    for i, (A, inverse) in enumerate(blocks):
        for j, (B, other) in enumerate(blocks):
            covariance[np.ix_(columns[i], columns[j])] = noise[i, j] * inverse @ (A.T @ B) @ other
    return PaperFit(Affine(K, b, covariance, dof=float(dof)), residual)


def _inverse(A: FloatArray, axis: int, what: str) -> FloatArray:
    scale = np.linalg.norm(A, axis=0)
    singular = np.linalg.svd(A / np.where(scale > 0, scale, 1.0), compute_uv=False)
    if np.any(scale == 0) or singular[-1] * WORST_CONDITION < singular[0]:
        raise DataError(_undetermined(axis, what))
    return np.asarray(np.linalg.inv(A.T @ A))


def _undetermined(axis: int, what: str) -> str:
    return (
        f"the {what} do not determine the {AXES[axis]} axis: they must point or turn along all "
        "three axes, both ways"
    )
