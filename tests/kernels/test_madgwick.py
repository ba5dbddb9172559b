"""The gradient descent follows turns exactly and finds up, and north, at the speed it is given."""

import numpy as np
import pytest

from imu_rig.kernels.madgwick import gradient_descent
from imu_rig.rotation import (
    compose,
    conjugate,
    from_rotation_vector,
    multiply,
    normalize,
    rotate,
    to_rotation_vector,
)

NONE = np.empty((0, 3))
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
UP = np.array([0.0, 0.0, 9.8])


def at_rest(n, attitude, mag=None):
    accel = np.tile(rotate(conjugate(attitude), UP), (n, 1))
    field = NONE if mag is None else np.tile(rotate(conjugate(attitude), mag), (n, 1))
    return 0.01 * np.arange(n), accel, np.zeros((n, 3)), field


def angle_between(p, q):
    return np.linalg.norm(to_rotation_vector(multiply(conjugate(p), q)), axis=-1)


def test_without_correction_it_is_the_product_of_the_turns():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.0, 0.02, 200))
    t[50:53] = t[50]
    gyro = rng.normal(0.0, 5.0, (200, 3))
    found = gradient_descent(t, np.tile(UP, (200, 1)), gyro, NONE, LEVEL, 0.0)
    turns = from_rotation_vector(0.5 * np.diff(t)[:, None] * (gyro[1:] + gyro[:-1]))
    assert angle_between(found[-1], compose(turns)) < 1e-9
    assert np.array_equal(found[50], found[52])


def test_a_wrong_tilt_goes_at_twice_the_gain_and_stops_at_the_bottom():
    t, accel, gyro, _ = at_rest(400, LEVEL)
    wrong = from_rotation_vector(np.array([0.2, -0.1, 0.0]))
    found = gradient_descent(t, accel, gyro, NONE, wrong, 0.05)
    tilt = np.arccos(np.clip(rotate(found, np.array([0.0, 0.0, 1.0]))[:, 2], -1.0, 1.0))
    speed = np.diff(tilt) / np.diff(t)
    assert np.allclose(speed[:150], -0.1, rtol=0.03)
    assert (speed < 1e-4).all()
    assert tilt[-1] < 1e-6  # a step of constant length would dither by gain times dt


def test_a_gap_does_not_overshoot():
    t, accel, gyro, _ = at_rest(3, LEVEL)
    t[2] = 60.0
    wrong = from_rotation_vector(np.array([0.1, 0.0, 0.0]))
    found = gradient_descent(t, accel, gyro, NONE, wrong, 0.1)
    assert angle_between(found[2], LEVEL) < 1e-3


def test_it_follows_the_published_step_where_steps_are_fine():
    """Against the paper's Euler step down its cost on unit quaternions, by differences."""
    rng = np.random.default_rng(3)
    n, gain = 500, 0.2
    t = 4e-4 * np.arange(n)
    rate = np.array([1.0, -2.0, 0.5])
    accel = np.tile(UP, (n, 1)) + rng.normal(0.0, 0.5, 3)
    field = np.tile(rng.normal(0.0, 1.0, 3), (n, 1))
    start = from_rotation_vector(np.array([0.3, 0.2, -0.4]))

    def cost(q, a, m):
        b = rotate(normalize(q_now), m)
        b = np.array([np.hypot(b[0], b[1]), 0.0, b[2]])

        def turned(v):  # without normalizing, as in the paper
            w, x, y, z = q
            return np.array(
                [
                    2 * v[0] * (0.5 - y * y - z * z)
                    + 2 * v[1] * (w * z + x * y)
                    + 2 * v[2] * (x * z - w * y),
                    2 * v[0] * (x * y - w * z)
                    + 2 * v[1] * (0.5 - x * x - z * z)
                    + 2 * v[2] * (w * x + y * z),
                    2 * v[0] * (w * y + x * z)
                    + 2 * v[1] * (y * z - w * x)
                    + 2 * v[2] * (0.5 - x * x - y * y),
                ]
            )

        up = turned(np.array([0.0, 0.0, 1.0])) - a
        north = turned(b) - m
        return 0.5 * (up @ up + north @ north)

    q = q_now = start
    a, m = accel[0] / np.linalg.norm(accel[0]), field[0] / np.linalg.norm(field[0])
    for _ in range(n - 1):
        q_now = q
        slope = np.array(
            [
                (cost(normalize(q + e), a, m) - cost(normalize(q - e), a, m)) / 2e-6
                for e in 1e-6 * np.eye(4)
            ]
        )
        turn = 0.5 * multiply(q, np.concatenate(([0.0], rate)))
        q = normalize(q + 4e-4 * (turn - gain * slope / np.linalg.norm(slope)))
    gyro = np.tile(rate, (n, 1))
    found = gradient_descent(t, accel, gyro, field, start, gain)
    assert angle_between(found[-1], q) < 2e-3
    assert angle_between(found[-1], gradient_descent(t, accel, gyro, field, start, 0.0)[-1]) > 0.02


def test_with_a_field_x_turns_to_its_north():
    heading = from_rotation_vector(np.array([0.0, 0.0, 0.7]))
    t, accel, gyro, field = at_rest(3000, heading, np.array([20.0, 0.0, -45.0]))
    found = gradient_descent(t, accel, gyro, field, LEVEL, 0.05)
    assert angle_between(found[-1], heading) < 0.01
    field[:] = np.nan  # as good as none
    assert np.allclose(gradient_descent(t, accel, gyro, field, LEVEL, 0.05)[-1], LEVEL)


@pytest.mark.parametrize("bias", [0.5, 2.0])
def test_it_makes_up_for_a_bias_of_less_than_twice_the_gain(bias):
    n, gain = 6000, 0.02
    t, accel, gyro, _ = at_rest(n, LEVEL)
    gyro[:, 0] = 2.0 * gain * bias
    tilt = rotate(gradient_descent(t, accel, gyro, NONE, LEVEL, gain), np.array([0.0, 0.0, 1.0]))
    astray = np.degrees(np.arccos(np.clip(tilt[:, 2], -1.0, 1.0))).max()
    assert (astray < 0.5) == (bias < 1.0)
