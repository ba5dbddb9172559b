"""A full load of devices, for a few seconds: nothing is lost."""

import load_harness
import pytest


@pytest.mark.slow
def test_four_fast_sensors_a_barometer_and_servos_lose_nothing(tmp_path):
    figures = load_harness.run(1.0, tmp_path)
    assert figures.sent > 4 * 300
    assert (figures.lost, figures.corrupt) == (0, 0)
    assert figures.unwritten_records == 0
    assert figures.servo_answers > 5
    assert figures.latency_p50_ms > 0
