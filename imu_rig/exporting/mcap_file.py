"""Trials as MCAP with JSON messages, as Foxglove and PlotJuggler read it.

Every device has a topic ``/<device>/imu`` (``/<device>/samples`` without inertial sensor); markers
and gaps are log messages in ``/markers``. Times are wall clock [ns], from a
stand-in on where nobody knows when the trial began.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

import imu_rig
from imu_rig.arrays import BoolArray
from imu_rig.errors import InputError
from imu_rig.exporting.device_data import Column, DeviceData, TrialData, inertial_fields, parts
from imu_rig.exporting.number_text import (
    Bytes,
    constant,
    decimals_of,
    integer_text,
    number_text,
    rows,
)
from imu_rig.exporting.output import Output, Place
from imu_rig.foreign_text import one_line

NS_PER_S = 1_000_000_000
NAMES = {"accel": "linear_acceleration", "gyro": "angular_velocity", "mag": "magnetic_field"}
"""What other robots' messages call the inertial fields."""
INFO, WARNING = 2, 3
"""Levels of foxglove.Log."""
TIME = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": NS_PER_S - 1},
    },
    "required": ["sec", "nsec"],
}
LOG = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "foxglove.Log",
    "description": "A log message",
    "type": "object",
    "properties": {
        "timestamp": TIME,
        "level": {
            "title": "foxglove.LogLevel",
            "description": "Log level",
            "oneOf": [
                {"title": title, "const": level}
                for level, title in enumerate(
                    ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
                )
            ],
        },
        "message": {"type": "string"},
        "name": {"type": "string"},
        "file": {"type": "string"},
        "line": {"type": "integer", "minimum": 0},
    },
    "required": ["timestamp", "level", "message"],
}


