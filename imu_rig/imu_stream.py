"""Packets of a sensor as blocks of samples in SI units, live or recorded."""

from __future__ import annotations

from firmware_protocols.layout import PacketLayout
from imu_rig.blocks import ImuBlock, Samples
from imu_rig.imu_scaling import field_values, si_factors, si_values, watched_fields
from imu_rig.packet_stream import PacketBlock, PacketStream, StreamStats
from imu_rig.timing.clock_fit import ClockFit


class ImuStream:
    """Turns the bytes of one sensor into blocks as they arrive.

    Parameters
    ----------
    layout : PacketLayout
        With a field "accel" or "gyro"; whichever is missing reads NaN.

    Attributes
    ----------
    time_source : str
        What the samples' times rest on: "device clock", "packet counter" or "arrival".

    Raises
    ------
    InputError
        If the layout holds neither, or a field in an unknown unit.
    """

    def __init__(self, layout: PacketLayout) -> None:
        self.layout = layout
        self._factors = si_factors(layout)
        self._packets = PacketStream(layout, watched_fields(layout))
        self.time_source = self._packets.time_source

    @property
    def stats(self) -> StreamStats:
        """Counts so far."""
        return self._packets.stats

    @property
    def clock_fit(self) -> ClockFit | None:
        """The device clock on the host's, as known now; None before the first sample."""
        return self._packets.clock_fit

    @property
    def identical(self) -> int:
        """How many of the last samples in a row have the same counts in all axes."""
        return self._packets.identical

    def feed(self, t_ns: int, data: bytes) -> ImuBlock:
        """Take in bytes that arrived at ``t_ns`` (host monotonic clock, not decreasing).

        Returns
        -------
        ImuBlock
            The samples that are complete now, after all returned before; perhaps none.
        """
        return self.feed_many([(t_ns, data)])

    def cut(self) -> None:
        """Let no packet lie on both sides of here: the port was opened anew, bytes are missing."""
        self._packets.cut()

    def feed_many(self, chunks: list[tuple[int, bytes]]) -> ImuBlock:
        """Take in several pieces in order of arrival, faster than one by one."""
        packets = self._packets.feed_many(chunks)
        return _imu_block(self.layout, self._factors, packets) if len(packets) else ImuBlock.empty()


def imu_block(layout: PacketLayout, packets: PacketBlock) -> ImuBlock:
    """Return packets as samples in SI units.

    Raises
    ------
    InputError
        If the layout holds neither accelerometer nor gyroscope, or a field in an unknown unit.
    """
    return _imu_block(layout, si_factors(layout), packets)


def packet_samples(layout: PacketLayout, packets: PacketBlock) -> Samples:
    """Return packets of any device as samples, with all that the layout names in them."""
    columns, units = field_values(layout, packets.rows)
    return Samples(
        packets.t, packets.host_s, packets.device_s, packets.counter, values=columns, units=units
    )


def _imu_block(layout: PacketLayout, factors: dict[str, float], packets: PacketBlock) -> ImuBlock:
    measured = si_values(layout, packets.rows, factors)
    return ImuBlock(
        t=packets.t,
        accel=measured["accel"],
        gyro=measured["gyro"],
        host_s=packets.host_s,
        device_s=packets.device_s,
        counter=packets.counter,
        mag=measured.get("mag"),
        temperature=measured.get("temperature"),
    )
