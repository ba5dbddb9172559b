"""The motion of a foot: it rolls over the ground about heel and ball, and swings onward.

A foot is rigid, its sole flat from the heel to the ball. It turns about the ball, which rests on
the ground, from the moment it lies flat until only the toes hold it before toe-off, and about the
heel from contact until it lies flat; going down stairs the ball comes first. With b(t) where the
ball would be if the foot lay flat, a share g of the sole, the attitude R and the direction d in
which the sole will lie:

    ball = b + g sole (R x - d)

b rests while the foot is on the ground. g is 0 there, so that the ball rests, and goes over to 1 in
the swing, so that from contact on the heel, ball - sole R x = b - sole d, rests. When the foot lies
flat, R x is d and does not move: g may fall back to 0, and nothing jumps.
"""

from __future__ import annotations

import itertools
import math
from enum import IntEnum

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.rotation import about_y, about_z
from imu_rig.units import DEG
from simulators.walker.channels import Channel, Track, swept
from simulators.walker.jets import constant
from simulators.walker.motion import Motion
from simulators.walker.steps import SIDES, Footfall, Manner

SOLE_M = 0.18
"""From heel to ball."""

SWING_YAW, SWING_ROLL = 6.0 * DEG, 5.0 * DEG
"""How far the foot turns outward and rolls in early swing, before it goes back."""
STRIKE_ROLL = 6.0 * DEG
"""How far the sole is turned inward when it meets the ground."""

CREEP_S = 0.3
"""A foot that lies for less time creeps less."""
LEAST_CREEP_S = 0.08
"""A foot that lies for less time does not creep at all."""
CREEP_EVERY_S = 4.0
"""A foot that stands longer turns a little again and again."""

CRUISE = (0.35, 0.55)
"""Shares of the swing between which the foot is at its fastest."""

EDGE_M, OVER_EDGE_M = 0.1, 0.06
"""A stride that rises by so much more than the ground's slope [m] goes over an edge, and so much
higher than its end."""
OVER_EDGE_AT = 0.52
UP_FIRST = 0.15
"""Shares of the swing at which it is highest, and before which it only goes up."""

STRIKE_S = 0.072
"""In this time the ground takes the last speed from the foot."""


class Phase(IntEnum):
    """What a foot does."""

    SWING = 0
    STRIKE = 1
    FLAT = 2
    HEEL_OFF = 3


