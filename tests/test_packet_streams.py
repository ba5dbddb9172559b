"""The streams of one port as they come: apart from each other, in the dtype of their layouts."""

import numpy as np

from firmware_protocols.known import load_protocol
from firmware_protocols.packets import encode
from imu_rig.packet_stream import PacketBlock, PacketStreams, assemble_packets

TWO = load_protocol("two-imu")
PERIOD_S = 0.02


def sent(stream, number):
    """One packet of a unit."""
    layout = TWO.streams[stream]
    columns = {
        f.name: np.zeros(f.count, np.int64) if f.count > 1 else 0
        for f in layout.fields
        if f.type != "pad"
    }
    columns[layout.counter] = number % 65536
    columns[layout.clock] = round(number * PERIOD_S / layout.clock_tick_s) % 2**32
    columns["accel"] = [number % 100, -number % 100, 4096]
    return encode(layout, columns)


def arriving(numbers, dropped=()):
    """Both units' packets with the times at which they arrive [ns]."""
    return [
        (round((1.0 + PERIOD_S * n) * 1e9), sent(stream, n))
        for n in numbers
        for stream in TWO.streams
        if (stream, n) not in dropped
    ]


def test_a_loss_of_one_unit_is_no_loss_of_the_other():
    dropped = {("waist", n) for n in range(40, 50)}
    live = PacketStreams(TWO)
    for chunk in arriving(range(100), dropped):
        live.feed_many([chunk])
    assert (live.stats("foot").good, live.stats("foot").lost) == (100, 0)
    assert (live.stats("waist").good, live.stats("waist").lost) == (90, 10)


def test_rows_keep_the_dtype_of_their_layout_however_they_are_joined():
    pieces = arriving(range(60))
    live = PacketStreams(TWO)
    blocks = [live.feed_many([piece]) for piece in pieces]
    for stream, layout in TWO.streams.items():
        joined = PacketBlock.concatenate(layout, [b[stream] for b in blocks if stream in b])
        assert joined.rows.dtype == layout.dtype
        whole = assemble_packets(
            TWO,
            b"".join(data for _, data in pieces),
            np.cumsum([len(data) for _, data in pieces]),
            np.array([t_ns / 1e9 for t_ns, _ in pieces]),
        )[stream]
        assert whole.block.rows.dtype == layout.dtype
        assert whole.block.rows.tobytes() == joined.rows.tobytes()


def test_units_that_count_one_clock_agree_in_time():
    live = PacketStreams(TWO)
    blocks = [live.feed_many([piece]) for piece in arriving(range(200))]
    t = {
        stream: np.concatenate([b[stream].t for b in blocks if stream in b])
        for stream in TWO.streams
    }
    np.testing.assert_allclose(t["foot"][-50:], t["waist"][-50:], atol=1e-3)
