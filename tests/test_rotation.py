"""Rotations: agreement of the forms, the direction they turn, the tree against the loop."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imu_rig import rotation

seeds = st.integers(0, 2**32 - 1)


def some(seed: int, n: int, size: float = 3.0) -> np.ndarray:
    direction = np.random.default_rng(seed).standard_normal((n, 3))
    angle = np.random.default_rng(seed + 1).uniform(0, size, (n, 1))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True) * angle


@given(seeds)
def test_quaternion_matrix_and_vector_turn_alike(seed: int) -> None:
    theta, v = some(seed, 5), some(seed + 7, 5)
    q = rotation.from_rotation_vector(theta)
    by_matrix = np.einsum("nij,nj->ni", rotation.to_matrix(q), v)
    assert rotation.rotate(q, v) == pytest.approx(by_matrix, abs=1e-12)
    assert rotation.to_rotation_vector(q) == pytest.approx(theta, abs=1e-9)
    assert rotation.rotate(rotation.conjugate(q), rotation.rotate(q, v)) == pytest.approx(v)


@given(seeds)
def test_the_product_applies_its_right_factor_first(seed: int) -> None:
    p, q = rotation.from_rotation_vector(some(seed, 2))
    v = some(seed + 3, 1)[0]
    assert rotation.rotate(rotation.multiply(p, q), v) == pytest.approx(
        rotation.rotate(p, rotation.rotate(q, v))
    )


@given(seeds, st.integers(1, 70))
def test_the_tree_is_the_loop(seed: int, n: int) -> None:
    q = rotation.from_rotation_vector(some(seed, n, size=0.2))
    product = q[0]
    for one in q[1:]:
        product = rotation.multiply(product, one)
    assert rotation.compose(q) == pytest.approx(product, abs=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_axis_matrices_follow_the_right_hand(axis: int) -> None:
    turn = (rotation.about_x, rotation.about_y, rotation.about_z)[axis]
    unit = np.eye(3)
    assert turn(np.pi / 2) @ unit[(axis + 1) % 3] == pytest.approx(unit[(axis + 2) % 3])
    angles = np.array([-2.0, 0.0, 0.5])
    vectors = angles[:, None] * unit[axis]
    expected = rotation.to_matrix(rotation.from_rotation_vector(vectors))
    assert turn(angles) == pytest.approx(expected, abs=1e-12)


def test_tiny_and_half_turns_keep_their_vector() -> None:
    for theta in ([0, 0, 0], [1e-13, 0, 0], [0, np.pi - 1e-7, 0]):
        q = rotation.from_rotation_vector(np.array(theta, dtype=float))
        assert rotation.to_rotation_vector(q) == pytest.approx(theta, abs=1e-9)


def test_skew_is_the_cross_product() -> None:
    u, v = some(3, 4), some(5, 4)
    assert np.einsum("nij,nj->ni", rotation.skew(u), v) == pytest.approx(np.cross(u, v))


def test_euler_angles_are_turns_about_z_then_y_then_x() -> None:
    angles = np.array([[0.1, -0.2, 3.0], [-3.0, 1.5, -0.4], [0.0, 0.0, 0.0]])
    R = rotation.about_z(angles[:, 2]) @ rotation.about_y(angles[:, 1])
    q = rotation.from_rotation_vector(rotation.vector_of_matrix(R @ rotation.about_x(angles[:, 0])))
    assert rotation.euler_angles(q) == pytest.approx(angles, abs=1e-9)
