"""What is wrong with a recording is named: its rate, its unit, its copies."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_sessions import random_sensor, record, spread_attitudes

from imu_rig.blocks import ImuBlock
from imu_rig.calibration.solve import solve
from imu_rig.errors import DataError


@pytest.fixture(scope="module")
def block():
    rng = np.random.default_rng(1)
    return record(spread_attitudes(18, rng), random_sensor(rng), rng).block


def joined(block, times):
    """The recording put behind itself."""
    span = block.t[-1] + 0.01
    t = np.concatenate([block.t + k * span for k in range(times)])
    return ImuBlock(t, np.tile(block.accel, (times, 1)), np.tile(block.gyro, (times, 1)), t)


@pytest.mark.parametrize(
    ("stretch", "said"),
    [
        (10.0, "1/10 times as large: the sample rate"),
        (0.1, "with 1000 samples per second hardly any rest .* but with 100 there are 18"),
    ],
)
def test_a_wrong_sample_rate(block, stretch, said):
    with pytest.raises(DataError, match=said):
        solve(replace(block, t=block.t * stretch))


@pytest.mark.parametrize("factor", [1000 / 9.80665, 1 / 9.80665, 2.0, 0.25])
def test_a_wrong_unit_or_range_of_the_accelerometer(block, factor):
    with pytest.raises(DataError, match="unit or range"):
        solve(replace(block, accel=block.accel * factor))


def test_copies_of_a_recording_count_once(block):
    once, often = solve(block), solve(joined(block, 3))
    assert len(often.poses) == len(once.poses)
    assert any("copies of itself" in w for w in often.warnings)
    assert np.all(often.accel.b_uncertainty > 0.95 * once.accel.b_uncertainty)
    assert np.all(often.gyro.K_uncertainty > 0.9 * once.gyro.K_uncertainty)
    assert not any("copies" in w for w in once.warnings)
