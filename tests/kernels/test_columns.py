"""One pass over columns says what numpy says."""

import numpy as np
import pytest

from imu_rig import rotation
from imu_rig.kernels.columns import extent, repeated, rotated, scatter


@pytest.fixture
def values():
    return np.random.default_rng(2).normal([0.0, 9.8, 1e3], [1.0, 0.1, 1e-3], (500, 3))


def test_extent_is_numpys(values):
    want = [values.min(axis=0), values.max(axis=0), values.mean(axis=0), values.var(axis=0)]
    assert extent(values) == pytest.approx(np.array(want), rel=1e-9)
    assert extent(values[:1])[3] == pytest.approx(np.zeros(3))


def test_extent_tells_of_nan_anywhere(values):
    for row in (0, 77, 499):
        bad = values.copy()
        bad[row, 1] = np.nan
        assert np.isnan(extent(bad)[2:]).tolist() == [[False, True, False]] * 2


def test_repeats_are_rows_of_which_nothing_changed(values):
    other = values.copy()
    values[10:13] = values[9]
    other[11:14] = other[10]
    assert np.flatnonzero(repeated(values, other)).tolist() == [11, 12]


def test_rotation_is_that_of_quaternions(values):
    q = rotation.from_rotation_vector(values * [1.0, 0.1, 1e-3])
    assert rotated(q, values) == pytest.approx(rotation.rotate(q, values), abs=1e-10)


def test_scatter_is_the_variance_of_noise_and_nothing_of_a_smooth_curve(values):
    t = np.linspace(0.0, 1.0, len(values))
    smooth = np.column_stack((np.sin(6.0 * t), t**3, np.ones(len(t))))
    assert scatter(smooth).max() < 1e-15
    noise = np.random.default_rng(3).normal(0.0, 0.2, (5000, 3))
    assert scatter(100.0 * noise + 5.0).mean() == pytest.approx(400.0, rel=0.05)
    assert not scatter(noise[:4]).any()
