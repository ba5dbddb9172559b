"""Where and when a person puts the feet: footfalls along a way, varied as people vary them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imu_rig.units import DEG
from simulators.walker.gait import Gait, gait_at
from simulators.walker.path import (
    Arc,
    Piece,
    Stairs,
    Station,
    Straight,
    Turn,
    on_pieces,
    plan_length,
)

RUN_FROM_MS = 2.1
"""Who goes faster runs."""

STAIRS_STEP_S = 0.62
TURN_STEP_S = 0.52
TURN_STEP_DEG = 50.0
TOE_OUT = 6.0 * DEG
BALL_AHEAD_M = 0.10
"""From the middle of a footprint to the ball of the foot."""

LEFT, RIGHT = 0, 1
SIDES = (1.0, -1.0)
"""Of the left and the right foot along y."""


@dataclass(frozen=True)
class Stand:
    """Stand still for a time [s]."""

    seconds: float


@dataclass(frozen=True)
class Walk:
    """Go along pieces, from standing to standing.

    Attributes
    ----------
    pieces : tuple of pieces of the way
    speeds : tuple of float
        At equal distances along the way, in between linearly [m/s].
    cadence : float
        How many steps on the level are taken in a time, as a share of what is usual at the speed.
    """

    pieces: tuple[Piece, ...]
    speeds: tuple[float, ...] = (1.3,)
    cadence: float = 1.0


Leg = Stand | Walk

_Uneven = Callable[[int], float]
"""Length of a step, by its number, as a share of what is usual."""


@dataclass(frozen=True)
class Manner:
    """How a person differs from step to step and from side to side.

    Attributes
    ----------
    length, time : float
        Standard deviations of a step's length and time, as shares.
    width_m, yaw : float
        Standard deviations of the sideward place [m] and of the direction [rad] of a footprint.
    angles : float
        Standard deviation of the pitch angles and of the height of the lift, as a share.
    asymmetry : float
        By which share the left leg's steps are longer than the right's.
    creep : float
        How far a foot on the ground turns, standard deviation [rad].
    """

    length: float = 0.025
    time: float = 0.018
    width_m: float = 0.015
    yaw: float = 2.0 * DEG
    angles: float = 0.05
    asymmetry: float = 0.008
    creep: float = 0.4 * DEG

    @staticmethod
    def regular() -> Manner:
        """Return a person who takes every step alike."""
        return Manner(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Footfall:
    """One stay of a foot on the ground.

    Attributes
    ----------
    foot : int
        `LEFT` or `RIGHT`.
    contact, flat, heel_off, toe_off : float
        When it meets the ground, lies on it with the whole sole, begins to rise, leaves it [s];
        infinite where it stands before the first step or after the last.
    ball : (float, float, float)
        Where the ball of the foot rests [m].
    yaw : float
        Direction of the foot [rad].
    ground : float
        Pitch of the foot that lies on the ground [rad].
    gait : Gait
        Of the step that ends here.
    """

    foot: int
    contact: float
    flat: float
    heel_off: float
    toe_off: float
    ball: tuple[float, float, float]
    yaw: float
    ground: float
    gait: Gait


@dataclass(frozen=True)
class Waypoint:
    """Where the middle of the body passes at a time, how many steps were taken, and how it goes."""

    t: float
    station: Station
    steps: float
    gait: Gait | None


@dataclass(frozen=True)
class StepPlan:
    """Every footfall of a walk.

    Attributes
    ----------
    feet : (list of Footfall, list of Footfall)
        Of the left and the right foot, in order.
    waypoints : list of Waypoint
    turns : list of (float, float, float)
        Begin and end [s] of every turn on the spot, and its angle [rad].
    end_s : float
    """

    feet: tuple[list[Footfall], list[Footfall]]
    waypoints: list[Waypoint]
    turns: list[tuple[float, float, float]]
    end_s: float


def plan_steps(legs: Sequence[Leg], manner: Manner, rng: np.random.Generator) -> StepPlan:
    """Plan a walk that begins at the origin, heading along x."""
    planner = _Planner(manner, rng)
    for leg in legs:
        if isinstance(leg, Stand):
            planner.stand(leg.seconds)
        else:
            planner.walk(leg)
    return planner.plan()


@dataclass(frozen=True)
class _Step:
    """One step as intended: where the body is in its middle, and how it is taken."""

    station: Station
    gait: Gait
    turning: float = 0.0


class _Planner:
    def __init__(self, manner: Manner, rng: np.random.Generator) -> None:
        self._manner, self._rng = manner, rng
        self._t = 0.0
        self._steps = 0
        self._station = Station()
        standing = gait_at(1.3)
        self._feet = ([self._standing(LEFT, standing)], [self._standing(RIGHT, standing)])
        self._waypoints = [Waypoint(0.0, self._station, 0.0, None)]
        self._turns: list[tuple[float, float, float]] = []

    def plan(self) -> StepPlan:
        return StepPlan(self._feet, self._waypoints, self._turns, self._t)

    def stand(self, seconds: float) -> None:
        self._t += seconds
        self._waypoints.append(Waypoint(self._t, self._station, float(self._steps), None))

    def walk(self, walk: Walk) -> None:
        steps = list(_intended(walk, self._station, self._uneven))
        steps.append(replace(steps[-1], turning=0.0))  # the foot behind closes up
        first = steps[0].gait
        push_s = (first.stance - first.heel_off) * first.stride_s
        contact = self._t + push_s + first.swing_s
        turning: list[float] = []
        for number, step in enumerate(steps):
            if number:
                wait = 1.0 + self._manner.time * self._normal()
                contact += step.gait.step_s * min(1.2, max(0.8, wait))
            self._put(step, contact)
            if step.turning:
                turning.append(step.turning)
                if len(turning) == 1:
                    turned_from = contact - step.gait.swing_s
            elif turning:
                self._turns.append((turned_from, contact, sum(turning)))
                turning = []
        last = self._feet[(self._steps - 1) % 2][-1].flat
        self._t = max(last, self._waypoints[-1].t) + 0.2
        self._waypoints.append(Waypoint(self._t, self._station, float(self._steps), None))

    def _put(self, step: _Step, contact: float) -> None:
        """Let the foot behind leave the ground and meet it again at a time."""
        foot = self._steps % 2
        gait = self._varied(step.gait)
        before = self._feet[foot][-1]
        toe_off = contact - gait.swing_s
        push_s = (gait.stance - gait.heel_off) * gait.stride_s
        earliest = max(before.flat, 0.0) + 0.02
        toe_off = max(toe_off, earliest + 0.08)
        heel_off = max(toe_off - push_s, earliest)
        self._feet[foot][-1] = replace(before, heel_off=heel_off, toe_off=toe_off)
        flat = contact + gait.flat * gait.stride_s
        self._feet[foot].append(self._fall(foot, contact, flat, step.station, gait))
        middle = Waypoint(
            contact, _between(self._station, step.station), self._steps + 0.5, step.gait
        )
        over = Waypoint(
            contact + 0.5 * gait.step_s, step.station, float(self._steps + 1), step.gait
        )
        self._waypoints += [middle, over]
        self._station = step.station
        self._steps += 1

    def _fall(
        self, foot: int, contact: float, flat: float, station: Station, gait: Gait
    ) -> Footfall:
        manner, side = self._manner, SIDES[foot]
        aside = side * (0.5 * gait.width_m + 0.7 * manner.width_m * self._normal())
        yaw = station.heading + side * TOE_OUT + manner.yaw * self._normal()
        cos, sin = math.cos(station.heading), math.sin(station.heading)
        ball = (
            station.x + BALL_AHEAD_M * cos - aside * sin,
            station.y + BALL_AHEAD_M * sin + aside * cos,
            station.z + BALL_AHEAD_M * math.tan(station.slope),
        )
        ground = -station.slope
        return Footfall(foot, contact, flat, math.inf, math.inf, ball, yaw, ground, gait)

    def _standing(self, foot: int, gait: Gait) -> Footfall:
        return self._fall(foot, -math.inf, -math.inf, self._station, gait)

    def _varied(self, gait: Gait) -> Gait:
        share = self._manner.angles
        return replace(
            gait,
            strike=gait.strike * (1.0 + share * self._normal()),
            push=gait.push * (1.0 + 0.5 * share * self._normal()),
            kick=gait.kick * (1.0 + 0.5 * share * self._normal()),
            lift_m=gait.lift_m * (1.0 + abs(2.0 * share * self._normal())),
            arc_m=gait.arc_m * (1.0 + 3.0 * share * self._normal()),
        )

    def _uneven(self, number: int) -> float:
        """Return the length of a step of the coming walk as a share of what is usual."""
        side = SIDES[(self._steps + number) % 2]
        return 1.0 + 0.5 * side * self._manner.asymmetry + self._manner.length * self._normal()

    def _normal(self) -> float:
        return min(2.5, max(-2.5, float(self._rng.standard_normal())))


def _intended(walk: Walk, begin: Station, uneven: _Uneven) -> Iterator[_Step]:
    """Yield the steps of a walk without the one that closes up."""
    total = sum(plan_length(piece) for piece in walk.pieces)
    done, station, number = 0.0, begin, 0
    for kind, group in itertools.groupby(walk.pieces, key=lambda p: isinstance(p, Straight | Arc)):
        if kind:
            flat = [piece for piece in group if isinstance(piece, Straight | Arc)]
            length = sum(plan_length(piece) for piece in flat)
            for at, gait in _level_steps(walk, done, length, total, uneven, number):
                number += 1
                yield _Step(on_pieces(station, flat, at), gait)
            station = on_pieces(station, flat, length)
            done += length
            continue
        for piece in group:
            if isinstance(piece, Turn):
                count = max(2, math.ceil(abs(piece.angle_deg) / TURN_STEP_DEG))
                gait = replace(gait_at(0.5), step_s=TURN_STEP_S, flat=0.12, strike=-4.0 * DEG)
                angle = piece.angle_deg * DEG / count
                for turned in range(1, count + 1):
                    yield _Step(station.turned(turned * angle), gait, angle)
                number += count
                station = station.turned(piece.angle_deg * DEG)
            elif isinstance(piece, Stairs):
                way = int(math.copysign(1, piece.steps))
                gait = gait_at(0.28 / STAIRS_STEP_S, "up" if way > 0 else "down")
                for climbed in range(1, abs(piece.steps) + 1):
                    yield _Step(station.climbed(way * climbed), gait)
                number += abs(piece.steps)
                station = station.climbed(piece.steps)
                done += plan_length(piece)


def _level_steps(
    walk: Walk,
    done: float,
    length: float,
    total: float,
    uneven: _Uneven,
    number: int,
) -> list[tuple[float, Gait]]:
    """Return place [m] and gait of the steps that together are as long as a stretch."""
    lengths: list[float] = []
    gaits: list[Gait] = []
    while sum(lengths) < length - 0.25:
        share = (done + sum(lengths)) / total
        speed = float(np.interp(share, np.linspace(0.0, 1.0, len(walk.speeds)), walk.speeds))
        gait = gait_at(speed, "run" if speed >= RUN_FROM_MS else "walk")
        step = (gait.step_m / walk.cadence, gait.step_s / walk.cadence)
        gait = replace(gait, step_m=step[0], step_s=step[1])
        gaits.append(gait)
        lengths.append(gait.step_m * max(0.5, uneven(number + len(lengths))))
    scale = length / sum(lengths) if lengths else 1.0
    places = scale * np.cumsum(lengths)
    return list(zip(places.tolist(), gaits, strict=True))


def _between(a: Station, b: Station) -> Station:
    return Station(
        0.5 * (a.x + b.x), 0.5 * (a.y + b.y), 0.5 * (a.z + b.z), 0.5 * (a.heading + b.heading)
    )
