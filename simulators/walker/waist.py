"""The motion of the waist: along the way, up and down with each step, to the side of the leg below.

Along the way it follows a spline of degree 5 through where the body passes at each contact and over
each standing foot, so that it also turns, climbs and stops smoothly. Bob, surge, sway and the turns
of the pelvis are sines of the number of steps taken, which is such a spline too.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.interpolate import BSpline, PPoly

from imu_rig.arrays import FloatArray, IntArray
from simulators.walker.channels import Channel, Track
from simulators.walker.jets import Jet, cosine, sine
from simulators.walker.motion import Motion
from simulators.walker.steps import StepPlan, Waypoint

HEIGHT_M = 0.98
"""Of the waist of a person who stands."""

DEGREE = 5
KNOT_EVERY_S = 0.3
MORE = 2 * DEGREE
"""Control points added alike at both ends, so that the body rests where the splines end."""
BEGINS_S = 2.0
"""Before time 0 the body is at rest; so long it takes to sway fully."""

JOLT_S = 0.045
"""Half the length of the jolt when a foot meets the ground."""

BALANCE_M = 0.004
BALANCE = 0.006
BALANCE_HZ = (0.13, 0.41)
"""How far, and how fast, the body of a person moves to keep its balance [m, rad]."""


class Waist:
    """The waist of a person; its origin is in the middle of the pelvis.

    Parameters
    ----------
    plan : StepPlan
    rng : numpy Generator
        Of how the body keeps its balance.
    height_m : float
        Above the ground, standing.
    """

    def __init__(
        self, plan: StepPlan, rng: np.random.Generator, height_m: float = HEIGHT_M
    ) -> None:
        points = _filled(plan.waypoints)
        knots = _knots(np.array([point.t for point in points]))
        columns = np.array([_column(point, height_m) for point in points])
        self._channels = [_spline(knots, column) for column in columns.T]
        self._balance = [
            (size * float(rng.normal(0.0, 1.0)), hz * float(rng.uniform(0.8, 1.25)), phase)
            for size in (BALANCE_M, BALANCE_M, BALANCE, BALANCE)
            for hz, phase in zip(BALANCE_HZ, rng.uniform(0.0, 6.28, 2).tolist(), strict=True)
        ]
        begins = Track(0.0, 0.0)
        begins.go((0.0, 0.5 * BEGINS_S, BEGINS_S), (0.0, 1.0, 0.0), 1.0)
        self._begins = begins.channel()
        falls = [fall for foot in plan.feet for fall in foot[1:]]
        falls.sort(key=lambda fall: fall.contact)
        self._contacts = np.array([fall.contact for fall in falls])
        self._jolts = np.array([fall.gait.jolt_ms2 for fall in falls])
        edges = (self._contacts - JOLT_S, self._contacts, self._contacts + JOLT_S)
        self.breaks: FloatArray = np.unique(
            np.concatenate((self._channels[0].breaks, self._begins.breaks, *edges))
        )

    def motion(self, t: FloatArray) -> Motion:
        """Return the motion at times [s], shape (n,)."""
        x, y, z, heading, steps, *amplitudes = (channel.jet(t) for channel in self._channels)
        bob, surge, sway, twist, list_, nod, low_at = amplitudes
        # A contact is half-way between whole numbers; at a whole number a leg is below the body.
        stride, step = math.pi * steps, 2.0 * math.pi * (steps - 0.5)
        lowest = step - 2.0 * math.pi * low_at
        forward = -(surge * sine(step - 0.9))
        aside = -(sway * cosine(stride))
        up = -(bob * cosine(lowest)) - 0.12 * (bob * cosine(2.0 * lowest - 0.6))
        lean_x, lean_y, lean_roll, lean_pitch = self._keeps_balance(t)
        forward, aside = forward + lean_x, aside + lean_y
        cos, sin = cosine(heading), sine(heading)
        origin = (
            x + cos * forward - sin * aside,
            y + sin * forward + cos * aside,
            z + up + self._jolt(t),
        )
        yaw = heading - twist * sine(stride)
        roll = -(list_ * cosine(stride - 0.4)) + lean_roll
        pitch = nod * cosine(step - 0.3) + lean_pitch
        return Motion(origin, yaw, pitch, roll)

    def phase(self, t: FloatArray) -> IntArray:
        """Return zeros: a waist has no phases."""
        return np.zeros(len(t), dtype=np.int64)

    def _keeps_balance(self, t: FloatArray) -> list[Jet]:
        sums: list[Jet] = []
        begins = self._begins.jet(t)
        for slow, quick in zip(self._balance[::2], self._balance[1::2], strict=True):
            sums.append(begins * (_wave(t, *slow) + 0.3 * _wave(t, *quick)))
        return sums

    def _jolt(self, t: FloatArray) -> Jet:
        """Return the way that the jolts of contacts add, at times [s]."""
        if not len(self._contacts):
            zero = np.zeros_like(t)
            return Jet(zero, zero, zero)
        middles = 0.5 * (self._contacts[1:] + self._contacts[:-1])
        nearest = np.searchsorted(middles, t)
        u = np.clip((t - self._contacts[nearest]) / JOLT_S, -1.0, 1.0)
        # -(1 - u^2)^6 has its greatest acceleration, 12 / JOLT_S^2, at u = 0.
        size = -self._jolts[nearest] * JOLT_S**2 / 12.0
        w = 1.0 - u * u
        return Jet(
            size * w**6,
            size * -12.0 * u * w**5 / JOLT_S,
            size * (120.0 * u * u * w**4 - 12.0 * w**5) / JOLT_S**2,
        )


def _wave(t: FloatArray, size: float, hz: float, phase: float) -> Jet:
    turn = 2.0 * math.pi * hz
    angle = Jet(turn * t + phase, np.full_like(t, turn), np.zeros_like(t))
    return size * sine(angle)


def _column(point: Waypoint, height_m: float) -> tuple[float, ...]:
    gait, station = point.gait, point.station
    place = (station.x, station.y, station.z + height_m, station.heading, point.steps)
    if gait is None:
        return (*place, *[0.0] * 6, 0.2)
    lower = 0.5 * gait.bob_m
    return (
        *place[:2],
        place[2] - lower,
        *place[3:],
        gait.bob_m,
        gait.surge_m,
        gait.sway_m,
        gait.twist,
        gait.list_,
        gait.nod,
        gait.low_at,
    )


def _filled(points: list[Waypoint]) -> list[Waypoint]:
    """Return waypoints with rests filled up, so that the body rests there too."""
    filled: list[Waypoint] = []
    for point, after in itertools.pairwise(points):
        filled.append(point)
        number = int((after.t - point.t) / KNOT_EVERY_S)
        for count in range(1, number + 1):
            t = point.t + (after.t - point.t) * count / (number + 1)
            near = point if 2 * count <= number + 1 else after
            filled.append(Waypoint(t, near.station, near.steps, near.gait))
    filled.append(points[-1])
    return filled


def _knots(t: FloatArray) -> FloatArray:
    """Return the knots with which every control point acts around its time."""
    ends = KNOT_EVERY_S * np.arange(1, MORE + (DEGREE + 1) // 2 + 1)
    return np.concatenate((t[0] - ends[::-1], t, t[-1] + ends))


def _spline(knots: FloatArray, values: FloatArray) -> Channel:
    """Return the spline with given control points; before the first and after the last it rests."""
    control = np.concatenate((np.full(MORE, values[0]), values, np.full(MORE, values[-1])))
    pieces = PPoly.from_spline(BSpline(knots, control, DEGREE))
    inside = slice(DEGREE, len(control))
    rest = np.zeros((1, DEGREE + 1))
    rest[0, 0] = values[-1]
    breaks = np.append(pieces.x[inside], knots[len(control)])
    return Channel(breaks, np.vstack((pieces.c[::-1, inside].T, rest)))
