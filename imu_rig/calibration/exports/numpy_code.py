"""A Python module that needs NumPy alone."""

from __future__ import annotations

from imu_rig.arrays import FloatArray
from imu_rig.calibration.exports.exported import Exported
from imu_rig.calibration.exports.options import ExportOptions
from imu_rig.calibration.exports.source import UNITS, Source

HEAD = '''\
"""Calibration of an inertial sensor: calibrated = K @ raw - b."""
# Written by imu-rig.
'''
APPLY = '''

def calibrate_{sensor}(raw):
    """Calibrate readings [{unit}], shape (3,) or (n, 3)."""
    return np.asarray(raw, dtype=float) @ {sensor}_K.T - {sensor}_b
'''


def numpy_code(source: Source, options: ExportOptions) -> Exported:
    """Write arrays and a function for each sensor."""
    text = HEAD + "".join(f"# {line}\n" for line in source.about)
    text += "\nimport numpy as np\n"
    for sensor, model in source.sensors.items():
        values = {
            "K": model.K,
            "K_uncertainty": model.K_uncertainty,
            "b": model.b,
            "b_uncertainty": model.b_uncertainty,
        }
        text += "\n"
        for name, array in values.items():
            unit = "" if name.startswith("K") else f"  # {UNITS[sensor]}"
            text += f"{sensor}_{name} = {_array(array)}{unit}\n"
    for sensor in source.sensors:
        text += APPLY.format(sensor=sensor, unit=UNITS[sensor])
    return Exported(text)


def _array(array: FloatArray) -> str:
    values = (array + 0.0).tolist()
    if array.ndim == 1:
        return f"np.array({values})"
    return "np.array([\n" + "".join(f"    {row},\n" for row in values) + "])"
