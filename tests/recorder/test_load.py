"""A full load of devices, for a few seconds: nothing is lost."""

import all_devices_harness
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


@pytest.mark.slow
def test_every_kind_of_device_at_once_loses_nothing(tmp_path):
    figures = all_devices_harness.run(1.0, tmp_path)
    assert figures.lost == 0
    assert figures.unwritten_records == 0
    assert figures.servo_answers > 5
    assert {s.corrupt for s in figures.streams} == {0}
    for stream in figures.streams:
        assert stream.received >= 0.8 * stream.published_hz
        assert stream.rate_hz == pytest.approx(stream.published_hz, rel=0.05)
