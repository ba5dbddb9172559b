"""The verdict of a report says in plain words what a careful reader must know."""

from dataclasses import replace

from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.result import ErrorStages
from imu_rig.report.facts import SessionSummary
from imu_rig.report.verdict import left_out_ratio, verdict


def test_a_good_calibration_needs_no_attention(make_result):
    words = verdict(make_result())
    assert words.attention == ()
    assert words.headline == "Accelerometer and gyroscope calibrated; nothing needs attention"


def test_a_calibration_that_makes_it_worse_is_called_so(make_result):
    result = make_result(8)
    worse = ErrorStages(before=result.accel_errors.held_out, held_out=result.accel_errors.before)
    words = verdict(replace(result, accel_errors=worse))
    assert len(words.attention) == 1
    assert "calibrated accelerometer is no better than the uncalibrated one" in words.attention[0]
    assert not any("times more" in sentence and "mg" in sentence for sentence in words.sentences)


def test_uncertainties_that_left_out_poses_contradict_are_called_too_small(make_result):
    result = make_result(24)
    ratio = left_out_ratio(result)
    poses = tuple(replace(pose, left_out_sigma=pose.left_out_sigma / 5) for pose in result.poses)
    boastful = replace(result, poses=poses)
    assert abs(left_out_ratio(boastful) - 5 * ratio) < 1e-9
    assert (
        "take the uncertainties of the accelerometer as too small" in verdict(boastful).attention[0]
    )


def test_few_left_out_poses_judge_no_uncertainty(make_result):
    assert left_out_ratio(make_result(7)) is None


def test_a_session_that_ended_early_is_said(make_result):
    session = SessionSummary("full", "paper-jig", planned=24, finished=11, duration_s=60.0)
    words = verdict(make_result(11), session)
    assert "11 of 24 stops" in words.attention[0]
    assert "on the jig paper-jig" in words.sentences[0]


def test_assumed_gravity_must_be_heeded_because_no_uncertainty_covers_it(make_result):
    words = verdict(replace(make_result(4, gyro=False), gravity=Gravity()))
    assert "local gravity was not given" in words.attention[0]
    assert "WGS-84" in verdict(make_result(4, gyro=False)).sentences[-1]


def test_the_gain_is_stated_over_the_uncalibrated_sensor(make_result):
    result = make_result(24)
    before, after = result.accel_errors.before.rms, result.accel_errors.held_out.rms
    accelerometer = verdict(result).sentences[1]
    assert f"{before / after:.0f} times more" in accelerometer
    assert "On poses kept out of the fit" in accelerometer
