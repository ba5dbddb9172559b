"""An estimated path brought into the frame of a reference, and what errors are left.

An inertial path has no heading of its own and begins at its own origin; a reference has axes that
its makers chose. Both agree on which way is up. So the best turn about the vertical and the best
shift are taken out, and nothing else: no scale, no tilt.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import DataError
from imu_rig.reference.handedness import TO_MIRRORED, TO_Z_DOWN, Handedness, check_hands
from imu_rig.reference.lever import attitude_at, fit_lever_arm
from imu_rig.reference.planar import fit_plane, root_mean_square, turned
from imu_rig.reference.reference import Reference
from imu_rig.reference.time_offset import find_time_offset
from imu_rig.units import DEG

FEWEST = 10
"""Places that both must have; fewer would be fitted by anything."""
LEAST_M = 0.1
"""A path that stays within less has no heading."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """A path beside its reference, in the reference's axes, at the reference's times.

    Attributes
    ----------
    t : shape (n,)
        Times on the reference's clock at which both have a place [s].
    estimate, reference : shape (n, 3)
        Places [m].
    yaw : float
        By which the estimate was turned about z [rad].
    translation : shape (3,)
        By which it was shifted after that [m].
    time_offset : float
        Added to the reference's times to find the estimate's [s].
    lever : shape (3,) or None
        From the sensor to the marker, sensor axes [m], where it was fitted.
    coverage : float
        Share of the reference's samples that count: the rest is lost or outside the recording.
    hands : Handedness
        Whether the reference fits better with other signs.
    turned_axes : str
        Axes of the reference whose sign was turned because its user said so, such as "y".
    notes : tuple of str
    """

    t: FloatArray
    estimate: FloatArray
    reference: FloatArray
    yaw: float
    translation: FloatArray
    time_offset: float
    lever: FloatArray | None
    coverage: float
    hands: Handedness
    turned_axes: str = ""
    notes: tuple[str, ...] = ()

    @property
    def errors(self) -> FloatArray:
        """Estimate less reference, shape (n, 3) [m]."""
        return self.estimate - self.reference

    @property
    def rmse(self) -> FloatArray:
        """Root mean square error of each axis, shape (3,) [m]."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=0)))

    @property
    def rmse_horizontal(self) -> float:
        """Root mean square of the distance on the plan [m]."""
        return root_mean_square(self.errors[:, :2])

    @property
    def rmse_vertical(self) -> float:
        """Root mean square error of height [m]."""
        return float(self.rmse[2])

    @property
    def largest_horizontal(self) -> float:
        """Largest distance on the plan [m]."""
        return float(np.max(np.linalg.norm(self.errors[:, :2], axis=1)))

    @property
    def end_error(self) -> float:
        """Distance in space at the last time [m]."""
        return float(np.linalg.norm(self.errors[-1]))

    @property
    def closure(self) -> float:
        """By how much the way from begin to end differs in space [m]: no fit of places in it."""
        return float(np.linalg.norm(self.errors[-1] - self.errors[0]))

    def to_dict(self) -> dict[str, Any]:
        """Return all figures in SI units, for JSON."""
        return {
            "samples": len(self.t),
            "coverage": self.coverage,
            "rmse_horizontal_m": self.rmse_horizontal,
            "rmse_vertical_m": self.rmse_vertical,
            "rmse_m": self.rmse.tolist(),
            "largest_horizontal_m": self.largest_horizontal,
            "end_error_m": self.end_error,
            "closure_m": self.closure,
            "yaw_rad": self.yaw,
            "translation_m": self.translation.tolist(),
            "time_offset_s": self.time_offset,
            "lever_m": None if self.lever is None else self.lever.tolist(),
            "turned_axes": self.turned_axes,
            "hands": self.hands.to_dict(),
            "notes": list(self.notes),
        }

    def lines(self) -> list[str]:
        """Return the figures as text."""
        x, y, z = self.rmse
        told = [
            f"horizontal  {self.rmse_horizontal:.3f} m RMSE, at most "
            f"{self.largest_horizontal:.3f} m",
            f"per axis    {x:.3f} {y:.3f} {z:.3f} m RMSE in x, y, z of the reference",
            f"end         {self.end_error:.3f} m off, closure {self.closure:.3f} m",
            f"fitted      yaw {self.yaw / DEG:.2f} deg and the shift; "
            f"{len(self.t)} places, {100 * self.coverage:.0f} % of the reference",
        ]
        if self.time_offset:
            told.append(f"time        reference {self.time_offset:+.3f} s later")
        if self.lever is not None:
            a, b, c = 100 * self.lever
            told.append(f"marker      {a:.1f} {b:.1f} {c:.1f} cm from the sensor, fitted")
        return told + list(self.notes)


