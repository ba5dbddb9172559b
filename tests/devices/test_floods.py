"""What a driver does at a time when bytes cost more than usual."""

import os
import time
import tty

from firmware_protocols.fields import Checksum, Field
from firmware_protocols.layout import PacketLayout
from imu_rig.clock import SystemClock
from imu_rig.devices.stream_device import CHECKED_BYTES, PacketDevice
from imu_rig.packet_stream import PacketStreams

PATIENCE_S = 10.0
LONG = PacketLayout(
    name="long",
    title="",
    byte_order="little",
    header=b"\xa5",
    fields=(Field("samples", "u8", count=4094),),
    checksum=Checksum("sum8"),
)


def test_of_long_packets_few_bytes_are_decoded_at_a_time(monkeypatch):
    """Every byte of a run of their header costs a checksum over a whole packet."""
    fed, received = [], []
    feed_many = PacketStreams.feed_many

    def noted(self, chunks):
        fed.append([len(data) for _, data in chunks])
        return feed_many(self, chunks)

    monkeypatch.setattr(PacketStreams, "feed_many", noted)
    device, host = os.openpty()
    tty.setraw(host)
    driver = PacketDevice(
        "unit", os.ttyname(host), LONG, SystemClock(), tap=lambda t, data: received.append(data)
    )
    driver.start()
    try:
        end = time.monotonic() + PATIENCE_S
        for number in range(1, 41):
            os.write(device, b"\xa5" * 1000)
            while sum(map(len, received)) < 1000 * number:
                assert time.monotonic() < end
                time.sleep(0.0005)
        driver.poll()
    finally:
        driver.stop()
        os.close(device)
        os.close(host)
    assert sum(map(sum, fed)) == 40_000
    assert max(sum(sizes) for sizes in fed if len(sizes) > 1) * LONG.longest <= CHECKED_BYTES
