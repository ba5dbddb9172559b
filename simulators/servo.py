"""How a hobby servo turns pulses into motion: dead band, play, limited speed, a short ring."""

from __future__ import annotations

import math

import numpy as np

from imu_rig.units import DEG
from simulators.faults import SLOW_SERVO, WRONG_ANGLE_DEG, FaultSet
from simulators.models import ServoModel

STEP_S = 0.001
"""Step of the mechanics [s]; within one, accelerations are constant."""

NEW_STOP_AFTER_S = 0.2
"""A pulse that changes after this long unchanged begins a new move."""

STILL_ANGLE = 1e-7
STILL_RATE = 1e-6
"""Within these of its target [rad, rad/s] friction holds the axis."""

Row = tuple[float, float, float]
"""Angle, rate and acceleration of an axis in the middle of a step [rad, rad/s, rad/s^2]."""


class Follower:
    """Approaches a target, critically damped, with limited speed and acceleration.

    Within a step the acceleration is constant, so that angle and rate are exact integrals of it.
    """

    __slots__ = ("_w", "angle", "max_acceleration", "max_rate", "rate", "resting", "target")

    def __init__(
        self,
        angle: float,
        bandwidth_hz: float,
        max_rate: float = math.inf,
        max_acceleration: float = math.inf,
    ) -> None:
        self._w = 2.0 * math.pi * bandwidth_hz
        self.angle = self.target = angle
        self.rate = 0.0
        self.max_rate = max_rate
        self.max_acceleration = max_acceleration
        self.resting = True

    def aim(self, target: float) -> None:
        """Set a new target."""
        self.target = target
        self.resting = False

    def let_go(self) -> None:
        """Come to rest without going back, as friction would have it."""
        self.aim(self.angle + self.rate / self._w)

    def step(self) -> Row:
        """Advance by one step."""
        angle, rate = self.angle, self.rate
        if self.resting:
            return angle, 0.0, 0.0
        error = self.target - angle
        if -STILL_ANGLE < error < STILL_ANGLE and -STILL_RATE < rate < STILL_RATE:
            self.resting = True
            self.rate = 0.0
            return angle, 0.0, 0.0
        w = self._w
        acceleration = w * (w * error - 2.0 * rate)
        limit = self.max_acceleration
        if acceleration > limit:
            acceleration = limit
        elif acceleration < -limit:
            acceleration = -limit
        new_rate = rate + acceleration * STEP_S
        limit = self.max_rate
        if not -limit <= new_rate <= limit:
            within = min(max(new_rate, -limit), limit)
            brake = self.max_acceleration * STEP_S
            new_rate = min(max(within, rate - brake), rate + brake)
            acceleration = (new_rate - rate) / STEP_S
        self.angle = angle + 0.5 * STEP_S * (rate + new_rate)
        self.rate = new_rate
        middle = angle + 0.5 * STEP_S * rate + 0.125 * STEP_S * STEP_S * acceleration
        return middle, 0.5 * (rate + new_rate), acceleration


