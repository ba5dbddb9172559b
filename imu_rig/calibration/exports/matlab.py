"""A script for MATLAB and Octave."""

from __future__ import annotations

import re

from imu_rig.arrays import FloatArray
from imu_rig.calibration.exports.exported import Exported
from imu_rig.calibration.exports.options import ExportOptions
from imu_rig.calibration.exports.source import KINDS, UNITS, Source

KEYWORDS = frozenset(
    [
        "break",
        "case",
        "catch",
        "classdef",
        "continue",
        "else",
        "elseif",
        "end",
        "for",
        "function",
        "global",
        "if",
        "otherwise",
        "parfor",
        "persistent",
        "return",
        "spmd",
        "switch",
        "try",
        "while",
        "do",
        "until",
        "endfor",
        "endfunction",
        "endif",
        "endswitch",
        "endwhile",
        "end_try_catch",
        "end_unwind_protect",
        "endclassdef",
        "endenumeration",
        "endevents",
        "endmethods",
        "endparfor",
        "endproperties",
        "unwind_protect",
        "unwind_protect_cleanup",
    ]
)
"""Words of MATLAB and of Octave that name nothing else."""


def runs_as(name: str) -> bool:
    """Whether a script of this name, without its ``.m``, can be called."""
    return bool(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", name)) and name not in KEYWORDS


def matlab(source: Source, options: ExportOptions) -> Exported:
    """Write matrices and a function handle for each sensor."""
    lines = ["% Calibration of an inertial sensor: calibrated = K * raw - b."]
    lines += [f"% {line}" for line in source.about]
    for sensor, model in source.sensors.items():
        unit = UNITS[sensor]
        lines += [
            "",
            f"% {KINDS[sensor]}: raw and calibrated readings and b in {unit}.",
            f"{sensor}_K = {_matrix(model.K)};",
            f"{sensor}_K_uncertainty = {_matrix(model.K_uncertainty)};",
            f"{sensor}_b = {_matrix(model.b[:, None])};",
            f"{sensor}_b_uncertainty = {_matrix(model.b_uncertainty[:, None])};",
            "% of readings in rows, n by 3",
            f"calibrate_{sensor} = @(raw) bsxfun(@minus, raw * {sensor}_K', {sensor}_b');",
        ]
    return Exported("\n".join(lines) + "\n")


def _matrix(array: FloatArray) -> str:
    rows = [" ".join(repr(value) for value in row) for row in (array + 0.0).tolist()]
    return "[" + "; ".join(rows) + "]"
