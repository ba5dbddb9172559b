"""Strides beside footprints and motion capture, where the recordings are at hand."""

import gait_reference as study
import numpy as np
import pytest


@pytest.mark.parametrize(("name", "strides"), [("33", 47), ("34", 24)])
def test_every_footprint_has_its_stride(imu_rig_data, name, strides):
    """Walking, and brisk walking of which a fixed threshold sees a tenth."""
    found = study.footprint_trial(imu_rig_data / "foot" / "gcp_footprints", name)
    assert found.count == found.true_count == strides
    assert found.mae < 0.02
    assert abs(found.distance_percent) < 1.0


def test_strides_are_those_of_motion_capture(imu_rig_data):
    """Without its events, both feet; and the events themselves within three hundredths."""
    folder = imu_rig_data / "foot" / "gaitmap_mocap"
    errors = []
    for foot, strides in study.mocap_strides(folder).items():
        compared = study.mocap_lengths(folder, foot, strides)
        assert compared.count == compared.true_count  # each has a stride of its own
        errors.append(np.abs(compared.errors))
        for off in study.mocap_events(folder, foot, strides).values():
            assert abs(np.median(off)) < 0.035
    assert np.concatenate(errors).mean() < 0.037
