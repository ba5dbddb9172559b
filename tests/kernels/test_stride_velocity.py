"""What a strapdown integration leaves at the end of strides, by each way of reading the gyro."""

import numpy as np

from imu_rig.kernels.stride_velocity import stride_velocities
from imu_rig.rotation import from_rotation_vector, multiply, rotate

GRAVITY = 9.8


def test_a_right_reading_leaves_what_was_gained_and_a_wrong_one_does_not():
    """A sensor that turns and is accelerated, as a chain of small exact rotations says."""
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.002, 0.004, 400))
    rates = np.stack([a * np.sin(f * t) for a, f in ((3.0, 7.0), (5.0, 4.0), (2.0, 9.0))], axis=1)
    moved = np.stack([a * np.sin(f * t) for a, f in ((8.0, 6.0), (5.0, 8.0), (9.0, 5.0))], axis=1)
    dt = np.diff(t, prepend=t[0])
    q = np.empty((len(t), 4))
    up = np.array([0.3, -0.5, 0.8])
    up /= np.linalg.norm(up)
    w, x, y = 1.0 + up[2], up[1], -up[0]
    q[0] = np.array([w, x, y, 0.0]) / np.sqrt(w * w + x * x + y * y)
    np.testing.assert_allclose(rotate(q[0], up), [0.0, 0.0, 1.0], atol=1e-12)
    for k in range(1, len(t)):
        step = 0.5 * (rates[k] + rates[k - 1]) * dt[k]
        q[k] = multiply(q[k - 1], from_rotation_vector(step))
    force = rotate(q * [1, -1, -1, -1], moved + np.array([0.0, 0.0, GRAVITY]))
    axes = np.stack((np.eye(3), np.diag([1.0, -1.0, 1.0]), np.eye(3)[[1, 0, 2]]))
    first, last = np.array([0]), np.array([len(t) - 1])
    left = stride_velocities(dt, rates, force, first, last, GRAVITY * up[np.newaxis], GRAVITY, axes)
    gained = np.sum(0.5 * (moved[1:] + moved[:-1]) * dt[1:, np.newaxis], axis=0)
    assert left.shape == (3, 1, 3)
    np.testing.assert_allclose(left[0, 0], gained, atol=0.01)
    assert np.linalg.norm(left[1:, 0] - gained, axis=1).min() > 1.0


def test_upside_down_is_no_special_case():
    still = np.tile([0.0, 0.0, -GRAVITY], (50, 1))
    ends = np.array([0]), np.array([49])
    left = stride_velocities(
        np.full(50, 0.01), np.zeros((50, 3)), still, *ends, still[:1], GRAVITY, np.eye(3)[None]
    )
    np.testing.assert_allclose(left, 0.0, atol=1e-9)
