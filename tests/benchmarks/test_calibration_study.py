"""The study runs, and judges what it is shown."""

import sys

import calibration_study as study
import pytest


def test_a_small_study_tells_a_good_method_from_one_that_trusts_the_servos(monkeypatch, capsys):
    arguments = "accuracy --sessions 1 --processes 1 --methods paper,multi-position --variant"
    case = "uniform within 0.2 %"
    monkeypatch.setattr(sys, "argv", ["study", *arguments.split(), case])
    study.main()
    printed = capsys.readouterr().out
    assert "1 sessions: median / 95th percentile" in printed
    session = study.session_of(study.designed(1000))
    paper, good = (study.score(session, method) for method in ("paper", "multi-position"))
    for group in ("accel scale", "gyro scale", "gyro cross"):
        worst, best = (max(map(abs, s.error[group])) for s in (paper, good))
        assert worst > 10 * best
        assert f"{group} [" in printed


@pytest.mark.parametrize(
    ("name", "finding"),
    [
        ("swapped", {"kind": "mislabelled"}),
        ("clipped z", {"kind": "saturated", "axis": "z"}),
        ("time x2", {"kind": "rate"}),
        ("slip roll", {"kind": "slip", "axis": "roll"}),
        ("bumped", {"kind": "bumped"}),
    ],
)
def test_a_fault_counts_as_named_only_where_kind_and_place_are_right(name, finding):
    faults = study.fault_of(name, 5, 24)
    size = faults.slip[2] + 1.0 if faults.slip else 0.0
    poses = list(faults.swapped or ())
    poses += [faults.slip[1] + 1] if faults.slip else []
    poses += [faults.bumped] if faults.bumped is not None else []
    right = {"axis": "", "poses": poses, "size": size, "text": ""} | finding

    def named(**changes) -> bool:
        return study.named_right(name, faults, study.Score("", findings=[right | changes]))

    assert named()
    assert not named(kind="moved")
    assert not study.named_right(name, faults, study.Score(""))
    if poses:
        assert not named(poses=[pose + 2 for pose in poses])
    if faults.slip:
        assert not named(size=-size)
        assert not named(axis="pan")


def test_a_clean_session_must_stay_silent():
    nothing = study.fault_of("clean", 5, 24)
    assert study.named_right("clean", nothing, study.Score(""))
    assert not study.named_right("clean", nothing, study.Score("", warnings=["Something."]))
