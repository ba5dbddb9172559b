"""The compiled foot smoother: equal to the textbook's, and true to its invariances."""

from __future__ import annotations

import numpy as np
import pytest
import textbook_smoother as textbook
from foot_motion import MODEL, known, readings

from imu_rig.kernels.foot_filter import smooth_foot_states
from imu_rig.kernels.foot_types import FootState


def column(states: list[FootState], name: str):
    return np.array([getattr(s, name) for s in states])


@pytest.fixture(scope="module")
def case():
    inputs = readings()
    start = known(inputs)
    return inputs, start, textbook.smooth(inputs, MODEL, start)


@pytest.mark.parametrize("forward", [True, False])
def test_equals_the_textbook_to_rounding(case, forward):
    inputs, start, (filtered, smoothed, covariances) = case
    ours = smooth_foot_states(
        inputs, MODEL, estimate_gyro_bias=True, forward_only=forward, start=start
    )
    theirs = filtered if forward else smoothed
    for name in ("quaternion", "velocity", "gyro_bias", "accel_bias"):
        want = column(theirs, name)
        assert getattr(ours, name) == pytest.approx(want, abs=1e-10 * np.abs(want).max()), name
    want = column(theirs, "height")
    height = ours.position[:, 2] - ours.floor
    assert height == pytest.approx(want, abs=1e-10 * np.abs(want).max())
    assert ours.pivot == pytest.approx(smoothed[-1].pivot, rel=1e-10)
    scale = np.sqrt(np.diag(covariances[-1]))
    close = (ours.end.covariance - covariances[-1]) / np.outer(scale, scale)
    assert np.abs(close).max() < 1e-10
    assert ours.gyro_bias_covariance == pytest.approx(covariances[-1][13:16, 13:16], rel=1e-8)