def align(
    t: FloatArray,
    position: FloatArray,
    reference: Reference,
    *,
    mirrored: bool = False,
    z_down: bool = False,
    search_offset_s: float = 0.0,
    quaternion: FloatArray | None = None,
    fit_lever: bool = False,
) -> Alignment:
    """Fit yaw and shift of a path to a reference, and return what is left.

    Parameters
    ----------
    t : shape (n,)
        Times of the estimate [s], not decreasing.
    position : shape (n, 3)
        Estimate [m], z up.
    reference : Reference
        With positions.
    mirrored : bool
        The reference is left-handed: the sign of its y is turned.
    z_down : bool
        Its z points down: the signs of its y and z are turned, which keeps its hand.
    search_offset_s : float
        The clocks may differ by up to so much [s]; 0: they are the same.
    quaternion : shape (n, 4), optional
        Attitude of the estimate; for the lever arm.
    fit_lever : bool
        Whether to fit where on the foot the marker sits. A fit to the truth: for a report of what
        else would differ, not for the error itself.

    Raises
    ------
    DataError
        No positions, too few that overlap, or paths that go nowhere.
    """
    if reference.position is None:
        raise DataError("the reference has no positions; take one that has")
    if fit_lever and quaternion is None:
        raise DataError("fitting where the marker sits needs the attitude of the sensor")
    sign = np.ones(3)
    sign *= TO_MIRRORED if mirrored else 1.0
    sign *= TO_Z_DOWN if z_down else 1.0
    times, places = _there(reference, sign)
    offset = 0.0
    notes: list[str] = []
    if search_offset_s > 0.0:
        _require_way(position, "estimated path")
        offset, at_edge = find_time_offset(t, position, times, places, search_offset_s)
        if at_edge:
            notes.append(
                f"The best time offset is at the bound of the search ({offset:+.3f} s): search "
                "farther, or check that both files are of one trial."
            )
    inside = (times + offset >= t[0]) & (times + offset <= t[-1]) if len(t) else times < times
    if np.count_nonzero(inside) < FEWEST:
        raise DataError(_no_overlap(t, times, int(np.count_nonzero(inside))))
    times, places = times[inside], places[inside]
    _require_way(places, "reference")
    at = times + offset
    path = np.column_stack([np.interp(at, t, column) for column in position.T])
    hands = check_hands(path, places)
    if hands.sentence is not None:
        notes.append(hands.sentence)
    lever = None
    if fit_lever and quaternion is not None:
        R = attitude_at(t, quaternion, at)
        lever = fit_lever_arm(path, R, places)
        path = path + R @ lever
    yaw, translation = fit_plane(path, places)
    return Alignment(
        t=times,
        estimate=turned(path, yaw) + translation,
        reference=places,
        yaw=yaw,
        translation=translation,
        time_offset=offset,
        lever=lever,
        coverage=len(times) / len(reference),
        hands=hands,
        turned_axes="".join(axis for axis, s in zip("xyz", sign, strict=True) if s < 0.0),
        notes=tuple(notes),
    )


def _there(reference: Reference, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times and places of the reference where it has them, with signs turned."""
    if reference.position is None:
        return np.zeros(0), np.zeros((0, 3))
    known = np.all(np.isfinite(reference.position), axis=1) & np.isfinite(reference.t)
    return reference.t[known], reference.position[known] * sign


def _require_way(places: FloatArray, what: str) -> None:
    if np.max(np.ptp(places[:, :2], axis=0)) < LEAST_M:
        raise DataError(
            f"the {what} stays within {100 * LEAST_M:.0f} cm, so it has no heading to compare; "
            "take a trial with a walk"
        )


def _no_overlap(t: FloatArray, times: FloatArray, count: int) -> str:
    if not len(times):
        return "the reference has no sample with a position; check which marker was read"
    if not len(t):
        return "the estimate is empty; nothing can be compared"
    return (
        f"the reference ({times[0]:.2f} to {times[-1]:.2f} s) and the estimate ({t[0]:.2f} to "
        f"{t[-1]:.2f} s) share {count} places, fewer than {FEWEST}; check the unit of time, or "
        "search for a time offset"
    )
