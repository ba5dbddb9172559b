"""Devices unplugged at random moments: each gap is on record, and nothing else is missing."""

import pytest
import unplug_harness


@pytest.mark.slow
def test_unplugged_devices_come_back_and_the_others_lose_nothing(tmp_path):
    figures = unplug_harness.run(3, tmp_path, seed=4, calm_s=0.1, absence_s=0.3)
    assert figures.problems == []
    assert figures.gaps == 3
    assert figures.gaps_without_counters == figures.missing_elsewhere == 0
    assert figures.noticed_worst_s < unplug_harness.PATIENCE_S
    assert figures.live_again_worst_s < unplug_harness.PATIENCE_S
