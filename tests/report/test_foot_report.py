"""The reports of walks, and what their figures show."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from imu_rig.blocks import ImuBlock
from imu_rig.gait.distance import WalkDistance
from imu_rig.gait.strides import gait_parameters
from imu_rig.gait.trajectory import Footfalls, FootTrack, Trajectory, TrajectoryCovariance
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.report import foot_figures, stride_figures
from imu_rig.report.foot import foot_report, told_with_sigma
from imu_rig.report.foot_facts import FootAnalysis, FootReport, Measured
from imu_rig.report.foot_several import several_report
from imu_rig.report.gait import gait_report
from imu_rig.report.gait_facts import GaitReport, GaitTrial, along_the_walk
from imu_rig.report.stride_table import stride_head, stride_rows
from imu_rig.report.svg import report_style
from imu_rig.report.walk_panels import MOST_POINTS, thinned

RATE, STRIDE_S, SWING_S, STRIDE_M = 100.0, 1.1, 0.44, 1.3
STAND_S = 1.0


def walk(count: int, *, known: bool = True) -> FootTrack:
    """A foot that goes ``count`` equal strides along x, lifted by 8 cm, heel first."""
    n = round((2.0 * STAND_S + count * STRIDE_S) * RATE)
    t = np.arange(n) / RATE
    phase = (t - STAND_S) / STRIDE_S
    stride = np.clip(np.floor(phase), 0, max(count - 1, 0))
    swing = np.clip((phase - stride) * STRIDE_S / SWING_S, 0.0, 1.0) * (count > 0)
    ahead = swing**3 * (10.0 - 15.0 * swing + 6.0 * swing**2)
    lifted = np.sin(np.pi * swing) ** 2
    x = STRIDE_M * (stride + ahead)
    position = np.column_stack((x, np.zeros(n), 0.08 * lifted))
    half = 0.25 * np.sin(2.0 * np.pi * swing) * lifted
    quaternion = np.column_stack((np.cos(half), np.zeros(n), np.sin(half), np.zeros(n)))
    velocity = np.gradient(position, t, axis=0)
    still = (swing == 0.0) | (swing == 1.0)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(int), [0]))))
    first, last = edges[::2], edges[1::2] - 1
    falls = Footfalls(first, last, (first + last) // 2)
    covariance = None
    if known:
        rows = np.unique(np.concatenate(([0], falls.quietest, [n - 1])))
        sigma = np.array([2e-3] * 3 + [1e-2] * 3 + [2e-2] * 3)
        values = np.diag(sigma**2) * (1.0 + t[rows])[:, None, None]
        strides = np.tile(np.diag([0.01, 0.01, 0.005]) ** 2, (len(falls) - 1, 1, 1))
        covariance = TrajectoryCovariance(rows, values, strides)
    motion = 0.02 + np.linalg.norm(velocity, axis=1)
    return FootTrack(
        Trajectory(t, quaternion, velocity, position),
        ZeroVelocity(still, np.where(still, 0.01, np.inf), motion, np.full(n, 0.1)),
        falls,
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        pivot=np.zeros(3),
        covariance=covariance,
    )


def analysis(count: int, *, name: str = "left-foot", known: bool = True) -> FootAnalysis:
    track = walk(count, known=known)
    t = track.trajectory.t
    block = ImuBlock(t, np.tile([0.0, 0.0, 9.81], (len(t), 1)), np.zeros((len(t), 3)), t)
    return FootAnalysis(name, block, track, gait_parameters(track))


def stands_alone(page: str) -> None:
    assert "<script" not in page
    assert not re.search(r'(?:src|href)="(?!#)', page)
    assert not re.search(r"\b(nan|inf)\b", page, re.IGNORECASE)
    names = re.findall(r'\bid="([^"]+)"', page)
    assert len(names) == len(set(names))


def test_a_report_of_two_feet_stands_alone_and_escapes_names() -> None:
    foot = analysis(8, name="<b>foot")
    path = foot.track.trajectory
    measured = Measured(
        (("Horizontal", "0.031 m RMSE"),),
        ("Reference", "0.031", "m", "horizontal RMSE"),
        "Yaw and shift were fitted.",
        foot_figures.SeenPath(path.t, path.position + 0.02),
    )
    foot = replace(foot, notes=("A <i>note</i>.",), reference=measured)
    standing = analysis(0, name="right-foot", known=False)
    report = FootReport("<u>walk.mat", "ab" * 32, (foot, standing), shared=True)
    page = foot_report(report)
    stands_alone(page)
    assert "<b>foot" not in page
    assert "<u>walk" not in page
    assert "A &lt;i&gt;note&lt;/i&gt;." in page
    assert "Against the reference" in page
    assert ">reference<" in page
    assert "There is no stride" in page
    assert "Both feet" in page
    lost = replace(report, left_out=(("<i>third", "It is in a pocket."),))
    assert "&lt;i&gt;third is left out" in foot_report(lost)
    together = several_report([report], [], {"<i>lost": "It is empty."})
    stands_alone(together)
    assert "&lt;i&gt;lost: It is empty." in together
    assert page.count("<svg") == 8 + 5  # one plan for both, and no figures of no strides
    assert re.search(r"10\.40\d? ± ", page)  # 8 strides of 1.3 m, digits as sigma has them


def test_a_plan_has_equal_axes_and_holds_all_of_the_walk() -> None:
    track = walk(5)
    crooked = replace(track, trajectory=track.trajectory.turned(0.7))
    seen = foot_figures.SeenPath(
        track.trajectory.t, track.trajectory.position + np.array([0.0, -4.0, 0.0])
    )
    for one, other in ((track, None), (crooked, None), (track, seen)):
        with report_style():
            figure = foot_figures.plan([("foot", one)], other)
        (axes,) = figure.axes
        box = axes.get_position()
        wide, high = box.width * figure.get_figwidth(), box.height * figure.get_figheight()
        (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
        assert (x1 - x0) / wide == pytest.approx((y1 - y0) / high)
        drawn = [one.trajectory.position] + ([] if other is None else [other.position])
        every = np.concatenate(drawn)
        assert x0 < every[:, 0].min()
        assert every[:, 0].max() < x1
        assert y0 < every[:, 1].min()
        assert every[:, 1].max() < y1


def test_figures_of_a_long_walk_are_of_some_strides_and_not_of_every_sample() -> None:
    track = walk(400)
    window = stride_figures.strides_window(track)
    t = track.trajectory.t[window]
    assert 4.0 * STRIDE_S < t[-1] - t[0] < stride_figures.WINDOW_S + 1.0
    later = np.where(np.arange(len(t := track.trajectory.t)) > len(t) // 2, t + 60.0, t)
    rested = replace(track, trajectory=replace(track.trajectory, t=later))
    shown = later[stride_figures.strides_window(rested)]
    assert 4.0 * STRIDE_S < shown[-1] - shown[0] < stride_figures.WINDOW_S + 1.0
    drawn = np.arange(len(track.trajectory))[thinned(len(track.trajectory))]
    assert 0.5 * MOST_POINTS < len(drawn) <= MOST_POINTS


def test_angles_of_a_foot_that_points_steeply_have_no_heading() -> None:
    foot = analysis(3)
    level = foot.angles
    assert np.isfinite(level).all()
    steep = np.array([[np.cos(0.74), 0.0, -np.sin(0.74), 0.0]])
    quaternion = np.repeat(steep, len(level), axis=0)
    track = replace(foot.track, trajectory=replace(foot.track.trajectory, quaternion=quaternion))
    strides = replace(foot.strides, axes=replace(foot.strides.axes, rotation=np.eye(3)))
    angles = replace(foot, track=track, strides=strides).angles
    assert np.isnan(angles[:, 2]).all()
    np.testing.assert_allclose(angles[:, 1], 1.48, atol=1e-9)


def test_digits_follow_the_uncertainty() -> None:
    assert told_with_sigma(49.8372, 0.213) == "49.84 ± 0.21"
    assert told_with_sigma(49.8372, 1.73) == "49.8 ± 1.7"
    assert told_with_sigma(49.8372, float("nan")) == "49.84"
    assert told_with_sigma(float("nan"), 1.0) == "–"


def test_rows_of_strides_are_in_the_units_of_their_names() -> None:
    strides = analysis(3).strides
    head, rows = stride_head(strides), stride_rows("left", strides)
    assert len(rows) == 3
    assert all(len(row) == len(head) for row in rows)
    at = {name: index for index, name in enumerate(head)}
    assert rows[1][at["length_m"]] == pytest.approx(STRIDE_M)
    assert rows[1][at["lowest_pitch_deg"]] == pytest.approx(
        np.degrees(strides.lowest_pitch[1]), abs=1e-3
    )
    assert np.isnan(rows[0][at["duration_s"]])  # type: ignore[call-overload]


def integrated(x: float) -> WalkDistance:
    t = np.arange(400) / RATE
    still = (t % 1.0) < 0.5
    position = np.column_stack((x * t / t[-1], 0.1 * x * t / t[-1], np.zeros(400)))
    zero = ZeroVelocity(still, np.where(still, 0.01, np.inf), np.ones(400), np.full(400, 2.0))
    shape: NDArray[np.float64] = np.zeros((400, 3))
    return WalkDistance(
        t, np.tile([1.0, 0.0, 0.0, 0.0], (400, 1)), shape + 1.0, zero, shape, position, np.zeros(3)
    )


def test_gait_of_trials_with_a_known_distance() -> None:
    track = walk(8)
    trials = tuple(
        GaitTrial(
            f"trial <{k}>",
            gait_parameters(track),
            along_the_walk(track.trajectory.turned(0.4)),
            integrated(9.8 + 0.1 * k),
            integrated(9.0 + 0.1 * k),
        )
        for k in range(1, 3)
    )
    report = GaitReport(trials, np.array([10.0, 0.0, 0.0]))
    comparison = report.comparison()
    assert comparison is not None
    np.testing.assert_allclose(comparison.axes[0].improvement, [100 - 10 / 0.9, 100.0])
    np.testing.assert_allclose(trials[0].ours, [8 * STRIDE_M, 0.0, 0.0], atol=1e-9)
    page = gait_report(report)
    stands_alone(page)
    assert "Distance along z" in page
    assert "trial &lt;2&gt;" in page
    assert "trial <" not in page
    uncalibrated = replace(trials[0], calibrated=None)
    assert GaitReport((uncalibrated,), report.known).comparison() is None
