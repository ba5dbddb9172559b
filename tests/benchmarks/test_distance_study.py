"""The study runs, and calibrating makes the distance better by more than was published."""

import distance_study as study


def test_calibrating_is_worth_more_than_was_published(capsys):
    walked = [study.walk((seed, 1.0)) for seed in (1, 2)]
    found = study.shown(walked, "all of the errors")
    assert "published method, 2 of 2 walks" in capsys.readouterr().out
    for axis, published in zip("xyz", study.PUBLISHED, strict=True):
        assert found[f"published method, {axis}"]["pooled"] > published
    for one in walked:
        ours = one.measured["default smoother"][1]
        assert abs(ours[0] - one.reference[0]) < 0.05


def test_default_thresholds_find_stances_of_a_walk_and_no_swings(capsys):
    found = study.detectors(1, 11)
    assert "default" in capsys.readouterr().out
    del found["magnitude"]  # a bias blinds it
    for name, speeds in found.items():
        for speed in ("0.8", "1.2", "1.8"):
            low, high = speeds[speed]
            assert low < study.detector_named(name).threshold < high
