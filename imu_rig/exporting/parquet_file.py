"""Trials as Parquet: a table for each device, units and all else in the metadata of its schema."""

from __future__ import annotations

import json

import pyarrow
from pyarrow import parquet

from imu_rig.exporting.device_data import DeviceData, TrialData
from imu_rig.exporting.output import Output, Place
from imu_rig.foreign_text import one_line


def write_parquet(data: TrialData, place: Place, output: Output) -> None:
    """Write the tables.

    Raises
    ------
    InputError
        If a file exists.
    StorageError
        If the disk is full or fails.
    """
    output.require_new(*(place.of(key) for key in data.chosen_keys))
    for device in data:
        schema = _schema(data, device)
        with (
            output.open(place.of(device.key)) as file,
            parquet.ParquetWriter(file, schema, compression="zstd") as writer,
        ):
            for span in output.spans(device.name, len(device), len(device.columns)):
                writer.write_table(_table(device[span], schema))


def _schema(data: TrialData, device: DeviceData) -> pyarrow.Schema:
    fields = [pyarrow.field("t_s", pyarrow.float64(), metadata={"unit": "s"})]
    if device.start_utc_ns is not None:
        fields.append(pyarrow.field("utc", pyarrow.timestamp("us", tz="UTC")))
    for column in device.columns:
        state = "calibrated" if column.calibrated else "raw"
        metadata = {"unit": one_line(column.unit), "state": state}
        fields.append(pyarrow.field(column.label, pyarrow.float64(), metadata=metadata))
    if device.samples.counter is not None:
        fields.append(pyarrow.field("counter", pyarrow.int64()))
    for name in ("host_s", "device_s"):
        if getattr(device.samples, name) is not None:
            fields.append(pyarrow.field(name, pyarrow.float64(), metadata={"unit": "s"}))
    gaps = [
        {"start_s": g.start_s, "stop_s": g.stop_s, "samples": g.samples, "reason": g.reason}
        for g in device.missing
    ]
    about = {
        "device": device.name,
        "layout": device.layout,
        "time_uncertainty_s": device.time_uncertainty,
        "trial": json.dumps(data.about, ensure_ascii=False),
        "gaps": json.dumps(gaps, ensure_ascii=False),
        "markers": json.dumps(
            [{"t_s": m.t, "label": m.label} for m in data.markers], ensure_ascii=False
        ),
    }
    return pyarrow.schema(fields, metadata=about)


def _table(device: DeviceData, schema: pyarrow.Schema) -> pyarrow.Table:
    samples = device.samples
    measured = (column.values for column in device.columns)
    arrays = [samples.t, device.utc_us, *measured]
    arrays += [samples.counter, samples.host_s, samples.device_s]
    there = [array for array in arrays if array is not None]
    columns = [
        pyarrow.array(array, type=field.type) for array, field in zip(there, schema, strict=True)
    ]
    return pyarrow.Table.from_arrays(columns, schema=schema)
