"""Strides of a foot: one row each, from a footfall to the next, with uncertainty.

A stride begins and ends at the quietest moment of a footfall. Its swing begins when the foot leaves
the ground and ends when it meets it again (`imu_rig.gait.events`); the stance that belongs to it
goes before, so that both together are one gait cycle from contact to contact. Angles are those of
the foot that `imu_rig.gait.mounting` found: pitch positive with the toe up, roll positive with the
left side up, turns positive to the left.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Annotated, get_origin, get_type_hints

import numpy as np

from imu_rig.arrays import AnyArray, BoolArray, FloatArray
from imu_rig.gait.distance_uncertainty import distance_sigma
from imu_rig.gait.events import GroundContacts, find_contacts
from imu_rig.gait.mounting import FootAxes, find_foot_axes, foot_matrices
from imu_rig.gait.stride_kinds import GAIT, SHIFT, StrideFacts, standing, stride_kinds
from imu_rig.gait.trajectory import FootTrack

EVENT_SIGMA_S = 0.012
"""Standard uncertainty of a contact or toe-off beside what all of them share: from step to step a
simulated foot's are found with 1 to 3 ms and 5 to 13 ms."""
MOMENTS = ("start", "end", "toe_off", "contact", "heading")
"""Columns that have no mean."""
LONGEST_CYCLE_S = 4.0
"""Who rests longer on a foot stands; the slowest walkers take 3 s for a stride."""


@dataclass(frozen=True)
class Column:
    """What a column of the table says.

    Attributes
    ----------
    unit : str
        In SI; empty for shares and words.
    text : str
    """

    unit: str
    text: str


