"""What is told of devices that are watched."""

from __future__ import annotations

from dataclasses import dataclass, field

from imu_rig.monitor.quantities import Quantity
from imu_rig.recorder.status import DeviceStatus

Reading = tuple[Quantity, tuple[float, ...]]
"""A quantity and its newest numbers, in its unit."""


@dataclass(frozen=True)
class MonitorStatus:
    """How devices do.

    Attributes
    ----------
    elapsed_s : float
        Since the ports were opened.
    planned_s : float or None
        When it ends by itself.
    devices : tuple of DeviceStatus
    readings : dict of str to tuple of Reading
        The newest sample by the name of the stream, as in the rows of the devices.
    """

    elapsed_s: float = 0.0
    planned_s: float | None = None
    devices: tuple[DeviceStatus, ...] = ()
    readings: dict[str, tuple[Reading, ...]] = field(default_factory=dict)

    @property
    def rows(self) -> tuple[DeviceStatus, ...]:
        """Every stream of every device."""
        return tuple(row for device in self.devices for row in device.rows)
