"""`imu-rig analyze gait`: strides and distances over a set of trials."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.analyze_options import AnyDevice, Certificates, Level, NoFiles, Raw, Sensors
from imu_rig.cli.options import (
    AccelColumns,
    AccelUnit,
    Columns,
    Gravity_,
    GyroColumns,
    GyroUnit,
    Height,
    Json,
    Latitude,
    MagColumns,
    MagUnit,
    MapFile,
    Rate,
    TimeColumn,
    TimeUnit,
    gravity_from,
    named,
)
from imu_rig.errors import DataError, InputError
from imu_rig.foreign_text import one_line

if TYPE_CHECKING:
    from imu_rig.arrays import FloatArray
    from imu_rig.cli.analyze_methods import Way
    from imu_rig.cli.analyze_source import WalkRecording
    from imu_rig.gait.distance import WalkDistance, WalkOptions
    from imu_rig.report.gait_facts import GaitReport, GaitTrial

REPORT_NAME, STRIDES_NAME = "report.html", "strides.csv"
DISTANCES_NAME, SUMMARY_NAME = "distances.csv", "summary.json"
FARTHEST_M = 1e5
FAR_OFF = 0.15
"""A known distance that is farther from the smoother's [1] is hardly that of the trial: a sensor
that nobody calibrated errs by a third of that."""


def gait(
    files: Annotated[
        list[Path],
        typer.Argument(help="Trial files, or recordings of other programs."),
    ],
    distance: Annotated[
        str | None,
        typer.Option(
            "--distance",
            metavar="X[,Y,Z]",
            help="How far each trial went [m]: along the walk, to the left, up. With it the "
            "distance by double integration is shown, calibrated and not.",
        ),
    ] = None,
    sensor: Sensors = None,
    certificate: Certificates = None,
    raw: Raw = False,
    any_device: AnyDevice = False,
    gravity: Gravity_ = None,
    latitude: Latitude = None,
    height: Height = None,
    level: Level = "auto",
    detector: Annotated[
        str,
        typer.Option(
            "--detector",
            help="Of the double integration: threshold (default), paper, shoe, are, variance, "
            "magnitude.",
        ),
    ] = "threshold",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            parser=named,
            metavar="PATH",
            help="New folder for report and tables; by default one named by recording and time.",
        ),
    ] = None,
    no_files: NoFiles = False,
    map_file: MapFile = None,
    columns: Columns = None,
    rate: Rate = None,
    accel: AccelColumns = None,
    gyro: GyroColumns = None,
    mag: MagColumns = None,
    time: TimeColumn = None,
    accel_unit: AccelUnit = None,
    gyro_unit: GyroUnit = None,
    mag_unit: MagUnit = None,
    time_unit: TimeUnit = None,
    as_json: Json = False,
) -> None:
    """Measure the strides of a set of trials, and their distances against a known one."""
    from imu_rig.cli.analyze_feet import gravity_words
    from imu_rig.cli.analyze_files import json_text
    from imu_rig.cli.analyze_gait_show import gait_summary, show_gait
    from imu_rig.cli.analyze_methods import Way
    from imu_rig.cli.analyze_source import Calibrating, read_walk
    from imu_rig.cli.recordings import TableOptions
    from imu_rig.cli.working import Working
    from imu_rig.gait.detectors import DETECTORS

    table = TableOptions(
        map_file, columns, rate, accel, gyro, time, accel_unit, gyro_unit, mag_unit, time_unit, mag
    )
    local = gravity_from(gravity, latitude, height)
    calibrating = Calibrating(tuple(certificate or ()), raw, any_device)
    calibrating.check()
    way = Way(level=level, gravity=local.value)
    way.check()
    if detector not in DETECTORS:
        raise InputError(f"--detector is one of {', '.join(DETECTORS)}, not {detector!r}.")
    if no_files and output is not None:
        raise InputError("Give either --output or --no-files, not both.")
    known = None if distance is None else _known(distance)
    wanted = _Wanted(way, detector, known)
    trials: list[GaitTrial] = []
    left_out: dict[str, InputError] = {}
    calibrations: dict[str, str] = {}
    with Working(f"Reading {one_line(files[0].name)}") as working:
        for file in files:
            working.now(f"Following {one_line(file.name)}")
            try:
                recordings = read_walk(file, table, tuple(sensor or ()), calibrating)
            except InputError as error:
                left_out[one_line(file.stem)] = error
                continue
            for recording in recordings:
                who = _name(recording, several=len(recordings) > 1)
                try:
                    trials.append(_trial(recording, who, wanted))
                except DataError as error:
                    left_out[who] = error
                else:
                    calibrations[who] = recording.calibration
        if not trials:
            raise next(iter(left_out.values()))
        report = replace(
            _report(trials, known, calibrations, wanted, gravity_words(local)),
            left_out=tuple(
                (who, f"{str(e.__cause__ or e).rstrip('.')}.") for who, e in left_out.items()
            ),
        )
        written: dict[str, str] = {}
        if not no_files:
            working.now("Drawing")
            written = _write(output, files[0], report)
    if as_json:
        sys.stdout.write(json_text(gait_summary(report, written)) + "\n")
    else:
        show_gait(report, written)
    if left_out:
        raise typer.Exit(InputError.exit_code)


@dataclass(frozen=True, eq=False)
class _Wanted:
    """What the options ask for."""

    way: Way
    detector: str
    known: FloatArray | None

    @property
    def walk_options(self) -> WalkOptions:
        """Return the options of the double integration."""
        from imu_rig.gait.distance import WalkOptions

        return WalkOptions(detector=self.detector, gravity=self.way.gravity)


def _known(text: str) -> FloatArray:
    """Read a known distance: along x, or along all three axes."""
    import numpy as np

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 3) or not all(abs(v) <= FARTHEST_M for v in values):
        raise InputError(
            f"--distance {text!r} is no distance: give metres along the walk, as 10, or along all "
            "axes, as 10,0,0."
        )
    if values[0] <= 0.0:
        raise InputError(
            f"--distance {text!r}: x is how far the walk led away from where it began, and more "
            "than 0; of a walk that comes back compare places, with imu-rig analyze foot."
        )
    return np.array([*values, 0.0, 0.0][:3])


def _name(recording: WalkRecording, *, several: bool) -> str:
    return f"{recording.file.stem}, {recording.sensor}" if several else recording.file.stem


def _trial(recording: WalkRecording, name: str, wanted: _Wanted) -> GaitTrial:
    """Analyse one foot of one recording.

    Raises
    ------
    DataError
        If it cannot be one of a foot that walks.
    """
    from imu_rig.cli.analyze_methods import find_track
    from imu_rig.cli.analyze_show import sentences
    from imu_rig.gait.strides import gait_parameters
    from imu_rig.report.gait_facts import GaitTrial, along_the_walk

    try:
        found = find_track(recording.block, wanted.way, recording.certificate)
    except DataError as error:
        raise DataError(f"{recording.file}: {str(error).rstrip('.')}.") from error
    strides = gait_parameters(found.track)
    notes = [*found.track.notes, *strides.notes]
    ours = along_the_walk(found.track.trajectory)
    before = after = None
    doubts: list[str] = []
    if wanted.known is not None:
        before = _integrated(recording, wanted, doubts, calibrated=False)
        if recording.certificate is not None:
            after = _integrated(recording, wanted, doubts, calibrated=True)
        if abs(ours[0] - wanted.known[0]) > FAR_OFF * wanted.known[0]:
            notes.append(
                f"It led {ours[0]:.2f} m away from where it began, and --distance says "
                f"{wanted.known[0]:.2f} m: is that the distance of this trial, in metres?"
            )
    return GaitTrial(name, strides, ours, after, before, sentences(*notes), sentences(*doubts))


def _integrated(
    recording: WalkRecording, wanted: _Wanted, notes: list[str], *, calibrated: bool
) -> WalkDistance | None:
    """Return the distance by double integration; where there is none, a note says why."""
    from imu_rig.gait.distance import walk_distance

    kind = "calibrated" if calibrated else "not calibrated"
    try:
        found = walk_distance(recording.block if calibrated else recording.raw, wanted.walk_options)
    except DataError as error:
        notes.append(f"{kind}: there is no distance, as {error}")
        return None
    notes += [f"{kind}: {note}" for note in found.notes]
    return found


def _report(
    trials: list[GaitTrial],
    known: FloatArray | None,
    calibrations: dict[str, str],
    wanted: _Wanted,
    gravity: str,
) -> GaitReport:
    from imu_rig.report.gait_facts import GaitReport

    facts = [("Strides by", wanted.way.words), ("Level floor", wanted.way.level)]
    if known is not None:
        facts.append(("Double integration", f"detector {wanted.detector}"))
    every = set(calibrations.values())
    if len(every) == 1:
        facts.append(("Calibration", every.pop()))
    else:
        facts += [(f"Calibration of {name}", words) for name, words in calibrations.items()]
    facts.append(("Gravity", gravity))
    return GaitReport(tuple(trials), known, tuple(facts))


def _write(output: Path | None, first: Path, report: GaitReport) -> dict[str, str]:
    """Write all files; return their paths by what they are."""
    from imu_rig.cli.analyze_files import analysis_folder, removed_on_failure

    names = (REPORT_NAME, STRIDES_NAME, DISTANCES_NAME, SUMMARY_NAME)
    folder = analysis_folder(output, "gait", first, names)
    with removed_on_failure(folder, names):
        return _write_into(folder, report)


def _write_into(folder: Path, report: GaitReport) -> dict[str, str]:
    from imu_rig.cli.analyze_files import write_json, write_rows
    from imu_rig.cli.analyze_gait_show import distance_head, distance_rows, gait_summary
    from imu_rig.report.gait import gait_report
    from imu_rig.report.page import write_report
    from imu_rig.report.stride_table import stride_head, stride_rows

    write_report(folder / REPORT_NAME, gait_report(report))
    rows = [row for trial in report.trials for row in stride_rows(trial.name, trial.strides)]
    head = ["trial", *stride_head(report.trials[0].strides)[1:]]
    write_rows(folder / STRIDES_NAME, head, rows, "strides")
    write_rows(folder / DISTANCES_NAME, distance_head(), distance_rows(report), "distances")
    files = {
        "report": str(folder / REPORT_NAME),
        "strides": str(folder / STRIDES_NAME),
        "distances": str(folder / DISTANCES_NAME),
        "summary": str(folder / SUMMARY_NAME),
    }
    write_json(folder / SUMMARY_NAME, gait_summary(report, files))
    return files
