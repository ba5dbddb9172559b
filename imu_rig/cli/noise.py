"""`imu-rig noise`: how noisy a sensor at rest is, from a recording of it."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.options import (
    AccelColumns,
    AccelUnit,
    Columns,
    GyroColumns,
    GyroUnit,
    Json,
    MagUnit,
    MapFile,
    Quiet,
    Rate,
    SensorName,
    Serial,
    TimeColumn,
    TimeUnit,
    named,
)
from imu_rig.cli.recordings import TableOptions, open_if_trial, read_block
from imu_rig.cli.status_line import StatusLine

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.calibration.noise_model import NoiseModel

MODEL_NAME = "noise.json"
REPORT_NAME = "noise.html"
WIDTH = 80
SILENT_S = 2.0
"""Work that takes longer shows how far it is."""


def noise(
    file: Annotated[Path, typer.Argument(help="A trial file, a CSV or white-space text.")],
    map_file: MapFile = None,
    columns: Columns = None,
    rate: Rate = None,
    accel: AccelColumns = None,
    gyro: GyroColumns = None,
    time: TimeColumn = None,
    accel_unit: AccelUnit = None,
    gyro_unit: GyroUnit = None,
    mag_unit: MagUnit = None,
    time_unit: TimeUnit = None,
    sensor: Annotated[
        str | None, typer.Option("--sensor", help="Which sensor of a trial with several.")
    ] = None,
    name: SensorName = "",
    serial: Serial = "",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            parser=named,
            metavar="PATH",
            help="Folder for the noise model and the report.",
        ),
    ] = None,
    certificate: Annotated[
        Path | None,
        typer.Option(
            "--certificate", help="A certificate of the sensor; a copy gets the noise as a part."
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Find the noise of a sensor that lies still: random walks, bias instability, Allan plot."""
    from imu_rig.calibration.noise import analyse_noise
    from imu_rig.calibration.result import DeviceInfo
    from imu_rig.errors import DataError, InputError

    table = TableOptions(
        map_file, columns, rate, accel, gyro, time, accel_unit, gyro_unit, mag_unit, time_unit
    )
    if certificate is not None and output is None:
        raise InputError("--certificate needs --output DIR, where the copy is written.")
    status_line = StatusLine(quiet=quiet, silent_s=SILENT_S)
    trial = open_if_trial(file, table)
    if trial is not None:
        from imu_rig.cli.info import require_one_imu

        source = require_one_imu(trial, sensor)
        block, digest = trial.imu_in_time(source), trial.sha256
        device = DeviceInfo(name=name or source, serial=serial)
    else:
        block, digest = read_block(file, table, sensor)
        device = DeviceInfo(name=name or file.stem, serial=serial)
    try:
        analysis = analyse_noise(
            block,
            device=device,
            recording=(file.name, digest),
            progress=lambda share: status_line.show(f"Noise: {100.0 * share:3.0f} % done"),
        )
    except DataError as error:
        raise DataError(f"{file}: {error}.") from error
    finally:
        status_line.close()
    files: dict[str, str] = {}
    if output is not None:
        from imu_rig.cli.sessions import CERTIFICATE_NAME, new_folder
        from imu_rig.report.noise import noise_report
        from imu_rig.report.page import write_report

        whole = None if certificate is None else _with_noise(certificate, analysis.model)
        folder = new_folder(output, (MODEL_NAME, REPORT_NAME, CERTIFICATE_NAME))
        analysis.model.save(folder / MODEL_NAME)
        write_report(folder / REPORT_NAME, noise_report(analysis))
        files = {"noise": str(folder / MODEL_NAME), "report": str(folder / REPORT_NAME)}
        if whole is not None:
            whole.save(folder / CERTIFICATE_NAME)
            files["certificate"] = str(folder / CERTIFICATE_NAME)
    if as_json:
        model = analysis.model.model_dump(mode="json", by_alias=True)
        sys.stdout.write(json.dumps({"noise": model, "files": files}, allow_nan=False) + "\n")
        return
    for line in noise_lines(analysis.model):
        sys.stdout.write(line + "\n")
    for kind, path in files.items():
        sys.stdout.write(f"  {kind:12}{path}\n")
    if not files:
        sys.stderr.write("Nothing was written; --output DIR writes noise model and report.\n")


def _with_noise(file: Path, model: NoiseModel) -> Certificate:
    """Return a certificate with the noise; one of another serial number is refused."""
    from imu_rig.calibration.certificate import load_certificate
    from imu_rig.errors import InputError

    certificate = load_certificate(file)
    theirs, ours = certificate.device.serial, model.device.serial
    if theirs and ours and theirs != ours:
        raise InputError(f"{file} is of the sensor with serial number {theirs}, not {ours}.")
    return certificate.model_copy(update={"noise": model})


def noise_lines(model: NoiseModel) -> list[str]:
    """Lines that tell a noise model; uncertainties are standard uncertainties."""
    from imu_rig.cli.summary import paragraph
    from imu_rig.report.noise_units import noise_rows, noise_sensors
    from imu_rig.report.numbers import duration

    lines = [
        f"Noise of {model.device.name or 'the sensor'} over {duration(model.duration_s)} at rest, "
        f"{model.rate_hz:.2f} samples/s"
    ]
    for units, found in noise_sensors(model):
        lines += ["", *_sensor_lines(units.title, noise_rows(units, found))]
    lines += ["", "  '<': an upper bound (95 %) of what the record does not determine."]
    for warning in model.warnings:
        lines += ["", *paragraph(warning, mark="! ")]
    return [*lines, ""]


def _sensor_lines(title: str, rows: list[tuple[str, str, str, str]]) -> list[str]:
    """Rows under their title; labels stand above the numbers where both do not fit one line."""
    label_width = 1 + max(len(label) for label, *_ in rows)
    cell = 2 + max(len(text) for _, *texts in rows for text in texts)
    beside = label_width + 3 * cell <= WIDTH - 2
    indent = label_width if beside else WIDTH - 2 - 3 * cell

    def cells(texts: Iterable[str]) -> str:
        return "".join(f"{text:>{cell}}" for text in texts)

    lines = [f"  {title:{indent}}{cells('xyz')}"]
    for label, *texts in rows:
        if beside:
            lines.append(f"  {label:{indent}}{cells(texts)}")
        else:
            lines += [f"  {label}", f"  {'':{indent}}{cells(texts)}"]
    return lines
