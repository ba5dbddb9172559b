"""Trials as C3D with analog channels, beside the markers of an optical system.

C3D has no times: all devices stand on one grid of equal steps, that of the fastest, and the file
and the notes of the export say how many samples that repeated or left out. NaN stands where a
device has no sample.
"""

from __future__ import annotations

import shutil
import struct
import tempfile
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np

from imu_rig.errors import DataError, InputError, StorageError
from imu_rig.exporting.device_data import DeviceData, TrialData, iso_utc
from imu_rig.exporting.grid import Grid, Placed, common_grid, place
from imu_rig.exporting.names import variable_names
from imu_rig.exporting.output import Output, Place
from imu_rig.foreign_text import one_line

MOST_CHANNELS = 255
MOST_EVENTS = 255
MOST_FRAMES = 65_535
MOST_NUMBERS = 20_000_000
"""The library holds a file several times over in memory."""
TEXT_BYTES = 100
BLOCK = 512
GROUP = "IMU_RIG"


def write_c3d(data: TrialData, target: Place, output: Output) -> None:
    """Write all devices to one file.

    Raises
    ------
    InputError
        If the file exists, or the trial is larger than a C3D file can be.
    DataError
        If there are no samples.
    StorageError
        If the disk is full or fails.
    """
    output.require_new(target.path)
    devices = list(data)
    times = [device.samples.t for device in devices]
    if not any(map(len, times)):
        raise DataError(f"{data.trial.path} holds no samples to place in a C3D file.")
    grid = common_grid(times)
    channels = sum(len(device.columns) for device in devices)
    _require_possible(grid, channels)
    per_frame = 1
    while grid.count > per_frame * MOST_FRAMES:
        per_frame *= 2
    frames = -(-grid.count // per_frame)
    file = ezc3d.c3d()
    del file["data"]["rotations"]  # there are none, and the library divides by their number
    file["data"]["points"] = np.zeros((4, 0, frames))
    analogs = np.full((1, channels, frames * per_frame), np.nan)
    placed, row = [], 0
    for device in devices:
        output.tell(f"exporting {device.name}")
        where = place(grid, device.samples.t, device.missing)
        placed.append(where)
        there = np.flatnonzero(where.rows >= 0)
        for column in device.columns:
            analogs[0, row, there] = column.values[where.rows[there]]
            row += 1
    file["data"]["analogs"] = analogs
    _describe(file, devices, grid, per_frame)
    _tell_placing(file, data, devices, grid, placed, output)
    _write(file, target.path, output, 4 * analogs.size)


def _require_possible(grid: Grid, channels: int) -> None:
    if channels > MOST_CHANNELS:
        raise InputError(
            f"A C3D file takes {MOST_CHANNELS} channels and these devices have {channels}: choose "
            "some with --sensor."
        )
    if grid.count * channels > MOST_NUMBERS:
        raise InputError(
            f"{channels} channels at {grid.count} times are more than a C3D file is made for: "
            "choose some devices with --sensor, or export as mcap or parquet."
        )


def _describe(file: Any, devices: list[DeviceData], grid: Grid, per_frame: int) -> None:
    keys = variable_names([device.key for device in devices])
    columns = [(device, column) for device in devices for column in device.columns]
    analog, point = file["parameters"]["ANALOG"], file["parameters"]["POINT"]
    point["RATE"]["value"] = [grid.rate_hz / per_frame]
    analog["RATE"]["value"] = [grid.rate_hz]
    analog["LABELS"]["value"] = [f"{keys[d.key]}.{column.name}" for d, column in columns]
    analog["UNITS"]["value"] = [_short(column.unit) for _, column in columns]
    analog["DESCRIPTIONS"]["value"] = [
        _short(f"{'calibrated' if column.calibrated else 'raw'}, {device.name}")
        for device, column in columns
    ]
    analog["SCALE"]["value"] = [1.0] * len(columns)


def _tell_placing(
    file: Any,
    data: TrialData,
    devices: list[DeviceData],
    grid: Grid,
    placed: list[Placed],
    output: Output,
) -> None:
    """Say in the file and in the notes what the grid did to the samples."""
    start_ns = data.trial.start_utc_ns
    begin_ns = None if start_ns is None else start_ns + round(grid.start_s * 1e9)
    output.notes.append(
        f"C3D has no times: samples stand on a grid of {grid.rate_hz:.6g} Hz, each point with the "
        "nearest sample in time, nothing interpolated."
    )
    for device, where in zip(devices, placed, strict=True):
        output.notes.append(
            f"{device.name}: {where.repeated} points repeat a sample, {where.left_out} samples "
            f"are left out, {where.empty} points are NaN."
        )
    facts: dict[str, list[Any]] = {
        "UTC_START": [iso_utc(begin_ns)],
        "START_S": [grid.start_s],
        "PLACING": ["nearest sample in time on one grid; NaN where samples are missing"],
        "DEVICES": [_short(device.name) for device in devices],
        "REPEATED": [float(where.repeated) for where in placed],
        "LEFT_OUT": [float(where.left_out) for where in placed],
        "TIME_UNCERTAINTY_S": [device.time_uncertainty_s for device in devices],
        "EMPTY": [float(where.empty) for where in placed],
    }
    for name, value in facts.items():
        file.add_parameter(GROUP, name, value)
    for name in ("subject", "session", "trial", "note"):
        if data.about.get(name):
            file.add_parameter(GROUP, name.upper(), [_short(data.about[name])])
    markers = data.markers[:MOST_EVENTS]
    if len(data.markers) > len(markers):
        output.notes.append(f"Of {len(data.markers)} markers the first {MOST_EVENTS} are in it.")
    if markers:
        times = [[0.0] * len(markers), [marker.t - grid.start_s for marker in markers]]
        file.add_parameter("EVENT", "USED", len(markers))
        file.add_parameter("EVENT", "CONTEXTS", ["General"] * len(markers))
        file.add_parameter("EVENT", "LABELS", [_short(marker.label) or "-" for marker in markers])
        file.add_parameter("EVENT", "TIMES", np.array(times))


def _write(file: Any, path: Path, output: Output, data_bytes: int) -> None:
    """Write through a file of the library's own, which does not say when the disk is full."""
    try:
        with tempfile.TemporaryDirectory(prefix=".imu-rig-", dir=path.parent) as folder:
            made = Path(folder) / "trial.c3d"
            file.write(str(made))
            with output.open(path) as target, made.open("rb") as source:
                head = source.read(BLOCK)
                first_block = struct.unpack_from("<H", head, 16)[0] if len(head) == BLOCK else 0
                if made.stat().st_size < BLOCK * max(1, first_block - 1) + data_bytes:
                    raise OSError("the disk is full or fails")
                target.write(head)
                shutil.copyfileobj(source, target)
    except OSError as error:
        raise StorageError(f"{path} could not be written: {error}") from error


def _short(text: str) -> str:
    """Return what a text parameter holds of a text."""
    return one_line(text).encode()[:TEXT_BYTES].decode(errors="ignore")
