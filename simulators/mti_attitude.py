"""The orientation that a simulated MTi computes: a stand-in for its filter, which nobody knows.

The rate of turn is integrated; the accelerometer and the magnetometer draw the result slowly to
where they say that up and north are (Mahony's complementary filter).
"""

from __future__ import annotations

import math

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import FloatArray
from imu_rig.units import STANDARD_GRAVITY

CORRECTION = 0.5
"""Share of the error of up and north that is taken away per second."""

STEADY = 0.1
"""Share of 1 g by which the force may differ from it and still tell where up is."""


class Attitude:
    """Orientation of the sensor in east, north, up, sample after sample."""

    def __init__(self) -> None:
        self._q: tuple[float, float, float, float] | None = None

    def follow(
        self, accel: FloatArray, gyro: FloatArray, mag: FloatArray, period_s: float
    ) -> FloatArray:
        """Return the quaternions of the next samples, shape (n, 4), from sensor to earth."""
        found = np.empty((len(accel), 4))
        rows = zip(accel.tolist(), gyro.tolist(), mag.tolist(), strict=True)
        for place, (force, rate, field) in enumerate(rows):
            if self._q is None:
                self._q = _level(np.array(force), np.array(field))
            else:
                self._q = _next(self._q, force, rate, field, period_s)
            found[place] = self._q
        return found


def _level(force: FloatArray, field: FloatArray) -> tuple[float, float, float, float]:
    """Return the orientation that force and field alone tell."""
    up = force / (np.linalg.norm(force) or 1.0)
    east = np.cross(field, up)
    if np.linalg.norm(east) < 1e-6:
        return 1.0, 0.0, 0.0, 0.0
    east /= np.linalg.norm(east)
    matrix = np.stack([east, np.cross(up, east), up])
    w, x, y, z = rotation.from_rotation_vector(rotation.vector_of_matrix(matrix)).tolist()
    return w, x, y, z


def _next(
    q: tuple[float, float, float, float],
    force: list[float],
    rate: list[float],
    field: list[float],
    period_s: float,
) -> tuple[float, float, float, float]:
    """Return the orientation one sample later; plain numbers, as it is done for each sample."""
    w, x, y, z = q
    up = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    ex = ey = ez = 0.0
    size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    if abs(size / STANDARD_GRAVITY - 1.0) < STEADY:
        a, b, c = (part / size for part in force)
        ex, ey, ez = b * up[2] - c * up[1], c * up[0] - a * up[2], a * up[1] - b * up[0]
    east = (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y))
    north = (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x))
    to_east = sum(m * e for m, e in zip(field, east, strict=True))
    to_north = sum(m * n for m, n in zip(field, north, strict=True))
    level = math.hypot(to_east, to_north)
    if level > 1e-9:
        turn = to_east / level  # about up: north is east of where it was thought to be
        ex, ey, ez = ex + turn * up[0], ey + turn * up[1], ez + turn * up[2]
    half = 0.5 * period_s
    dx = half * (rate[0] + CORRECTION * ex)
    dy = half * (rate[1] + CORRECTION * ey)
    dz = half * (rate[2] + CORRECTION * ez)
    angle = math.sqrt(dx * dx + dy * dy + dz * dz)
    part = math.sin(angle) / angle if angle > 1e-12 else 1.0
    cw, cx, cy, cz = math.cos(angle), part * dx, part * dy, part * dz
    return (
        w * cw - x * cx - y * cy - z * cz,
        w * cx + x * cw + y * cz - z * cy,
        w * cy - x * cz + y * cw + z * cx,
        w * cz + x * cy - y * cx + z * cw,
    )
