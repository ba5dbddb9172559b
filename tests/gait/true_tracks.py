"""Foot tracks made of simulated truth: what a perfect smoother would give."""

import numpy as np

from imu_rig.gait.trajectory import Footfalls, FootTrack, Trajectory
from imu_rig.gait.zero_velocity import ZeroVelocity
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Walker

FEET = {"left-foot": 0, "right-foot": 1}


def walk_of(*pieces, speeds=(1.3,), seed=1, **options):
    """A person who stands for 2 s, walks along pieces and stands for 1 s."""
    scenario = Scenario("short", "A short walk", (Stand(2.0), Walk(pieces, speeds), Stand(1.0)))
    return Walker(scenario, seed=seed, **options)


def true_track(walker, place="left-foot", rate_hz=100.0, placement=None):
    """The track of a foot as it was, with its footfalls where the sole lies flat."""
    t = np.arange(int(walker.end_s * rate_hz) + 1) / rate_hz
    motion = walker.sensor(place, placement).at(t)
    falls = walker.falls[FEET[place]]
    flat = np.clip([fall.flat for fall in falls], 0.0, t[-1])
    rising = np.clip([fall.heel_off for fall in falls], 0.0, t[-1])
    first = np.searchsorted(t, flat - 1e-9)
    last = np.maximum(np.searchsorted(t, rising + 1e-9) - 1, first)
    still = np.zeros(len(t), dtype=bool)
    for a, b in zip(first, last, strict=True):
        still[a : b + 1] = True
    zero = np.zeros(len(t))
    return FootTrack(
        trajectory=Trajectory(t, motion.attitude, motion.velocity, motion.position),
        zero_velocity=ZeroVelocity(still, np.where(still, 0.01, np.inf), zero, zero),
        footfalls=Footfalls(first, last, (first + last) // 2),
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        pivot=np.array([0.0, 0.0, 0.06]),
    )
