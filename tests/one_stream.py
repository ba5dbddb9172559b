"""The one stream of a port that sends nothing else, for tests that are about one."""

from imu_rig.blocks import ImuBlock
from imu_rig.imu_scaling import si_factors
from imu_rig.imu_stream import imu_block
from imu_rig.packet_stream import PacketBlock, PacketStreams


class PacketStream:
    """Live packets of a layout."""

    def __init__(self, layout):
        self.layout = layout
        self.streams = PacketStreams(layout)

    stats = property(lambda self: self.streams.stats(""))
    time_source = property(lambda self: self.streams.time_source(""))
    clock_fit = property(lambda self: self.streams.clock_fit(""))
    identical = property(lambda self: self.streams.identical(""))

    def feed_many(self, chunks):
        return self.streams.feed_many(chunks).get("", PacketBlock.empty(self.layout))

    def feed(self, t_ns, data):
        return self.feed_many([(t_ns, data)])

    def cut(self):
        self.streams.cut()


class ImuStream(PacketStream):
    """Live samples of an inertial sensor."""

    def __init__(self, layout):
        si_factors(layout)
        super().__init__(layout)

    def feed_many(self, chunks):
        packets = super().feed_many(chunks)
        return imu_block(self.layout, packets) if len(packets) else ImuBlock.empty()