@dataclass(frozen=True, eq=False)
class Strides:
    """Strides of one foot: columns of shape (m,), NaN where something cannot be known.

    `columns` lists the unit and the meaning of each. Standard uncertainties of length and height
    are NaN where the track has no covariance.

    Attributes
    ----------
    kind : shape (m,) of str
        See `imu_rig.gait.stride_kinds`.
    axes : FootAxes
        Of the foot.
    distance : float
        Walked [m]: the sum of the lengths of all strides but shifts of a standing foot.
    distance_sigma : float
        Its standard uncertainty [m], with what all strides err alike; NaN without covariance.
    notes : tuple of str
    """

    start: Annotated[FloatArray, Column("s", "quietest moment of the footfall before")]
    end: Annotated[FloatArray, Column("s", "quietest moment of the footfall after")]
    toe_off: Annotated[FloatArray, Column("s", "when the foot leaves the ground")]
    contact: Annotated[FloatArray, Column("s", "when it meets the ground again")]
    length: Annotated[FloatArray, Column("m", "horizontal distance from footfall to footfall")]
    height: Annotated[FloatArray, Column("m", "how much higher it ends than it begins")]
    duration: Annotated[FloatArray, Column("s", "from the contact before to this one")]
    velocity: Annotated[FloatArray, Column("m/s", "length over duration")]
    cadence: Annotated[
        FloatArray, Column("1/min", "steps of both feet per minute: 120 s over duration")
    ]
    stance_time: Annotated[FloatArray, Column("s", "from the contact before to toe-off")]
    swing_time: Annotated[FloatArray, Column("s", "from toe-off to contact")]
    stance_share: Annotated[FloatArray, Column("", "stance time over duration")]
    sideways: Annotated[
        FloatArray, Column("m", "to the left of where the foot points at both ends")
    ]
    swing_width: Annotated[
        FloatArray, Column("m", "farthest from the straight line; left is positive")
    ]
    clearance: Annotated[
        FloatArray, Column("m", "of the sensor, highest above the line of the ground")
    ]
    toe_off_pitch: Annotated[FloatArray, Column("rad", "pitch at toe-off, toe up positive")]
    contact_pitch: Annotated[FloatArray, Column("rad", "pitch at contact, toe up positive")]
    lowest_pitch: Annotated[FloatArray, Column("rad", "least pitch, toe down")]
    highest_pitch: Annotated[FloatArray, Column("rad", "greatest pitch, toe up")]
    lowest_roll: Annotated[FloatArray, Column("rad", "least roll, right side up")]
    highest_roll: Annotated[FloatArray, Column("rad", "greatest roll, left side up")]
    turn: Annotated[FloatArray, Column("rad", "change of the foot's heading, to the left positive")]
    heading: Annotated[FloatArray, Column("rad", "direction of travel in the track's frame")]
    length_sigma: Annotated[FloatArray, Column("m", "standard uncertainty of length")]
    height_sigma: Annotated[FloatArray, Column("m", "standard uncertainty of height")]
    duration_sigma: Annotated[FloatArray, Column("s", "standard uncertainty of duration")]
    kind: Annotated[AnyArray, Column("", "what kind of stride it is")]
    axes: FootAxes
    distance: float
    distance_sigma: float
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of strides."""
        return len(self.start)

    @property
    def walking(self) -> BoolArray:
        """Which strides, shape (m,), are of steady walking or running: what statistics are of.

        Those that begin from standing or end in it are shorter or slower, and none of them. Nor are
        those of unknown duration, so that all means are of the same strides; but where no duration
        is known, all are taken.
        """
        gait = np.isin(self.kind, GAIT)
        timed = gait & np.isfinite(self.duration)
        return timed if timed.any() else gait

    @staticmethod
    def columns() -> dict[str, Column]:
        """Return what every column says, by name, in order."""
        hints = get_type_hints(Strides, include_extras=True)
        return {
            name: hint.__metadata__[0]
            for name, hint in hints.items()
            if get_origin(hint) is Annotated
        }


@dataclass(frozen=True)
class Summary:
    """Statistics of one column over strides.

    Attributes
    ----------
    mean, sd : float
        Mean and sample standard deviation; NaN where there are too few.
    cv : float
        Coefficient of variation, sd over the mean's size.
    count : int
        Strides in which it is known.
    """

    mean: float
    sd: float
    cv: float
    count: int


def summarize(strides: Strides, which: BoolArray | None = None) -> dict[str, Summary]:
    """Return mean, deviation and count of every column of numbers.

    Parameters
    ----------
    strides : Strides
    which : shape (m,), optional
        Strides to count; those of steady walking and running where not given.
    """
    chosen = strides.walking if which is None else which
    columns = [name for name in strides.columns() if name not in ("kind", *MOMENTS)]
    return {name: summary_of(getattr(strides, name)[chosen]) for name in columns}


def summary_of(values: FloatArray) -> Summary:
    """Return the statistics of the finite ones of some values, shape (n,)."""
    known = values[np.isfinite(values)]
    mean = float(known.mean()) if len(known) else float("nan")
    sd = float(known.std(ddof=1)) if len(known) > 1 else float("nan")
    cv = sd / abs(mean) if mean else float("nan")
    return Summary(mean, sd, cv, len(known))


def gait_parameters(track: FootTrack) -> Strides:
    """Measure every stride of a track.

    Parameters
    ----------
    track : FootTrack
        In any heading and mounting; with covariance, lengths get uncertainties.

    Returns
    -------
    Strides
        Empty where the foot has fewer than two footfalls.
    """
    trajectory, falls = track.trajectory, track.footfalls
    axes = find_foot_axes(trajectory, falls)
    foot = foot_matrices(trajectory.quaternion, axes)
    pitch, roll = foot_pitch(foot), np.arcsin(np.clip(foot[:, 2, 1], -1.0, 1.0))
    rows = falls.quietest
    count = max(len(falls) - 1, 0)
    moved = np.diff(trajectory.position[rows], axis=0) if count else np.zeros((0, 3))
    length = np.hypot(moved[:, 0], moved[:, 1])
    facing = np.arctan2(foot[rows, 1, 0], foot[rows, 0, 0])
    turn = _wrapped(np.diff(facing)) if count else np.zeros(0)
    travel = np.arctan2(moved[:, 1], moved[:, 0])
    off_foot = _wrapped(travel - facing[:-1] - 0.5 * turn) if count else np.zeros(0)
    t = trajectory.t
    start, end = t[rows[:-1]], t[rows[1:]]
    events = find_contacts(trajectory, falls)
    swing_time = events.contact - events.toe_off
    before = np.concatenate(([np.nan], events.contact[:-1]))[:count]
    stance_time = _of_a_cycle(events.toe_off - before)
    duration = stance_time + swing_time
    stance_share = stance_time / duration
    stood = _stood(track, events, duration)
    kind = stride_kinds(
        StrideFacts(
            length=length,
            height=moved[:, 2],
            turn=turn,
            swing_time=swing_time,
            duration=duration,
            stance_share=stance_share,
            off_foot=off_foot if axes.forward_known else np.zeros(count),
            stood_before=stood[:-1],
            stood_after=stood[1:],
        )
    )
    swing_width, clearance = _shape(trajectory.position, rows, moved, length)
    low_pitch, high_pitch = _extremes(pitch, rows)
    low_roll, high_roll = _extremes(roll, rows)
    length_sigma, height_sigma = _sigmas(track, travel, count)
    walked = kind != SHIFT
    total_sigma = float("nan")
    if track.covariance is not None:
        total_sigma = distance_sigma(track.covariance, rows, trajectory.position, walked)
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    duration_sigma = np.where(
        np.isfinite(duration), np.hypot(EVENT_SIGMA_S, step / np.sqrt(6.0)), np.nan
    )
    return Strides(
        start=start,
        end=end,
        toe_off=events.toe_off,
        contact=events.contact,
        length=length,
        height=moved[:, 2],
        duration=duration,
        velocity=length / duration,
        cadence=120.0 / duration,
        stance_time=stance_time,
        swing_time=swing_time,
        stance_share=stance_share,
        sideways=length * np.sin(off_foot),
        swing_width=swing_width,
        clearance=clearance,
        toe_off_pitch=_at(t, pitch, events.toe_off),
        contact_pitch=_at(t, pitch, events.contact),
        lowest_pitch=low_pitch,
        highest_pitch=high_pitch,
        lowest_roll=low_roll,
        highest_roll=high_roll,
        turn=turn,
        heading=travel,
        length_sigma=length_sigma,
        height_sigma=height_sigma,
        duration_sigma=duration_sigma,
        kind=kind,
        axes=axes,
        distance=float(length[walked].sum()),
        distance_sigma=total_sigma,
        notes=(axes.note,) if axes.note else (),
    )


def foot_pitch(foot: FloatArray) -> FloatArray:
    """Pitch, shape (n,) [rad], toe up positive, of foot axes (n, 3, 3); beyond 90 deg as well.

    The foot of a runner points back and up in early swing; an arcsine would fold that over.
    """
    level = np.hypot(foot[:, 0, 0], foot[:, 1, 0])
    return np.asarray(np.arctan2(foot[:, 2, 0], np.copysign(level, foot[:, 2, 2])))


def _stood(track: FootTrack, events: GroundContacts, duration: FloatArray) -> BoolArray:
    """Whether the foot stood at each footfall, shape (k,); the first counts as a stand.

    Of what was before the first nothing is known: its stride is not compared with others.
    """
    t, falls = track.trajectory.t, track.footfalls
    if len(falls) < 2:
        return np.ones(len(falls), dtype=bool)
    begin, end = t[falls.first].copy(), t[falls.last].copy()
    begin[1:] = np.where(np.isfinite(events.contact), events.contact, begin[1:])
    end[:-1] = np.where(np.isfinite(events.toe_off), events.toe_off, end[:-1])
    known = duration[np.isfinite(duration)]
    cycle = float(np.median(known)) if len(known) else LONGEST_CYCLE_S
    stood = standing(end - begin, cycle)
    stood[0] = True
    return stood


def _of_a_cycle(stance_time: FloatArray) -> FloatArray:
    """Stance times [s] with those of a stand left out: they belong to no stride."""
    return np.where(stance_time <= LONGEST_CYCLE_S, stance_time, np.nan)


def _shape(
    position: FloatArray, rows: AnyArray, moved: FloatArray, length: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far the path of each stride leaves its straight line sideways and upward [m]."""
    count = len(moved)
    aside, above = np.full(count, np.nan), np.zeros(count)
    for i in range(count):
        path = position[rows[i] : rows[i + 1] + 1] - position[rows[i]]
        if length[i] < 1e-6:
            above[i] = float(path[:, 2].max())
            continue
        along = moved[i, :2] / length[i]
        share = np.clip(path[:, :2] @ along / length[i], 0.0, 1.0)
        across = path[:, 1] * along[0] - path[:, 0] * along[1]
        aside[i] = across[np.argmax(np.abs(across))]
        above[i] = float((path[:, 2] - share * moved[i, 2]).max())
    return aside, above


def _extremes(angle: FloatArray, rows: AnyArray) -> tuple[FloatArray, FloatArray]:
    pairs = list(itertools.pairwise(rows))
    low = np.array([angle[a : b + 1].min() for a, b in pairs])
    high = np.array([angle[a : b + 1].max() for a, b in pairs])
    return low, high


def _at(t: FloatArray, values: FloatArray, when: FloatArray) -> FloatArray:
    if not len(when):
        return np.zeros(0)
    return np.asarray(np.where(np.isfinite(when), np.interp(when, t, values), np.nan))


def _sigmas(track: FootTrack, travel: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the standard uncertainties [m] of lengths and heights."""
    if track.covariance is None:
        return np.full(count, np.nan), np.full(count, np.nan)
    along = np.stack((np.cos(travel), np.sin(travel), np.zeros(count)), axis=1)
    P = track.covariance.strides
    length = np.sqrt(np.maximum(np.einsum("ij,ijk,ik->i", along, P, along), 0.0))
    return length, np.sqrt(np.maximum(P[:, 2, 2], 0.0))


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
