"""Attitude at rest from the directions of gravity and of the magnetic field."""

from __future__ import annotations

import math

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.gait.start import level_attitude
from imu_rig.rotation import from_rotation_vector, multiply, rotate

LEVEL_SHARE = 0.1
"""A sensor axis whose level part is shorter than this share gives no heading to begin with."""


def triad(force: FloatArray, field: FloatArray | None = None) -> FloatArray:
    """Return the attitude of a sensor at rest: a quaternion, shape (4,), sensor to navigation axes.

    Pitch and roll come from gravity alone, so that iron nearby cannot tilt the result; yaw comes
    from the level part of the field.

    Parameters
    ----------
    force : shape (3,)
        Specific force in sensor axes, any unit: it points up.
    field : shape (3,), optional
        Magnetic field in sensor axes, any unit. Navigation x then points to magnetic north.
        Without it, navigation x points where the sensor's x axis does (its z axis where x is
        nearly vertical), and yaw is 0.
    """
    tilt = level_attitude(force)
    ahead = rotate(tilt, np.array((1.0, 0.0, 0.0)) if field is None else field)
    if field is None and math.hypot(ahead[0], ahead[1]) < LEVEL_SHARE:
        ahead = rotate(tilt, np.array((0.0, 0.0, 1.0)))
    yaw = math.atan2(ahead[1], ahead[0])
    return multiply(from_rotation_vector(np.array((0.0, 0.0, -yaw))), tilt)
