"""The golden trial of several devices stays readable for ever."""

from pathlib import Path

import numpy as np
import pytest
from make_golden_devices import (
    CERTIFICATE,
    CONFIG,
    CREATED_NS,
    SAMPLES,
    UNPLUGGED,
    device_statistics,
    golden_devices,
)

from imu_rig.recording import open_trial

GOLDEN = Path(__file__).resolve().parent.parent / "data" / "golden-devices-v1.imu-trial"


@pytest.fixture
def trial():
    return open_trial(GOLDEN)


def test_the_file_is_the_one_that_was_made():
    assert GOLDEN.read_bytes() == golden_devices()


def test_it_is_whole_and_says_who_and_what(trial):
    assert not trial.damage
    assert trial.config == CONFIG
    assert trial.ended == "complete"
    assert trial.start_utc_ns == CREATED_NS
    assert trial.sensors == ["left shoe", "right shoe", "barometer"]
    assert trial.sources["left shoe"].descriptor["certificate"] == CERTIFICATE
    assert "certificate" not in trial.sources["right shoe"].descriptor
    assert [(m.t, m.label) for m in trial.markers] == [(0.902, "turn 90 °"), (2.102, "turn 210 °")]


def test_each_device_has_statistics_of_its_own(trial):
    assert [t for t, _ in trial.statistics] == [1.0, 2.0, 3.0]
    assert trial.statistics[0][1]["latency_p99_s"] == 0.004
    left = trial.device_statistics("left shoe")
    assert left == [(t, device_statistics(100 * round(t), 0, 0)) for t in (1.0, 2.0, 3.0)]
    right = trial.device_statistics("right shoe")
    lost = len(UNPLUGGED)
    assert right[-1] == (3.0, device_statistics(SAMPLES - lost, lost, 1))
    assert trial.device_statistics("barometer") == []


def test_a_gap_told_twice_is_one_gap_that_the_last_record_tells_of(trial):
    [gap] = trial.gaps
    assert (gap.t, gap.source) == (1.2, 2)
    assert gap.fields == {
        "reason": "unplugged",
        "until_s": 1.802,
        "counter_before": 119,
        "counter_after": 180,
        "restarted": False,
    }
    assert trial.missing("left shoe") == []
    [missing] = trial.missing("right shoe")
    assert (missing.samples, missing.reason) == (len(UNPLUGGED), "unplugged")
    assert missing.start_s == pytest.approx(1.192, abs=0.003)
    assert missing.stop_s == pytest.approx(1.802, abs=0.003)


def test_the_samples_are_those_that_were_sent(trial):
    left, right = trial.imu("left shoe"), trial.imu("right shoe")
    assert left.counter.tolist() == list(range(SAMPLES))
    assert right.counter.tolist() == [n for n in range(SAMPLES) if n not in UNPLUGGED]
    both = np.isin(left.counter, right.counter)
    np.testing.assert_array_equal(left.accel[both], right.accel)
    pressure = trial.samples("barometer")
    assert pressure.units == {"battery": "%", "pressure": "Pa", "temperature": "degC"}
    np.testing.assert_allclose(
        pressure.values["pressure"], 101_325 + np.arange(SAMPLES // 10) / 100, atol=1e-9
    )
