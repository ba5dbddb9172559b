"""The magnetic field of a building: the Earth's, bent by iron in floor, walls and furniture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray

EARTH_UT = (0.0, 22.0, -45.0)
"""The Earth's field with magnetic north to the left of where a walk sets out [uT]."""

SPACING_M = 1.5
"""Iron is about so far apart."""
REACH_M = 3.0
SOFTENING_M = 1.0
"""Half the size of a piece of iron: nearer than this its field does not grow.

Many wide pieces bend the field everywhere; a few small ones in a single spot of a way."""


@dataclass(frozen=True, eq=False)
class MagneticField:
    """A uniform field with magnetized iron in it.

    Attributes
    ----------
    uniform : shape (3,)
        uT, in navigation axes.
    places : shape (k, 3)
        Of the pieces of iron [m].
    moments : shape (k, 3)
        Of the pieces; a moment gives, at distance d along its direction, 2 moment / d^3 [uT m^3].
    """

    uniform: FloatArray
    places: FloatArray
    moments: FloatArray

    def at(self, position: FloatArray) -> FloatArray:
        """Return the field [uT] in navigation axes at places (n, 3)."""
        field = np.tile(self.uniform, (len(position), 1))
        for place, moment in zip(self.places, self.moments, strict=True):
            r = position - place
            size2 = np.einsum("ni,ni->n", r, r) + SOFTENING_M**2
            along = r @ moment
            field += (3.0 * along / size2**2.5)[:, np.newaxis] * r
            field -= (size2**-1.5)[:, np.newaxis] * moment
        return field


GREATEST = 200.0
"""Of the moments, where a way is too short for the field to vary along it [uT m^3]."""


def uniform_field() -> MagneticField:
    """Return the Earth's field where there is no iron."""
    return MagneticField(np.array(EARTH_UT), np.empty((0, 3)), np.empty((0, 3)))


def building_field(
    way: FloatArray, rng: np.random.Generator, disturbance: float = 0.15
) -> MagneticField:
    """Return a field with iron along a way, so that its norm varies there by a given share.

    Parameters
    ----------
    way : shape (n, 3)
        Places of the waist along the walk [m].
    rng : numpy Generator
    disturbance : float
        Standard deviation over mean of the field's norm along the way; 0 for no iron.
    """
    if not disturbance:
        return uniform_field()
    spread = np.ptp(way, axis=0)[:2] + 2.0 * REACH_M
    number = int(np.clip(spread[0] * spread[1] / SPACING_M**2, 6, 400))
    low = way.min(axis=0) - np.array((REACH_M, REACH_M, 1.3))
    high = way.max(axis=0) + np.array((REACH_M, REACH_M, 1.6))
    places = rng.uniform(low, high, (number, 3))
    near = np.min(
        np.linalg.norm(places[:, np.newaxis, :2] - way[np.newaxis, :, :2], axis=-1), axis=1
    )
    places = places[near < REACH_M]
    moments = rng.normal(0.0, 1.0, (len(places), 3)) * rng.lognormal(0.0, 0.5, (len(places), 1))
    uniform = np.array(EARTH_UT)
    low_size, high_size = 0.0, GREATEST
    for _ in range(12):  # the share grows with the moments
        size = 0.5 * (low_size + high_size)
        norm = np.linalg.norm(MagneticField(uniform, places, size * moments).at(way), axis=-1)
        if np.std(norm) / np.mean(norm) < disturbance:
            low_size = size
        else:
            high_size = size
    return MagneticField(uniform, places, low_size * moments)
