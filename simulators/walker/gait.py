"""How a person walks at a speed: step length and time, when the foot does what, how the waist goes.

The figures are those of gait laboratories for adults: at 1.3 m/s steps of 0.71 m, 110 per minute,
stance 60 % of the stride, heel strike at 25 deg toe up, toe-off near 60 deg toe down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from imu_rig.units import DEG

WALK_RATIO = 0.0065
"""Length [m] over steps per minute: nearly the same at every speed of one person."""

SPRINT_MS = 4.5
"""Who runs faster sprints."""

Kind = Literal["walk", "run", "up", "down"]


@dataclass(frozen=True)
class Gait:
    """One way to step. Shares are of the stride, which begins when the foot meets the ground.

    Attributes
    ----------
    step_m, step_s : float
        Length and time of a step; a stride has two.
    stance : float
        Share in which the foot is on the ground.
    flat, heel_off : float
        Share at which the sole has come down, and at which the heel begins to rise.
    toes : float
        Share before toe-off in which only the toes are on the ground: the ball has left it.
    strike, push, kick : float
        Pitch [rad], toe down positive, against the ground: when the foot meets it, about when the
        toe leaves it, and the greatest, in early swing.
    kick_at : float
        Share of the swing at which the pitch is greatest.
    lift_m : float
        How high the toe is lifted above the straight way.
    lift_at : float
        Share of the swing at which it is highest.
    strike_ms, drop_ms : float
        Forward and downward speed that the ground takes from the foot [m/s].
    arc_m : float
        How far the foot swings outward.
    bob_m, surge_m, sway_m : float
        Amplitudes of the waist: up and down, to and fro twice per stride, left and right once.
    low_at : float
        Share of the step after contact at which the waist is lowest.
    jolt_ms2 : float
        Peak of the waist's acceleration at contact.
    twist, list_, nod : float
        Amplitudes [rad] of the pelvis about z, x (once per stride) and y (twice).
    width_m : float
        Between the middles of left and right footprints.
    """

    step_m: float
    step_s: float
    stance: float
    flat: float
    heel_off: float
    toes: float
    strike: float
    push: float
    kick: float
    kick_at: float
    lift_m: float
    lift_at: float
    strike_ms: float
    drop_ms: float
    arc_m: float
    bob_m: float
    surge_m: float
    sway_m: float
    low_at: float
    jolt_ms2: float
    twist: float
    list_: float
    nod: float
    width_m: float = 0.12

    @property
    def stride_s(self) -> float:
        """Time from one contact of a foot to its next."""
        return 2.0 * self.step_s

    @property
    def swing_s(self) -> float:
        """Time of a foot in the air."""
        return (1.0 - self.stance) * self.stride_s


def gait_at(speed: float, kind: Kind = "walk") -> Gait:
    """Return the gait of an adult at a speed [m/s], on the level or on stairs.

    Raises
    ------
    ValueError
        If nobody goes like this: a speed that is not above 0, or above 8 m/s.
    """
    if not 0.0 < speed <= 8.0:
        raise ValueError(f"nobody goes at {speed:g} m/s; take a speed up to 8 m/s")
    match kind:
        case "walk":
            return _walk(speed)
        case "run":
            return _run(speed)
        case "up" | "down":
            return _stairs(speed, kind)


def _walk(speed: float) -> Gait:
    step = math.sqrt(60.0 * WALK_RATIO * speed)
    brisk = speed / 1.3
    stance = min(0.70, max(0.56, 0.60 + 0.06 * (1.3 - speed)))
    # Of an inverted pendulum with a soft knee.
    bob = 0.3 * (0.9 - math.sqrt(0.81 - min(0.45, 0.5 * step) ** 2))
    return Gait(
        step_m=step,
        step_s=step / speed,
        stance=stance,
        flat=0.20 * stance,
        heel_off=(0.50 if brisk > 0.6 else 0.62) * stance,
        toes=0.085,
        strike=-25.0 * DEG * min(1.2, brisk),
        push=54.0 * DEG * min(1.15, brisk**0.5),
        kick=66.0 * DEG * min(1.15, brisk**0.5),
        kick_at=0.16,
        lift_m=0.040 * min(1.3, max(0.6, brisk)),
        lift_at=0.36,
        strike_ms=1.5 * min(1.6, brisk),
        drop_ms=0.45 * min(1.6, brisk),
        arc_m=0.015,
        bob_m=bob,
        surge_m=0.012 * min(1.5, brisk),
        sway_m=0.022 / max(0.5, brisk) ** 0.5,
        low_at=0.14,
        jolt_ms2=3.5 * min(2.0, brisk**1.5),
        twist=4.5 * DEG * min(1.5, brisk),
        list_=3.5 * DEG * min(1.3, brisk),
        nod=1.2 * DEG,
    )


def _run(speed: float) -> Gait:
    """Return the gait of a runner, who sprints from `SPRINT_MS` on: the ball then meets the ground.

    Sprinters take shorter steps, lie flat for an instant only, and are over the ball at once.
    """
    sprint = min(1.0, max(0.0, speed - SPRINT_MS))
    step_s = 0.375 - 0.012 * min(6.0, max(0.0, speed - 2.0)) - 0.025 * max(0.0, speed - SPRINT_MS)
    return Gait(
        step_m=speed * step_s,
        step_s=step_s,
        stance=max(0.24, 0.40 - 0.045 * (speed - 2.0)),
        flat=0.14 - 0.08 * sprint,
        heel_off=0.19 - 0.10 * sprint,
        toes=0.045,
        strike=(-12.0 + 16.0 * sprint) * DEG,
        push=52.0 * DEG,
        kick=88.0 * DEG,
        kick_at=0.20,
        lift_m=0.11 + 0.02 * (speed - 2.0),
        lift_at=0.42,
        strike_ms=1.8,
        drop_ms=0.8,
        arc_m=0.01,
        bob_m=0.040,
        surge_m=0.010,
        sway_m=0.010,
        low_at=max(0.24, 0.40 - 0.045 * (speed - 2.0)),
        jolt_ms2=9.0,
        twist=7.0 * DEG,
        list_=4.0 * DEG,
        nod=3.0 * DEG,
        width_m=0.06,
    )


def _stairs(speed: float, kind: Kind) -> Gait:
    """Return the gait on stairs of 0.28 m tread: the ball meets the step first going down."""
    step_s = 0.28 / speed
    up = kind == "up"
    return replace(
        _walk(0.8),
        step_m=0.28,
        step_s=step_s,
        stance=0.60,
        flat=0.10,
        heel_off=0.40,
        toes=0.05,
        strike=(4.0 if up else 20.0) * DEG,
        push=(38.0 if up else 32.0) * DEG,
        kick=(46.0 if up else 36.0) * DEG,
        kick_at=0.18,
        lift_m=0.06 if up else 0.07,
        lift_at=0.55 if up else 0.30,
        strike_ms=0.15,
        drop_ms=0.25 if up else 0.45,
        bob_m=0.020,
        surge_m=0.010,
        jolt_ms2=3.0 if up else 6.0,
        low_at=0.14 if up else 0.3,
    )
