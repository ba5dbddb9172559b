"""A person on a walk, the building around, and the places where sensors are worn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.units import STANDARD_GRAVITY
from simulators.walker.air import Weather, still_air, weather
from simulators.walker.feet import Foot
from simulators.walker.field import building_field, uniform_field
from simulators.walker.motion import Mover
from simulators.walker.scenarios import Scenario, Slide, scenario_of
from simulators.walker.sensor import IdealSensor, Placement
from simulators.walker.slider import Slider
from simulators.walker.steps import LEFT, RIGHT, Footfall, Manner, plan_steps
from simulators.walker.waist import Waist

PLACES = ("left-foot", "right-foot", "waist")

INSTEP = Placement(lever_m=(-0.08, 0.0, 0.075), turn=(0.0, 0.35, 0.0))
"""On the laces: behind the ball, x sloping down with the instep."""

BELT = Placement(lever_m=(-0.10, 0.0, 0.03), turn=(0.0, 0.52, 0.0))
"""At the back of the belt, tilted by about 30 deg as people wear it."""

WORN_ASKEW = 0.06
"""Standard deviation of each angle by which a sensor is put on differently [rad]."""


@dataclass(frozen=True)
class Surroundings:
    """What disturbs the sensors.

    Attributes
    ----------
    magnetic : float
        Standard deviation of the field's norm along the way, as a share; 0 for no iron.
    drift_m_per_min, fast_m : float
        Of the barometer: see `simulators.walker.air.weather`.
    still : bool
        Air whose pressure follows height only.
    """

    magnetic: float = 0.15
    drift_m_per_min: float = 0.1
    fast_m: float = 0.07
    still: bool = False

    @staticmethod
    def ideal() -> Surroundings:
        """Return a place without iron, weather and doors."""
        return Surroundings(magnetic=0.0, fast_m=0.0, still=True)


class Walker:
    """A person on a walk; the same names and seed give the same walk, bit for bit.

    Parameters
    ----------
    scenario : Scenario or str
    seed : int
        Of the person, the steps, how sensors are worn, and the building.
    manner : Manner, optional
        How steps vary.
    surroundings : Surroundings, optional
    gravity : float
        m/s^2.

    Attributes
    ----------
    end_s : float
        When the walk ends; the person stands from there on, as before time 0.
    air : Weather
    falls : (list of Footfall, list of Footfall)
        Of left and right foot; empty where nobody walks.
    turns : list of (float, float, float)
        Begin and end [s] and angle [rad] of turns on the spot.
    """

    def __init__(
        self,
        scenario: Scenario | str,
        seed: int = 1,
        *,
        manner: Manner | None = None,
        surroundings: Surroundings | None = None,
        gravity: float = STANDARD_GRAVITY,
    ) -> None:
        self.scenario = scenario_of(scenario) if isinstance(scenario, str) else scenario
        around = surroundings or Surroundings()
        manner = manner or Manner()
        steps, left, right, waist, worn, building, air = (
            np.random.default_rng(child) for child in np.random.SeedSequence([seed, 7]).spawn(7)
        )
        self.falls: tuple[list[Footfall], list[Footfall]] = ([], [])
        self.turns: list[tuple[float, float, float]] = []
        self._movers: dict[str, Mover]
        self._placements: dict[str, Placement]
        legs = self.scenario.legs
        if isinstance(legs, Slide):
            slider = Slider(legs.radius_m, legs.angle_deg, legs.rest_s, legs.seconds)
            self.end_s = slider.end_s
            self._movers = dict.fromkeys(PLACES, slider)
            self._placements = dict.fromkeys(PLACES, Placement())
        else:
            plan = plan_steps(legs, manner, steps)
            self.falls, self.turns, self.end_s = plan.feet, plan.turns, plan.end_s
            self._movers = {
                "left-foot": Foot(plan.feet[LEFT], plan.end_s, manner, left),
                "right-foot": Foot(plan.feet[RIGHT], plan.end_s, manner, right),
                "waist": Waist(plan, waist),
            }
            self._placements = {
                place: _worn(BELT if place == "waist" else INSTEP, worn) for place in PLACES
            }
        self._magnetic = building_field(self._way(), building, around.magnetic)
        if not around.magnetic:
            self._magnetic = uniform_field()
        self.air: Weather = (
            still_air()
            if around.still
            else weather(air, self.end_s, around.drift_m_per_min, around.fast_m)
        )
        self._gravity = gravity

    def sensor(self, place: str, placement: Placement | None = None) -> IdealSensor:
        """Return a sensor without errors at a place of `PLACES`.

        Raises
        ------
        ValueError
            If there is no such place.
        """
        if place not in PLACES:
            raise ValueError(f"there is no place {place!r}; take one of {', '.join(PLACES)}.")
        worn = placement or self._placements[place]
        return IdealSensor(self._movers[place], worn, self._magnetic, self._gravity)

    def _way(self) -> FloatArray:
        t = np.linspace(0.0, self.end_s, max(60, int(4 * self.end_s)))
        origin = self._movers["waist"].motion(t).origin
        return np.stack([component.value for component in origin], axis=-1)


def _worn(usual: Placement, rng: np.random.Generator) -> Placement:
    x, y, z = (np.array(usual.turn) + rng.normal(0.0, WORN_ASKEW, 3)).tolist()
    return Placement(usual.lever_m, (x, y, z))
