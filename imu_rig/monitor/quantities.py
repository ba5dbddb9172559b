"""What a stream measures, named and scaled as people read it: g, deg/s, uT, hPa, degC."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.units import DEG, STANDARD_GRAVITY

HUMAN_UNITS = {
    "m/s2": ("g", 1.0 / STANDARD_GRAVITY),
    "rad/s": ("deg/s", 1.0 / DEG),
    "uT": ("uT", 1.0),
    "Pa": ("hPa", 0.01),
    "mbar": ("hPa", 1.0),
    "degC": ("degC", 1.0),
}
"""Unit of the samples to the unit shown, and units shown per unit of the samples."""

TITLES = {
    "accel": "acceleration",
    "gyro": "angular rate",
    "mag": "magnetic field",
}
FIRST = ("accel", "gyro", "mag", "pressure", "altitude", "temperature")
"""Fields in the order in which they are shown; others follow in the order of the layout."""

SPOKEN = {"uT": "µT", "degC": "°C", "deg/s": "°/s", "m/s2": "m/s²"}
"""Units as they are written for people."""

DECIMALS = {"g": 3, "deg/s": 1, "uT": 1, "hPa": 2, "degC": 1, "m": 1, "V": 2}
USUAL_DECIMALS = 2

SUPPLY_WORDS = ("battery", "supply", "voltage")
UNKNOWN = "raw"  # what a draft of a layout calls numbers that it cannot name
MOST_NUMBERS = 9  # in one quantity; more are a table, not a measurement to look at


@dataclass(frozen=True)
class Quantity:
    """One thing that a stream measures.

    Attributes
    ----------
    name : str
        Of the field.
    unit : str
        In which it is shown.
    factor : float
        Shown units per unit of the samples.
    count : int
        Numbers in it: 3 for axes.
    """

    name: str
    unit: str
    factor: float = 1.0
    count: int = 1

    @property
    def title(self) -> str:
        """What people call it."""
        return TITLES.get(self.name, self.name.replace("_", " "))

    @property
    def spoken_unit(self) -> str:
        """Its unit as it is written for people."""
        return SPOKEN.get(self.unit, self.unit)

    @property
    def decimals(self) -> int:
        """Digits after the point that are worth a look."""
        return DECIMALS.get(self.unit, USUAL_DECIMALS)

    def shown(self, values: Mapping[str, FloatArray]) -> FloatArray:
        """Return its numbers in shown units, shape (n, count)."""
        numbers = np.asarray(values[self.name], dtype=float)
        with np.errstate(over="ignore", invalid="ignore"):
            scaled: FloatArray = numbers.reshape(len(numbers), self.count) * self.factor
        return scaled


def quantities_of(
    values: Mapping[str, FloatArray], units: Mapping[str, str], left_out: Iterable[str] = ()
) -> tuple[Quantity, ...]:
    """Return what is worth watching among the columns of a stream's samples.

    A column without a unit is a count or a flag and is left out, unless nothing else is there or
    its name says that nobody knows yet what it is; so are supplies, which have a place of their
    own.

    Parameters
    ----------
    values, units : mapping
        As of `imu_rig.blocks.Samples`; they may hold no rows.
    left_out : iterable of str
        More names to leave out.
    """
    out = set(left_out)
    found = []
    for name, numbers in values.items():
        count = 1 if numbers.ndim == 1 else int(np.prod(numbers.shape[1:]))
        if name in out or name.startswith(SUPPLY_WORDS) or not 1 <= count <= MOST_NUMBERS:
            continue
        unit, factor = HUMAN_UNITS.get(units.get(name, ""), (units.get(name, ""), 1.0))
        found.append(Quantity(name, unit, factor, count))
    measured = [q for q in found if q.unit or q.name in FIRST or q.name.startswith(UNKNOWN)]
    chosen = measured or found
    places = {name: place for place, name in enumerate(FIRST)}
    return tuple(sorted(chosen, key=lambda q: places.get(q.name, len(FIRST))))
