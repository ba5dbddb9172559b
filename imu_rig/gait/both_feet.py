"""Two feet of one person: never farther apart than a step, which holds their headings together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import DataError
from imu_rig.gait.heading import turned_by
from imu_rig.gait.trajectory import FootTrack
from imu_rig.units import DEG

REACH_M = 1.0
"""The feet of a person who walks are at most this far apart [m] on the plan: a step of 0.8 m and
the width of the hips. With longer strides, 0.6 of a stride and 0.2 m."""
STRIDE_SHARE = 0.6

SIDE_M = 0.2
"""Farthest that two standing feet are apart at the begin [m], in any direction."""

KNOT_S = 5.0
"""Heading drifts are straight between moments this far apart [s]."""

DRIFT = 0.1 * DEG
WANDER = 0.02 * DEG
"""Standard uncertainties of a track's drift of heading [rad/s], and of how much it changes from one
knot to the next [rad/s]: what stills and strides leave of a gyroscope's bias."""

LENGTHS = 0.02
"""By which the lengths of the two sensors may differ [1]: on a long straight way that puts the feet
apart, too, and no heading is to make up for it."""

MOST_SIGMA = 3.0
"""Headings that would have to be turned by more than so many times their uncertainty are left."""

SOFT_M = 0.1
"""By which the limit may be exceeded [m], standard deviation."""

TURN, OFFSET, LENGTH = -4, slice(-3, -1), -1
"""Where the unknowns that are no drifts are: heading and place of the right foot, and the ratio of
lengths."""

ROUNDS = 12
LEAST_S = 5.0


@dataclass(frozen=True, eq=False)
class BothFeet:
    """Two tracks in one frame.

    Attributes
    ----------
    left, right : FootTrack
        The left one's axes and first heading are kept.
    turned : float
        By which the right one was turned as a whole [rad].
    drift : tuple of FloatArray
        Corrections of the headings of left and right, per sample [rad].
    apart_before, apart_after : float
        Farthest that the feet were apart on the plan [m]: with one begin and one first heading,
        and now, but for a difference of the lengths that the two sensors measure.
    note : str
        What was done, a sentence.
    """

    left: FootTrack
    right: FootTrack
    turned: float
    drift: tuple[FloatArray, FloatArray]
    apart_before: float
    apart_after: float
    note: str


@dataclass(frozen=True, eq=False)
class _Way:
    """One foot's way at common moments."""

    track: FootTrack
    moments: FloatArray
    place: FloatArray
    knots: FloatArray

    def bent(self, drift: FloatArray) -> FloatArray:
        """Return its places with its heading corrected by ``drift`` at the knots, (k,) [rad]."""
        angle = np.interp(self.moments, self.knots, drift)
        step = np.diff(self.place, axis=0)
        half = 0.5 * (angle[1:] + angle[:-1])
        c, s = np.cos(half), np.sin(half)
        turned = np.stack((c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1]), 1)
        return np.concatenate((np.zeros((1, 2)), np.cumsum(turned, axis=0)))


def join_feet(left: FootTrack, right: FootTrack, *, reach_m: float | None = None) -> BothFeet:
    """Put two feet into one frame and let each hold the other's heading.

    Each track has a heading of its own, and loses it slowly. The feet are never farther apart than
    a step; where they come out so, the least change of both headings is looked for that brings
    them back: Gauss-Newton over heading drifts at knots, the first heading of the right foot and
    the offset between the feet at the begin, with a penalty beyond the limit only.

    Parameters
    ----------
    left, right : FootTrack
        On one clock, of walks that begin with both feet side by side.
    reach_m : float, optional
        The limit [m]; by default from the longest strides of the two.

    Raises
    ------
    DataError
        If the two hardly overlap in time.
    """
    begin = max(left.trajectory.t[0], right.trajectory.t[0])
    end = min(left.trajectory.t[-1], right.trajectory.t[-1])
    if end - begin < LEAST_S:
        raise DataError(
            f"the feet have only {max(end - begin, 0.0):.1f} s in common; put both on one clock"
        )
    reach = _reach(left, right) if reach_m is None else reach_m
    moments = np.arange(begin, end, 0.1)
    knots = np.linspace(begin, end, max(2, int(np.ceil((end - begin) / KNOT_S)) + 1))
    ways = tuple(_Way(track, moments, _places(track, moments), knots) for track in (left, right))
    x0 = np.zeros(2 * len(knots) + 4)
    x0[TURN] = _first_turn(ways[0].place, ways[1].place)
    before = _apart(ways, x0)
    x = _solved(ways, x0, reach, knots)
    after = _apart(ways, x)
    k = len(knots)
    likely = MOST_SIGMA * DRIFT * (end - begin)
    if after.max() >= before.max() or np.abs(x[: 2 * k]).max() > likely:
        x, after = x0, before
    drifts = x[:k], x[k : 2 * k]
    angles = tuple(
        np.interp(track.trajectory.t, knots, drift)
        for track, drift in zip((left, right), drifts, strict=True)
    )
    whole = angles[1] + x[TURN]
    l_track, r_track = turned_by(left, angles[0]), turned_by(right, whole)
    first = [
        np.array([np.interp(begin, p.t, p.position[:, a]) for a in range(3)])
        for p in (l_track.trajectory, r_track.trajectory)
    ]
    shift = first[0] - first[1]
    shift[:2] += x[OFFSET]
    r_track = replace(r_track, trajectory=r_track.trajectory.moved(shift))
    turned = max(float(np.abs(angle).max()) for angle in angles)
    note = (
        f"the feet came out up to {before.max():.1f} m apart, where {reach:.1f} m is possible; "
        f"turning their headings by up to {turned / DEG:.1f} deg makes it {after.max():.1f} m"
    )
    return BothFeet(
        l_track, r_track, float(x[TURN]), (angles[0], angles[1]), float(before.max()),
        float(after.max()), note,
    )  # fmt: skip


