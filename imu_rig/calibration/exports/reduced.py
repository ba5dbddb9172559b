"""The nearest calibration that a format without all nine gains can hold, and what is lost by it.

The sensor reads ``raw = S @ (input + b)`` with ``S = inverse(K)``. A reduced calibration
``M @ (raw - offset)`` gives ``(M @ S) @ (input + b) - M @ offset``: with ``offset = S @ b`` the
input zero reads zero, and ``M @ S - 1`` is what remains. M minimizes its effect over all
directions of the input, ``|M @ S - 1|`` (Frobenius), among the matrices of its form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.model import Affine


@dataclass(frozen=True, eq=False)
class Reduced:
    """``calibrated = M @ (raw - offset)`` with an M of restricted form.

    Attributes
    ----------
    M : shape (3, 3)
        Gain.
    offset : shape (3,)
        Raw reading at zero input.
    """

    M: FloatArray
    offset: FloatArray

    def apply(self, raw: FloatArray) -> FloatArray:
        """Calibrate readings (..., 3) as the target will."""
        calibrated: FloatArray = (raw - self.offset) @ self.M.T
        return calibrated

    def worst_error(self, exact: Affine, size: float) -> float:
        """Largest length of the error against ``exact`` over all inputs of one size.

        It is the exact maximum where zero input reads zero, and an upper bound elsewhere.
        """
        S = np.linalg.inv(exact.K)
        left = np.linalg.norm(self.M @ S - np.eye(3), 2) * size
        return float(left + np.linalg.norm(self.M @ (S @ exact.b - self.offset)))


def untouched() -> Reduced:
    """Return the calibration that changes nothing."""
    return Reduced(np.eye(3), np.zeros(3))


def offset_only(affine: Affine) -> Reduced:
    """Return the offset alone, for a format without gains."""
    return Reduced(np.eye(3), _zero_reading(affine))


def diagonal(affine: Affine) -> Reduced:
    """Return the diagonal M that comes nearest over all directions.

    Row i of ``M @ S - 1`` is ``M[i, i] * S[i] - e_i``, least where M[i, i] is the projection of
    e_i on S[i]. That is neither the diagonal of K nor the inverse of a gain.
    """
    S = np.linalg.inv(affine.K)
    return Reduced(np.diag(np.diag(S) / np.sum(S**2, axis=1)), _zero_reading(affine))


def symmetric(affine: Affine) -> Reduced:
    """Return the symmetric M that comes nearest over all directions.

    The gradient of ``|M @ S - 1|^2`` among symmetric M vanishes where
    ``M @ W + W @ M = S + S.T`` with ``W = S @ S.T``: in the axes of W, a division by sums of its
    eigenvalues.
    """
    S = np.linalg.inv(affine.K)
    w, V = np.linalg.eigh(S @ S.T)
    M = V @ ((V.T @ (S + S.T) @ V) / (w[:, None] + w)) @ V.T
    return Reduced((M + M.T) / 2.0, _zero_reading(affine))


def _zero_reading(affine: Affine) -> FloatArray:
    return np.asarray(np.linalg.solve(affine.K, affine.b), dtype=float)
