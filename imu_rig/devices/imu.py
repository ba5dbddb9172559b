"""An inertial sensor on a port: samples in SI units, in order."""

from __future__ import annotations

from collections.abc import Callable

from firmware_protocols.layout import PacketLayout
from imu_rig.blocks import ImuBlock
from imu_rig.clock import Clock
from imu_rig.devices.ports import DEFAULT_BAUD
from imu_rig.devices.stream_device import StreamDevice
from imu_rig.imu_stream import ImuStream


class ImuDevice(StreamDevice[ImuBlock]):
    """Reads one inertial sensor; parameters as for `StreamDevice`.

    Raises
    ------
    InputError
        If the layout holds neither accelerometer nor gyroscope.
    """

    def __init__(
        self,
        name: str,
        url: str,
        layout: PacketLayout,
        clock: Clock,
        *,
        tap: Callable[[int, bytes], None] | None = None,
        baud: int = DEFAULT_BAUD,
    ) -> None:
        stream = ImuStream(layout)
        super().__init__(name, url, layout, stream, ImuBlock.concatenate, clock, tap=tap, baud=baud)
