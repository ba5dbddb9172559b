"""Strides told while they are walked: early, the same in any blocks, and near the smoother's."""

import re
import runpy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.live import LOST_S, LiveFoot
from imu_rig.gait.smoother import smooth_foot
from imu_rig.units import DEG
from simulators.walker.device import Carried
from simulators.walker.path import Straight, Turn
from simulators.walker.record import record_walk
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Walker

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "live-foot.md"


@pytest.fixture(scope="module")
def walk():
    """A foot that walks, pauses and runs, by a sensor without errors, and its footfalls."""
    parts = (
        Stand(2.5),
        Walk((Straight(4.0), Turn(90.0), Straight(3.0)), (1.2,)),
        Stand(3.0),
        Walk((Straight(8.0),), (2.8,)),
        Stand(1.5),
    )
    walker = Walker(Scenario("short", "Walk, pause and run", parts), seed=2)
    unit = record_walk(walker, [Carried("left-foot", "mavlink-raw")], exact=True)["left-foot"]
    unit = unit.units[0]
    return ImuBlock(unit.t, unit.accel, unit.gyro, unit.t), unit.truth.position


@pytest.fixture(scope="module")
def told(walk):
    return LiveFoot().update(walk[0])


@pytest.mark.parametrize("size", [1, 37])
def test_blocks_of_any_size_give_the_same_strides(walk, told, size):
    block, _ = walk
    foot = LiveFoot()
    again = [s for row in range(0, len(block), size) for s in foot.update(block[row : row + size])]
    assert again == told


def test_strides_are_as_long_as_they_were(walk, told):
    block, position = walk
    assert len(told) >= 9
    for stride in told:
        a, b = np.searchsorted(block.t, [stride.begin_s, stride.end_s])
        way = position[b] - position[a]
        assert stride.length == pytest.approx(np.hypot(way[0], way[1]), rel=0.01, abs=0.005)
        assert stride.height == pytest.approx(way[2], abs=0.02)
    assert np.degrees(sum(s.turn for s in told)) == pytest.approx(90.0, abs=6.0)


def test_strides_are_told_before_the_next_one_ends(told):
    assert all(s.told_s - s.end_s < max(0.7, s.duration) for s in told)
    assert all(a.end_s <= b.begin_s for a, b in pairwise(told))


def test_strides_agree_with_the_smoother(walk, told):
    track = smooth_foot(walk[0])
    rows = track.footfalls.quietest
    steps = np.diff(track.trajectory.position[rows, :2], axis=0)
    smooth = np.linalg.norm(steps, axis=1)
    ends = walk[0].t[rows[1:]]
    pairs = [(s.length, smooth[k]) for s in told for k in np.flatnonzero(abs(ends - s.end_s) < 0.1)]
    assert len(pairs) >= len(told) - 3
    np.testing.assert_allclose(*np.array(pairs).T, rtol=0.01, atol=0.003)
    assert sum(s.length for s in told) == pytest.approx(smooth.sum(), rel=0.01)


def test_the_state_is_that_of_the_newest_sample(walk):
    block, position = walk
    foot = LiveFoot()
    assert foot.state is None
    middle = int(np.searchsorted(block.t, 6.0))
    foot.update(block[:middle])
    assert foot.state.t == block.t[middle - 1]
    gone = np.linalg.norm(foot.state.position[:2])
    assert gone == pytest.approx(
        np.linalg.norm(position[middle - 1, :2] - position[0, :2]), abs=0.1
    )


def test_memory_is_bounded_whatever_the_foot_does(walk):
    block, _ = walk
    rate = 1.0 / np.median(np.diff(block.t))
    stands = block[: int(2.0 * rate)]
    foot = LiveFoot()
    kept = []
    for k in range(15):
        foot.update(ImuBlock(stands.t + 2.0 * k, stands.accel, stands.gyro, stands.t))
        kept.append(len(foot._kept))
    assert foot.strides == 0
    assert kept[-1] == kept[-4] < 6.0 * rate
    swing = int(np.argmax(np.linalg.norm(block.gyro, axis=1)))
    away = block[np.full(int(20.0 * rate), swing)]
    t = 32.0 + np.arange(len(away)) / rate
    assert foot.update(ImuBlock(t, away.accel, away.gyro, t)) == []
    assert len(foot._kept) < (LOST_S + 3.0) * rate


