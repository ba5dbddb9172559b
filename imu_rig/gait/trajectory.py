"""The motion of a sensor on a foot as estimated, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import AnyArray, FloatArray, IntArray
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.rotation import about_z, from_rotation_vector, multiply


@dataclass(frozen=True, eq=False)
class Trajectory:
    """``n`` moments of the motion of one sensor, in a navigation frame with z up.

    Attributes
    ----------
    t : shape (n,)
        Time [s].
    quaternion : shape (n, 4)
        Attitude, scalar first, sensor to navigation axes.
    velocity : shape (n, 3)
        Of the sensor [m/s], navigation axes.
    position : shape (n, 3)
        Of the sensor [m], navigation axes.
    """

    t: FloatArray
    quaternion: FloatArray
    velocity: FloatArray
    position: FloatArray

    def __len__(self) -> int:
        """Return the number of moments."""
        return len(self.t)

    def __getitem__(self, rows: slice | AnyArray) -> Trajectory:
        """Return the moments that ``rows`` (a slice, mask or index array) selects."""
        return Trajectory(
            self.t[rows], self.quaternion[rows], self.velocity[rows], self.position[rows]
        )

    def turned(self, yaw: float) -> Trajectory:
        """Return the same motion in axes in which all is turned by ``yaw`` [rad] about z."""
        R = about_z(yaw)
        turn = from_rotation_vector(np.array([0.0, 0.0, yaw]))
        # A product with one quaternion is linear in the other: as a matrix it takes a tenth.
        product = multiply(turn, np.eye(4))
        return replace(
            self,
            quaternion=self.quaternion @ product,
            velocity=self.velocity @ R.T,
            position=self.position @ R.T,
        )

    def moved(self, by: FloatArray) -> Trajectory:
        """Return the same motion with ``by`` (3,) [m] added to every position."""
        return replace(self, position=self.position + by)


@dataclass(frozen=True, eq=False)
class Footfalls:
    """The stays of a foot on the ground, in order; samples are counted from 0.

    Attributes
    ----------
    first, last : shape (k,)
        First and last sample of each zero-velocity interval, both in it.
    quietest : shape (k,)
        The sample in between at which the foot rests most: strides are measured between these.
    """

    first: IntArray
    last: IntArray
    quietest: IntArray

    def __len__(self) -> int:
        """Return the number of footfalls."""
        return len(self.quietest)


@dataclass(frozen=True, eq=False)
class TrajectoryCovariance:
    """Uncertainty of a trajectory at some of its moments.

    Attributes
    ----------
    rows : shape (m,)
        Of the trajectory's samples, ascending; every footfall's quietest sample is among them.
    values : shape (m, 9, 9)
        Covariance of the errors of attitude (a small rotation in navigation axes [rad]), velocity
        [m/s] and position [m], in this order. Position and yaw count from the first row, where
        they are known by definition.
    strides : shape (k - 1, 3, 3)
        Covariance of the displacement [m] from each footfall to the next.
    common : shape (k - 1, p, 3) or None
        What one standard uncertainty of each of ``p`` errors that last through the recording (bias,
        gain and alignment of the sensor) adds to each displacement [m]. It is part of ``strides``,
        ``sum_j common[:, j] common[:, j]'``, and makes strides err alike; what is left is their
        own.
    """

    rows: IntArray
    values: FloatArray
    strides: FloatArray
    common: FloatArray | None = None

    @property
    def heading_sigma(self) -> FloatArray:
        """Standard uncertainty of yaw, shape (m,) [rad]."""
        return np.sqrt(self.values[:, 2, 2])

    @property
    def position_sigma(self) -> FloatArray:
        """Standard uncertainties of position, shape (m, 3) [m]."""
        return np.sqrt(np.diagonal(self.values, axis1=1, axis2=2)[:, 6:9])


@dataclass(frozen=True, eq=False)
class FootTrack:
    """What is known of one foot after a trial.

    Attributes
    ----------
    trajectory : Trajectory
        As long as the recording. It begins at the origin; at the first footfall the foot points
        along x.
    zero_velocity : ZeroVelocity
    footfalls : Footfalls
    gyro_bias, accel_bias : shape (3,)
        Subtracted from the readings, sensor axes [rad/s, m/s^2].
    pivot : shape (3,)
        From the point about which the standing foot rolls to the sensor, sensor axes [m].
    covariance : TrajectoryCovariance or None
        None where it was not asked for.
    notes : tuple of str
        What its reader should know: a sentence each.
    """

    trajectory: Trajectory
    zero_velocity: ZeroVelocity
    footfalls: Footfalls
    gyro_bias: FloatArray
    accel_bias: FloatArray
    pivot: FloatArray
    covariance: TrajectoryCovariance | None = None
    notes: tuple[str, ...] = ()
