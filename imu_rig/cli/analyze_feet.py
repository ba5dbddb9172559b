"""The feet of one recording: followed, held together, set beside what else is known of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from imu_rig.cli.analyze_methods import Found, Way, find_track
from imu_rig.cli.analyze_reference import (
    ReferenceOptions,
    beside_footprints,
    beside_reference,
)
from imu_rig.cli.analyze_source import Calibrating, WalkRecording, read_walk
from imu_rig.cli.recordings import TableOptions
from imu_rig.cli.working import Working
from imu_rig.errors import DataError, InputError
from imu_rig.foreign_text import one_line

if TYPE_CHECKING:
    from imu_rig.calibration.gravity import Gravity
    from imu_rig.report.foot_facts import FootAnalysis, FootReport

LEFT, RIGHT = "left", "right"


@dataclass(frozen=True)
class Bounds:
    """What holds a heading beside the sensors.

    Attributes
    ----------
    straight : bool
        Whether the walk keeps to straight corridors.
    together : bool
        Whether a left and a right foot are held together by how far legs reach.
    """

    straight: bool = False
    together: bool = True


@dataclass(frozen=True)
class Wanted:
    """What the options ask for."""

    table: TableOptions
    sensors: tuple[str, ...]
    calibrating: Calibrating
    way: Way
    gravity: Gravity
    beside: ReferenceOptions
    bounds: Bounds


def analyse_recording(file: Path, wanted: Wanted, working: Working) -> FootReport:
    """Analyse the feet of one recording."""
    from imu_rig.report.foot_facts import FootReport

    recordings = read_walk(file, wanted.table, wanted.sensors, wanted.calibrating)
    if len(recordings) > 1 and (wanted.beside.file or wanted.beside.footprints):
        raise InputError(
            f"{file} has {len(recordings)} feet, and a reference is of one: name it with --sensor."
        )
    if wanted.beside.file is None and all(r.reference is None for r in recordings):
        wanted.beside.require_reference()
    found = analyse_feet(recordings, wanted.way, wanted.beside, wanted.bounds, working)
    facts = [("Method", wanted.way.words), ("Level floor", wanted.way.level)]
    facts += [(f"Calibration of {r.sensor}", r.calibration) for r in recordings]
    facts.append(("Gravity", gravity_words(wanted.gravity)))
    return FootReport(
        file.name, recordings[0].sha256, tuple(found.feet), found.shared, tuple(facts),
        tuple(found.left_out),
    )  # fmt: skip


def gravity_words(gravity: Gravity) -> str:
    """Say which gravity was taken, for people."""
    source = gravity.source if gravity.known else "standard gravity, as none was given"
    return f"{gravity.value:.5f} m/s², {source}"


@dataclass(frozen=True, eq=False)
class Feet:
    """The feet of one recording.

    Attributes
    ----------
    feet : list of FootAnalysis
    shared : bool
        Whether they are in one frame.
    left_out : list of (str, str)
        Sensors that could not be followed, and why.
    """

    feet: list[FootAnalysis]
    shared: bool
    left_out: list[tuple[str, str]]


def analyse_feet(
    recordings: Sequence[WalkRecording],
    way: Way,
    beside: ReferenceOptions,
    bounds: Bounds,
    working: Working,
) -> Feet:
    """Find tracks and strides of the feet of one recording.

    Raises
    ------
    DataError
        If none of them can be one of a foot that walks, or a reference not of it.
    """
    from imu_rig.cli.analyze_show import sentences

    feet: list[tuple[WalkRecording, Found]] = []
    failed: list[tuple[WalkRecording, DataError]] = []
    for recording in recordings:
        working.now(f"Following {one_line(recording.sensor)}")
        try:
            found = find_track(recording.block, way, recording.certificate)
            feet.append((recording, _straightened(found) if bounds.straight else found))
        except DataError as error:
            failed.append((recording, error))
    if not feet:
        first, why = failed[0]
        raise DataError(_named(first, why, several=len(recordings) > 1)) from why
    shared = bounds.together and _are_a_pair([recording for recording, _ in feet])
    if shared:
        working.now("Holding both feet together")
        feet, shared = _together(feet)
    try:
        described = [_described(recording, found, beside, way) for recording, found in feet]
    except DataError as error:
        raise DataError(_named(recordings[0], error, several=False)) from error
    return Feet(described, shared, [(r.sensor, sentences(str(e))[0]) for r, e in failed])


def _are_a_pair(recordings: Sequence[WalkRecording]) -> bool:
    """Whether they are of a left and a right foot, by their names."""
    names = [recording.sensor.lower() for recording in recordings]
    return len(names) == 2 and sorted(_side(name) for name in names) == [LEFT, RIGHT]


def _side(name: str) -> str:
    return LEFT if LEFT in name else RIGHT if RIGHT in name else ""


def _together(
    feet: Sequence[tuple[WalkRecording, Found]],
) -> tuple[list[tuple[WalkRecording, Found]], bool]:
    """Bring a left and a right foot into one frame, and say whether they hold together there."""
    from imu_rig.gait.both_feet import join_feet

    tracks = {_side(recording.sensor.lower()): found.track for recording, found in feet}
    try:
        both = join_feet(tracks[LEFT], tracks[RIGHT])
    except DataError as error:
        return [(r, _noted(f, f"The feet are not in one frame: {error}")) for r, f in feet], False
    joined = {LEFT: both.left, RIGHT: both.right}
    return [
        (
            recording,
            _noted(replace(found, track=joined[_side(recording.sensor.lower())]), both.note),
        )
        for recording, found in feet
    ], both.held


def _noted(found: Found, note: str) -> Found:
    if not note:
        return found
    return replace(found, track=replace(found.track, notes=(*found.track.notes, note)))


def _straightened(found: Found) -> Found:
    from imu_rig.gait.heading import follow_corridors

    corridors = follow_corridors(found.track)
    return _noted(replace(found, track=corridors.track), corridors.note)


def _described(
    recording: WalkRecording, found: Found, beside: ReferenceOptions, way: Way
) -> FootAnalysis:
    """Measure the strides of a track, and set it beside what else is known."""
    from imu_rig.cli.analyze_show import sentences
    from imu_rig.gait.strides import gait_parameters
    from imu_rig.report.foot_facts import FootAnalysis

    strides = gait_parameters(found.track)
    notes = [*found.track.notes, *strides.notes]
    given, measured = beside.read(), None
    if given is not None:
        measured = beside_reference(found.track, strides, given, beside)
    elif recording.reference is not None and recording.reference.position is not None:
        try:
            measured = beside_reference(found.track, strides, recording.reference, beside)
        except DataError as error:
            notes.append(f"The recording's own reference was not used: {error}")
    prints = beside.read_footprints()
    trodden = None if prints is None else beside_footprints(strides, prints)
    notes += [doubt for other in (measured, trodden) if other is not None for doubt in other.doubts]
    return FootAnalysis(
        recording.sensor,
        found.block,
        found.track,
        strides,
        measured,
        trodden,
        sentences(*notes),
        found.steps,
        way.motion_unit,
    )


def _named(recording: WalkRecording, error: DataError, *, several: bool) -> str:
    who = f"{recording.file}" + (f", {recording.sensor}" if several else "")
    text = str(error).rstrip(".")
    return f"{who}: {text}."
