"""Simulated walks as sensors of three grades read them, with the truth."""

from functools import cache

import numpy as np

from imu_rig.blocks import ImuBlock
from simulators.walker.grades import read_as
from simulators.walker.scenarios import SCENARIOS, Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Walker


class Read:
    """What a left foot's sensor read of a walk, and how the foot really moved."""

    def __init__(self, scenario, rate_hz=200.0, seed=1):
        self.walker = Walker(scenario, seed=seed)
        self.t = np.arange(1, int((self.walker.end_s + 2.0) * rate_hz) + 1) / rate_hz
        sensor = self.walker.sensor("left-foot")
        self.means = sensor.means(self.t, 0.0)
        self.truth = sensor.at(self.t)
        self.falls = self.walker.falls[0]

    def by(self, grade, seed=1):
        """Return the readings of one sensor."""
        read = read_as(grade, self.means, seed)
        return ImuBlock(self.t, read.accel, read.gyro, self.t)

    def strides_right(self, track):
        """Return how many footfalls were missed, and how many made up."""
        t = self.t[track.footfalls.quietest]
        on = [np.flatnonzero((t >= f.contact) & (t <= f.toe_off)) for f in self.falls]
        found = sum(len(rows) > 0 for rows in on)
        return len(self.falls) - found, len(t) - found

    def distance_error(self, track):
        """Return the error of the sum of all strides' lengths as a share of it."""
        rows = track.footfalls.quietest
        ours = np.linalg.norm(np.diff(track.trajectory.position[rows, :2], axis=0), axis=1)
        true = np.linalg.norm(np.diff(self.truth.position[rows, :2], axis=0), axis=1)
        return ours.sum() / true.sum() - 1.0


def walk_along(*pieces, speeds=(1.3,), stand_s=2.0, **options):
    """A person who stands, walks along pieces, and stands for 1 s."""
    legs = (Stand(stand_s), Walk(pieces, speeds, **options), Stand(1.0))
    return Scenario("short", "A short walk", legs)


@cache
def named(name, rate_hz=200.0):
    """Return a walk of `SCENARIOS`, simulated once."""
    return Read(SCENARIOS[name], rate_hz)
