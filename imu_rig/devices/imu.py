"""An inertial sensor on a port: samples in SI units, in order."""

from __future__ import annotations

from collections.abc import Callable

from firmware_protocols.protocol import DeviceProtocol
from imu_rig.blocks import ImuBlock
from imu_rig.clock import Clock
from imu_rig.devices.ports import DEFAULT_BAUD
from imu_rig.devices.stream_device import StreamDevice, StreamHealth
from imu_rig.errors import InputError
from imu_rig.imu_scaling import si_factors
from imu_rig.imu_stream import imu_block


class ImuDevice(StreamDevice):
    """Reads one inertial sensor; parameters as for `StreamDevice`, and its stream.

    Parameters
    ----------
    stream : str, optional
        Which stream of the port, where several are inertial.

    Raises
    ------
    InputError
        If the protocol has no such stream, no inertial one or several of them, or the stream a
        field in an unknown unit.
    """

    def __init__(
        self,
        name: str,
        url: str,
        protocol: DeviceProtocol,
        clock: Clock,
        *,
        stream: str | None = None,
        tap: Callable[[int, bytes], None] | None = None,
        sent: Callable[[int, bytes], None] | None = None,
        baud: int = DEFAULT_BAUD,
    ) -> None:
        self.stream = inertial_stream(protocol, stream)
        self.layout = protocol.streams[self.stream]
        si_factors(self.layout)  # refuses units that are not known
        super().__init__(name, url, protocol, clock, tap=tap, sent=sent, baud=baud)

    def poll(self) -> ImuBlock:
        """Return all samples since the last poll: ordered, each once, time strictly increasing.

        Raises
        ------
        Exception
            What the tap raised.
        """
        packets = self.poll_streams()[self.stream]
        return imu_block(self.layout, packets) if len(packets) else ImuBlock.empty()

    @property
    def health(self) -> StreamHealth:
        """Figures of the sensor's stream as of now."""
        return self.stream_health(self.stream)


def inertial_stream(protocol: DeviceProtocol, wanted: str | None = None) -> str:
    """Return the name of the inertial stream that is meant.

    Raises
    ------
    InputError
        If there is none of that name, or none at all, or several where none is named.
    """
    streams = protocol.inertial_streams
    if wanted is not None and wanted in streams:
        return wanted
    if len(streams) == 1 and wanted is None:
        return streams[0]
    if not streams:
        raise InputError(
            f"Packet layout {protocol.name} has neither a field accel nor a field gyro: name the "
            "fields that hold the accelerometer and the gyroscope so."
        )
    raise InputError(
        f"Packet layout {protocol.name} holds the inertial sensors {', '.join(streams)}: "
        + ("name one of them." if wanted is None else f"{wanted!r} is none of them.")
    )