class Foot:
    """One foot along its footfalls; its origin is the ball, on the sole.

    Parameters
    ----------
    falls : list of Footfall
        Of this foot, in order; the first stands from the begin, the last to the end.
    end_s : float
        Until when it creeps in standing.
    manner : Manner
    rng : numpy Generator
    """

    def __init__(
        self, falls: list[Footfall], end_s: float, manner: Manner, rng: np.random.Generator
    ) -> None:
        self._side = SIDES[falls[0].foot]
        self._manner, self._rng = manner, rng
        first = falls[0]
        self._place = [Track(0.0, coordinate) for coordinate in first.ball]
        self._yaw, self._pitch = Track(0.0, first.yaw), Track(0.0, first.ground)
        self._roll, self._guide = Track(0.0, 0.0), Track(0.0, 0.0)
        for fall, after in itertools.pairwise(falls):
            self._lie(fall, max(fall.flat, 0.0), fall.heel_off)
            self._swing(fall, after)
            self._land(after)
        self._lie(falls[-1], max(falls[-1].flat, 0.0), end_s)
        self._lying_from = np.array([-math.inf, *(fall.toe_off for fall in falls[:-1])])
        ways = [about_z(fall.yaw) @ about_y(fall.ground) for fall in falls]
        self._lying = np.array([way[:, 0] for way in ways])
        tracks = (*self._place, self._yaw, self._pitch, self._roll, self._guide)
        self._channels: list[Channel] = [track.channel() for track in tracks]
        self.falls = falls
        self.breaks: FloatArray = np.unique(np.concatenate([c.breaks for c in self._channels]))

    def motion(self, t: FloatArray) -> Motion:
        """Return the motion at times [s], shape (n,)."""
        x, y, z, yaw, pitch, roll, guide = (channel.jet(t) for channel in self._channels)
        sole = Motion((x, y, z), yaw, pitch, roll).turned(constant((SOLE_M, 0.0, 0.0), x))
        lying = SOLE_M * self._lying[np.searchsorted(self._lying_from, t, side="right") - 1]
        moved = [
            place + guide * (along - flat)
            for place, along, flat in zip((x, y, z), sole, lying.T, strict=True)
        ]
        return Motion((moved[0], moved[1], moved[2]), yaw, pitch, roll)

    def phase(self, t: FloatArray) -> IntArray:
        """Return the `Phase` at times [s], shape (n,)."""
        edges, phases = [-math.inf], [int(Phase.FLAT)]
        for fall, after in zip(self.falls, self.falls[1:], strict=False):
            edges += [fall.heel_off, fall.toe_off, after.contact, after.flat]
            phases += [Phase.HEEL_OFF, Phase.SWING, Phase.STRIKE, Phase.FLAT]
        return np.array(phases, dtype=np.int64)[np.searchsorted(edges, t, side="right") - 1]

    def _lie(self, fall: Footfall, begin: float, end: float) -> None:
        """Turn a little about the ball while the foot lies on the ground."""
        if not self._manner.creep:
            return
        number = max(1, math.ceil((end - begin) / CREEP_EVERY_S))
        for piece in range(number):
            start = begin + (end - begin) * (piece + 0.1) / number
            stop = begin + (end - begin) * (piece + 0.9) / number
            if stop - start < LEAST_CREEP_S:
                continue
            times = (start, 0.5 * (start + stop), stop)
            creep = self._manner.creep * min(1.0, (stop - start) / CREEP_S)
            ground = fall.ground + creep * abs(self._normal())
            for track, aim in (
                (self._yaw, fall.yaw + creep * self._normal()),
                (self._roll, creep * self._normal()),
                (self._pitch, ground),
            ):
                track.go(times, (0.0, 1.0, 0.0), aim - track.value)

    def _swing(self, fall: Footfall, after: Footfall) -> None:
        gait = after.gait
        begin, end = fall.toe_off, after.contact
        swing = end - begin
        strike = after.ground + gait.strike

        # Over the ball and up: the rate at toe-off follows from what is left to the greatest pitch.
        kick_s = begin + gait.kick_at * swing
        push_s = begin - fall.heel_off
        rise = fall.ground + gait.push - self._pitch.value
        leaving = 2.0 * (gait.kick - gait.push) / (kick_s - begin)
        early = 2.0 * rise / push_s - 0.5 * leaving
        if early < 0.0:
            early, leaving = 0.0, 4.0 * rise / push_s
        self._pitch.run(
            (fall.heel_off, fall.heel_off + 0.5 * push_s, begin, kick_s),
            (0.0, early, leaving, 0.0),
        )
        down = (kick_s, *(kick_s + share * (end - kick_s) for share in (0.40, 0.80, 1.0)))
        self._pitch.go(down, (0.0, 1.0, 0.3, 0.0), strike - self._pitch.value)

        outward, back = (
            [begin + share * swing for share in shares]
            for shares in ((0.04, 0.22, 0.40), (0.40, 0.68, 0.97))
        )
        for track, out, aim in (
            (self._yaw, SWING_YAW, after.yaw),
            (self._roll, SWING_ROLL, self._side * STRIKE_ROLL),
        ):
            away = -self._side * out * (1.0 + 3.0 * self._manner.angles * self._normal())
            track.go(outward, (0.0, 1.0, 0.0), away + 0.4 * (aim - track.value))
            track.go(back, (0.0, 1.0, 0.0), aim - track.value)
        if gait.strike < 0.0:
            along = tuple(begin + share * swing for share in (0.35, 0.65, 0.95))
            self._guide.go(along, (0.0, 1.0, 0.0), 1.0)
        self._carry(after, begin, swing, -min(fall.ground, after.ground))

    def _carry(self, after: Footfall, begin: float, swing: float, steepest: float) -> None:
        """Bring the ball to its next place."""
        gait = after.gait
        way = np.array(after.ball) - [track.value for track in self._place]
        length = math.hypot(way[0], way[1])
        toes, last = self._toes(after, begin, swing), begin + swing - STRIKE_S
        cruise_from, cruise_to = (begin + share * swing for share in CRUISE)
        edge = way[2] - length * math.tan(steepest) >= EDGE_M
        if edge:  # up before ahead
            toes = begin + UP_FIRST * swing
        times = (toes, cruise_from, cruise_to, last, begin + swing)
        cruise = swept(times, (0.0, 1.0, 1.0, 0.0, 0.0))
        braked = swept(times, (0.0, 0.0, 0.0, 1.0, 0.0))
        strike = min(gait.strike_ms, 0.3 * length / cruise)
        top = (length - strike * braked) / cruise
        forward = (0.0, top, top, strike, 0.0)
        # Outward at first, then back by as much.
        ahead = swept(times, (0.0, 1.0, 0.0, 0.0, 0.0))
        back = swept(times, (0.0, 0.0, 1.0, 0.0, 0.0))
        out = self._side * gait.arc_m / (0.25 * swing)
        outward = (0.0, out, -out * ahead / back, 0.0, 0.0)
        cos, sin = (way[0] / length, way[1] / length) if length > 1e-6 else (1.0, 0.0)
        for track, share, aside in ((self._place[0], cos, -sin), (self._place[1], sin, cos)):
            track.run(times, [share * f + aside * o for f, o in zip(forward, outward, strict=True)])
        self._lift(after, begin, swing, float(way[2]), edge)

    @staticmethod
    def _toes(after: Footfall, begin: float, swing: float) -> float:
        """Return when the ball leaves the ground before the toes do."""
        return begin - after.gait.toes / (1.0 - after.gait.stance) * swing

    def _lift(self, after: Footfall, begin: float, swing: float, rise: float, edge: bool) -> None:
        gait = after.gait
        lift, high = gait.lift_m, gait.lift_at
        if edge:
            lift, high = max(lift, OVER_EDGE_M), OVER_EDGE_AT
        up = lift + max(rise, 0.0)
        down = up - rise
        last = 1.0 - STRIKE_S / swing
        shares = (0.4 * high, high, 0.5 * (high + last), last, 1.0)
        toes = self._toes(after, begin, swing)
        times = (toes, *(begin + share * swing for share in shares))
        climbing = up / swept(times, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
        falling = swept(times[2:], (0.0, 1.0, 0.0, 0.0))
        braked = swept(times[2:], (0.0, 0.0, 1.0, 0.0))
        drop = min(gait.drop_ms, 0.6 * down / braked)
        self._place[2].run(
            times, (0.0, climbing, 0.0, -(down - drop * braked) / falling, -drop, 0.0)
        )

    def _land(self, fall: Footfall) -> None:
        """Come down on the sole about the point that has met the ground."""
        span = fall.flat - fall.contact
        times = (fall.contact, fall.contact + 0.5 * span, fall.flat)
        self._pitch.go(times, (0.0, 1.0, 0.0), fall.ground - self._pitch.value)
        self._roll.go(times, (0.0, 1.0, 0.0), -self._roll.value)
        self._guide.jump(fall.flat, 0.0)

    def _normal(self) -> float:
        return min(2.5, max(-2.5, float(self._rng.standard_normal())))
