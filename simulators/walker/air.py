"""The pressure of the air around a person who walks: height, weather, gusts and doors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imu_rig.altitude import pressure_at
from imu_rig.arrays import FloatArray

PA_PER_M = 12.0
"""Of air near the ground."""

WAVES = 7
LONGEST_S, SHORTEST_S = 1800.0, 90.0
"""Periods of the waves that together are the drift."""

GUST_EVERY_S = 10.0
GUST_PA = 2.5
DOOR_EVERY_S = 60.0
DOOR_PA = 6.0

FAST_NOISE_M = 0.07
"""Standard deviation of what turbulence and sensor add to each sample."""


@dataclass(frozen=True, eq=False)
class Weather:
    """Air whose pressure changes with time and height.

    Attributes
    ----------
    level_pa : float
        Pressure at height 0 at the begin.
    air_c : float
        Temperature [degC].
    waves : shape (k, 3)
        Amplitude [Pa], rate [rad/s] and phase of the waves of the drift.
    gusts : shape (k, 3)
        Time [s], pressure [Pa] and width [s] of every gust.
    doors : shape (k, 3)
        Time [s], change of pressure that stays [Pa] and how fast it comes [s].
    noise_pa : float
        Standard deviation of each sample.
    """

    level_pa: float
    air_c: float
    waves: FloatArray
    gusts: FloatArray
    doors: FloatArray
    noise_pa: float

    def pressure(self, t: FloatArray, z: FloatArray) -> FloatArray:
        """Return the pressure [Pa] at times [s] and heights [m], shapes (n,), without noise."""
        changed = np.zeros_like(t)
        for size, rate, phase in self.waves.tolist():
            changed += size * (np.sin(rate * t + phase) - math.sin(phase))
        for at, size, width in self.gusts.tolist():
            changed += size * np.exp(-0.5 * ((t - at) / width) ** 2)
        for at, size, width in self.doors.tolist():
            changed += 0.5 * size * (1.0 + np.tanh((t - at) / width))
        return pressure_at(z, self.level_pa) + changed


def still_air() -> Weather:
    """Return air that depends on height only."""
    none = np.empty((0, 3))
    return Weather(101_325.0, 20.0, none, none, none, 0.0)


def weather(
    rng: np.random.Generator,
    seconds: float,
    drift_m_per_min: float = 0.1,
    fast_m: float = FAST_NOISE_M,
) -> Weather:
    """Return changing air for a walk of so many seconds.

    Parameters
    ----------
    rng : numpy Generator
    seconds : float
    drift_m_per_min : float
        Root mean square of the drift, told as height per minute.
    fast_m : float
        Standard deviation of each sample, told as height.
    """
    periods = np.geomspace(LONGEST_S, SHORTEST_S, WAVES) * rng.uniform(0.8, 1.25, WAVES)
    rates = 2.0 * math.pi / periods
    # Each wave has the same share in the variance of the slope.
    slope = drift_m_per_min / 60.0 * PA_PER_M * math.sqrt(2.0 / WAVES)
    waves = np.stack((slope / rates, rates, rng.uniform(0.0, 2.0 * math.pi, WAVES)), axis=1)
    gusts = _events(rng, seconds, GUST_EVERY_S, GUST_PA, (0.2, 1.5))
    doors = _events(rng, seconds, DOOR_EVERY_S, DOOR_PA, (0.1, 0.4))
    level = 101_325.0 + rng.normal(0.0, 600.0)
    return Weather(float(level), 20.0, waves, gusts, doors, fast_m * PA_PER_M)


def _events(
    rng: np.random.Generator,
    seconds: float,
    every_s: float,
    size: float,
    widths: tuple[float, float],
) -> FloatArray:
    number = int(rng.poisson(seconds / every_s))
    return np.stack(
        (
            rng.uniform(0.0, seconds, number),
            rng.normal(0.0, size, number),
            rng.uniform(*widths, number),
        ),
        axis=1,
    )
