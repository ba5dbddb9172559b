"""The study runs, and calibrating makes the distance better by more than was published."""

import distance_study as study


def test_calibrating_is_worth_more_than_was_published(capsys):
    found = study.walks(2, 1, 1, shares=(1.0,))["1.0"]
    assert "published method, 2 walks" in capsys.readouterr().out
    for axis, published in zip("xyz", study.PUBLISHED, strict=True):
        assert found[f"published method, {axis}"]["pooled"] > published
    x = found["default smoother, x"]
    assert all(abs(a - b) < 0.05 for a, b in zip(x["calibrated_m"], x["reference_m"], strict=True))


def test_default_thresholds_find_stances_of_a_walk_and_no_swings(capsys):
    found = study.detectors(1, 11)
    assert "default" in capsys.readouterr().out
    del found["magnitude"]  # a bias blinds it
    for name, speeds in found.items():
        for speed in ("0.8", "1.2", "1.8"):
            low, high = speeds[speed]
            assert low < study.detector_named(name).threshold < high
