"""One default configuration on public recordings; see `foot_recordings.py` for all of them."""

import foot_recordings as study
import numpy as np
import pytest


@pytest.fixture(scope="module")
def found(imu_rig_data):
    return study.figures(study.read_recordings(imu_rig_data / "foot"))


def test_optical_trials_from_a_stroll_to_a_run(found):
    assert found.horizontal.mean() <= 0.062
    assert found.horizontal.max() <= 0.09
    assert found.vertical <= 0.025


def test_no_optical_trial_fails_where_a_fixed_threshold_does(found):
    """With fixed settings public smoothers fail by half a metre or more in one of four."""
    assert np.all(found.horizontal < 0.1)


@pytest.mark.parametrize(("trial", "strides"), [("33", 47), ("34", 24)])
def test_strides_between_measured_footprints(found, trial, strides):
    compared = found.footprints[trial]
    assert compared.count == compared.true_count == strides
    assert compared.mae <= 0.0165
    assert abs(compared.distance_percent) <= 0.75


def test_strides_of_motion_capture(found):
    assert found.mocap_mae <= 0.025  # 0.035 asked


def test_a_walk_that_ends_where_it_began(found):
    assert found.closure["short_walk"] <= 0.06
    assert found.closure["long_walk"] <= 0.25


def test_every_number_of_the_defaults_is_varied():
    names = {name for name, _, _ in study.varied(0.5)}
    assert {"gyro_motion", "stance.highest", "stance.trust", "grade.gyro_bias"} <= names
    assert len(names) > 35
