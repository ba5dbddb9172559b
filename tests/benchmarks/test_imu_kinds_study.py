"""The study of kinds runs, and sees what counts cost."""

import imu_kinds_study as study


def test_a_small_study_tells_coarse_counts_from_floats(capsys):
    found = study.study(["mavlink-scaled", "mavlink-highres"], range(1, 2), "quick", 1)
    printed = capsys.readouterr().out
    assert "1 sessions each" in printed
    coarse, fine = (found[kind]["gyro bias"] for kind in ("mavlink-scaled", "mavlink-highres"))
    unrounded = found["mavlink-scaled, not rounded"]["gyro bias"]
    assert coarse is not None
    assert fine is not None
    assert unrounded is not None
    assert coarse[1] > 1.5 * unrounded[1]
    assert fine[1] < 1.1 * unrounded[1]
