"""A few minutes of an accelerated day: nothing piles up, nothing is lost, and time stays true."""

import soak_harness


def test_minutes_of_an_accelerated_recording(tmp_path):
    figures = soak_harness.run(
        0.05, tmp_path, unplugs_per_hour=45.0, warm_hours=0.025, step_hours=0.025
    )
    assert figures.problems == []
    assert figures.unplugged == 2
    assert figures.lost_records == 0
    assert figures.descriptors[0] == figures.descriptors[1]
    assert figures.threads[0] == figures.threads[1]
    assert figures.growth_mb < 5.0
    assert 0 < figures.file_mb - figures.wire_mb < 0.25 * figures.wire_mb
