"""The simulated analogue accelerometer and its converter against the figures of the data sheet."""

from __future__ import annotations

import numpy as np
import pytest

from simulators.mma7260 import Converter, Mma7260, counts_per_g, noise_mg, sampled_noise_ug

RANGES = [(0, 1.5, 0.8), (1, 2.0, 0.6), (2, 4.0, 0.3), (3, 6.0, 0.2)]


@pytest.mark.parametrize(("g_select", "range_g", "volts"), RANGES)
def test_sensitivity_and_zero_are_those_of_the_data_sheet(g_select, range_g, volts):
    sensor = Mma7260(g_select)
    assert sensor.range_g == range_g
    assert sensor.volts_per_g == pytest.approx(volts)
    np.testing.assert_allclose(sensor.volts(np.array([0.0, 1.0])), [1.65, 1.65 + volts])


@pytest.mark.parametrize(
    ("bits", "volts", "expected"),
    [
        (10, 3.3, [248.2, 186.2, 93.1, 62.1]),
        (12, 3.3, [993.0, 744.7, 372.4, 248.2]),
        (10, 5.0, [163.8, 122.9, 61.4, 41.0]),
    ],
)
def test_counts_per_g_are_those_of_the_table(bits, volts, expected):
    got = [counts_per_g(g, bits, volts, 3.3) for g in range(4)]
    np.testing.assert_allclose(got, expected, atol=0.05)


def test_a_5_volt_converter_sees_the_zero_at_337_9():
    zero = 1.65 * 1024 / 5.0
    assert zero == pytest.approx(337.9, abs=0.05)
    assert Converter(10, 5.0).counts(Mma7260(0).volts(np.zeros(1))).tolist() == [338]


@pytest.mark.parametrize("supply_v", [2.2, 3.0, 3.3, 3.6])
def test_the_supply_is_not_in_the_counts(supply_v):
    counts = Converter(12, supply_v).counts(
        Mma7260(2, supply_v).volts(np.array([0.0, 1.0, -2.0, 2.5]))
    )
    assert counts.tolist() == [2048, 2420, 1303, 2979]


@pytest.mark.parametrize(("g_select", "range_g"), [(g, r) for g, r, _ in RANGES])
def test_the_output_ends_beyond_the_range_and_before_the_rails(g_select, range_g):
    sensor = Mma7260(g_select)
    far = sensor.volts(np.array([-100.0, 100.0]))
    assert far.tolist() == [0.25, 3.05]
    assert range_g < sensor.end_g < 1.25 * range_g


def test_asleep_all_outputs_are_at_ground():
    assert Mma7260(0, asleep=True).volts(np.ones(3)).tolist() == [0.0] * 3


def test_the_converter_ends_at_its_ends():
    assert Converter().counts(np.array([-1.0, 9.0])).tolist() == [0, 4095]


def test_noise_folds_into_what_a_slow_converter_sees():
    """350 ug per root hertz over 350 Hz behind one pole; the scatter of a reading stays."""
    assert noise_mg(350.0) == pytest.approx(8.2, abs=0.05)
    assert noise_mg(150.0) == pytest.approx(5.4, abs=0.05)
    assert sampled_noise_ug(100.0) * np.sqrt(50.0) * 1e-3 == pytest.approx(noise_mg(350.0))


def test_another_setting_of_the_pins_is_refused():
    with pytest.raises(ValueError, match="0 to 3, not 4"):
        Mma7260(4)
