"""How a sensor sits on its foot, found from the foot's own motion.

A foot that lies on the ground shows by gravity which way is up; where it goes from there to its
next footfall shows which way is forward. Whatever the mounting, no person has to align anything.
Knees bend one way only: in its swing a foot hangs toe down far more than it is held toe up, so a
person who walks backward is told from one who walks forward. A foot that points outward as its
owner walks is described with x along the walk, not along the shoe: the two are not told apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.gait.trajectory import Footfalls, Trajectory
from imu_rig.kernels.tracks import rises
from imu_rig.rotation import about_z, conjugate, rotate, to_matrix
from imu_rig.units import DEG

SHORTEST_M = 0.10
"""A foot that is put elsewhere by less than half its own width may have gone anywhere."""
TOE_UP, MORE = float(np.sin(30.0 * DEG)), 1.3
"""A foot that swings toe up by more than 30 deg, and by so many times what it hangs toe down, was
taken for its reverse: a shuffling one does neither."""
WIDEST = 40.0 * DEG
"""Typical deviation between strides above which there is no direction that they share."""


@dataclass(frozen=True, eq=False)
class FootAxes:
    """The axes of a foot: x forward, y left, z up while it lies flat.

    Attributes
    ----------
    rotation : shape (3, 3)
        From sensor to foot axes: ``v_foot = rotation @ v_sensor``.
    strides : int
        From so many x was found.
    spread : float
        Typical deviation of a stride's direction from x [rad]; NaN for fewer than two strides.
    forward_known : bool
        False where x is merely some horizontal direction: there were no strides, or they went
        in no common direction.
    """

    rotation: FloatArray
    strides: int
    spread: float
    forward_known: bool

    @property
    def note(self) -> str | None:
        """What a reader should know, a sentence; None where all is as it should be."""
        if self.forward_known:
            return None
        if self.strides == 0:
            return (
                "No stride says which way the foot points: yaw is that of the sensor, and pitch "
                "and roll cannot be told apart."
            )
        return (
            f"The {self.strides} strides go in no common direction seen from the foot (they "
            f"scatter by {self.spread / DEG:.0f} deg): which way it points is uncertain."
        )


def find_foot_axes(trajectory: Trajectory, footfalls: Footfalls) -> FootAxes:
    """Find the axes of the foot that a sensor sits on, whatever way it was put on.

    Parameters
    ----------
    trajectory : Trajectory
        In any heading.
    footfalls : Footfalls
        Without any, the whole trajectory is taken for a foot that lies flat.
    """
    rows = footfalls.quietest if len(footfalls) else np.arange(len(trajectory))
    to_sensor = conjugate(trajectory.quaternion[rows])
    up = _unit(np.median(rotate(to_sensor, np.array([0.0, 0.0, 1.0])), axis=0))
    # the sensor axis that lies flattest stands in for x until strides say better
    flattest = _unit(np.eye(3)[np.argmin(np.abs(up))] - up[np.argmin(np.abs(up))] * up)
    level = np.stack((flattest, np.cross(up, flattest), up))
    angles, weights = _directions(trajectory.position[rows], to_sensor, level)
    if not len(footfalls) or not len(angles):
        return FootAxes(level, 0, float("nan"), forward_known=False)
    middle = _weighted_median_angle(angles, weights)
    off = np.abs(_wrapped(angles - middle))
    spread = 1.4826 * float(np.median(off)) if len(off) > 1 else float("nan")
    known = len(off) == 1 or spread < WIDEST
    rotation = about_z(-middle) @ level
    if known and _swings_toe_up(trajectory.quaternion, rows, rotation[0]):
        rotation = rotation * np.array([[-1.0], [-1.0], [1.0]])
    return FootAxes(rotation, len(angles), spread, forward_known=known)


def foot_matrices(quaternion: FloatArray, axes: FootAxes) -> FloatArray:
    """Rotation matrices (n, 3, 3) from foot to navigation axes, of a sensor's attitude (n, 4)."""
    return np.asarray(to_matrix(quaternion) @ axes.rotation.T)


def first_heading(trajectory: Trajectory, footfalls: Footfalls, axes: FootAxes) -> float:
    """Direction in which the foot points at its first footfall [rad], 0 for that of x."""
    row = int(footfalls.quietest[0]) if len(footfalls) else 0
    x = foot_matrices(trajectory.quaternion[row], axes)[:, 0]
    return float(np.arctan2(x[1], x[0]))


def _directions(
    places: FloatArray, to_sensor: FloatArray, level: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Angles (m,) of strides from the provisional x, as the foot sees them, and their lengths."""
    moved = np.diff(places, axis=0)
    moved[:, 2] = 0.0
    length = np.linalg.norm(moved, axis=1)
    # A foot that turns by some angle goes by half of it aside of where it pointed, and comes in by
    # half of it the other way: the two together leave nothing of the turn.
    leaving = rotate(to_sensor[:-1], moved) @ level[:2].T
    coming = rotate(to_sensor[1:], moved) @ level[:2].T
    mean = _each_unit(leaving) + _each_unit(coming)
    far = (length >= SHORTEST_M) & (np.linalg.norm(mean, axis=1) > 0.5)
    return np.arctan2(mean[far, 1], mean[far, 0]), length[far]


def _swings_toe_up(quaternion: FloatArray, rows: IntArray, x: FloatArray) -> bool:
    """Whether x (3,), sensor axes, rises in swings more than it falls, so that it is the heel."""
    extremes = np.median(rises(np.ascontiguousarray(quaternion), rows, x), axis=0)
    down, up = -float(extremes[0]), float(extremes[1])
    return up > TOE_UP and up > MORE * down


def _weighted_median_angle(angles: FloatArray, weights: FloatArray) -> float:
    """Angle that has as much weight on either side, near where most of the weight is."""
    start = float(np.angle(np.sum(weights * np.exp(1j * angles))))
    off = _wrapped(angles - start)
    order = np.argsort(off)
    passed = np.cumsum(weights[order])
    # between the last below and the first above one half, so that no side is preferred
    below = order[np.searchsorted(passed, 0.5 * passed[-1] * (1.0 - 1e-12))]
    above = order[np.searchsorted(passed, 0.5 * passed[-1] * (1.0 + 1e-12))]
    return start + 0.5 * float(off[below] + off[above])


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v))


def _each_unit(v: FloatArray) -> FloatArray:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(v / np.where(length > 1e-9, length, 1.0))
