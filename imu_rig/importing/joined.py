"""Recordings of several files put on one time, where they have a clock in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from imu_rig.errors import InputError
from imu_rig.importing.foreign import ForeignRecording, shifted


def join_recordings(recordings: Sequence[ForeignRecording]) -> ForeignRecording:
    """Put recordings together; time 0 is that of the one that begins first.

    Raises
    ------
    InputError
        If nothing ties their clocks, two sensors have one name, or two have a reference.
    """
    if not recordings:
        raise InputError("nothing to import: name a file")
    if len(recordings) == 1:
        return recordings[0]
    first = recordings[0]
    later = [_later_by(first, other) for other in recordings]
    begin = min(later)
    streams = {}
    for recording, by_s in zip(recordings, later, strict=True):
        for name, samples in recording.streams.items():
            if name in streams:
                raise InputError(
                    f"two of the files hold a sensor named {name!r}: import them apart"
                )
            streams[name] = shifted(samples, by_s - begin)
    references = [(r.reference, by) for r, by in zip(recordings, later, strict=True) if r.reference]
    if len(references) > 1:
        raise InputError("more than one of the files has a reference: import them apart")
    clock = first.clock
    notes = _notes(recordings)
    if clock is not None:
        notes.append(f"the files are put on one time by their {clock.name}")
    starts = [
        r.start_utc_ns - round((by - begin) * 1e9)
        for r, by in zip(recordings, later, strict=True)
        if r.start_utc_ns is not None
    ]
    return ForeignRecording(
        format=first.format,
        files=tuple(file for r in recordings for file in r.files),
        streams=streams,
        reference=replace(references[0][0], t=references[0][0].t + references[0][1] - begin)
        if references
        else None,
        notes=tuple(notes),
        start_utc_ns=min(starts) if starts else None,
        clock=None if clock is None else replace(clock, zero_s=clock.zero_s + begin),
    )


def _later_by(first: ForeignRecording, other: ForeignRecording) -> float:
    """Time from the beginning of one recording to that of another [s]."""
    ours, theirs = first.clock, other.clock
    if ours is None or theirs is None or ours.name != theirs.name:
        raise InputError(
            f"{first.files[0]} and {other.files[0]} have no clock in common that would put them "
            "on one time: import each to a file of its own"
        )
    apart = theirs.zero_s - ours.zero_s
    if ours.wraps_s is not None:  # the nearer way round
        apart = (apart + ours.wraps_s / 2) % ours.wraps_s - ours.wraps_s / 2
    return apart


def _notes(recordings: Sequence[ForeignRecording]) -> list[str]:
    """Return all notes with the name of their file, what is said of every file once."""
    common = [n for n in recordings[0].notes if all(n in r.notes for r in recordings)]
    own = [
        f"{r.files[0].name}: {note}" for r in recordings for note in r.notes if note not in common
    ]
    return [*common, *own]
