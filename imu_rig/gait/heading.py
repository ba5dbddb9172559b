"""Heading held by straight corridors: an option, for nothing in a recording says they are there.

A gyroscope's bias that is left turns a track slowly. Where a person goes straight on for a while,
and comes by in the same or the opposite direction again, that shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.gait.footfalls import runs
from imu_rig.gait.trajectory import FootTrack, Trajectory, TrajectoryCovariance
from imu_rig.rotation import about_z, multiply
from imu_rig.units import DEG

STEP_M = 0.4
"""Shorter strides have no direction [m]."""

BEND = 15.0 * DEG
"""Who goes straight on keeps the direction within this over four strides [rad]; single strides
differ by 3 to 5 deg."""

LEAST_RUN = 6
LEAST_STRAIGHT = 0.5
"""Of fewer strides, a straight cannot be told from a bend; and where less than this share of the
strides, without those beside turns, is straight, nothing is done."""

DRIFT = 0.3 * DEG
"""By which a track may turn [rad/s] while its walker goes straight on: what is left of a bias. A
way that bends as slowly as this has a radius of 200 m."""

SAME_WAY = 15.0 * DEG
"""Straights whose directions, or opposite directions, are as near as this go along one corridor."""

SCATTER = 4.0 * DEG
"""Of the directions of strides along a corridor, standard deviation [rad]."""

WANDER = 0.1 * DEG
"""By which heading wanders besides a constant drift [rad/sqrt(s)]."""

ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Corridors:
    """A track along corridors.

    Attributes
    ----------
    track : FootTrack
        With its heading corrected; the one that was given where no corridor was found.
    correction : shape (n,)
        Added to yaw [rad].
    directions : shape (m,)
        Of the corridors found, between 0 and pi [rad]; empty where nothing was changed.
    note : str
        What was done, a sentence.
    """

    track: FootTrack
    correction: FloatArray
    directions: FloatArray
    note: str


def follow_corridors(track: FootTrack) -> Corridors:
    """Turn a track so that its straights agree.

    The correction of heading is a constant drift plus a random walk, and corridors have directions:
    least squares over the directions of the strides of straights, each weighed by how well it
    agrees (a Cauchy weight, so that no stride, and no straight that is none, pulls hard). Heading
    at the first sample is kept. Strides of bends and turns say nothing, and where most of the way
    is not straight, nothing is changed.
    """
    rows = track.footfalls.quietest
    t = track.trajectory.t
    nothing = np.zeros(len(t))
    steps = np.diff(track.trajectory.position[rows, :2], axis=0)
    long = np.flatnonzero(np.hypot(steps[:, 0], steps[:, 1]) > STEP_M)
    middle = 0.5 * (t[rows[:-1]] + t[rows[1:]])[long]
    direction = np.unwrap(np.arctan2(steps[long, 1], steps[long, 0]))
    straights = _straights(middle, direction)
    among = sum(b - a for a, b in straights)
    if among < max(2 * LEAST_RUN, LEAST_STRAIGHT * len(long)):
        note = "heading was left alone: the way is not straight enough for corridors"
        return Corridors(track, nothing, np.empty(0), note)
    corridor, ways = _corridors(direction, straights)
    at, sigma = _correct(np.concatenate(([t[0]], middle)), direction, corridor, ways)
    correction = np.interp(t, np.concatenate(([t[0]], middle)), at)
    spread = np.interp(t, np.concatenate(([t[0]], middle)), sigma)
    turned = turned_by(track, correction)
    if turned.covariance is not None:
        turned = replace(turned, covariance=_narrowed(turned.covariance, spread))
    note = (
        f"heading follows {len(ways)} corridor{'s' if len(ways) > 1 else ''}: it was turned by up "
        f"to {np.abs(correction).max() / DEG:.1f} deg"
    )
    turned = replace(turned, notes=(*track.notes, note))
    return Corridors(turned, correction, np.mod(ways, np.pi), note)


def _straights(t: FloatArray, direction: FloatArray) -> list[tuple[int, int]]:
    """Return begin and end of straights, rows of the strides."""
    n = len(direction)
    if n < LEAST_RUN:
        return []
    before, after = np.maximum(np.arange(n) - 2, 0), np.minimum(np.arange(n) + 2, n - 1)
    # Medians of three: one stride around something does not end a straight.
    padded = np.concatenate((direction[:1], direction, direction[-1:]))
    smooth = np.median(np.stack((padded[:-2], padded[1:-1], padded[2:])), axis=0)
    straight: BoolArray = np.abs(smooth[after] - smooth[before]) < BEND
    found = []
    for first, last in zip(*runs(straight), strict=True):
        if last - first + 1 < LEAST_RUN:
            continue
        some = slice(first, last + 1)
        slope, _ = np.polyfit(t[some] - t[first], direction[some], 1)
        length = t[last] - t[first]
        unsure = 2.0 * SCATTER * np.sqrt(12.0 / (last - first + 1)) / length
        if abs(slope) < DRIFT + unsure:
            found.append((int(first), int(last) + 1))
    return found


def _corridors(
    direction: FloatArray, straights: list[tuple[int, int]]
) -> tuple[IntArray, FloatArray]:
    """Return the corridor of each stride, -1 for none, and the directions to begin with."""
    corridor = np.full(len(direction), -1, dtype=np.int64)
    ways: list[float] = []
    for begin, end in straights:
        mean = float(np.median(direction[begin:end]))
        apart = [abs(_line_angle(mean - way)) for way in ways]
        if apart and min(apart) < SAME_WAY:
            number = int(np.argmin(apart))
            ways[number] = mean  # heading drifts: the latest is the one to compare with
        else:
            number = len(ways)
            ways.append(mean)
        corridor[begin:end] = number
    return corridor, np.array(ways)


def _line_angle(angle: FloatArray | float) -> FloatArray:
    """Return angles between lines, within a quarter turn of 0 [rad]."""
    return np.asarray(np.mod(np.asarray(angle) + np.pi / 2, np.pi) - np.pi / 2)


def _correct(
    t: FloatArray, direction: FloatArray, corridor: IntArray, ways: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return corrections of heading at times ``t`` (k + 1,), the first 0, and their sigmas [rad].

    Unknown are the corrections, one drift, and the directions of corridors; ``ways`` is changed to
    what they come to.
    """
    k, m = len(direction), len(ways)
    step = np.maximum(np.diff(t), 0.1)
    motion = np.zeros((k, k + 1 + m))
    motion[np.arange(k), np.arange(k)] = 1.0
    motion[np.arange(1, k), np.arange(k - 1)] = -1.0
    motion[:, k] = -step
    motion /= (WANDER * np.sqrt(step))[:, np.newaxis]
    prior = np.zeros((1, k + 1 + m))
    prior[0, k] = 1.0 / DRIFT
    along = np.flatnonzero(corridor >= 0)
    first = {c: int(along[np.argmax(corridor[along] == c)]) for c in range(m)}
    for c in range(m):
        ways[c] = direction[first[c] : first[c] + LEAST_RUN].mean()
    seen = np.zeros((len(along), k + 1 + m))
    seen[np.arange(len(along)), along] = 1.0
    seen[np.arange(len(along)), k + 1 + corridor[along]] = -1.0
    x: FloatArray = np.zeros(k + 1 + m)
    x[k + 1 :] = ways
    # Each stride is compared with that direction of its corridor, there or back, that is nearer.
    turns = np.round((direction[along] - ways[corridor[along]]) / np.pi) * np.pi
    value = -(direction[along] - turns)
    information: FloatArray = np.eye(k + 1 + m)
    for _ in range(ROUNDS):
        off = (seen @ x - value) / SCATTER
        weight = 1.0 / (SCATTER * np.sqrt(1.0 + np.square(off / 2.0)))
        rows = np.concatenate((motion, prior, seen * weight[:, np.newaxis]))
        right = np.concatenate((np.zeros(k + 1), value * weight))
        information = np.asarray(rows.T @ rows, dtype=float)
        x = np.asarray(np.linalg.solve(information, rows.T @ right), dtype=float)
    ways[:] = x[k + 1 :]
    sigma = np.sqrt(np.diagonal(np.linalg.inv(information))[:k])
    return np.concatenate(([0.0], x[:k])), np.concatenate(([0.0], sigma))


