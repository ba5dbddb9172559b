"""Accelerometer from six faces: gravity's magnitude for scale and bias, the faces for the lean.

Opposite faces give scale and bias by the magnitude of gravity, however badly the block stands.
The lean between the axes shows only as far as the faces stand level and the block is square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.calibration.magnitude import FLICKER, UPPER, full_covariance, unpack
from imu_rig.calibration.model import Affine
from imu_rig.units import DEG, MILLI_G

PLACEMENT = 0.5 * DEG
"""How level a face placed by hand is assumed to stand, per axis [rad]; the faces judge it too."""
SQUARENESS = 0.5 * DEG
"""How square the block is assumed to be, per pair of faces and axis [rad]; nothing shows it."""
REPEATABILITY = 0.5 * MILLI_G
"""Scatter of gravity's magnitude from one placement to the next [m/s^2], unless faces repeat."""
PRIOR_DOF = 4.0
"""Weight of these assumptions against what the faces show."""
LEAST_PLACEMENT = 0.1 * DEG
"""Better than any hand and table."""


@dataclass(frozen=True, eq=False)
class FaceFit:
    """An accelerometer fitted to ``m`` placements on six faces.

    Attributes
    ----------
    affine : Affine
        K upper triangular.
    sigma : shape (m,)
        Standard uncertainty of each mean along gravity [m/s^2].
    placement : float
        Standard deviation of the tilt of a placed face, per axis [rad].
    tilts : shape (m, 2)
        Tilt of each placement against the block [rad].
    """

    affine: Affine
    sigma: FloatArray
    placement: float
    tilts: FloatArray


def fit_faces(
    means: FloatArray, covs: FloatArray, axis: IntArray, sign: FloatArray, gravity: float
) -> FaceFit:
    """Fit scale, lean and bias.

    Parameters
    ----------
    means : shape (m, 3)
        Raw mean specific force; every one of the six faces at least once.
    covs : shape (m, 3, 3)
        Covariances of the means.
    axis, sign : shape (m,)
        The axis that is vertical, 0 to 2, and whether it reads gravity upward.
    gravity : float
        Magnitude of gravity [m/s^2].
    """
    m = len(means)
    across = np.array([[a for a in range(3) if a != k] for k in axis])
    p = np.concatenate((np.eye(3)[UPPER], np.zeros(3)))
    R = np.eye(3)
    radial_scale, placement = 1.0, PLACEMENT
    for _ in range(12):
        T, o = unpack(p)
        c = means @ T.T - o
        size = np.linalg.norm(c, axis=1)
        seen = (c / size[:, None]) @ T
        noise = np.einsum("mi,mij,mj->m", seen, covs, seen) + FLICKER**2 + REPEATABILITY**2
        y = c @ R
        tilt = np.take_along_axis(y, across, axis=1)
        J = _slopes(means, c / size[:, None], y, R, across)
        r = np.concatenate((size - gravity, tilt.ravel()))
        sigma = np.concatenate((radial_scale * np.sqrt(noise), np.full(2 * m, placement * gravity)))
        W = J / sigma[:, None]
        C = np.linalg.inv(W.T @ W)
        step = -C @ (W.T @ (r / sigma))
        p = p + step[:9]
        R = R @ rotation.to_matrix(rotation.from_rotation_vector(step[9:]))
        radial = (r + J @ step)[:m] ** 2 / noise
        radial_scale = float(np.sqrt((PRIOR_DOF + radial.sum()) / (PRIOR_DOF + max(m - 6, 0))))
        square = float(np.sum(((r + J @ step)[m:] / gravity) ** 2))
        own = (PRIOR_DOF * PLACEMENT**2 + square) / (PRIOR_DOF + max(2 * m - 6, 0))
        placement = max(float(np.sqrt(own)), LEAST_PLACEMENT)
    gain = C @ (W.T / sigma)
    C = C + gain @ _block_shape(axis, sign, across, gravity) @ gain.T
    affine = Affine(*unpack(p), full_covariance(C[:9, :9]), dof=PRIOR_DOF + max(m - 6, 0) + 4.0)
    return FaceFit(affine, radial_scale * np.sqrt(noise), placement, tilt / gravity)


def _slopes(
    means: FloatArray, up: FloatArray, y: FloatArray, R: FloatArray, across: IntArray
) -> FloatArray:
    """Differentiate magnitudes and tilts (3 m, 12) by T, o and the block's rotation."""
    m = len(means)
    dc = np.zeros((m, 3, 12))
    dc[:, UPPER[0], range(6)] = means[:, UPPER[1]]
    dc[:, range(3), range(6, 9)] = -1.0
    radial = np.einsum("mi,mij->mj", up, dc)
    turned = np.einsum("ik,mij->mkj", R, dc)
    turned[:, :, 9:] = rotation.skew(y)
    tilts = np.take_along_axis(turned, across[:, :, None], axis=1)
    return np.concatenate((radial, tilts.reshape(2 * m, 12)))


def _block_shape(axis: IntArray, sign: FloatArray, across: IntArray, gravity: float) -> FloatArray:
    """Covariance (3 m, 3 m) from a block that is not square: alike for the faces of a pair."""
    m = len(axis)
    kind = (3 * axis[:, None] + across).ravel()
    s = np.repeat(sign, 2)
    C = np.zeros((3 * m, 3 * m))
    C[m:, m:] = (kind[:, None] == kind[None, :]) * np.outer(s, s) * (SQUARENESS * gravity) ** 2
    return C


def faces_of(means: FloatArray, widest: float) -> tuple[IntArray, FloatArray, BoolArray]:
    """Nearest axis (m,), its sign (m,), and whether it is within ``widest`` [rad]."""
    up = means / np.linalg.norm(means, axis=1, keepdims=True)
    axis = np.argmax(np.abs(up), axis=1)
    along = np.take_along_axis(up, axis[:, None], axis=1)[:, 0]
    return axis, np.sign(along), np.asarray(np.abs(along) > np.cos(widest))
