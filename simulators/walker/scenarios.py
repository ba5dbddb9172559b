"""Walks by name."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.walker.path import Arc, Stairs, Straight, Turn, through
from simulators.walker.steps import Leg, Stand, Walk

CORRIDOR = ((0.0, 0.0), (9.0, 0.0), (10.0, -8.0), (11.8, -8.0), (11.0, 1.35), (0.0, 1.35))
"""The office walk of the published two-unit system [m]."""

LOOP = ((0.0, 0.0), (26.0, 0.0), (26.0, 14.0), (14.0, 14.0), (14.0, 10.0), (0.0, 10.0))
"""A way of 80 m with bends to both sides that comes back to its begin [m]."""


@dataclass(frozen=True)
class Slide:
    """A sensor slid along an arc on a board; see `simulators.walker.slider.Slider`."""

    radius_m: float
    angle_deg: float
    rest_s: float
    seconds: float


@dataclass(frozen=True)
class Scenario:
    """A walk, or what else a sensor is carried through.

    Attributes
    ----------
    name, title : str
    legs : tuple of legs, or a Slide
    """

    name: str
    title: str
    legs: tuple[Leg, ...] | Slide


def _walk(name: str, title: str, *pieces: Walk) -> Scenario:
    legs: list[Leg] = [Stand(4.0)]
    for piece in pieces:
        legs += [piece, Stand(3.0)]
    return Scenario(name, title, tuple(legs))


def _there_and_back(*pieces: Straight) -> tuple[Straight | Turn, ...]:
    back = tuple(Straight(piece.length_m, -piece.slope_deg) for piece in reversed(pieces))
    return (*pieces, Turn(180.0), *back, Turn(180.0))


SCENARIOS = {
    scenario.name: scenario
    for scenario in (
        Scenario(
            "half-circle",
            "Slid along a half circle of 0.36 m radius on a board, heading along it",
            Slide(0.36, 180.0, 4.0, 3.0),
        ),
        _walk("straight-50m", "Straight 50 m at 1.3 m/s", Walk((Straight(50.0),))),
        _walk("level-10m", "Straight 10 m at 1.2 m/s", Walk((Straight(10.0),), (1.2,))),
        _walk(
            "corridor",
            "Office loop through (9,0) (10,-8) (11.8,-8) (11,1.35) (0,1.35) m, at 1.2 m/s",
            Walk(through(CORRIDOR), (1.2,)),
        ),
        _walk("corridor-slow", "The office loop at 0.8 m/s", Walk(through(CORRIDOR), (0.8,))),
        _walk(
            "slope-up",
            "10 m level, 50 m up 5.5 deg, 10 m level",
            Walk((Straight(10.0), Straight(50.0, 5.5), Straight(10.0)), (1.2,)),
        ),
        _walk(
            "slope-down",
            "10 m level, 50 m down 5.5 deg, 10 m level",
            Walk((Straight(10.0), Straight(50.0, -5.5), Straight(10.0)), (1.25,)),
        ),
        _walk(
            "mixed-slopes",
            "126 m: level, up 5.5 deg, level, down 5.5 deg, level",
            Walk(
                (
                    Straight(26.0),
                    Straight(30.0, 5.5),
                    Straight(20.0),
                    Straight(30.0, -5.5),
                    Straight(20.0),
                ),
                (1.25,),
            ),
        ),
        _walk(
            "stairs-up",
            "Two flights of 10 steps up with a landing",
            Walk((Straight(3.0), Stairs(10), Straight(1.2), Stairs(10), Straight(3.0)), (1.0,)),
        ),
        _walk(
            "stairs-down",
            "Two flights of 10 steps down with a landing",
            Walk((Straight(3.0), Stairs(-10), Straight(1.2), Stairs(-10), Straight(3.0)), (1.0,)),
        ),
        _walk(
            "slow-shuffle",
            "10 m at 0.5 m/s with feet hardly lifted",
            Walk((Straight(10.0),), (0.5,)),
        ),
        _walk("brisk", "50 m at 1.8 m/s", Walk((Straight(50.0),), (1.8,))),
        _walk("running", "100 m at 3 m/s", Walk((Straight(100.0),), (3.0,))),
        _walk(
            "speeds",
            "120 m from a stroll to a run and back",
            Walk((Straight(120.0),), (0.8, 1.3, 1.8, 2.6, 3.2, 1.8, 1.3, 0.8)),
        ),
        _walk(
            "turns",
            "Turns on the spot of 90, -90, 180 and -360 deg between walks of 4 m, and bends",
            Walk((Straight(4.0), Turn(90.0), Straight(4.0), Turn(-90.0), Straight(4.0))),
            Walk((Turn(180.0), Straight(4.0), Turn(-360.0), Straight(4.0))),
            Walk((Straight(2.0), Arc(1.0, 180.0), Straight(3.0), Arc(0.6, -90.0), Straight(2.0))),
        ),
        _walk(
            "there-and-back",
            "Five times 10 m there and back",
            *(Walk(_there_and_back(Straight(10.0))) for _ in range(5)),
        ),
        _walk(
            "loop-80m",
            "80 m with six bends to either side, back to the begin, at 1.3 m/s",
            Walk((*through(LOOP, to_start=True), Turn(90.0))),
        ),
        _walk(
            "shuffle-turns",
            "Shuffling at 0.4 m/s, with turns on the spot of 90, -180, 360 and -270 deg",
            Walk((Straight(2.0), Turn(90.0), Straight(2.0), Turn(-180.0)), (0.4,)),
            Walk((Straight(2.0), Turn(360.0), Straight(2.0), Turn(-270.0)), (0.4,)),
        ),
        _walk("fast-run", "100 m at 4.4 m/s with strides of 3 m", Walk((Straight(100.0),), (4.4,))),
        _walk(
            "sprint",
            "80 m, in the middle at 5.5 m/s on the balls of the feet with strides of 3 m",
            Walk((Straight(80.0),), (3.0, 5.5, 5.5, 5.5, 5.5, 3.0), cadence=1.12),
        ),
        Scenario("standing", "Standing for a minute", (Stand(60.0),)),
        _walk(
            "mixed",
            "Walk, stand, turn, stairs up and down, run, stroll: about two minutes",
            Walk((Straight(12.0), Arc(0.8, 90.0), Straight(4.0)), (1.3,)),
            Walk((Turn(-90.0), Straight(2.0), Stairs(10), Straight(2.0)), (1.1,)),
            Walk((Turn(180.0), Straight(2.0), Stairs(-10), Straight(3.0)), (1.1,)),
            Walk((Straight(30.0),), (1.3, 2.8, 2.8, 1.3)),
            Walk((Turn(-180.0), Straight(20.0)), (0.7,)),
        ),
    )
}
"""Every scenario by its name."""


def scenario_of(name: str) -> Scenario:
    """Return a scenario by its name.

    Raises
    ------
    ValueError
        If there is none; the sentence lists them.
    """
    try:
        return SCENARIOS[name]
    except KeyError:
        known = ", ".join(SCENARIOS)
        raise ValueError(f"there is no walk {name!r}; take one of {known}.") from None
