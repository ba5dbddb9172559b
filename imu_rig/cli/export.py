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
    from imu_rig.recording.csv_export import write_csv
    from imu_rig.recording.reader import open_trial

    trial = open_trial(file)
    block = trial.imu(require_one_imu(trial, sensor))
    if not len(block):
        raise InputError(f"{file} holds no samples to export.")
    if certificate is not None:
        block = apply_certificate(load_certificate(certificate), block)
    write_csv(output, block)
    summary = {
        "file": str(output),
        "samples": len(block),
        "calibrated": certificate is not None,
    }
    if as_json:
        sys.stdout.write(json.dumps(summary) + "\n")
    else:
        kind = "calibrated" if certificate is not None else "raw"
        sys.stdout.write(f"{len(block)} {kind} samples in {output}\n")
