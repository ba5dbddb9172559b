"""`imu-rig analyze foot`: where a sensor on a foot went, how far, and how sure that is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_rig.cli.analyze_options import (
    AnyDevice,
    Certificates,
    ClockSearch,
    Detector,
    FitLever,
    FootprintsFile,
    Level,
    Marker,
    Mirrored,
    NoFiles,
    Raw,
    ReferenceColumns,
    ReferenceFile,
    ReferenceRate,
    ReferenceTimeUnit,
    ReferenceUnit,
    ReferenceYUp,
    ReferenceZDown,
    Sensors,
)
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
from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line

if TYPE_CHECKING:
    from imu_rig.cli.analyze_feet import Wanted
    from imu_rig.reference.tables import AxisTable
    from imu_rig.report.foot_facts import FootReport

REPORT_NAME = "report.html"
STRIDES_NAME = "strides.csv"
SUMMARY_NAME = "summary.json"
TRAJECTORY_NAME = "trajectory.csv"


def foot(
    files: Annotated[
        list[Path],
        typer.Argument(help="Trial files, or recordings of other programs."),
    ],
    sensor: Sensors = None,
    certificate: Certificates = None,
    raw: Raw = False,
    any_device: AnyDevice = False,
    gravity: Gravity_ = None,
    latitude: Latitude = None,
    height: Height = None,
    level: Level = "auto",
    detector: Detector = None,
    method: Annotated[
        str,
        typer.Option(
            "--method", help="default, or paper: a forward and a backward filter, step by step."
        ),
    ] = "default",
    straight: Annotated[
        bool,
        typer.Option(
            "--straight", help="The walk keeps to straight corridors: hold the heading by them."
        ),
    ] = False,
    separate: Annotated[
        bool,
        typer.Option(
            "--separate", help="Do not hold a left and a right foot together by how far legs reach."
        ),
    ] = False,
    reference: ReferenceFile = None,
    marker: Marker = None,
    reference_columns: ReferenceColumns = None,
    reference_unit: ReferenceUnit = None,
    reference_rate: ReferenceRate = None,
    reference_time_unit: ReferenceTimeUnit = None,
    reference_z_down: ReferenceZDown = False,
    reference_y_up: ReferenceYUp = False,
    search_offset: ClockSearch = 0.0,
    mirrored: Mirrored = False,
    fit_lever: FitLever = False,
    footprints: FootprintsFile = None,
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
    """Find where a foot went: trajectory, strides, and how far they can be trusted."""
    from imu_rig.cli.analyze_feet import Bounds, Wanted
    from imu_rig.cli.analyze_methods import Way
    from imu_rig.cli.analyze_reference import ReferenceOptions
    from imu_rig.cli.analyze_source import Calibrating
    from imu_rig.cli.recordings import TableOptions
    from imu_rig.cli.sessions import new_folder

    table = TableOptions(
        map_file, columns, rate, accel, gyro, time, accel_unit, gyro_unit, mag_unit, time_unit, mag
    )
    local = gravity_from(gravity, latitude, height)
    calibrating = Calibrating(tuple(certificate or ()), raw, any_device)
    way = Way(method, detector, level, local.value)
    calibrating.check()
    way.check()
    if no_files and output is not None:
        raise InputError("Give either --output or --no-files, not both.")
    beside = ReferenceOptions(
        reference, marker, search_offset, mirrored, fit_lever, footprints, reference_columns,
        reference_unit, reference_rate, reference_time_unit, reference_z_down, reference_y_up,
    )  # fmt: skip
    beside.check(len(files))
    wanted = Wanted(
        table, tuple(sensor or ()), calibrating, way, local, beside, Bounds(straight, not separate)
    )
    together = None
    if output is not None and len(files) > 1:
        together = new_folder(output, (REPORT_NAME,)) / REPORT_NAME
    done = _Done(as_json=as_json, together=together)
    for file in files:
        try:
            _analyse(file, wanted, done, output, several=len(files) > 1, writes=not no_files)
        except InputError as error:
            if len(files) == 1:
                raise
            done.failed(file, error)
    done.finish()


class _Done:
    """What was found of each recording, told as soon as that is known."""

    def __init__(self, *, as_json: bool, together: Path | None) -> None:
        self._as_json = as_json
        self._together = together
        self._answers: list[dict[str, Any]] = []
        self._reports: list[FootReport] = []
        self._errors: dict[str, InputError] = {}

    def found(self, report: FootReport, written: dict[str, Any]) -> None:
        """Take what was found of a recording."""
        from imu_rig.cli.analyze_show import foot_summary, show_foot

        self._answers.append(foot_summary(report, written))
        self._reports.append(report)
        if not self._as_json:
            show_foot(report, written)

    def failed(self, file: Path, error: InputError) -> None:
        """Take that a recording could not be analysed; the others go on."""
        from imu_rig.cli.terminal import fitted
        from imu_rig.foreign_text import printable

        self._errors[str(file)] = error
        sys.stderr.write(fitted(f"imu-rig: {printable(str(error))}") + "\n\n")
        sys.stderr.flush()

    def finish(self) -> None:
        """Tell what all recordings have in common, and end with a code that says whether all went.

        Raises
        ------
        typer.Exit
            If a recording, or a foot in one, could not be analysed.
        """
        from imu_rig.cli.analyze_files import json_text
        from imu_rig.cli.analyze_show import reference_tables, show_tables

        tables = reference_tables(self._reports) if len(self._reports) > 1 else []
        if self._together is not None and self._reports:
            self._write_page(self._together, tables)
        if not self._as_json:
            show_tables(tables)
            if self._together is not None and self._reports:
                sys.stdout.write(f"  all together {self._together}\n")
        else:
            single = len(self._answers) == 1 and not self._errors
            answer: dict[str, Any] = self._answers[0] if single else {"recordings": self._answers}
            if self._errors:
                answer["errors"] = {file: str(error) for file, error in self._errors.items()}
            if tables:
                answer["tables"] = [table.to_dict() for table in tables]
            sys.stdout.write(json_text(answer) + "\n")
        if self._errors or any(report.left_out for report in self._reports):
            raise typer.Exit(InputError.exit_code)

    def _write_page(self, path: Path, tables: list[AxisTable]) -> None:
        """Write the page over all recordings."""
        from imu_rig.report.foot_several import several_report
        from imu_rig.report.page import write_report

        failed = {Path(file).name: str(error) for file, error in self._errors.items()}
        for report in self._reports:
            failed |= {f"{report.recording}, {name}": why for name, why in report.left_out}
        write_report(path, several_report(self._reports, tables, failed))


def _analyse(
    file: Path, wanted: Wanted, done: _Done, output: Path | None, *, several: bool, writes: bool
) -> None:
    from imu_rig.cli.analyze_feet import analyse_recording
    from imu_rig.cli.analyze_files import removed_on_failure
    from imu_rig.cli.working import Working

    with Working(f"Reading {one_line(file.name)}") as working:
        report = analyse_recording(file, wanted, working)
        written: dict[str, Any] = {}
        if writes:
            working.now(f"Drawing {one_line(file.name)}")
            folder = _folder(output, file, several=several, report=report)
            with removed_on_failure(folder, _names(report)):
                written = _write(folder, report)
    done.found(report, written)


def _folder(output: Path | None, file: Path, *, several: bool, report: FootReport) -> Path:
    from imu_rig.cli.analyze_files import analysis_folder, safe_name

    where = output / safe_name(file.stem) if several and output is not None else output
    return analysis_folder(where, "foot", file, _names(report))


def _names(report: FootReport) -> tuple[str, ...]:
    return (REPORT_NAME, STRIDES_NAME, SUMMARY_NAME, *_trajectory_names(report))


def _trajectory_names(report: FootReport) -> list[str]:
    from imu_rig.cli.analyze_files import safe_name

    if len(report.feet) == 1:
        return [TRAJECTORY_NAME]
    return [f"trajectory-{safe_name(foot.name)}.csv" for foot in report.feet]


def _write(folder: Path, report: FootReport) -> dict[str, Any]:
    """Write all files of one recording; return their paths by what they are."""
    from imu_rig.cli.analyze_files import write_json, write_rows, write_trajectory
    from imu_rig.cli.analyze_show import foot_summary
    from imu_rig.report.foot import foot_report
    from imu_rig.report.page import write_report
    from imu_rig.report.stride_table import stride_head, stride_rows

    write_report(folder / REPORT_NAME, foot_report(report))
    rows = [row for foot in report.feet for row in stride_rows(foot.name, foot.strides)]
    write_rows(folder / STRIDES_NAME, stride_head(report.feet[0].strides), rows, "strides")
    trajectories = []
    for foot, name in zip(report.feet, _trajectory_names(report), strict=True):
        write_trajectory(folder / name, foot.track)
        trajectories.append(str(folder / name))
    files = {
        "report": str(folder / REPORT_NAME),
        "strides": str(folder / STRIDES_NAME),
        "trajectory": trajectories[0] if len(trajectories) == 1 else trajectories,
        "summary": str(folder / SUMMARY_NAME),
    }
    write_json(folder / SUMMARY_NAME, foot_summary(report, files))
    return files
