"""Strides beside footprints and motion capture, where the recordings are at hand."""

from dataclasses import replace

import gait_reference as study
import numpy as np
import pytest

from imu_rig.gait.smoother import smooth_foot
from imu_rig.importing.formats import load_foreign
from imu_rig.reference.alignment import align


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


@pytest.mark.parametrize("name", ["2017-11-22-11-49-03", "2017-11-27-11-24-07"])
def test_the_hand_of_a_real_reference_is_told(imu_rig_data, name):
    """A slow walk and a run, with the signs of the file, which are left-handed, and turned."""
    recording = load_foreign(imu_rig_data / "foot" / "pyshoe_vicon" / f"{name}.mat")
    path, right = smooth_foot(recording.imu()).trajectory, recording.reference
    assert align(path.t, path.position, right, search_offset_s=0.5).notes == ()
    left = replace(right, position=right.position * [1.0, -1.0, 1.0])
    told = align(path.t, path.position, left, search_offset_s=0.5)
    assert "left-handed" in told.notes[0]
    assert align(path.t, path.position, left, mirrored=True).rmse_horizontal < 0.12
