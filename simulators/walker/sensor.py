"""What an ideal sensor on a moving part feels: specific force, angular rate, field and pressure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.rotation import from_rotation_vector, multiply, to_matrix
from imu_rig.units import STANDARD_GRAVITY
from simulators.sampling import Means
from simulators.walker.field import MagneticField
from simulators.walker.jets import Vector, add, constant
from simulators.walker.motion import Mover

LONGEST_PANEL_S = 0.01
"""Longest piece over which one rule averages."""
SHORT_PANEL_S, FEW_NODES, NODES = 0.003, 4, 6
"""Pieces so short need few nodes."""


@dataclass(frozen=True)
class Placement:
    """Where a sensor sits on a part of the body.

    Attributes
    ----------
    lever_m : (float, float, float)
        From the part's origin to the sensor, on the part's axes.
    turn : (float, float, float)
        Rotation vector [rad] that turns the sensor's axes into the part's.
    """

    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class SensorMotion:
    """The motion of a sensor at ``n`` moments, and what it feels there.

    Attributes
    ----------
    t : shape (n,)
        Since the begin of the walk [s].
    position, velocity : shape (n, 3)
        In navigation axes [m, m/s].
    attitude : shape (n, 4)
        Quaternion, scalar first, sensor to navigation axes.
    force : shape (n, 3)
        Specific force on the sensor's axes [m/s^2].
    rate : shape (n, 3)
        Angular rate on the sensor's axes [rad/s].
    field : shape (n, 3)
        Magnetic field on the sensor's axes [uT].
    """

    t: FloatArray
    position: FloatArray
    velocity: FloatArray
    attitude: FloatArray
    force: FloatArray
    rate: FloatArray
    field: FloatArray


class IdealSensor:
    """A sensor without errors, fixed on a part of the body.

    The Earth does not turn here: its rate, 0.0042 deg/s, is less than what any of the sensors errs.

    Parameters
    ----------
    mover : Mover
        The part of the body.
    placement : Placement
    magnetic : MagneticField
    gravity : float
        m/s^2.
    """

    def __init__(
        self,
        mover: Mover,
        placement: Placement,
        magnetic: MagneticField,
        gravity: float = STANDARD_GRAVITY,
    ) -> None:
        self.mover = mover
        self._lever = placement.lever_m
        self._turn = from_rotation_vector(np.array(placement.turn))
        self._to_part = to_matrix(self._turn)
        self._magnetic = magnetic
        self._gravity = gravity

    def at(self, t: FloatArray) -> SensorMotion:
        """Return the motion at times [s], shape (n,)."""
        motion = self.mover.motion(t)
        place = add(motion.origin, motion.turned(constant(self._lever, motion.yaw)))
        axes = [motion.turned(constant(axis, motion.yaw)) for axis in _UNITS]
        # Columns are the part's axes in navigation axes, and how fast they turn.
        columns = np.stack([_values(axis) for axis in axes], axis=-1)
        speeds = [np.stack([c.rate for c in axis], axis=-1) for axis in axes]
        x, y, z = np.moveaxis(columns, -1, 0)
        rate = np.stack(
            (_dot(z, speeds[1]), _dot(x, speeds[2]), _dot(y, speeds[0])),
            axis=-1,
        )
        felt = np.stack([c.acceleration for c in place], axis=-1)
        felt[:, 2] += self._gravity
        position = _values(place)
        field = self._magnetic.at(position)
        return SensorMotion(
            t=t,
            position=position,
            velocity=np.stack([c.rate for c in place], axis=-1),
            attitude=multiply(motion.quaternions(), self._turn),
            force=self._on_sensor(columns, felt),
            rate=rate @ self._to_part,
            field=self._on_sensor(columns, field),
        )

    def height(self, t: FloatArray) -> FloatArray:
        """Return how high the sensor is at times [s], shape (n,), in m."""
        motion = self.mover.motion(t)
        lifted = motion.turned(constant(self._lever, motion.yaw))[2]
        return (motion.origin[2] + lifted).value

    def means(self, ends: FloatArray, begin: float) -> Means:
        """Return means over the intervals that end at given times, exact to rounding.

        Each interval is cut where the motion changes its polynomial, so that Gauss' rule meets
        smooth functions only.

        Parameters
        ----------
        ends : shape (n,)
            Increasing [s].
        begin : float
            Begin of the first interval [s].
        """
        edges = np.concatenate(([begin], ends))
        breaks = self.mover.breaks
        inside = breaks[(breaks > edges[0]) & (breaks < edges[-1])]
        number = max(1, int(np.ceil(np.max(np.diff(edges), initial=0.0) / LONGEST_PANEL_S - 1e-9)))
        shares = np.arange(number) / number
        fine = (edges[:-1, np.newaxis] + shares * np.diff(edges)[:, np.newaxis]).ravel()
        cuts = np.unique(np.concatenate((fine, inside, edges[-1:])))
        half = 0.5 * np.diff(cuts)
        middle = 0.5 * (cuts[1:] + cuts[:-1])
        few = bool(np.max(half, initial=0.0) <= 0.5 * SHORT_PANEL_S)
        rule, weights = np.polynomial.legendre.leggauss(FEW_NODES if few else NODES)
        nodes = middle[:, np.newaxis] + half[:, np.newaxis] * rule
        motion = self.at(nodes.ravel())
        felt = np.hstack((motion.force, motion.rate, motion.field)).reshape(len(half), -1, 9)
        panels = np.einsum("pnc,n->pc", felt, weights) * half[:, np.newaxis]
        first = np.searchsorted(cuts, edges[:-1])
        sums = np.add.reduceat(panels, first, axis=0)
        duration = np.diff(edges)
        mean = sums / duration[:, np.newaxis]
        return Means(ends, duration, mean[:, :3], mean[:, 3:6], mean[:, 6:])

    def _on_sensor(self, columns: FloatArray, vectors: FloatArray) -> FloatArray:
        on_part = np.einsum("nij,ni->nj", columns, vectors)
        on_sensor: FloatArray = on_part @ self._to_part
        return on_sensor


_UNITS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _values(vector: Vector) -> FloatArray:
    return np.stack([component.value for component in vector], axis=-1)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = np.einsum("ni,ni->n", a, b)
    return product
