"""Packets of a sensor as blocks of samples in SI units, live or recorded."""

from __future__ import annotations

from firmware_protocols.rows import RowLayout
from imu_rig.blocks import ImuBlock, Samples
from imu_rig.imu_scaling import field_values, si_factors, si_values
from imu_rig.packet_stream import PacketBlock


def imu_block(layout: RowLayout, packets: PacketBlock) -> ImuBlock:
    """Return packets as samples in SI units; whichever of accel and gyro is missing reads NaN.

    Raises
    ------
    InputError
        If the layout holds neither accelerometer nor gyroscope, or a field in an unknown unit.
    """
    measured = si_values(layout, packets.rows, si_factors(layout))
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


def packet_samples(layout: RowLayout, packets: PacketBlock) -> Samples:
    """Return packets of any device as samples, with all that the layout names in them."""
    columns, units = field_values(layout, packets.rows)
    return Samples(
        packets.t, packets.host_s, packets.device_s, packets.counter, values=columns, units=units
    )
