"""A disk that stalls costs nothing while the queue lasts, and nothing unsaid when it does not."""

import slow_disk_harness


def test_a_stall_within_the_stated_time_of_the_queue_loses_nothing(tmp_path):
    figures = slow_disk_harness.run(0.15, tmp_path, calm_s=0.2)
    assert figures.stalls == 2
    assert figures.stall_s < figures.queue_s
    assert figures.lost == figures.unknown == figures.gaps == figures.unwritten_records == 0


def test_what_a_longer_stall_loses_is_in_the_file(tmp_path):
    figures = slow_disk_harness.run(0.6, tmp_path, queue_bytes=8000, calm_s=0.2)
    assert figures.stalls == 2
    assert figures.stall_s > figures.queue_s
    assert figures.lost > 0
    assert figures.unknown == 0
    assert figures.gaps > 0
    assert figures.records_in_gaps == figures.unwritten_records > 0
