"""What a person may choose about an export."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.model import AXES
from imu_rig.errors import InputError

DEFAULT_AXES = "x,y,z"
INT32 = 2**31
IDENTIFIABLE = ("accel", "gyro", "mag")


@dataclass(frozen=True)
class ExportOptions:
    """Choices; only autopilots know the first four.

    Attributes
    ----------
    nearest : bool
        Whether an approximation may be exported where the target cannot hold everything.
    device_ids : mapping
        Id of each sensor in the autopilot, by ``accel``, ``gyro`` and ``mag``.
    slot : int
        Which of its sensors of one kind, from 0.
    axes_text : str
        Which axes of the recording the autopilot's x, y and z are, as in ``"x,-y,-z"``.
    name : str
        What names in generated code begin with.
    """

    nearest: bool = False
    device_ids: Mapping[str, int] = field(default_factory=dict)
    slot: int = 0
    axes_text: str = DEFAULT_AXES
    name: str = "imu"

    @property
    def axes(self) -> FloatArray:
        """The matrix (3, 3) from axes of the recording to axes of the autopilot.

        Raises
        ------
        InputError
            If the text is no right-handed set of axes.
        """
        P = np.zeros((3, 3))
        names = [part.strip().lower() for part in self.axes_text.split(",")]
        for row, name in enumerate(names[:3]):
            axis = name.lstrip("+-")
            if axis in AXES and name in (axis, f"+{axis}", f"-{axis}"):
                P[row, AXES.index(axis)] = -1.0 if name.startswith("-") else 1.0
        if len(names) != 3 or abs(np.linalg.det(P) - 1.0) > 0.5:
            raise InputError(
                f"--axes {self.axes_text!r} are no right-handed axes: write three of x, y and z "
                'with signs, as in "x,-y,-z".'
            )
        return P


def parse_device_ids(texts: list[str]) -> dict[str, int]:
    """Read ``"1310988"`` (accelerometer and gyroscope) or ``"mag=396825"``.

    Raises
    ------
    InputError
        Naming the text that is neither.
    """
    found: dict[str, int] = {}
    for text in texts:
        sensor, _, digits = text.rpartition("=")
        known = sensor in IDENTIFIABLE or not sensor
        if not known or not re.fullmatch(r"-?[0-9]{1,10}", digits) or not _is_id(int(digits)):
            raise InputError(
                f"--device-id {text!r}: write a number, or accel=, gyro= or mag= before a number "
                "that is not 0 and fits 32 bits."
            )
        for name in (sensor,) if sensor else ("accel", "gyro"):
            found[name] = int(digits)
    return found


def _is_id(number: int) -> bool:
    return number != 0 and -INT32 <= number < INT32