class Servo:
    """One axis of the jig, from the pulse at its input to the angle of its output.

    Parameters
    ----------
    model : ServoModel
    rng : numpy Generator
        For the error of each stop.
    """

    def __init__(self, model: ServoModel, rng: np.random.Generator) -> None:
        self.model = model
        self.faults = FaultSet()
        self.limp = True
        self._rng = rng
        self._drive = Follower(
            model.start_deg * DEG,
            model.bandwidth_hz,
            model.speed_dps * DEG,
            model.acceleration_dps2 * DEG,
        )
        self._ring_w2 = (2.0 * math.pi * model.ring_hz) ** 2
        self._ring_damping = 2.0 / model.ring_tau_s
        self._angle = self._drive.angle
        self._rate = 0.0
        (a0, a1), (p0, p1) = model.angle_deg, model.pulse_us
        self._deg_per_us = (a1 - a0) / (p1 - p0)
        self._heard_us = p0 + (model.start_deg - a0) / self._deg_per_us
        self._pulse_us = 0.0
        self._unchanged_since_s = -math.inf
        self._play_deg = self._commanded_deg(self._heard_us)
        self._stop_deg = 0.0

    @property
    def angle(self) -> float:
        """Angle of the axis now [rad]."""
        return self._angle

    @property
    def target(self) -> float:
        """Angle at which the axis will come to rest [rad]."""
        return self._drive.target

    def pulse_us(self, angle_deg: float) -> float:
        """Return the pulse that commands an angle, in the quarter microseconds of a Maestro."""
        model = self.model
        return (
            round(4.0 * (model.pulse_us[0] + (angle_deg - model.angle_deg[0]) / self._deg_per_us))
            / 4.0
        )

    @property
    def resting(self) -> bool:
        """Whether nothing of it moves."""
        return self._drive.resting

    def _commanded_deg(self, pulse_us: float) -> float:
        """Return the angle that a pulse commands, with gain, zero and sine error."""
        model = self.model
        nominal = model.angle_deg[0] + (pulse_us - model.pulse_us[0]) * self._deg_per_us
        sine = model.sine_deg * math.sin((nominal + model.sine_phase_deg) * DEG)
        return (1.0 + model.gain_error) * nominal + model.zero_deg + sine

    def hear(self, pulse_us: float, now_s: float) -> bool:
        """Take the pulse of one 20 ms period (0 for none); return whether a new move begins."""
        faulty = bool(self.faults)
        if pulse_us == self._pulse_us and not faulty and not self.limp:
            return False
        changed = pulse_us != self._pulse_us
        unchanged_s = now_s - self._unchanged_since_s
        if changed:
            self._pulse_us = pulse_us
            self._unchanged_since_s = now_s
        stuck = faulty and (self.faults.has("stuck") or self.faults.silent(now_s))
        if pulse_us == 0.0 or stuck:
            if not self.limp:
                self.limp = True
                self._drive.let_go()
            return False
        energized = self.limp
        self.limp = False
        half_band = 0.5 * self.model.dead_band_us
        heard_us = min(max(self._heard_us, pulse_us - half_band), pulse_us + half_band)
        if heard_us == self._heard_us and not energized and not faulty:
            return False
        new_move = heard_us != self._heard_us and (energized or unchanged_s > NEW_STOP_AFTER_S)
        if new_move:
            self._stop_deg = float(self._rng.normal(0.0, self.model.repeatability_deg))
        self._heard_us = heard_us
        self.aim()
        return new_move

    def aim(self) -> None:
        """Head for what was heard last, as the faults in effect have it."""
        if self.limp:
            return
        half_play = 0.5 * self.model.backlash_deg
        commanded = self._commanded_deg(self._heard_us)
        self._play_deg = min(max(self._play_deg, commanded - half_play), commanded + half_play)
        target_deg = self._play_deg + self._stop_deg
        if self.faults.has("wrong"):
            target_deg += WRONG_ANGLE_DEG
        slow = SLOW_SERVO if self.faults.has("slow") else 1.0
        self._drive.max_rate = slow * self.model.speed_dps * DEG
        if target_deg * DEG != self._drive.target:
            self._drive.aim(target_deg * DEG)

    def step(self) -> Row:
        """Advance by one step of the mechanics."""
        drive = self._drive
        if drive.resting:
            return self._angle, 0.0, 0.0
        row = drive.step()
        if self._ring_w2 == 0.0:
            self._angle = drive.angle
            return row
        angle, rate = self._angle, self._rate
        lag = row[0] - angle
        if drive.resting:
            if not (-STILL_ANGLE < lag < STILL_ANGLE and -STILL_RATE < rate < STILL_RATE):
                drive.resting = False
            else:
                self._rate = 0.0
                return angle, 0.0, 0.0
        acceleration = self._ring_w2 * lag + self._ring_damping * (row[1] - rate)
        self._angle = angle + STEP_S * (rate + 0.5 * STEP_S * acceleration)
        self._rate = rate + STEP_S * acceleration
        middle = angle + 0.5 * STEP_S * rate + 0.125 * STEP_S * STEP_S * acceleration
        return middle, 0.5 * (rate + self._rate), acceleration