def test_what_cannot_be_used_is_refused_and_not_taken(walk):
    block, _ = walk
    foot = LiveFoot()
    foot.update(block[:50])
    broken = ImuBlock(block.t[50:60], np.full((10, 3), np.nan), block.gyro[50:60], block.t[50:60])
    with pytest.raises(DataError, match="no numbers"):
        foot.update(broken)
    with pytest.raises(DataError, match="time goes back"):
        foot.update(block[:10])
    assert foot.update(block[50:60]) == []
    with pytest.raises(DataError, match="--accel-unit g"):
        LiveFoot().update(ImuBlock(block.t, block.accel / 9.8, block.gyro, block.t))


def test_lengths_are_as_sure_as_they_say(walk, told):
    """A sensor without errors is within what one that nobody calibrated is told to be."""
    block, position = walk
    for stride in told:
        a, b = np.searchsorted(block.t, [stride.begin_s, stride.end_s])
        true = np.hypot(*(position[b] - position[a])[:2])
        assert abs(stride.length - true) < 2.0 * stride.length_sigma
        assert 0.003 < stride.length_sigma < 0.05


def test_a_short_gap_makes_a_stride_less_certain_and_a_long_one_leaves_it_out(walk, told):
    block, position = walk
    middle = [s for s in told if s.length > 0.8][2]
    at = middle.end_s - 0.35
    short = LiveFoot().update(block[(block.t < at) | (block.t > at + 0.1)])
    same = min(short, key=lambda s: abs(s.end_s - middle.end_s))
    assert same.length_sigma > 1.2 * middle.length_sigma
    assert abs(same.length - middle.length) < 3.0 * same.length_sigma
    foot = LiveFoot()
    long = foot.update(block[(block.t < at - 0.2) | (block.t > at + 0.3)])
    assert 1 <= foot.lost <= 2
    assert len(told) - 2 <= len(long) <= len(told) - 1
    for stride in long:
        a, b = np.searchsorted(block.t, [stride.begin_s, stride.end_s])
        assert stride.length == pytest.approx(np.hypot(*(position[b] - position[a])[:2]), abs=0.03)
    pieces = LiveFoot()
    kept = block[(block.t < at - 0.2) | (block.t > at + 0.3)]
    again = [s for row in range(0, len(kept), 50) for s in pieces.update(kept[row : row + 50])]
    assert again == long


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda gyro: gyro / DEG, "deg/s"),
        (lambda gyro: gyro * DEG, "unit"),
        (lambda gyro: gyro * [1.0, -1.0, 1.0], "."),
    ],
)
def test_wrong_units_and_axes_are_refused_after_some_strides(walk, change, told):
    block, _ = walk
    foot = LiveFoot()
    with pytest.raises(DataError, match=told):
        foot.update(replace(block, gyro=change(block.gyro)))
    assert foot.strides <= 10


def test_readings_of_no_sensor_are_refused_at_any_time(walk):
    block, _ = walk
    foot = LiveFoot()
    foot.update(block[:800])
    for name in ("accel", "gyro"):
        broken = getattr(block, name)[800:820].copy()
        broken[3, 1] = 1e30
        with pytest.raises(DataError, match="no sensor"):
            foot.update(replace(block[800:820], **{name: broken}))
    with pytest.raises(DataError, match="shape"):
        foot.update(replace(block[800:820], accel=block.accel[800:820, :2]))
    foot.update(block[800:820])
    with pytest.raises(DataError, match="nothing but zeros"):
        LiveFoot().update(replace(block, accel=0.0 * block.accel))


def test_the_example_of_the_description_runs(walk, told, tmp_path, capsys):
    code = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    shown = tmp_path / "shown.py"
    shown.write_text(code[0], encoding="utf-8")
    follow = runpy.run_path(str(shown))["follow"]
    block, _ = walk
    follow(block[row : row + 20] for row in range(0, len(block), 20))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(told)
    assert lines[-1].endswith(f"{sum(s.length for s in told):.2f} m in all")
