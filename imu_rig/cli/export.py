"""`imu-rig export`: samples of a recording as CSV, raw or calibrated."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from imu_rig.cli.options import Json
from imu_rig.errors import InputError


def export(
    file: Annotated[Path, typer.Argument(help="A trial file.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="CSV file to write.")],
    certificate: Annotated[
        Path | None, typer.Option(help="Certificate to calibrate the samples with.")
    ] = None,
    sensor: Annotated[
        str | None, typer.Option(help="Which sensor, where the trial has several.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a sensor's samples as CSV: time, specific force, angular rate, field."""
    from imu_rig.calibration.certificate import apply_certificate, load_certificate
    from imu_rig.cli.info import require_one_imu
    from imu_rig.cli.sessions import warn_of_damage
    from imu_rig.recording.csv_export import write_csv
    from imu_rig.recording.reader import open_trial

    trial = open_trial(file)
    name = require_one_imu(trial, sensor)
    block = trial.imu(name)
    if not len(block):
        raise InputError(f"{file} holds no samples to export.")
    calibrated: list[str] = []
    if certificate is not None:
        loaded = load_certificate(certificate)
        block = apply_certificate(loaded, block)
        calibrated = ["accel"] if loaded.gyro is None else ["accel", "gyro"]
        if loaded.gyro is None:
            sys.stderr.write(f"{certificate} has no gyroscope: its columns are raw.\n")
        layout = trial.sources[name].descriptor.get("layout", {}).get("name", "")
        if loaded.device.layout and loaded.device.layout != layout:
            sys.stderr.write(
                f"{certificate} is for packets of {loaded.device.layout}, and {file} holds "
                f"packets of {layout}: is it this sensor's?\n"
            )
    warn_of_damage(trial)
    write_csv(output, block)
    summary = {"file": str(output), "samples": len(block), "calibrated": calibrated}
    if as_json:
        sys.stdout.write(json.dumps(summary) + "\n")
    else:
        kind = f"calibrated ({' and '.join(calibrated)})" if calibrated else "raw"
        sys.stdout.write(f"{len(block)} {kind} samples in {output}\n")
