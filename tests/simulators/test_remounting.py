"""A simulated sensor turned over on its plate: gravity and turns are seen from its new axes."""

import numpy as np

from imu_rig import rotation
from simulators.config import RigConfig
from simulators.world import World


def up_seen(world: World, seconds: float = 0.5) -> np.ndarray:
    """Direction of gravity's reaction in the sensor's axes by the world's own geometry."""
    world.advance(world.t_s + seconds)
    return world.state().attitude.T @ np.array([0.0, 0.0, 1.0])


def test_gravity_turns_against_the_sensor_and_back() -> None:
    world = World(RigConfig.ideal())
    assert np.allclose(up_seen(world), [0, 0, 1])
    turn = np.array([0.0, np.pi / 2, 0.0])
    world.remount(turn)
    expected = rotation.rotate(
        rotation.conjugate(rotation.from_rotation_vector(turn)), np.array([0.0, 0.0, 1.0])
    )
    assert np.allclose(up_seen(world), expected)
    assert np.allclose(expected, [-1, 0, 0])
    world.remount(np.zeros(3))
    assert np.allclose(up_seen(world), [0, 0, 1])


def test_a_sensor_sits_askew_in_every_mounting_but_as_before_in_its_first() -> None:
    world = World(RigConfig.random(4))
    first = world.state().attitude
    world.remount(np.array([0.0, np.pi / 2, 0.0]))
    nominal = first @ rotation.about_y(np.pi / 2)
    difference = np.arccos((np.trace(nominal.T @ world.state().attitude) - 1) / 2)
    assert 1e-3 < difference < np.radians(20)
    world.remount(np.zeros(3))
    assert np.allclose(world.state().attitude, first)
