"""Blocks of samples: selecting and joining keep the columns together."""

import numpy as np

from imu_rig.blocks import ImuBlock


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
