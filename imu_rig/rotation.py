"""Rotations, vectorized: scalar-first quaternions ``[w, x, y, z]``, body to navigation.

``v_nav = rotate(q, v_body)``; ``multiply(p, q)`` applies ``q`` first. Leading axes broadcast.
"""

import numpy as np

from imu_rig.arrays import FloatArray


def multiply(p: FloatArray, q: FloatArray) -> FloatArray:
    """Hamilton product ``p ⊗ q`` of quaternions, shapes (..., 4)."""
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    return np.stack(
        (
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ),
        axis=-1,
    )


def conjugate(q: FloatArray) -> FloatArray:
    """Inverse of unit quaternions, shape (..., 4)."""
    inverse: FloatArray = q * np.array([1.0, -1.0, -1.0, -1.0])
    return inverse


def normalize(q: FloatArray) -> FloatArray:
    """Scale quaternions to unit norm, shape (..., 4)."""
    unit: FloatArray = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return unit


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Rotate vectors (..., 3) by unit quaternions (..., 4)."""
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def from_rotation_vector(theta: FloatArray) -> FloatArray:
    """Quaternion of rotation vectors ``theta`` [rad], shape (..., 3) to (..., 4)."""
    angle = np.linalg.norm(theta, axis=-1, keepdims=True)
    return np.concatenate((np.cos(angle / 2), theta * (0.5 * np.sinc(angle / (2 * np.pi)))), -1)


def to_rotation_vector(q: FloatArray) -> FloatArray:
    """Rotation vector [rad] of unit quaternions, the short way (angle at most pi)."""
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    small = sine < 1e-12
    return q[..., 1:] * np.where(small, 2.0, angle / np.where(small, 1.0, sine))


def compose(q: FloatArray) -> FloatArray:
    """Product ``q[..., 0, :] ⊗ q[..., 1, :] ⊗ ...`` over the second last axis, as a pairwise tree.

    With ``q`` the small body rotations of consecutive samples (shape (..., n, 4), n at least 1),
    the result is the rotation from the last body frame to the first. The tree takes log2(n)
    vectorized products where a loop would take n.
    """
    while q.shape[-2] > 1:
        even = multiply(q[..., 0:-1:2, :], q[..., 1::2, :])
        q = np.concatenate((even, q[..., -1:, :]), -2) if q.shape[-2] % 2 else even
    return q[..., 0, :]


def to_matrix(q: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) with ``v_nav = R @ v_body`` of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def vector_of_matrix(R: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3), angles well below pi."""
    twice = np.stack(
        (
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ),
        axis=-1,
    )
    sine = 0.5 * np.linalg.norm(twice, axis=-1)
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    stretch = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-12), 1.0)
    return np.asarray(0.5 * twice * stretch[..., None])


def about_x(angle: FloatArray | float) -> FloatArray:
    """Rotation matrices (..., 3, 3) about x by ``angle`` [rad]."""
    return _about_axis(angle, 0)


def about_y(angle: FloatArray | float) -> FloatArray:
    """Rotation matrices (..., 3, 3) about y by ``angle`` [rad]."""
    return _about_axis(angle, 1)


def about_z(angle: FloatArray | float) -> FloatArray:
    """Rotation matrices (..., 3, 3) about z by ``angle`` [rad]."""
    return _about_axis(angle, 2)


def _about_axis(angle: FloatArray | float, axis: int) -> FloatArray:
    angles = np.asarray(angle, dtype=float)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*angles.shape, 3, 3))
    matrix[..., axis, axis] = 1.0
    matrix[..., first, first] = matrix[..., second, second] = np.cos(angles)
    matrix[..., second, first] = np.sin(angles)
    matrix[..., first, second] = -np.sin(angles)
    return matrix


def euler_angles(q: FloatArray) -> FloatArray:
    """Roll, pitch and yaw [rad] of unit quaternions, shape (..., 4) to (..., 3).

    The attitude is a turn by yaw about z, then by pitch about the new y, then by roll about the
    newest x. Pitch lies within a quarter turn of level; near there roll and yaw are one.
    """
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack(
        (
            np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            np.arcsin(np.clip(2 * (w * y - x * z), -1.0, 1.0)),
            np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        ),
        axis=-1,
    )


def skew(v: FloatArray) -> FloatArray:
    """Matrices ``[v]x`` (..., 3, 3) with ``skew(v) @ u = v x u``."""
    zero = np.zeros_like(v[..., 0])
    x, y, z = np.moveaxis(v, -1, 0)
    return np.stack(
        (
            np.stack((zero, -z, y), -1),
            np.stack((z, zero, -x), -1),
            np.stack((-y, x, zero), -1),
        ),
        axis=-2,
    )
