"""The foot study in short: covariances that fit, strides of sprints, shuffles without extras."""

from functools import cache

import foot_study as study
import numpy as np
import pytest

from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.smoother import smooth_foot

WALKS = ("level-10m", "turns")


@cache
def scores(grade: str, claimed: str) -> dict[str, float]:
    """Mean normalized errors of a few sensors of a grade that a certificate calls another."""
    runs = [
        study.nees_of(smooth_foot(block, grade=study.known(claimed), covariance=True), shape.truth)
        for shape, block in study.reads(WALKS, grade, 1, 2)
    ]
    return {part: float(np.mean([run[part] for run in runs])) for part in runs[0]}


@pytest.mark.parametrize("grade", study.GRADES)
def test_published_uncertainty_fits_sensors_of_every_grade(grade):
    found = scores(grade, grade)
    for part in study.JUDGED:
        assert 0.15 < found[part] < 2.5, part


def test_a_certificate_that_is_far_too_good_shows():
    assert scores("poor", "good")["tilt"] > 10.0
    assert scores("poor", "good")["position"] > 4.0


def test_a_sensor_that_shows_itself_poor_is_not_thought_better_than_it_is():
    ((shape, block),) = study.reads(("level-10m",), "poor", 1, 1)
    doubted = smooth_foot(block, grade=SensorGrade(), covariance=True)
    trusted = smooth_foot(block, grade=SensorGrade(raw_odds=0.0), covariance=True)
    assert study.nees_of(doubted, shape.truth)["tilt"] < 5.0
    for of in (lambda c: c.heading_sigma[-1], lambda c: np.trace(c.strides[5])):
        assert of(doubted.covariance) > 1.3 * of(trusted.covariance)


def test_what_is_lost_in_a_swing_makes_its_stride_uncertain():
    ((_, block),) = study.reads(("level-10m",), "middle", 1, 1)
    whole = smooth_foot(block, covariance=True)
    third, fourth = whole.footfalls.quietest[3:5]
    there = np.ones(len(block), dtype=bool)
    middle = (third + fourth) // 2
    there[middle - 10 : middle + 10] = False
    track = smooth_foot(block[there], covariance=True)
    assert len(track.footfalls) == len(whole.footfalls)
    truth = study.shape_of("level-10m", 1).truth.position[there][track.footfalls.quietest]
    found = track.trajectory.position[track.footfalls.quietest]
    off = np.linalg.norm(np.diff(found, axis=0), axis=1)
    off -= np.linalg.norm(np.diff(truth, axis=0), axis=1)
    sigma, usual = (np.sqrt(np.trace(t.covariance.strides[3])) for t in (track, whole))
    assert sigma > 1.5 * usual
    assert abs(off[3]) < 3.0 * sigma


def test_strides_share_what_lasts_and_have_something_of_their_own():
    ((_, block),) = study.reads(("level-10m",), "middle", 1, 1)
    uncertainty = smooth_foot(block, covariance=True).covariance
    common = uncertainty.common
    own = uncertainty.strides - common.transpose(0, 2, 1) @ common
    assert np.linalg.eigvalsh(own).min() > 0.004**2
    assert np.abs(common[2:-2]).max() > 0.001
    assert np.all(np.linalg.eigvalsh(uncertainty.values) > -1e-12)
    assert uncertainty.heading_sigma[-1] > uncertainty.heading_sigma[len(uncertainty.rows) // 2]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["sprints", "--grades", "good", "--only", "fast-run"], "missed 0, extra 0"),
        (["uncalibrated", "--sensors", "5"], " sigma (rms)"),
        (["walks", "--grades", "poor", "--only", "shuffle-turns"], "missed 0 extra 0"),
    ],
)
def test_the_study_prints_what_it_found(arguments, told, monkeypatch, capsys):
    monkeypatch.setattr(study, "UNCALIBRATED_WALK", "level-10m")
    monkeypatch.setattr("sys.argv", ["study", *arguments])
    study.main()
    printed = capsys.readouterr().out
    assert told in printed
    assert printed.endswith("\nwithin bounds\n")
