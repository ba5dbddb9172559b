"""Two feet of one person: never farther apart than a step, which holds their headings together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import DataError
from imu_rig.gait.distance_uncertainty import distance_sigma
from imu_rig.gait.heading import turned_by
from imu_rig.gait.holding import RATIO, TURN, Pair, Way
from imu_rig.gait.trajectory import FootTrack
from imu_rig.rotation import to_matrix
from imu_rig.units import DEG

REACH_M = 1.0
"""The feet of a person who walks are at most this far apart [m] on the plan: a step of 0.8 m and
the width of the hips. With longer strides, `STRIDE_SHARE` of a stride and `HIPS_M`."""
STRIDE_SHARE, HIPS_M = 0.6, 0.2

SLACK_M = 0.3
"""Beyond their reach by less than this, feet count as held: single steps are longer than others."""

SIDE_M = 0.15
"""So far to the right of the left foot does a standing person's right one lie [m]."""

DRIFT, LEAST_DRIFT = 0.1 * DEG, 0.03 * DEG
"""Standard uncertainty of a track's drift of heading [rad/s] where the track does not tell, and the
least in any case: what stills and strides leave of a gyroscope's bias."""

WANDER = 0.1 * DEG
"""By which a heading wanders besides [rad/sqrt(s)], at least."""

LENGTH = 0.01
"""By which the lengths of a sensor may be wrong beside what its track tells [1]: on a long straight
way that puts the feet apart, too, and no heading is to make up for it."""

MOST_SIGMA = 4.0
"""Corrections that are larger than so many times their standard uncertainty are none."""

KNOT_S, MOST_KNOTS = 5.0, 60
"""Heading drifts are straight between moments this far apart [s], and so many at most."""
MOMENT_S, MOST_MOMENTS = 0.1, 3000
"""The feet are compared this often [s], and so many times at most."""

LEAST_S = 5.0
FIRST_WAY_M = 3.0


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
    scale : tuple of float
        By which left and right ways were made longer or shorter.
    apart_before, apart_after : float
        Farthest that the feet were apart on the plan [m]: with one begin and one first heading,
        and now.
    reach : float
        Farthest that they can be [m].
    held : bool
        Whether they are within reach of each other now.
    note : str
        What was done, or could not be done, a sentence; empty where nothing had to be.
    """

    left: FootTrack
    right: FootTrack
    turned: float
    drift: tuple[FloatArray, FloatArray]
    scale: tuple[float, float]
    apart_before: float
    apart_after: float
    reach: float
    held: bool
    note: str


def join_feet(left: FootTrack, right: FootTrack, *, reach_m: float | None = None) -> BothFeet:
    """Put two feet into one frame and let each hold the other's heading.

    Each track has a heading of its own, and loses it slowly. The feet are never farther apart than
    a step, and pass each other in every stride; where they come out farther apart, the likeliest
    corrections of both ways are looked for that bring them back (`imu_rig.gait.holding`), by what
    each track knows of its heading and its lengths.

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
    moments = np.linspace(begin, end, min(MOST_MOMENTS, int((end - begin) / MOMENT_S)) + 1)
    count = int(np.clip(np.ceil((end - begin) / KNOT_S), 1, MOST_KNOTS)) + 1
    knots = np.linspace(begin, end, count)
    ways = [_way(track, moments, knots) for track in (left, right)]
    facing = _facing(left)[0]
    side = SIDE_M * np.array([np.sin(facing), -np.cos(facing)])
    pair = Pair(
        ways[0],
        ways[1],
        float(moments[1] - moments[0]),
        reach,
        _first_turn(*(_summed(way.step) for way in ways)),
        side,
    )
    x = pair.solved()
    before, after = pair.apart(pair.begin()), pair.apart(x)
    failed = after > max(reach + SLACK_M, before) or pair.unlikely(x) > MOST_SIGMA
    if failed:
        x, after = pair.begin(), before
    drift = tuple(
        np.interp(track.trajectory.t, moments, way.angles @ part)
        for track, part, way in zip((left, right), pair.parts(x), ways, strict=True)
    )
    scale = pair.scales(x)
    l_track = turned_by(left, drift[0], scale[0])
    r_track = turned_by(right, drift[1] + x[TURN], scale[1])
    places = [_at(track, begin) for track in (l_track, r_track)]
    shift = places[0] - places[1] + np.array([*x[-3:-1], 0.0])
    r_track = replace(r_track, trajectory=r_track.trajectory.moved(shift))
    most = max(float(np.abs(part).max()) for part in drift)
    held = after <= reach + SLACK_M
    note = _note(before, after, reach, most, abs(float(x[RATIO])), failed=failed)
    return BothFeet(
        l_track, r_track, float(x[TURN]), (drift[0], drift[1]), scale, before, after, reach, held,
        note,
    )  # fmt: skip


