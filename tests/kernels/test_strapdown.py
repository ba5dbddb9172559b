"""Strapdown on known motion: rotations exact, and errors that shrink with the step as they must."""

from __future__ import annotations

import numpy as np
import pytest
from foot_motion import MODEL

from imu_rig import rotation
from imu_rig.arrays import FloatArray
from imu_rig.kernels.foot_filter import smooth_foot_states
from imu_rig.kernels.foot_types import FootInputs
from imu_rig.kernels.strapdown import exponential, integrated_rate

GRAVITY = np.array([0.0, 0.0, -MODEL.gravity])
CONE, NOD = 0.4, 12.0
"""Half angle [rad] and rate [rad/s] of an axis that goes round a cone."""


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.3, 0.4898, 0.4900, 1.0, 3.0])
def test_exponential_is_exact(angle):
    turn = angle * np.array([0.6, -0.48, 0.64])
    assert exponential.py_func(*turn) == pytest.approx(
        rotation.from_rotation_vector(turn), abs=5e-16, rel=0
    )


def coning(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return attitude (n, 4) and rate (n, 3) of a sensor whose axis goes round a cone.

    The classical test of attitude integration (P. G. Savage, J. Guidance 21, 1998): rates that
    oscillate about two axes make the sensor drift about the third.
    """
    zero = np.zeros_like(t)
    vector = CONE * np.stack((np.cos(NOD * t), np.sin(NOD * t), zero), -1)
    rate = NOD * np.stack(
        (
            -np.sin(CONE) * np.sin(NOD * t),
            np.sin(CONE) * np.cos(NOD * t),
            zero - (1.0 - np.cos(CONE)),
        ),
        -1,
    )
    return rotation.from_rotation_vector(vector), rate


def reckoned(rate: float, seconds: float = 4.0):
    """Return errors of tilt and heading [rad] and of position [m] after dead reckoning."""
    t = np.arange(int(seconds * rate) + 1) / rate
    q, w = coning(t)
    swing = np.stack((np.sin(3 * t), 0.5 * np.cos(2 * t), 0.2 * np.sin(5 * t)), -1)
    speed = np.stack((3 * np.cos(3 * t), -np.sin(2 * t), np.cos(5 * t)), -1)
    change = np.stack((-9 * np.sin(3 * t), -2 * np.cos(2 * t), -5 * np.sin(5 * t)), -1)
    force = rotation.rotate(rotation.conjugate(q), change - GRAVITY)
    nothing = np.full(len(t), np.inf)
    states = smooth_foot_states(
        FootInputs(
            np.diff(t, prepend=0.0), w, force, nothing, nothing, nothing, np.zeros(len(t)),
            q[0], speed[0],
        ),
        MODEL,
        estimate_gyro_bias=False,
        forward_only=True,
    )  # fmt: skip
    turn = rotation.multiply(states.quaternion[-1], rotation.conjugate(q[-1]))
    error = rotation.to_rotation_vector(turn)
    moved = states.position[-1] - (swing[-1] - swing[0])
    return np.linalg.norm(error[:2]), abs(error[2]), np.linalg.norm(moved)


def test_halving_the_step_quarters_the_error():
    coarse, fine = reckoned(100.0), reckoned(200.0)
    assert fine[1] < coarse[1] / 3.5
    assert fine[2] < coarse[2] / 3.5


def test_coning_is_within_what_sampling_leaves():
    """A mean rate alone would turn by 17 mrad in 4 s; half of it is the trapezoid's."""
    assert reckoned(100.0)[1] < 0.009


def test_a_linear_rate_is_right_to_the_fourth_power_of_the_step():
    w, change = np.array([3.0, -2.0, 5.0]), np.array([40.0, 60.0, -30.0])

    def error(dt: float, parts: int = 4000) -> float:
        middles = (np.arange(parts) + 0.5) * dt / parts
        fine = rotation.from_rotation_vector((w + middles[:, None] * change) * dt / parts)
        turn = integrated_rate.py_func(dt, tuple(w), tuple(w + dt * change))
        one = rotation.from_rotation_vector(np.array(turn))
        rest = rotation.multiply(rotation.conjugate(rotation.compose(fine)), one)
        return float(np.linalg.norm(rotation.to_rotation_vector(rest)))

    assert error(0.04) < error(0.08) / 25.0
    assert error(0.01) < 1e-6
