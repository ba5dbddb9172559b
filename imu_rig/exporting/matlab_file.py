"""Trials as a MATLAB 5 file, as MATLAB, Octave and SciPy read it: a struct for each device."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.io import savemat

import imu_rig
from imu_rig.errors import InputError
from imu_rig.exporting.device_data import DeviceData, TrialData
from imu_rig.exporting.names import variable_names
from imu_rig.exporting.output import Output, Place
from imu_rig.foreign_text import one_line

LARGEST_VARIABLE = (1 << 31) - 1
"""Bytes of one variable, which the format counts in 32 bits with sign."""
DESCRIPTION_BYTES = 116
TRIAL = "trial"
OWN_FIELDS = (
    *("name", "layout", "t", "host_s", "device_s", "counter"),
    *("units", "calibrated", "gaps", "utc_start", "utc_start_posix", "time_uncertainty_s"),
)


def write_matlab(data: TrialData, place: Place, output: Output) -> None:
    """Write all devices to one file.

    Raises
    ------
    InputError
        If the file exists, or a device has more samples than one variable holds.
    StorageError
        If the disk is full or fails.
    """
    variables = variable_names(data.names, taken=(TRIAL,))
    with output.open(place.path) as file:
        about: dict[str, Any] = dict(data.about)
        about["markers"] = {
            "t": np.array([marker.t for marker in data.markers]),
            "label": _cells([marker.label for marker in data.markers]),
        }
        about["devices"] = _cells(list(variables.values()))
        savemat(file, {TRIAL: about}, long_field_names=True, oned_as="column")
        file.seek(0)  # the library writes the date there: the same trial gives the same bytes
        text = f"MATLAB 5.0 MAT-file, imu-rig {imu_rig.__version__}"
        file.write(text.encode().ljust(DESCRIPTION_BYTES))
        file.seek(0, 2)
        for name in data.names:
            device = data.device(name)
            output.tell(f"exporting {device.name}")
            content = _struct(device)
            if (size := _size(content)) > LARGEST_VARIABLE:
                raise InputError(
                    f"{device.name} has {len(device)} samples, {size / 1e9:.1f} GB: a MATLAB 5 "
                    "file holds 2.1 GB for each; export it as mcap or parquet."
                )
            savemat(file, {variables[name]: content}, long_field_names=True, oned_as="column")


def _struct(device: DeviceData) -> dict[str, Any]:
    samples = device.samples
    content: dict[str, Any] = {
        "name": device.name,
        "layout": device.layout,
        "utc_start": device.start_utc,
        "utc_start_posix": np.nan if device.start_utc_ns is None else device.start_utc_ns / 1e9,
        "time_uncertainty_s": device.time_uncertainty_s,
        "t": samples.t,
        "host_s": samples.host_s,
    }
    if samples.device_s is not None:
        content["device_s"] = samples.device_s
    if samples.counter is not None:
        content["counter"] = samples.counter
    fields = variable_names(device.fields, taken=OWN_FIELDS)
    content |= {fields[name]: samples.values[name] for name in device.fields}
    units = {fields[name]: one_line(samples.units[name]) for name in device.fields}
    content["units"] = {"t": "s", **units}
    content["calibrated"] = _cells([fields[name] for name in device.calibrated])
    unknown = [np.nan if gap.samples is None else gap.samples for gap in device.missing]
    content["gaps"] = {
        "start_s": np.array([gap.start_s for gap in device.missing]),
        "stop_s": np.array([gap.stop_s for gap in device.missing]),
        "samples": np.array(unknown, float),
        "reason": _cells([one_line(gap.reason) for gap in device.missing]),
    }
    return content


def _cells(texts: list[str]) -> np.ndarray[Any, np.dtype[np.object_]]:
    cells = np.empty((len(texts), 1), object)
    for place, text in enumerate(texts):
        cells[place, 0] = text
    return cells


def _size(content: dict[str, Any]) -> int:
    return sum(value.nbytes for value in content.values() if isinstance(value, np.ndarray))
