"""The jig's kinematics: from joint angles to attitude, specific force and angular rate.

Joints in order from the base: pan about z, tilt about y, roll about x, and three small ones, about
x, y and z, for the wobble of a pose. Between them stand constant rotations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.rotation import about_x, about_y, about_z, from_rotation_vector, to_matrix
from imu_rig.units import DEG
from simulators.models import JigModel, Vector3

JOINTS = 6
SERVO_JOINTS = 3
JOINT_AXES = (2, 1, 0, 0, 1, 2)
"""Axis of each joint: 0 is x, 1 is y, 2 is z."""

_RATE, _ACCELERATION, _UP, _EARTH, _FIELD = range(5)
_ABOUT = (about_x, about_y, about_z)


@dataclass(frozen=True)
class Motion:
    """What the place of the sensor undergoes, in sensor axes, one row per instant.

    Attributes
    ----------
    force : shape (n, 3)
        Specific force [m/s^2]: at rest gravity's reaction, upward.
    rate : shape (n, 3)
        Angular rate against inertial space [rad/s].
    field : shape (n, 3)
        Magnetic field [uT].
    """

    force: FloatArray
    rate: FloatArray
    field: FloatArray


class Jig:
    """Geometry of one jig at one place on Earth.

    Parameters
    ----------
    model : JigModel
    gravity : float
        Local gravity [m/s^2].
    earth_rate, field : three numbers
        Rotation of the Earth [rad/s] and magnetic field [uT] in navigation axes.
    """

    def __init__(
        self, model: JigModel, *, gravity: float, earth_rate: Vector3, field: Vector3
    ) -> None:
        self.model = model
        skew_tilt = about_x(model.tilt_skew_deg * DEG)
        skew_roll = about_z(model.roll_skew_deg * DEG)
        base = _rotation((*model.base_tilt_deg, 0.0))
        self._mounting: FloatArray = skew_roll.T @ _rotation(model.mounting_deg)
        self._before: tuple[FloatArray | None, ...] = (
            base,
            skew_tilt,
            skew_tilt.T @ skew_roll,
            self._mounting,
            None,
            None,
        )
        self._lever = np.array(model.lever_arm_m)
        self._nav = np.zeros((3, 5, 1))
        self._nav[2, _UP] = gravity
        self._nav[:, _EARTH, 0] = earth_rate
        self._nav[:, _FIELD, 0] = field

    def attitude(self, angles: FloatArray) -> FloatArray:
        """Return rotation matrices body to navigation, shape (n, 3, 3), of joint angles (n, 6)."""
        matrix = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
        for joint, (before, axis) in enumerate(zip(self._before, JOINT_AXES, strict=True)):
            if before is not None:
                matrix = matrix @ before
            matrix = matrix @ _ABOUT[axis](angles[:, joint])
        return matrix

    def position(self, angles: FloatArray) -> FloatArray:
        """Return where the sensor is in navigation axes [m], shape (n, 3)."""
        position: FloatArray = self.attitude(angles) @ self._lever
        return position

    def motion(self, angles: FloatArray, rates: FloatArray, accelerations: FloatArray) -> Motion:
        """Return what the sensor undergoes; all arguments have shape (n, 6), in radians.

        Rate and angular acceleration are carried outward from joint to joint, together with the
        directions of gravity, the Earth's axis and the magnetic field:
        ``w' = R'w + q e``, ``a' = R'a + q (R'w x e) + p e`` with joint rate q, acceleration p and
        axis e. The force is ``up + a x r + w x (w x r)`` at the lever arm r.
        """
        number = len(angles)
        moving = SERVO_JOINTS if _at_rest(rates, accelerations) else JOINTS
        cos, sin = np.cos(angles).T, np.sin(angles).T
        rate_rows, acceleration_rows = rates.T, accelerations.T
        carried = np.broadcast_to(self._nav, (3, 5, number))
        for joint, (before, axis) in enumerate(
            zip(self._before[:moving], JOINT_AXES[:moving], strict=True)
        ):
            if before is not None:
                carried = (before.T @ carried.reshape(3, -1)).reshape(3, 5, number)
            first, second = (axis + 1) % 3, (axis + 2) % 3
            c, s = cos[joint], sin[joint]
            turned = np.empty((3, 5, number))
            turned[axis] = carried[axis]
            turned[first] = c * carried[first] + s * carried[second]
            turned[second] = c * carried[second] - s * carried[first]
            q = rate_rows[joint]
            turned[axis, _ACCELERATION] += acceleration_rows[joint]
            turned[first, _ACCELERATION] += q * turned[second, _RATE]
            turned[second, _ACCELERATION] -= q * turned[first, _RATE]
            turned[axis, _RATE] += q
            carried = turned
        if moving < JOINTS:
            mounted = self._mounting @ _wobble(*angles[0, SERVO_JOINTS:].tolist())
            carried = (mounted.T @ carried.reshape(3, -1)).reshape(3, 5, number)
        w, a = carried[:, _RATE], carried[:, _ACCELERATION]
        lever = self._lever[:, np.newaxis]
        force = carried[:, _UP] + _cross(a, lever) + _cross(w, _cross(w, lever))
        return Motion(force.T, (w + carried[:, _EARTH]).T, carried[:, _FIELD].T)


def _at_rest(rates: FloatArray, accelerations: FloatArray) -> bool:
    """Return whether the joints of the wobble stand still, as they do most of the time."""
    return not (rates[:, SERVO_JOINTS:].any() or accelerations[:, SERVO_JOINTS:].any())


@lru_cache(maxsize=4)
def _wobble(x: float, y: float, z: float) -> FloatArray:
    return about_x(x) @ about_y(y) @ about_z(z)


def _rotation(vector_deg: Vector3) -> FloatArray:
    return to_matrix(from_rotation_vector(np.array(vector_deg) * DEG))


def _cross(u: FloatArray, v: FloatArray) -> FloatArray:
    """Cross product along the first axis; numpy's own is slow for short arrays."""
    return np.stack(
        (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    )
