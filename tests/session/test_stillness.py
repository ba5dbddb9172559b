"""Stillness: noise is still, motion is not, and a turn about the vertical is motion."""

import numpy as np

from imu_rig.blocks import ImuBlock
from imu_rig.session.stillness import StillnessMonitor, scatter
from imu_rig.units import DEG, STANDARD_GRAVITY

RATE_HZ = 100.0
NOISE = (0.03, 0.05 * DEG)


def resting(
    seconds: float, seed: int = 1, rate: tuple[float, float, float] = (0, 0, 0)
) -> ImuBlock:
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    accel = np.array([0, 0, STANDARD_GRAVITY]) + NOISE[0] * rng.standard_normal((n, 3))
    gyro = np.array(rate) + np.array([3, -2, 1]) * DEG + NOISE[1] * rng.standard_normal((n, 3))
    return ImuBlock(t=t, accel=accel, gyro=gyro, host_s=t)


def monitor() -> StillnessMonitor:
    return StillnessMonitor(scatter(resting(2.0, seed=9)))


def test_a_resting_sensor_is_still_whatever_its_bias() -> None:
    judged = []
    for seed in range(200):
        still = monitor()
        still.update(resting(1.0, seed))
        judged.append(still.excess())
    assert max(judged) < 1.0


def test_a_slow_turn_about_the_vertical_is_not_still() -> None:
    judge = monitor()
    judge.update(resting(1.0, rate=(0, 0, 2 * DEG)))
    assert judge.excess() > 1.0


def test_shaking_is_not_still() -> None:
    judge, block = monitor(), resting(1.0)
    shaken = block.accel + 0.3 * np.sin(2 * np.pi * 9 * block.t)[:, None]
    judge.update(ImuBlock(t=block.t, accel=shaken, gyro=block.gyro, host_s=block.t))
    assert judge.excess() > 1.0


def test_nothing_is_still_before_the_window_is_filled() -> None:
    judge = monitor()
    assert judge.excess() == np.inf
    judge.update(resting(0.1))
    assert judge.excess() == np.inf
    judge.update(resting(1.0))
    assert judge.excess(since_s=0.9) == np.inf


def test_a_walking_bias_is_followed() -> None:
    judge = monitor()
    walked = resting(1.0, rate=(0.5 * DEG, 0, 0))
    judge.follow_bias(walked)
    judge.update(resting(1.0, rate=(0.9 * DEG, 0, 0)))
    assert judge.excess() < 1.0


def test_a_shaking_sensor_is_no_reference() -> None:
    block = resting(2.0)
    shaken = block.accel + 2.0 * np.sin(2 * np.pi * 3 * block.t)[:, None]
    assert not scatter(ImuBlock(t=block.t, accel=shaken, gyro=block.gyro, host_s=block.t)).is_rest
