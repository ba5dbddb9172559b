"""Attitude, specific force and rate of the sensor, against numeric differentiation."""

import numpy as np
import pytest

from imu_rig.rotation import about_x, about_y, about_z
from imu_rig.units import DEG
from simulators.config import RigConfig
from simulators.jig import JOINTS, Jig
from simulators.models import JigModel

GRAVITY = 9.7993
EARTH = (0.0, 5e-5, 5e-5)
FIELD = (3.0, 22.0, -45.0)


def jig(model: JigModel) -> Jig:
    return Jig(model, gravity=GRAVITY, earth_rate=EARTH, field=FIELD)


@pytest.fixture
def crooked() -> Jig:
    return jig(
        JigModel(
            base_tilt_deg=(1.3, -0.7),
            tilt_skew_deg=1.1,
            roll_skew_deg=-0.9,
            mounting_deg=(4.0, -3.0, 2.0),
            lever_arm_m=(0.05, -0.03, 0.04),
        )
    )


def swing(t):
    """Joint angles that all move at once, with their exact derivatives; each of shape (n, 6)."""
    t = np.atleast_1d(t)[:, np.newaxis]
    amplitude = np.array([1.5, 1.1, 2.0, 0.002, -0.003, 0.001])
    hz = np.array([0.31, 0.47, 0.73, 1.1, 0.9, 1.3])
    w = 2 * np.pi * hz
    phase = w * t + np.arange(JOINTS)
    return (
        0.3 + amplitude * np.sin(phase),
        amplitude * w * np.cos(phase),
        -amplitude * w**2 * np.sin(phase),
    )


def test_rate_and_force_are_the_derivatives_of_attitude_and_position(crooked):
    t = np.linspace(0.0, 4.0, 41)
    h = 1e-4
    motion = crooked.motion(*swing(t))
    before, now, after = (crooked.attitude(swing(t + d)[0]) for d in (-h, 0.0, h))
    turning = np.swapaxes(now, 1, 2) @ (after - before) / (2 * h)
    rate = np.stack((turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]), axis=1)
    assert motion.rate == pytest.approx(rate + np.array(EARTH) @ now, abs=1e-5)

    p = [crooked.position(swing(t + d)[0]) for d in (-h, 0.0, h)]
    acceleration = (p[0] - 2 * p[1] + p[2]) / h**2
    force = (acceleration + np.array([0.0, 0.0, GRAVITY]))[:, np.newaxis] @ now
    assert motion.force == pytest.approx(force[:, 0], abs=1e-5)
    assert np.abs(acceleration).max() > 1.0  # the test would not see the lever arm otherwise
    assert motion.field == pytest.approx(np.array(FIELD) @ now, abs=1e-12)


def test_at_rest_the_force_is_gravity_of_the_place_whatever_the_pose(crooked):
    angles = np.random.default_rng(1).uniform(-3, 3, (50, JOINTS))
    zero = np.zeros_like(angles)
    motion = crooked.motion(angles, zero, zero)
    assert np.linalg.norm(motion.force, axis=1) == pytest.approx(GRAVITY, rel=1e-13)
    assert np.linalg.norm(motion.rate, axis=1) == pytest.approx(np.linalg.norm(EARTH))
    assert np.linalg.norm(motion.field, axis=1) == pytest.approx(np.linalg.norm(FIELD))


def test_a_wobble_at_rest_is_the_limit_of_a_slow_one(crooked):
    angles, rates, accelerations = (np.tile(row, (3, 1)) for row in np.vstack(swing(0.4)))
    rates[:, 3:] = accelerations[:, 3:] = 0.0
    resting = crooked.motion(angles, rates, accelerations)
    rates[:, 3:] = 1e-12
    slow = crooked.motion(angles, rates, accelerations)
    assert resting.force == pytest.approx(slow.force, abs=1e-9)
    assert resting.rate == pytest.approx(slow.rate, abs=1e-9)
    assert resting.field == pytest.approx(slow.field, abs=1e-9)


def test_a_square_jig_has_the_attitude_pan_tilt_roll():
    square = jig(RigConfig.ideal().jig)
    pan, tilt, roll = 0.7, -0.4, 2.1
    attitude = square.attitude(np.array([[pan, tilt, roll, 0, 0, 0]]))[0]
    assert attitude == pytest.approx(about_z(pan) @ about_y(tilt) @ about_x(roll), abs=1e-15)


def test_skewed_axes_turn_about_skewed_axes():
    skewed = RigConfig.ideal().jig.model_copy(update={"tilt_skew_deg": 2.0, "roll_skew_deg": 3.0})
    angles = np.zeros((1, JOINTS))
    rates = np.zeros((2, 1, JOINTS))
    rates[0, 0, 1] = rates[1, 0, 2] = 1.0
    earth = np.array(EARTH)
    tilt = jig(skewed).motion(angles, rates[0], angles).rate[0] - earth
    roll = jig(skewed).motion(angles, rates[1], angles).rate[0] - earth
    assert tilt == pytest.approx([0.0, np.cos(2 * DEG), np.sin(2 * DEG)])
    assert roll == pytest.approx([np.cos(3 * DEG), np.sin(3 * DEG), 0.0])