def write_mcap(data: TrialData, place: Place, output: Output) -> None:
    """Write all devices to one file.

    Raises
    ------
    InputError
        If the file exists, or a time lies before 1970, which MCAP cannot say.
    StorageError
        If the disk is full or fails.
    """
    with output.open(place.path) as file:
        writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile="", library=f"imu-rig {imu_rig.__version__}")
        writer.add_metadata("trial", data.about)
        log = writer.register_channel(
            "/markers", "json", writer.register_schema("foxglove.Log", "jsonschema", _json(LOG))
        )
        said = [(m.dated_ns, INFO, m.label, "marker") for m in data.markers]
        for device in data:
            _write_device(writer, device, output)
            said += [_gap(device, gap) for gap in device.missing]
        for number, (utc_ns, level, message, name) in enumerate(sorted(said)):
            text = {
                "timestamp": {"sec": utc_ns // NS_PER_S, "nsec": utc_ns % NS_PER_S},
                "level": level,
                "message": message,
                "name": name,
                "file": "",
                "line": 0,
            }
            _require_positive(utc_ns, data)
            writer.add_message(log, utc_ns, _json(text), utc_ns, number)
        writer.finish()  # type: ignore[no-untyped-call]


def _write_device(writer: Writer, device: DeviceData, output: Output) -> None:
    topic = f"/{device.key}/{'imu' if device.samples.is_inertial else 'samples'}"
    schema = writer.register_schema(f"imu_rig.{device.key}", "jsonschema", _json(schema_of(device)))
    about = {
        "device": device.name,
        "layout": device.layout,
        "calibrated": ", ".join(device.calibrated) or "none",
        "time_uncertainty_s": device.time_uncertainty,
    }
    writer.add_metadata(f"device {device.name}", {**about, "topic": topic})
    channel = writer.register_channel(topic, "json", schema, about)
    decimals = [decimals_of(column.values) for column in device.columns]
    first = 0
    for span in output.spans(device.name, len(device), len(device.columns)):
        part = device[span]
        times = part.dated_ns.tolist()
        _require_positive(min(times), device)
        for number, (utc_ns, message) in enumerate(
            zip(times, rows(_messages(part, decimals)), strict=True), start=first
        ):
            writer.add_message(channel, utc_ns, message, utc_ns, number & 0xFFFFFFFF)
        first += len(part)


def schema_of(device: DeviceData) -> dict[str, Any]:
    """Return the JSON schema of a device's messages; units stand in the descriptions.

    Foxglove knows one type for each member and no list of types, so a member that may not be a
    number is one that may not be there.
    """
    properties: dict[str, Any] = {"timestamp": TIME}
    for field, name in _names(device).items():
        values, unit = device.samples.values[field], one_line(device.samples.units[field])
        state = "calibrated" if field in device.calibrated else "raw"
        value: dict[str, Any] = {"type": "number"}
        if values.ndim == 2:
            value = {"type": "object", "properties": dict.fromkeys(parts(values), value)}
        properties[name] = {**value, "description": f"{field}, {state}, {unit or 'counts'}"}
    if device.samples.counter is not None:
        properties["counter"] = {"type": "integer", "description": "packets counted by the device"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"imu_rig.{device.key}",
        "type": "object",
        "properties": properties,
        "required": [name for name in ("timestamp", "counter") if name in properties],
    }


def _names(device: DeviceData) -> dict[str, str]:
    """Names of the measured fields in messages, no two alike."""
    inertial = inertial_fields(device.samples)
    used, found = {"timestamp", "counter"}, {}
    for field in device.fields:
        name = NAMES[field] if field in inertial else field
        while name in used:
            name += "_"
        used.add(name)
        found[field] = name
    return found


def _messages(device: DeviceData, decimals: Sequence[int | None]) -> list[Bytes]:
    """Return the messages of all samples as columns of text."""
    count, utc_ns = len(device), device.dated_ns
    cells = [
        constant('{"timestamp":{"sec":', count),
        integer_text(utc_ns // NS_PER_S),
        constant(',"nsec":', count),
        integer_text(utc_ns % NS_PER_S),
        constant("}", count),
    ]
    numbers = zip(device.columns, decimals, strict=True)
    for field, name in _names(device).items():
        each = parts(device.samples.values[field])
        columns = [next(numbers) for _ in each]
        if each == [""]:
            cells += _members([name], columns, np.ones(count, bool))
        else:
            members = _members(each, columns, np.zeros(count, bool))
            cells += [constant(f',"{name}":{{', count), *members, constant("}", count)]
    if device.samples.counter is not None:
        cells += [constant(',"counter":', count), integer_text(device.samples.counter)]
    return [*cells, constant("}", count)]


def _members(
    names: Sequence[str], columns: Sequence[tuple[Column, int | None]], begun: BoolArray
) -> list[Bytes]:
    """Write members of an object, leaving out what is no number, for JSON has none such.

    ``begun`` says in which rows another member stands before.
    """
    cells: list[Bytes] = []
    for name, (column, places) in zip(names, columns, strict=True):
        there = np.isfinite(column.values)
        comma = np.where(there & begun, np.uint8(ord(",")), np.uint8(0))[:, None]
        text = [constant(f'"{name}":', len(there)), number_text(column.values, places)]
        if not there.all():
            text = [part * there[:, None] for part in text]
        cells += [comma, *text]
        begun = begun | there
    return cells


def _gap(device: DeviceData, gap: Any) -> tuple[int, int, str, str]:
    known = "" if gap.samples is None else f", {gap.samples} samples"
    message = f"{one_line(gap.reason)}: missing until {gap.stop_s:.6f} s{known}"
    return device.dated_start_ns + round(gap.start_s * 1e9), WARNING, message, device.name


def _require_positive(utc_ns: int, data: TrialData | DeviceData) -> None:
    if utc_ns < 0:
        raise InputError(
            "Times in this trial lie before 1970, and MCAP has no such times: export it as "
            "CSV, whose column t_s does not need that clock."
        )


def _json(value: dict[str, Any]) -> bytes:
    return json.dumps(value, ensure_ascii=False, allow_nan=False).encode()
