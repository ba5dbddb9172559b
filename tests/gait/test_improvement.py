"""Tables 1 to 3 of the gait distance paper, from the distances that it prints."""

import numpy as np
import pytest

from imu_rig.errors import InputError
from imu_rig.gait.improvement import compare_trials

UNCALIBRATED = ((9.76, 1.16, 0.56), (9.56, 1.07, 0.38), (9.67, 1.11, 0.93), (9.64, 1.49, 1.43))
CALIBRATED = ((9.85, 0.15, -0.09), (9.62, 0.12, -0.16), (9.76, 0.36, 0.02), (9.81, 0.43, 0.87))
IMPROVEMENT = {
    "x": ((37.5, 13.6, 27.3, 47.2), 31.4, 14.38),
    "y": ((87.07, 88.78, 67.57, 71.14), 78.64, 10.84),
    "z": ((83.93, 57.89, 97.85, 39.16), 69.71, 26.25),
}


def test_published_improvements_follow_from_the_published_distances():
    comparison = compare_trials((10.0, 0.0, 0.0), UNCALIBRATED, CALIBRATED)
    assert len(comparison) == 4
    for axis in comparison.axes:
        each, mean, sd = IMPROVEMENT[axis.axis]
        digits = 0.06 if axis.axis == "x" else 0.006
        assert axis.improvement == pytest.approx(each, abs=digits)
        assert axis.mean == pytest.approx(mean, abs=digits)
        assert axis.sd == pytest.approx(sd, abs=digits)
    assert comparison.axes[0].uncalibrated_error == pytest.approx([0.24, 0.44, 0.33, 0.36])
    assert comparison.axes[2].calibrated_error == pytest.approx([0.09, 0.16, 0.02, 0.87])


def test_the_pooled_improvement_is_that_of_the_mean_error():
    y = compare_trials((10.0, 0.0, 0.0), UNCALIBRATED, CALIBRATED).axes[1]
    assert y.pooled == pytest.approx(100.0 * (1.0 - 0.265 / 1.2075))
    assert y.median == pytest.approx(0.5 * (87.07 + 71.14), abs=0.01)


def test_each_trial_may_have_its_own_distance_and_errors_may_grow():
    known = [(10.0, 0.0, 0.0), (20.0, 0.0, 0.0)]
    table = compare_trials(known, [(9.0, 1.0, 0.0), (21.0, 1.0, 0.0)], [(8.0, 0.5, 0.0)] * 2)
    assert table.axes[0].improvement == pytest.approx([-100.0, -1100.0])
    assert np.isnan(table.axes[2].improvement).all()
    assert np.isnan(table.axes[2].pooled)
    assert np.isnan(compare_trials(known[0], [(9.0, 1.0, 1.0)], [(9.5, 1.0, 1.0)]).axes[0].sd)


def test_a_trial_without_an_error_is_left_out_of_the_mean():
    y = compare_trials((10.0, 0.0, 0.0), [(9, 0, 1), (9, 2, 1), (9, 4, 1)], [(9, 1, 1)] * 3).axes[1]
    assert y.mean == y.median == pytest.approx(62.5)
    assert y.sd == pytest.approx(12.5 * np.sqrt(2.0))


@pytest.mark.parametrize(
    ("reference", "before", "after", "sentence"),
    [
        ((10.0, 0.0, 0.0), [(9.0, 0.0, 0.0)] * 2, [(9.0, 0.0, 0.0)], "cannot be compared"),
        ([(10.0, 0.0, 0.0)] * 3, [(9.0, 0.0, 0.0)] * 2, [(9.0, 0.0, 0.0)] * 2, "3 known distances"),
        ((10.0, 0.0, 0.0), [(np.nan, 0.0, 0.0)], [(9.0, 0.0, 0.0)], "not a finite number"),
    ],
)
def test_what_cannot_be_compared_is_refused(reference, before, after, sentence):
    with pytest.raises(InputError, match=sentence):
        compare_trials(reference, before, after)