def _note(
    before: float, after: float, reach: float, turned: float, ratio: float, *, failed: bool
) -> str:
    came = f"the feet came out up to {before:.1f} m apart, where {reach:.1f} m is possible"
    if failed and before > reach + SLACK_M:
        return (
            f"{came}, and no likely error of their headings and lengths explains it: they are "
            "shown as each was measured; make sure that both sensors were on the feet of one "
            "person, that their clocks agree, and that neither was moved"
        )
    if failed or before <= reach + SLACK_M:
        return ""
    made = f"turning their headings by up to {turned / DEG:.1f} deg"
    if ratio >= 0.001:
        made += f" and lengths by {100.0 * ratio:.1f} % between them"
    return f"{came}; {made} makes it {after:.1f} m"


def _reach(left: FootTrack, right: FootTrack) -> float:
    longest = [REACH_M]
    for track in (left, right):
        steps = np.diff(track.trajectory.position[track.footfalls.quietest, :2], axis=0)
        if len(steps):
            usual = float(np.percentile(np.linalg.norm(steps, axis=1), 90))
            longest.append(STRIDE_SHARE * usual + HIPS_M)
    return max(longest)


def _way(track: FootTrack, moments: FloatArray, knots: FloatArray) -> Way:
    """Return the way of a foot at common moments."""
    t, position = track.trajectory.t, track.trajectory.position
    place = np.stack([np.interp(moments, t, position[:, axis]) for axis in (0, 1)], axis=1)
    rows, facing = track.footfalls.quietest, _facing(track)
    turned = np.interp(moments, t[rows], facing) if len(rows) else np.zeros(len(moments))
    weights = np.stack([np.interp(moments, knots, one) for one in np.eye(len(knots))], axis=1)
    drift, length = DRIFT, LENGTH
    wander = np.full(len(knots) - 1, WANDER**2 * (knots[1] - knots[0]))
    known = track.covariance
    if known is not None:
        drift, left = _drift(knots - knots[0], np.interp(knots, t[known.rows], known.heading_sigma))
        wander = np.maximum(wander, left)
        walked = float(np.linalg.norm(np.diff(position[rows, :2], axis=0), axis=1).sum())
        sigma = distance_sigma(known, rows, position, np.ones(max(len(rows) - 1, 0), dtype=bool))
        length = float(np.hypot(LENGTH, sigma / max(walked, 1.0)))
    since = moments - moments[0]
    turned = turned - turned[0]
    return Way(np.diff(place, axis=0), weights, turned, since, drift, np.sqrt(wander), length)


def _drift(since: FloatArray, sigma: FloatArray) -> tuple[float, FloatArray]:
    """Tell how a heading's uncertainty grew: by a drift that lasts, and by what came in between.

    Parameters
    ----------
    since : shape (k,)
        Time since the begin [s].
    sigma : shape (k,)
        Standard uncertainty of heading [rad].

    Returns
    -------
    drift : float
        Standard uncertainty of the drift [rad/s].
    rest : shape (k - 1,)
        Variances between knots beside a drift that lasts [rad^2]: turns, and what was not seen.
    """
    lasting = float((sigma[1:] / since[1:]).min())
    rest = np.diff(np.square(sigma)) - lasting**2 * np.diff(np.square(since))
    return max(LEAST_DRIFT, lasting), np.maximum(rest, 0.0)


def _facing(track: FootTrack) -> FloatArray:
    """Heading of the sensor's flattest axis at each footfall, without jumps (k,) [rad].

    Of it only changes are used but for the first: the smoother's tracks begin with the foot along
    x, which is 0.
    """
    rows = track.footfalls.quietest
    if not len(rows):
        return np.zeros(1)
    R = to_matrix(track.trajectory.quaternion[rows])
    flattest = int(np.argmin(np.abs(R[:, 2, :]).mean(axis=0)))
    turned = np.unwrap(np.arctan2(R[:, 1, flattest], R[:, 0, flattest]))
    return np.asarray(turned)


def _first_turn(left: FloatArray, right: FloatArray) -> float:
    """Return by how much the right way is turned to lie along the left one at its begin [rad]."""
    far = np.flatnonzero(np.hypot(left[:, 0], left[:, 1]) > FIRST_WAY_M)
    some = slice(None, int(far[0]) if len(far) else None)
    product = (left[some] @ np.array([1.0, -1.0j])) * (right[some] @ np.array([1.0, 1.0j]))
    return float(-np.angle(product.sum())) if np.abs(product).sum() > 0.0 else 0.0


def _at(track: FootTrack, t: float) -> FloatArray:
    way = track.trajectory
    return np.array([np.interp(t, way.t, way.position[:, axis]) for axis in range(3)])


def _summed(steps: FloatArray) -> FloatArray:
    return np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
