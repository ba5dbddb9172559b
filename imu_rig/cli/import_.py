"""`imu-rig import`: a recording of another program as a trial file."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_rig.cli.options import (
    AccelColumns,
    AccelUnit,
    Columns,
    GyroColumns,
    GyroUnit,
    Json,
    MagColumns,
    MagUnit,
    MapFile,
    Rate,
    TimeColumn,
    TimeUnit,
)
from imu_rig.cli.recordings import TableOptions
from imu_rig.cli.words import counted
from imu_rig.cli.working import Working
from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.importing.foreign import ForeignRecording
    from imu_rig.importing.trial_file import Imported


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            help="CSV or text, Xsens text, x-IMU3 or NGIMU (file or folder), BROAD or pyshoe .mat.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Trial file to write, as OUT.imu-trial.")
    ],
    form: Annotated[
        str | None,
        typer.Option("--format", help="table, xsens, x-imu3, ngimu, broad or pyshoe."),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--name", help="What to call the sensor in the trial.")
    ] = None,
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
    """Make a trial of another program's recording, with its times, gaps and reference."""
    from imu_rig.importing.formats import load_foreign
    from imu_rig.importing.joined import join_recordings
    from imu_rig.importing.trial_file import write_trial
    from imu_rig.recording.format import SUFFIX

    if output.suffix != SUFFIX:
        raise InputError(f"{output}: name a file that ends in {SUFFIX} for the trial.")
    if output.exists():  # before minutes of reading; the writer makes sure of it once more
        raise InputError(f"{output} exists already and is never overwritten; choose another name.")
    table = TableOptions(
        map_file, columns, rate, accel, gyro, time, accel_unit, gyro_unit, mag_unit, time_unit, mag
    )
    stated = table.column_map()
    with Working(f"Reading {files[0].name}") as working:
        recordings = []
        for file in files:
            working.now(f"Reading {file.name}")
            recordings.append(load_foreign(file, form, stated))
        recording = join_recordings(recordings)

        def tell(share: float) -> None:
            working.now(f"Writing {output.name}, {100.0 * share:.0f} %")

        tell(0.0)
        imported = write_trial(output, recording, name=name, progress=tell)
    if as_json:
        sys.stdout.write(json.dumps(_facts(recording, imported), allow_nan=False) + "\n")
        return
    for line in _lines(recording, imported):
        sys.stdout.write(line + "\n")


def _facts(recording: ForeignRecording, imported: Imported) -> dict[str, Any]:
    return {
        "file": str(imported.path),
        "format": recording.format,
        "duration_s": imported.duration_s,
        "sources": {
            name: {"packets": packets, "missing": imported.missing[name]}
            for name, packets in imported.packets.items()
        },
        "start_utc_ns": recording.start_utc_ns,
        "notes": list(recording.notes),
    }


def _lines(recording: ForeignRecording, imported: Imported) -> list[str]:
    from imu_rig.cli.summary import paragraph
    from imu_rig.foreign_text import one_line
    from imu_rig.importing.formats import FORMATS

    lines = [
        f"{imported.path}: {imported.duration_s:.2f} s",
        f"  read as {FORMATS[recording.format].split(':')[0]}",
    ]
    width = max(map(len, imported.packets))
    for name, packets in imported.packets.items():
        missing = imported.missing[name]
        lost = f", {missing} missing ({100.0 * missing / (missing + packets):.2g} %)"
        count = counted(packets, "sample")
        lines.append(f"  {one_line(name):{width}}  {count}{lost if missing else ''}")
    for note in recording.notes:
        lines += paragraph(f"{one_line(note, 400)}.", mark="- ")
    return lines
