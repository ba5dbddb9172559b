"""`imu-rig export`: samples of a recording as CSV, raw or calibrated."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.options import Json
from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.calibration.result import DeviceInfo

SENSORS = {"accel": "accelerometer", "gyro": "gyroscope", "mag": "magnetometer"}


def export(
    file: Annotated[Path, typer.Argument(help="A trial file.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="CSV file to write.")],
    certificate: Annotated[
        Path | None, typer.Option(help="Certificate to calibrate the samples with.")
    ] = None,
    sensor: Annotated[
        str | None, typer.Option(help="Which sensor, where the trial has several.")
    ] = None,
    any_device: Annotated[
        bool, typer.Option("--any-device", help="Apply the certificate of another sensor.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Write a sensor's samples as CSV: time, specific force, angular rate, field."""
    from imu_rig.calibration.certificate import apply_certificate, load_certificate
    from imu_rig.cli.info import recorded_device, require_one_imu
    from imu_rig.cli.sessions import warn_of_damage
    from imu_rig.recording.csv_export import write_csv
    from imu_rig.recording.reader import open_trial

    trial = open_trial(file)
    name = require_one_imu(trial, sensor)
    assembled = trial.imu_assembled(name)
    block = assembled.block
    if not len(block):
        raise InputError(f"{file} holds no samples to export.")
    calibrated: list[str] = []
    if certificate is not None:
        loaded = load_certificate(certificate)
        _require_same_device(loaded, recorded_device(trial, name), any_device=any_device)
        block = apply_certificate(loaded, block)
        there = {"accel": True, "gyro": True, "mag": block.mag is not None}
        calibrated = [sensor for sensor in loaded.calibrated if there[sensor]]
        for sensor, words in SENSORS.items():
            if there[sensor] and sensor not in calibrated:
                sys.stderr.write(f"{certificate} has no {words}: its columns are raw.\n")
    warn_of_damage(trial)
    if assembled.time_problem is not None:
        sys.stderr.write(f"{file}: {assembled.time_problem}.\n")
    write_csv(output, block)
    summary = {"file": str(output), "samples": len(block), "calibrated": calibrated}
    if as_json:
        sys.stdout.write(json.dumps(summary) + "\n")
    else:
        kind = f"calibrated ({', '.join(calibrated)})" if calibrated else "raw"
        sys.stdout.write(f"{len(block)} {kind} samples in {output}\n")


def _require_same_device(certificate: Certificate, device: DeviceInfo, *, any_device: bool) -> None:
    """Refuse a certificate that is of another sensor, unless that was asked for."""
    from imu_rig.calibration.recheck import other_device

    difference = other_device(certificate.device, device)
    if difference is None:
        return
    if not any_device:
        raise InputError(
            f"{difference[0].upper()}{difference[1:]}: give this sensor's own certificate, or "
            "--any-device to apply it all the same."
        )
    sys.stderr.write(f"Applied all the same: {difference}.\n")
