"""Trials as CSV: a table for each device, and one for gaps and one for markers where there are any.

One row per sample, units in the header, missing samples left out and listed in the table of gaps.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from imu_rig.exporting.device_data import DeviceData, Marked, TrialData, iso_utc
from imu_rig.exporting.number_text import (
    Bytes,
    constant,
    decimals_of,
    integer_text,
    joined,
    number_text,
    utc_text,
)
from imu_rig.exporting.output import Output, Place
from imu_rig.recording.contents import Missing

TIME_DECIMALS = 6  # of a second; the wall clock is written to the same microsecond


def write_csv(data: TrialData, place: Place, output: Output) -> None:
    """Write the tables.

    Raises
    ------
    InputError
        If a file exists.
    StorageError
        If the disk is full or fails.
    """
    gaps_path, markers_path = place.beside("gaps"), place.beside("markers")
    output.require_new(gaps_path, markers_path, *(place.of(key) for key in data.chosen_keys))
    gaps: list[tuple[str, Missing]] = []
    for device in data:
        gaps += [(device.name, missing) for missing in device.missing]
        with output.open(place.of(device.key)) as file:
            columns = device.columns
            counted = ["counter"] if device.samples.counter is not None else []
            clock = ["utc"] if device.start_utc_ns is not None else []
            file.write(_line(["t_s", *(c.label for c in columns), *counted, *clock]))
            decimals = [decimals_of(column.values) for column in columns]
            for span in output.spans(device.name, len(device), len(device.columns)):
                file.write(_rows(device[span], decimals))
    if gaps:
        names = ["device", "start_s", "stop_s", "samples", "reason"]
        _write_small(output, gaps_path, names, (_gap_row(*gap) for gap in gaps))
    if data.markers:
        known = data.trial.start_utc_ns is not None
        names = ["t_s", *(["utc"] if known else []), "label"]
        rows = (_marker_row(marker, with_utc=known) for marker in data.markers)
        _write_small(output, markers_path, names, rows)


def _rows(device: DeviceData, decimals: Sequence[int | None]) -> bytes:
    count = len(device)
    comma = constant(",", count)
    cells: list[Bytes] = [integer_text(device.t_us, TIME_DECIMALS)]
    for column, places in zip(device.columns, decimals, strict=True):
        cells += [comma, number_text(column.values, places)]
    if device.samples.counter is not None:
        cells += [comma, integer_text(device.samples.counter)]
    utc_us = device.utc_us
    if utc_us is not None:
        cells += [comma, utc_text(utc_us)]
    return joined([*cells, constant("\n", count)])


def _gap_row(device: str, gap: Missing) -> list[Any]:
    known = "" if gap.samples is None else gap.samples
    return [device, f"{gap.start_s:.6f}", f"{gap.stop_s:.6f}", known, gap.reason]


def _marker_row(marker: Marked, *, with_utc: bool) -> list[Any]:
    clock = [iso_utc(marker.dated_ns)] if with_utc else []
    return [f"{marker.t:.6f}", *clock, marker.label]


def _write_small(output: Output, path: Path, names: list[str], rows: Iterable[list[Any]]) -> None:
    with output.open(path) as file:
        file.write(_line(names))
        for row in rows:
            file.write(_line(row))


def _line(cells: Sequence[Any]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue().encode()
