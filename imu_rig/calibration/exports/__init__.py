"""A calibration in the words of other programs.

One module per target; each turns a `Source` into an `Exported` text, and none loses anything
silently.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from imu_rig.calibration.certificate import Certificate
from imu_rig.calibration.exports.ardupilot import ardupilot
from imu_rig.calibration.exports.c_header import c_header
from imu_rig.calibration.exports.exported import Exported
from imu_rig.calibration.exports.matlab import matlab
from imu_rig.calibration.exports.numpy_code import numpy_code
from imu_rig.calibration.exports.options import ExportOptions
from imu_rig.calibration.exports.px4 import px4
from imu_rig.calibration.exports.source import Source
from imu_rig.calibration.exports.table import table
from imu_rig.errors import InputError

TARGETS: dict[str, Callable[[Source, ExportOptions], Exported]] = {
    "px4": px4,
    "ardupilot": ardupilot,
    "c": c_header,
    "numpy": numpy_code,
    "matlab": matlab,
    "csv": table,
}
"""Every format by its name; autopilots first."""
AUTOPILOTS = ("px4", "ardupilot")


def export_certificate(
    certificate: Certificate, target: str, options: ExportOptions | None = None
) -> Exported:
    """Write a certificate's calibration in the format of ``target``.

    Raises
    ------
    InputError
        No such target, or a calibration that it cannot hold.
    """
    if target not in TARGETS:
        raise InputError(f"there is no export to {target!r}; choose one of {', '.join(TARGETS)}")
    source = Source.of(certificate)
    done = TARGETS[target](source, options or ExportOptions())
    return replace(done, notes=(*source.notes, *done.notes))
