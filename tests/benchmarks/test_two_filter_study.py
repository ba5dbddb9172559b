"""The study's figures, in short: the published experiments come out as published, or better."""

import numpy as np
import pytest
import two_filter_study as study

from imu_rig.gait.smoother import smooth_foot
from imu_rig.report.svg import inline, report_style
from imu_rig.report.two_filter import middle_step, plan, two_filter_figures


@pytest.fixture(scope="module")
def board():
    return study.by_steps(study.carried("half-circle", 1), study.ON_BOARD)


@pytest.fixture(scope="module")
def straight():
    carry = study.carried("straight-50m", 1)
    return study.by_steps(carry, study.ON_FOOT)


def test_the_smoother_follows_the_half_circle_and_the_filters_do_not(board):
    smoothed = study.from_the_arc(board.smoothed.trajectory)
    assert smoothed < 0.005
    assert study.from_the_arc(board.forward.trajectory) > 2.0 * smoothed
    assert study.from_the_arc(board.backward.trajectory) > 2.0 * smoothed


def test_the_default_smoother_follows_the_half_circle_as_well():
    track = smooth_foot(study.carried("half-circle", 2).block)
    assert study.from_the_arc(track.trajectory, turn=True) < 0.003


def test_50_m_come_out_as_published_because_the_sensor_clips(straight):
    length, rise = study.ends(straight.smoothed.trajectory.position)
    assert length == pytest.approx(study.PAPER_M, abs=0.5)
    assert abs(rise) < 0.01
    assert len(straight.steps) == pytest.approx(36, abs=1)
    endless = study.carried("level-10m", 1, clips=False)
    length, _ = study.ends(study.by_steps(endless, study.ON_FOOT).smoothed.trajectory.position)
    assert length == pytest.approx(10.0, rel=0.005)


def test_stairs_rise_when_the_ground_need_not_be_level():
    carry = study.carried("stairs-up", 1, clips=False)
    up = study.by_steps(carry, study.ON_FOOT, level=False)
    found = study.walked(carry, up, up.smoothed.trajectory)
    true = study.ends(carry.unit.truth.position[up.boundaries])[1]
    assert true == pytest.approx(3.4, abs=0.2)
    assert abs(found.rise) < 0.02 * true
    assert abs(found.distance) < 0.01


def test_the_papers_figures_are_drawn(board, straight):
    with report_style():
        figures = {name: two_filter_figures(s) for name, s in (("b", board), ("s", straight))}
        drawn = [inline(f.figure, f.name, f.title) for f in figures["b"]]
        x, y = np.array(plan(board, np.zeros((1, 2))).axes[0].viewLim.get_points()).T
    names = [one.name for one in figures["s"]]
    assert names == ["filtersplan", "filtersstep", "filterswalk", "filtersangles"]
    assert [one.name for one in figures["b"]] == [names[i] for i in (0, 1, 3)]
    assert all(name.isalpha() for name in names)
    assert "backward filter" in drawn[1]
    assert "nan" not in "".join(drawn)
    assert x[0] < -0.01
    assert x[1] > 0.36
    assert y[1] > 0.72
    begin, end = middle_step(straight)
    assert 1.5 < end - begin < 3.0
    assert "first zero-velocity interval" in drawn[2]
