"""`imu-rig solve`: a calibration from a trial file or a text table, with or without a jig."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.options import (
    DEFAULT_METHOD,
    Gravity_,
    Height,
    Json,
    Latitude,
    Method,
    Output,
    gravity_from,
)
from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.calibration.gravity import Gravity
    from imu_rig.calibration.result import CalibrationResult
    from imu_rig.importing.column_map import ColumnMap
    from imu_rig.recording.reader import Trial

TRIAL_SUFFIX = ".imu-trial"


def solve(
    file: Annotated[Path, typer.Argument(help="A trial file, a CSV or white-space text.")],
    method: Method = DEFAULT_METHOD,
    gravity: Gravity_ = None,
    latitude: Latitude = None,
    height: Height = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", help="TOML file that names columns and units.")
    ] = None,
    columns: Annotated[
        str | None, typer.Option(help='Names of all columns, as in "t ax ay az gx gy gz".')
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Samples per second, where there is no time column.")
    ] = None,
    accel: Annotated[
        str | None, typer.Option(help="Accelerometer columns by name or number, as X,Y,Z.")
    ] = None,
    gyro: Annotated[str | None, typer.Option(help="Gyroscope columns, likewise.")] = None,
    time: Annotated[str | None, typer.Option(help="Time column by name or number.")] = None,
    accel_unit: Annotated[
        str | None, typer.Option(help='m/s2, g, mg or counts as in "16384 LSB/g".')
    ] = None,
    gyro_unit: Annotated[
        str | None, typer.Option(help='rad/s, deg/s or counts as in "131 LSB/(deg/s)".')
    ] = None,
    mag_unit: Annotated[str | None, typer.Option(help="uT, gauss, mG or nT.")] = None,
    time_unit: Annotated[str | None, typer.Option(help="s, ms, us, ns or samples.")] = None,
    name: Annotated[str, typer.Option(help="Name of the sensor, for the certificate.")] = "",
    serial: Annotated[str, typer.Option(help="Serial number, for the certificate.")] = "",
    output: Output = None,
    as_json: Json = False,
) -> None:
    """Calibrate from a recording: a jig session, or a sensor held still and turned by hand."""
    from imu_rig.calibration.certificate import certificate_of
    from imu_rig.cli import sessions
    from imu_rig.recording.reader import open_trial

    local_gravity = gravity_from(gravity, latitude, height)
    trial: Trial | None = None
    if file.suffix == TRIAL_SUFFIX:
        table = (map_file, columns, rate, accel_unit, gyro_unit, mag_unit, time_unit)
        if any(option is not None for option in (*table, accel, gyro, time)):
            raise InputError(f"{file} knows its columns, units and rate: leave those options out.")
        trial = open_trial(file)
        sessions.warn_of_damage(trial)
        result = _solve_trial(trial, method, local_gravity)
        digest = trial.sha256
    else:
        from imu_rig.importing.column_map import ColumnMap, load_column_map

        stated = ColumnMap() if map_file is None else load_column_map(map_file)
        stated = stated.updated(
            columns=columns,
            rate_hz=rate,
            accel=accel,
            gyro=gyro,
            time=time,
            accel_unit=accel_unit,
            gyro_unit=gyro_unit,
            mag_unit=mag_unit,
            time_unit=time_unit,
        )
        result, digest = _solve_table(file, stated, method, local_gravity, name, serial)
    certificate = certificate_of(result, recording=(file.name, digest))
    files: dict[str, str] = {}
    if output is not None:
        folder = sessions.new_folder(output)
        files = sessions.write_results(folder, result, certificate, trial=trial)
    sessions.show(result, certificate, files, as_json=as_json)
    if not files and not as_json:
        sys.stderr.write("Nothing was written; --output DIR writes certificate and report.\n")


def _solve_trial(trial: Trial, method: str, gravity: Gravity) -> CalibrationResult:
    from imu_rig.calibration.result import DeviceInfo
    from imu_rig.calibration.solve import solve as solve_block
    from imu_rig.cli.info import require_one_imu
    from imu_rig.session.history import is_session
    from imu_rig.session.solve import solve_session

    if is_session(trial):
        return solve_session(trial, method=method, gravity=gravity)
    sensor = require_one_imu(trial, None)
    return solve_block(
        trial.imu(sensor), method=method, gravity=gravity, device=DeviceInfo(name=sensor)
    )


def _solve_table(
    file: Path, stated: ColumnMap, method: str, gravity: Gravity, name: str, serial: str
) -> tuple[CalibrationResult, str]:
    import hashlib

    from imu_rig.calibration.result import DeviceInfo
    from imu_rig.calibration.solve import solve as solve_block
    from imu_rig.importing.read_table import read_table

    block = read_table(file, stated)
    try:
        with file.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{file} cannot be read: {error.strerror}.") from error
    device = DeviceInfo(name=name or file.stem, serial=serial)
    return solve_block(block, method=method, gravity=gravity, device=device), digest