def turned_by(track: FootTrack, angle: FloatArray, scale: float = 1.0) -> FootTrack:
    """Return a track with each moment turned by its own angle (n,) [rad] about the vertical.

    Its way is integrated anew from its first place, on the plan ``scale`` times as long. The
    covariance turns with it, and is as large as before.
    """
    trajectory = track.trajectory
    R = about_z(angle)
    half = 0.5 * angle
    turn = np.zeros((len(angle), 4))
    turn[:, 0], turn[:, 3] = np.cos(half), np.sin(half)
    longer = np.array([scale, scale, 1.0])
    way = np.diff(trajectory.position, axis=0) * longer
    between = about_z(0.5 * (angle[1:] + angle[:-1]))
    moved = np.cumsum(np.einsum("nij,nj->ni", between, way), axis=0)
    position = trajectory.position[0] + np.concatenate((np.zeros((1, 3)), moved))
    turned = Trajectory(
        trajectory.t,
        multiply(turn, trajectory.quaternion),
        np.einsum("nij,nj->ni", R, trajectory.velocity * longer),
        position,
    )
    known = track.covariance
    if known is not None:
        known = _turned(known, angle, track.footfalls.quietest)
    return replace(track, trajectory=turned, covariance=known)


def _turned(
    known: TrajectoryCovariance, angle: FloatArray, footfalls: IntArray
) -> TrajectoryCovariance:
    # Places are where the way until then led: they turn by what it was turned on average.
    along = np.cumsum(angle) / np.arange(1, len(angle) + 1)
    whole = np.zeros((len(known.rows), 9, 9))
    whole[:, 0:3, 0:3] = whole[:, 3:6, 3:6] = about_z(angle[known.rows])
    whole[:, 6:9, 6:9] = about_z(along[known.rows])
    S = about_z(0.5 * (angle[footfalls[1:]] + angle[footfalls[:-1]]))
    common = known.common
    if common is not None:
        common = np.einsum("iab,ipb->ipa", S, common)
    values = _even(whole @ known.values @ np.swapaxes(whole, 1, 2))
    strides = _even(S @ known.strides @ np.swapaxes(S, 1, 2))
    return replace(known, values=values, strides=strides, common=common)


def _narrowed(known: TrajectoryCovariance, sigma: FloatArray) -> TrajectoryCovariance:
    """Return the covariance with yaw known to ``sigma`` (n,) at each moment by itself.

    What the corridors say of earlier headings, and so of the way that was gone, is left out: the
    positions are rather more certain than this.
    """
    values = known.values.copy()
    yaw = np.maximum(sigma[known.rows], 1e-9) ** 2
    gain = values[:, :, 2] / (values[:, 2, 2] + yaw)[:, np.newaxis]
    values -= gain[:, :, np.newaxis] * values[:, np.newaxis, 2, :]
    return replace(known, values=_even(values))


def _even(covariance: FloatArray) -> FloatArray:
    """Return covariances (..., p, p) without what rounding made uneven."""
    return np.asarray(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
