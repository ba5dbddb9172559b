"""When a foot leaves the ground and meets it again, from how its sensor moves.

As long as a foot touches the ground it turns about a point of itself: heel, ball or toes. That
point lies below the sensor and no farther away than the foot is long, so the sensor goes no faster
than the foot turns, times that reach. A foot in the air is faster, or hangs from knee and hip and
turns about a point above the sensor. This holds for any mounting, walking or running, on stairs
and slopes, and asks for no threshold of a person.

The reach is that of a long foot. A heel is nearer to the sensor, so that contacts come early: by 15
to 21 ms on simulated feet at any pace, and alike from step to step within 2 ms. Toe-off lies 13 ms
early in a shuffle, right in walking, and 40 ms late in a run, when the foot whirls while it leaves,
with 3 to 12 ms from step to step. A runner's stance so seems longer by 7 % of the stride than its
31 to 35 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.gait.trajectory import Footfalls, Trajectory
from imu_rig.rotation import conjugate, multiply, to_rotation_vector

REACH_M = 0.25
"""From a sensor on the foot to the end of the shoe that is farthest from it: no more than this."""
SLACK_MS = 0.05
"""The speed of a foot that touches the ground is known so well, shoe and skin included."""


@dataclass(frozen=True, eq=False)
class GroundContacts:
    """Begin and end of the swing between two footfalls, for all pairs of neighbours.

    Attributes
    ----------
    toe_off, contact : shape (k - 1,)
        When the foot leaves the ground and when it meets it again [s]; NaN where it never left.
    """

    toe_off: FloatArray
    contact: FloatArray


def find_contacts(trajectory: Trajectory, footfalls: Footfalls) -> GroundContacts:
    """Find when the foot leaves the ground and meets it between its footfalls.

    Parameters
    ----------
    trajectory : Trajectory
    footfalls : Footfalls

    Returns
    -------
    GroundContacts
        Between samples by linear interpolation.
    """
    t = trajectory.t
    speed = np.linalg.norm(trajectory.velocity, axis=1)
    rate = angular_rate(trajectory)
    # the point about which it turns lies at rate x velocity / |rate|^2 from the sensor
    below = np.cross(rate, trajectory.velocity)[:, 2] < 0.0
    excess = speed - np.where(below, REACH_M * np.linalg.norm(rate, axis=1), 0.0) - SLACK_MS
    count = max(len(footfalls) - 1, 0)
    toe_off, contact = np.full(count, np.nan), np.full(count, np.nan)
    for i in range(count):
        begin, end = int(footfalls.last[i]), int(footfalls.first[i + 1])
        if end <= begin + 1:
            continue
        peak = begin + int(np.argmax(speed[begin : end + 1]))
        if excess[peak] <= 0.0:
            continue
        held = np.flatnonzero(excess[begin:peak] <= 0.0)
        toe_off[i] = _crossing(t, excess, begin + int(held[-1])) if len(held) else t[begin]
        free = np.flatnonzero(excess[peak : end + 1] > 0.0)
        after = peak + int(free[-1])
        contact[i] = _crossing(t, excess, after) if after < end else t[end]
    return GroundContacts(toe_off, contact)


def angular_rate(trajectory: Trajectory) -> FloatArray:
    """Angular rate, shape (n, 3) [rad/s], navigation axes, from the attitudes before and after."""
    t, q = trajectory.t, trajectory.quaternion
    n = len(t)
    after, before = np.minimum(np.arange(n) + 1, n - 1), np.maximum(np.arange(n) - 1, 0)
    turned = to_rotation_vector(multiply(q[after], conjugate(q[before])))
    took = (t[after] - t[before])[:, None]
    return np.asarray(np.where(took > 0.0, turned / np.where(took > 0.0, took, 1.0), 0.0))


def _crossing(t: FloatArray, excess: FloatArray, row: int) -> float:
    """Time between ``row`` and the next at which the excess is zero."""
    a, b = float(excess[row]), float(excess[row + 1])
    share = a / (a - b) if a != b else 0.0
    return float(t[row] + share * (t[row + 1] - t[row]))