def _reach(left: FootTrack, right: FootTrack) -> float:
    longest = [REACH_M]
    for track in (left, right):
        steps = np.diff(track.trajectory.position[track.footfalls.quietest, :2], axis=0)
        if len(steps):
            longest.append(0.6 * float(np.percentile(np.linalg.norm(steps, axis=1), 90)) + 0.2)
    return max(longest)


def _places(track: FootTrack, moments: FloatArray) -> FloatArray:
    t, position = track.trajectory.t, track.trajectory.position
    place = np.stack([np.interp(moments, t, position[:, axis]) for axis in (0, 1)], axis=1)
    return np.asarray(place - place[0])


def _first_turn(left: FloatArray, right: FloatArray) -> float:
    """Return by how much the right way is turned to lie along the left one at its begin [rad]."""
    far = np.flatnonzero(np.hypot(left[:, 0], left[:, 1]) > 3.0)
    some = slice(None, int(far[0]) if len(far) else None)
    product = (left[some] @ np.array([1.0, -1.0j])) * (right[some] @ np.array([1.0, 1.0j]))
    return float(-np.angle(product.sum())) if np.abs(product).sum() > 0.0 else 0.0


def _between(ways: tuple[_Way, ...], x: FloatArray) -> FloatArray:
    """Return from the left to the right foot at each moment, shape (n, 2)."""
    k = len(ways[0].knots)
    left, right = ways[0].bent(x[:k]), ways[1].bent(x[k : 2 * k] + x[TURN])
    half = 0.5 * x[LENGTH]
    return np.asarray((1.0 + half) * right + x[OFFSET] - (1.0 - half) * left)


def _apart(ways: tuple[_Way, ...], x: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(_between(ways, x), axis=1))


def _residual(ways: tuple[_Way, ...], x: FloatArray, reach: float) -> FloatArray:
    k = len(ways[0].knots)
    step = ways[0].knots[1] - ways[0].knots[0]
    parts = [np.maximum(_apart(ways, x) - reach, 0.0) / SOFT_M * np.sqrt(0.1)]
    for drift in (x[:k], x[k : 2 * k]):
        rate = np.diff(drift) / step
        parts += [drift[:1] / (0.01 * DEG), [rate.mean() / DRIFT], np.diff(rate) / WANDER]
    parts += [x[OFFSET] / SIDE_M, [x[LENGTH] / LENGTHS]]
    return np.concatenate(parts)


def _solved(ways: tuple[_Way, ...], x0: FloatArray, reach: float, knots: FloatArray) -> FloatArray:
    x = x0.copy()
    value = _residual(ways, x, reach)
    for _ in range(ROUNDS):
        J = np.empty((len(value), len(x)))
        for column in range(len(x)):
            moved = x.copy()
            moved[column] += 1e-5
            J[:, column] = (_residual(ways, moved, reach) - value) / 1e-5
        change = np.linalg.lstsq(J, -value, rcond=None)[0]
        for shrink in (1.0, 0.5, 0.25, 0.1):
            tried = _residual(ways, x + shrink * change, reach)
            if tried @ tried < value @ value:
                break
        else:
            break
        x, value = x + shrink * change, tried
    return x
