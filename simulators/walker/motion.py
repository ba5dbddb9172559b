"""A rigid part of the body that moves: position and attitude as functions of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.rotation import multiply
from simulators.walker.jets import Jet, Vector, cosine, sine


@dataclass(frozen=True, eq=False)
class Motion:
    """Position and attitude at ``n`` moments, with their derivatives.

    The attitude turns x forward, y left, z up of the part into navigation axes: first roll about
    x, then pitch about y (x down positive), then yaw about z.

    Attributes
    ----------
    origin : Vector
        Of the part's origin [m].
    yaw, pitch, roll : Jet
        rad.
    """

    origin: Vector
    yaw: Jet
    pitch: Jet
    roll: Jet

    def turned(self, vector: Vector) -> Vector:
        """Turn a vector on the part's axes into navigation axes."""
        turns = [(cosine(angle), sine(angle)) for angle in (self.roll, self.pitch, self.yaw)]
        x, y, z = vector
        (c, s) = turns[0]
        y, z = c * y - s * z, s * y + c * z
        (c, s) = turns[1]
        x, z = c * x + s * z, c * z - s * x
        (c, s) = turns[2]
        return c * x - s * y, s * x + c * y, z

    def quaternions(self) -> FloatArray:
        """Return the attitude, part to navigation axes, shape (n, 4)."""
        halves = [0.5 * angle.value for angle in (self.yaw, self.pitch, self.roll)]
        zero = np.zeros_like(halves[0])
        (cz, sz), (cy, sy), (cx, sx) = ((np.cos(half), np.sin(half)) for half in halves)
        about_z = np.stack((cz, zero, zero, sz), axis=-1)
        about_y = np.stack((cy, zero, sy, zero), axis=-1)
        about_x = np.stack((cx, sx, zero, zero), axis=-1)
        return multiply(multiply(about_z, about_y), about_x)


class Mover(Protocol):
    """Whatever has a motion."""

    breaks: FloatArray
    """Times [s] at which the motion is only so smooth; between them it has every derivative."""

    def motion(self, t: FloatArray) -> Motion:
        """Return the motion at times [s], shape (n,)."""
        ...

    def phase(self, t: FloatArray) -> IntArray:
        """Return a `simulators.walker.truth.Phase` for every time, shape (n,)."""
        ...
