"""`imu-rig solve`: a calibration from a trial file or a text table, with or without a jig."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.known_facts import KnownOptions, Parts, Rates, TurnAngle, read_with_facts
from imu_rig.cli.options import (
    DEFAULT_METHOD,
    AccelColumns,
    AccelUnit,
    Columns,
    FieldUt,
    Gravity_,
    GyroColumns,
    GyroUnit,
    Height,
    Json,
    Latitude,
    MagColumns,
    MagUnit,
    MapFile,
    Method,
    Output,
    Rate,
    SensorName,
    Serial,
    TimeColumn,
    TimeUnit,
    gravity_from,
)
from imu_rig.cli.recordings import TableOptions, digest_of, open_if_trial
from imu_rig.cli.working import Working

if TYPE_CHECKING:
    from imu_rig.calibration.gravity import Gravity
    from imu_rig.calibration.result import CalibrationResult
    from imu_rig.recording.reader import Trial


WITHOUT_JIG = ("static", "ferraris", "turntable", "magnetometer")
"""Methods that take the samples of a jig session and nothing of its commands."""


def solve(
    file: Annotated[Path, typer.Argument(help="A trial file, a CSV or white-space text.")],
    method: Method = DEFAULT_METHOD,
    gravity: Gravity_ = None,
    latitude: Latitude = None,
    height: Height = None,
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
    field: FieldUt = None,
    parts: Parts = None,
    turn_angle: TurnAngle = None,
    rates: Rates = None,
    name: SensorName = "",
    serial: Serial = "",
    output: Output = None,
    as_json: Json = False,
) -> None:
    """Calibrate from a recording: a jig session, or a sensor held still and turned by hand."""
    from imu_rig.calibration.certificate import certificate_of
    from imu_rig.calibration.result import DeviceInfo
    from imu_rig.calibration.solve import solve as solve_block
    from imu_rig.cli import sessions
    from imu_rig.importing.formats import stated_units

    local_gravity = gravity_from(gravity, latitude, height)
    table = TableOptions(
        map_file, columns, rate, accel, gyro, time, accel_unit, gyro_unit, mag_unit, time_unit, mag
    )
    beside = KnownOptions(parts, turn_angle, rates)
    beside.check(method)
    with Working(f"Reading {file.name}") as working:
        trial = open_if_trial(file, table)
        if trial is not None:
            working.now("Solving")
            result = _solve_trial(trial, method, local_gravity, field, beside)
            digest = trial.sha256
        else:
            block, known = read_with_facts(file, table.column_map(), method, beside)
            working.now(f"Solving {len(block)} samples")
            units = stated_units(file, table.column_map())
            device = DeviceInfo(
                name=name or file.stem,
                serial=serial,
                accel_recorded_unit=units.get("accel", ""),
                gyro_recorded_unit=units.get("gyro", ""),
                mag_recorded_unit=units.get("mag", ""),
            )
            result = solve_block(
                block,
                method=method,
                gravity=local_gravity,
                device=device,
                field_ut=field,
                known=known,
            )
            digest = digest_of(file)
    certificate = certificate_of(result, recording=(file.name, digest))
    files: dict[str, str] = {}
    if output is not None:
        folder = sessions.new_folder(output)
        files = sessions.write_results(folder, result, certificate, trial=trial)
    sessions.show(result, certificate, files, as_json=as_json)
    if not files and not as_json:
        sys.stderr.write("Nothing was written; --output DIR writes certificate and report.\n")


def _solve_trial(
    trial: Trial, method: str, gravity: Gravity, field: float | None, beside: KnownOptions
) -> CalibrationResult:
    from imu_rig.calibration.solve import solve as solve_block
    from imu_rig.cli.info import recorded_device, require_one_imu
    from imu_rig.session.history import is_session
    from imu_rig.session.solve import solve_session

    if is_session(trial) and method not in WITHOUT_JIG:
        return solve_session(trial, method=method, gravity=gravity, field_ut=field)
    sensor = require_one_imu(trial, None)
    block = trial.imu_in_time(sensor)
    return solve_block(
        block,
        method=method,
        gravity=gravity,
        field_ut=field,
        device=recorded_device(trial, sensor),
        known=beside.facts(block),
    )
