"""Motion of the joints over a whole session at once: smooth ways from stop to stop.

Where a servo stops is :class:`simulators.servo.Servo`'s matter, with its dead band, its play and
its error of every stop. The way there is a speed profile with raised-cosine ramps in place of the
followed ramp of a Maestro, and the structure rings after it as it does after a servo.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from imu_rig.arrays import FloatArray
from simulators.models import ServoModel
from simulators.servo import STEP_S, STILL_ANGLE, STILL_RATE

RAMP_STEPS = 200
RING_DECAYS = 25.0
"""Decay times after which a ring is forgotten."""


@dataclass(frozen=True)
class Way:
    """A joint's way between two angles [rad], in steps of the mechanics."""

    start: int
    steps: int
    origin: float
    target: float

    @property
    def stop(self) -> int:
        """Step at which the drive stands."""
        return self.start + self.steps


def way_steps(angle: float, speed: float) -> int:
    """Return how many steps a way of ``angle`` [rad] takes at a top speed [rad/s]."""
    return max(2 * RAMP_STEPS, RAMP_STEPS + math.ceil(abs(angle) / (speed * STEP_S)))


def joint_rows(ways: list[Way], rest: float, steps: int, ring: ServoModel | None) -> FloatArray:
    """Return angle, rate and acceleration in the middle of every step, shape (steps, 3).

    Parameters
    ----------
    ways : list of Way
        In order of time; each begins where the one before ended.
    rest : float
        Angle before the first way [rad].
    steps : int
    ring : ServoModel or None
        Whose structure rings after every change of speed; None is rigid.
    """
    rows = np.zeros((steps, 3))
    rows[:, 0] = rest
    for way in ways:
        rows[way.start : way.stop] = _profile(way)
        rows[way.stop :, 0] = way.target
    if ring is not None and ring.ring_hz > 0.0:
        response = _ring(ring.ring_hz, ring.ring_tau_s)
        for way in ways:
            push = _top_acceleration(way)
            for start, size in ((way.start, push), (way.stop - RAMP_STEPS, -push)):
                part = rows[start : start + len(response)]
                part += size * response[: len(part)]
        _hold_still(rows, ways)
    return rows


def _top_acceleration(way: Way) -> float:
    speed = (way.target - way.origin) / ((way.steps - RAMP_STEPS) * STEP_S)
    return speed * math.pi / (2.0 * RAMP_STEPS * STEP_S)


def _profile(way: Way) -> FloatArray:
    """Return the drive's rows over its way; the rate sums to exactly the way."""
    ramp_s = RAMP_STEPS * STEP_S
    t = (np.arange(RAMP_STEPS) + 0.5) * STEP_S
    phase = math.pi * t / ramp_s
    speed = (way.target - way.origin) / ((way.steps - RAMP_STEPS) * STEP_S)
    up = np.stack(
        (
            way.origin + 0.5 * speed * (t - ramp_s / math.pi * np.sin(phase)),
            0.5 * speed * (1.0 - np.cos(phase)),
            _top_acceleration(way) * np.sin(phase),
        ),
        axis=1,
    )
    rows = np.zeros((way.steps, 3))
    rows[:RAMP_STEPS] = up
    rows[-RAMP_STEPS:] = up[::-1] * (-1.0, 1.0, -1.0) + (way.origin + way.target, 0.0, 0.0)
    even = slice(RAMP_STEPS, way.steps - RAMP_STEPS)
    since_s = (np.arange(way.steps - 2 * RAMP_STEPS) + 0.5) * STEP_S
    rows[even, 0] = way.origin + speed * (0.5 * ramp_s + since_s)
    rows[even, 1] = speed
    return rows


@lru_cache(maxsize=8)
def _ring(hz: float, tau_s: float) -> FloatArray:
    """Return how the structure swings about its drive after one ramp of unit top acceleration.

    With the drive's acceleration u'' the deviation e obeys ``e'' + 2/tau e' + w^2 e = -u''``, taken
    as constant within a step. Rows of e, e' and e'' in the middle of the steps.
    """
    decay, w2 = 1.0 / tau_s, (2.0 * math.pi * hz) ** 2
    steps = RAMP_STEPS + math.ceil(RING_DECAYS * tau_s / STEP_S)
    push = np.zeros(steps)
    push[:RAMP_STEPS] = np.sin(math.pi * (np.arange(RAMP_STEPS) + 0.5) / RAMP_STEPS)
    swing = np.sqrt(complex(w2 - decay**2))
    t = (np.arange(steps) + 0.5) * STEP_S
    wave = np.sin(swing * t) / swing
    rate_step = np.exp(-decay * t) * wave.real
    angle_step = (1.0 - np.exp(-decay * t) * (np.cos(swing * t) + decay * wave).real) / w2
    ramp = push[:RAMP_STEPS]
    angle = -np.convolve(ramp, np.diff(angle_step, prepend=0.0))[:steps]
    rate = -np.convolve(ramp, np.diff(rate_step, prepend=0.0))[:steps]
    response = np.stack((angle, rate, -push - 2.0 * decay * rate - w2 * angle), axis=1)
    response.setflags(write=False)
    return response


def _hold_still(rows: FloatArray, ways: list[Way]) -> None:
    """Let friction hold the joint where it has come to rest, as it holds a servo."""
    stops = [way.start for way in ways[1:]] + [len(rows)]
    for way, stop in zip(ways, stops, strict=True):
        after = rows[way.stop : stop]
        swings = (np.abs(after[:, 0] - way.target) > STILL_ANGLE) | (
            np.abs(after[:, 1]) > STILL_RATE
        )
        last = np.flatnonzero(swings)
        still = after[last[-1] + 1 if len(last) else 0 :]
        still[:] = (way.target, 0.0, 0.0)
