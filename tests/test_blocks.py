"""Blocks of samples: selecting and joining keep the columns together."""

import numpy as np

from firmware_protocols.layout import load_layout
from imu_rig.blocks import ImuBlock, Samples
from imu_rig.packet_stream import PacketBlock
from imu_rig.recording.contents import Wire


def block(n: int, start: float = 0.0, *, mag: bool = True) -> ImuBlock:
    t = start + np.arange(n) / 100.0
    vectors = np.arange(3 * n, dtype=float).reshape(n, 3)
    return ImuBlock(
        t=t,
        accel=vectors,
        gyro=-vectors,
        host_s=t + 0.01,
        counter=np.arange(n),
        mag=vectors * 2 if mag else None,
    )


def test_rows_are_selected_in_every_column() -> None:
    part = block(10)[2:5]
    assert len(part) == 3
    assert part.accel[:, 0].tolist() == [6, 9, 12]
    assert part.counter is not None
    assert part.counter.tolist() == [2, 3, 4]
    assert part.device_s is None
    assert len(block(10)[block(10).t > 0.045]) == 5


def test_joining_keeps_the_order_and_drops_what_one_part_lacks() -> None:
    joined = ImuBlock.concatenate([block(3), ImuBlock.empty(), block(2, 1.0, mag=False)])
    assert len(joined) == 5
    assert joined.mag is None
    assert joined.t.tolist() == [0, 0.01, 0.02, 1.0, 1.01]
    assert len(ImuBlock.concatenate([])) == 0


def test_whatever_is_printed_is_told_in_one_line() -> None:
    t = np.array([0.5, 2.25, 1234.5])
    pressure = np.arange(3.0)
    samples = Samples(t, t, values={"pressure": pressure, "status": t}, units={"pressure": "hPa"})
    rows = np.zeros(3, load_layout("mpu9150-28").dtype)
    wire = Wire(bytes(84), t, np.array([28, 56, 84]), np.zeros(3, bool))
    for thing, kind, said in (
        (block(10_000), "ImuBlock", ("10000 rows", "0.000 to 99.990 s", "accel", "counter", "mag")),
        (samples, "Samples", ("3 rows", "0.500 to 1234.500 s", "pressure [hPa]", "status")),
        (PacketBlock(rows, t, t), "PacketBlock", ("3 rows", "0.500 to 1234.500 s", "gyro")),
        (wire, "Wire", ("3 chunks", "0.500 to 1234.500 s", "84 bytes")),
    ):
        text = repr(thing)
        assert kind in text
        assert all(part in text for part in said), text
        assert "\n" not in text
        assert len(text) < 200
    assert "device_s" not in repr(block(3))
    assert "0 rows" in repr(ImuBlock.empty())
