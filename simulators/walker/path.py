"""The way over the ground: straights, arcs, turns on the spot, slopes and stairs.

x is forward at the begin, y left, z up; a heading turns from x to y.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from imu_rig.units import DEG

TREAD_M = 0.28
RISER_M = 0.17


@dataclass(frozen=True)
class Straight:
    """So many metres along the ground's plan, up or down a slope."""

    length_m: float
    slope_deg: float = 0.0


@dataclass(frozen=True)
class Arc:
    """A bend on the level; a positive angle turns left."""

    radius_m: float
    angle_deg: float


@dataclass(frozen=True)
class Turn:
    """A turn on the spot; a positive angle turns left."""

    angle_deg: float


@dataclass(frozen=True)
class Stairs:
    """So many steps; a negative number goes down."""

    steps: int


Piece = Straight | Arc | Turn | Stairs


@dataclass(frozen=True)
class Station:
    """A place on the way, between the feet.

    Attributes
    ----------
    x, y, z : float
        m.
    heading : float
        Unwrapped [rad].
    slope : float
        Of the ground in the direction of the heading [rad], uphill positive.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    heading: float = 0.0
    slope: float = 0.0

    def along(self, piece: Straight | Arc, length_m: float) -> Station:
        """Return the place so far along a piece that begins here."""
        if isinstance(piece, Straight):
            slope = piece.slope_deg * DEG
            return Station(
                self.x + length_m * math.cos(self.heading),
                self.y + length_m * math.sin(self.heading),
                self.z + length_m * math.tan(slope),
                self.heading,
                slope,
            )
        side = math.copysign(1.0, piece.angle_deg)
        heading = self.heading + side * length_m / piece.radius_m
        return Station(
            self.x + side * piece.radius_m * (math.sin(heading) - math.sin(self.heading)),
            self.y - side * piece.radius_m * (math.cos(heading) - math.cos(self.heading)),
            self.z,
            heading,
        )

    def turned(self, angle: float) -> Station:
        """Return the same place with the heading turned [rad]."""
        return replace(self, heading=self.heading + angle)

    def climbed(self, steps: int) -> Station:
        """Return the place so many steps higher, or lower where negative."""
        forward = abs(steps) * TREAD_M
        return Station(
            self.x + forward * math.cos(self.heading),
            self.y + forward * math.sin(self.heading),
            self.z + steps * RISER_M,
            self.heading,
        )


def plan_length(piece: Piece) -> float:
    """Return the horizontal length of a piece [m]."""
    match piece:
        case Straight():
            return piece.length_m
        case Arc():
            return abs(piece.angle_deg) * DEG * piece.radius_m
        case Stairs():
            return abs(piece.steps) * TREAD_M
        case Turn():
            return 0.0


def on_pieces(begin: Station, pieces: Iterable[Straight | Arc], length_m: float) -> Station:
    """Return the place so far along pieces, the last of which goes on for ever."""
    station, left = begin, length_m
    listed = list(pieces)
    for number, piece in enumerate(listed):
        length = plan_length(piece)
        if left <= length or number == len(listed) - 1:
            return station.along(piece, left)
        station, left = station.along(piece, length), left - length
    return station


def through(
    points: Iterable[tuple[float, float]], radius_m: float = 0.6, *, to_start: bool = False
) -> tuple[Piece, ...]:
    """Return straights through points of the plan with their corners rounded off.

    Parameters
    ----------
    points : of (x, y) [m]
        Where the way begins, its corners, and its end; it sets out along x.
    radius_m : float
        Of the bends at the corners; less where a straight is too short for it.
    to_start : bool
        Go back to the first point at the end.
    """
    corners = list(points)
    if to_start:
        corners.append(corners[0])
    legs = [(bx - ax, by - ay) for (ax, ay), (bx, by) in itertools.pairwise(corners)]
    lengths = [math.hypot(*leg) for leg in legs]
    pieces: list[Piece] = []
    heading, cut_before = 0.0, 0.0
    first = math.atan2(legs[0][1], legs[0][0])
    if abs(first) > 1e-9:
        pieces.append(Turn(first / DEG))
        heading = first
    for number, leg in enumerate(legs):
        cut, bend = 0.0, 0.0
        if number + 1 < len(legs):
            after = math.atan2(legs[number + 1][1], legs[number + 1][0])
            bend = math.remainder(after - heading, 2.0 * math.pi)
            room = min(0.45 * lengths[number], 0.45 * lengths[number + 1])
            cut = min(radius_m * math.tan(0.5 * abs(bend)), room)
            heading = math.atan2(leg[1], leg[0]) + bend
        pieces.append(Straight(lengths[number] - cut_before - cut))
        if bend:
            pieces.append(Arc(cut / math.tan(0.5 * abs(bend)), bend / DEG))
        cut_before = cut
    return tuple(pieces)
