"""`imu-rig export`: a trial as files of other programs, raw or calibrated."""

from __future__ import annotations

import json
import os
import sys
from contextlib import nullcontext
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_rig.cli.options import Json
from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.calibration.result import DeviceInfo
    from imu_rig.exporting.device_data import TrialData
    from imu_rig.recording.reader import Trial

SENSORS = {"accel": "accelerometer", "gyro": "gyroscope", "mag": "magnetometer"}


def export(
    file: Annotated[Path, typer.Argument(help="A trial file.")],
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            help="File to write, or a folder for it, a new one with / at its end; beside the trial "
            "by default. With several devices, csv and parquet put the name of each behind the "
            "file's.",
        ),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(
            help="csv, mcap (Foxglove), tlog (MAVLink), mat (MATLAB), parquet or c3d; by the "
            "suffix of the output if not given."
        ),
    ] = None,
    sensor: Annotated[
        list[str] | None, typer.Option(help="Which device; may be repeated. All by default.")
    ] = None,
    raw: Annotated[
        bool, typer.Option("--raw", help="As the sensors sent it, which is the default.")
    ] = False,
    calibrated: Annotated[
        bool,
        typer.Option("--calibrated", help="Calibrate with the certificates kept in the trial."),
    ] = False,
    certificate: Annotated[
        Path | None, typer.Option(help="Certificate to calibrate the samples of one sensor with.")
    ] = None,
    any_device: Annotated[
        bool, typer.Option("--any-device", help="Apply the certificate of another sensor.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Write a trial as CSV, MCAP, MAVLink log, MATLAB file, Parquet or C3D."""
    from imu_rig.cli.sessions import warn_of_damage
    from imu_rig.cli.working import Working
    from imu_rig.exporting.device_data import TrialData
    from imu_rig.exporting.formats import choose, destination, export_trial
    from imu_rig.exporting.output import made_folder
    from imu_rig.foreign_text import one_line
    from imu_rig.recording.reader import open_trial

    if raw + calibrated + (certificate is not None) > 1:
        raise InputError("Give one of --raw, --calibrated and --certificate.")
    with Working(f"reading {file.name}") as working:
        trial = open_trial(file)
        target = None if output is None else Path(output)
        is_folder = output is not None and output.endswith((os.sep, os.altsep or os.sep))
        to = choose(to, target)
        names = _chosen(trial, sensor)
        certificates: dict[str, Certificate] = {}
        if calibrated:
            certificates = _kept_certificates(trial, names)
        elif certificate is not None:
            certificates = _given_certificate(certificate, trial, names, any_device=any_device)
        data = TrialData(trial, names, certificates)
        path = destination(file, to, target, folder=is_folder)
        with made_folder(path.parent) if is_folder else nullcontext():
            done = export_trial(data, to, path, working.now)
    warn_of_damage(trial)
    for name, summary in data.summaries.items():
        if summary.time_problem is not None:
            sys.stderr.write(f"{one_line(name)}: {summary.time_problem}.\n")
    for note in done.notes:
        sys.stderr.write(f"{note}\n")
    if as_json:
        sys.stdout.write(json.dumps(_facts(data, to, done.files, done.notes)) + "\n")
        return
    for line in _lines(data):
        sys.stdout.write(f"{line}\n")
    for path in done.files:
        sys.stdout.write(f"{one_line(str(path))}\n")


def _chosen(trial: Trial, wanted: list[str] | None) -> list[str]:
    """Names of the devices to export, in the order of the trial."""
    if not trial.sensors:
        raise InputError(
            f"{trial.path} holds no sensors ({_listed(list(trial.sources)) or 'nothing'})."
        )
    for name in wanted or ():
        if name not in trial.sensors:
            raise InputError(
                f"{trial.path} has no sensor {name!r} (it has {_listed(trial.sensors)})."
            )
    return [name for name in trial.sensors if not wanted or name in wanted]


def _listed(names: list[str]) -> str:
    """Put names, which may hold anything, into a sentence."""
    from imu_rig.foreign_text import one_line

    return ", ".join(one_line(name) for name in names)


def _fields(trial: Trial, name: str) -> set[str]:
    """Names of the fields in a device's packets."""
    return {field.name for field in trial.layout(name).fields}


def _kept_certificates(trial: Trial, names: list[str]) -> dict[str, Certificate]:
    """Return the certificates that were recorded with the sensors, and say which have none."""
    imus = [name for name in names if name in trial.imus]
    with_one = [name for name in imus if trial.kept_certificate(name) is not None]
    if not with_one:
        raise InputError(
            f"{trial.path} holds no certificate of {_listed(imus) or 'any sensor'}: export it "
            "raw, or give one with --certificate."
        )
    found = {}
    for name in with_one:
        found[name] = trial.certificate(name)
        _tell_raw(found[name], trial, name, f"the certificate of {name!r}")
    for name in imus:
        if name not in with_one:
            sys.stderr.write(f"The trial holds no certificate of {name!r}: its values are raw.\n")
    return found


def _given_certificate(
    path: Path, trial: Trial, names: list[str], *, any_device: bool
) -> dict[str, Certificate]:
    """Read the certificate of a file, and find the one sensor that it can be of."""
    from imu_rig.calibration.certificate import load_certificate
    from imu_rig.cli.info import recorded_device

    certificate = load_certificate(path)
    imus = [name for name in names if name in trial.imus]
    if len(imus) != 1:
        raise InputError(
            f"A certificate is of one sensor, and {len(imus)} inertial sensors are to be exported "
            f"({_listed(imus) or 'none'}): name one with --sensor."
        )
    (name,) = imus
    require_same_device(certificate, recorded_device(trial, name), any_device=any_device)
    _tell_raw(certificate, trial, name, str(path))
    return {name: certificate}


def _tell_raw(certificate: Certificate, trial: Trial, name: str, source: str) -> None:
    """Say on stderr what of a sensor a certificate does not calibrate."""
    fields = _fields(trial, name)
    for short, words in SENSORS.items():
        if short in fields and short not in certificate.calibrated:
            sys.stderr.write(f"{source} has no {words}: its columns are raw.\n")


def require_same_device(certificate: Certificate, device: DeviceInfo, *, any_device: bool) -> None:
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


def _lines(data: TrialData) -> list[str]:
    """Tell what was exported, a line for each device."""
    from imu_rig.cli.words import counted
    from imu_rig.foreign_text import one_line

    lines = []
    for name, summary in data.summaries.items():
        kind = f"calibrated ({', '.join(summary.calibrated)})" if summary.calibrated else "raw"
        line = f"{one_line(name)}: {counted(summary.samples, f'{kind} sample')}"
        if summary.gaps:
            gaps = counted(summary.gaps, "gap")
            count = counted(summary.missing_samples, "sample")
            if summary.gaps_unknown:
                known = summary.gaps_unknown < summary.gaps
                count = f"{count} or more" if known else "number of samples unknown"
            line += f", {gaps} of {summary.gap_s:.2f} s ({count})"
        lines.append(line)
    return lines


def _facts(data: TrialData, to: str, files: list[Path], notes: list[str]) -> dict[str, Any]:
    summaries = data.summaries
    calibrated = [
        short
        for short in SENSORS
        if any(short in s.calibrated for s in summaries.values())
        and all(short in s.calibrated for s in summaries.values() if short in s.measured)
    ]
    return {
        "format": to,
        "files": [str(path) for path in files],
        "samples": sum(summary.samples for summary in summaries.values()),
        "calibrated": calibrated,
        "devices": {
            name: {
                "samples": summary.samples,
                "calibrated": list(summary.calibrated),
                "gaps": summary.gaps,
                "missing_samples": summary.missing_samples,
                "time_uncertainty_s": (
                    summary.time_uncertainty_s if isfinite(summary.time_uncertainty_s) else None
                ),
                "time_problem": summary.time_problem,
            }
            for name, summary in summaries.items()
        },
        "notes": notes,
    }
