"""Clock fits against simulated transport: one-sided, bursty, with drop-outs of seconds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imu_rig.timing import LiveClockFit, alignment_sigma_s, fit_clock

RATE_HZ = 100.0
ORIGIN_S = 4321.0


def bluetooth(seed, duration_s, *, skew=50e-6, drop_outs=True):
    """Device clock, arrival and true time [s] over a link that flushes every 20 to 100 ms."""
    rng = np.random.default_rng(seed)
    device = np.arange(int(duration_s * RATE_HZ)) / RATE_HZ
    true = ORIGIN_S + device * (1 + skew)
    flushes = true[0] + np.cumsum(rng.uniform(0.02, 0.1, int(duration_s / 0.02) + 200))
    host = flushes[np.searchsorted(flushes, true)] + rng.exponential(2e-4, len(device))
    if drop_outs:
        for start in rng.uniform(true[0], true[-1], 1 + int(duration_s / 30)):
            silent_s = rng.uniform(1.0, 4.0)
            late = (host >= start) & (host < start + silent_s)
            host[late] = start + silent_s
    return device, np.maximum.accumulate(host), true


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), skew=st.floats(-100e-6, 100e-6))
def test_half_a_minute_over_bluetooth_is_good_to_2_ms(seed, skew):
    device, host, true = bluetooth(seed, 30.0, skew=skew)
    assert rms(fit_clock(device, host).host(device) - true) < 2e-3


def test_errors_shrink_with_time_and_agree_with_the_stated_sigma():
    for duration_s, limit_s in ((10, 1e-3), (60, 0.4e-3), (300, 0.3e-3)):
        inside = []
        for seed in range(12):
            device, host, true = bluetooth(seed, duration_s)
            fit = fit_clock(device, host)
            error = fit.host(device) - true
            assert rms(error) < limit_s
            inside.append(np.mean(np.abs(error) < 2 * fit.sigma_s))
            assert duration_s == 10 or fit.sigma_s < 2e-3
        assert np.mean(inside) > 0.95


def test_a_mapped_time_is_never_later_than_its_arrival():
    device, host, _ = bluetooth(3, 60.0)
    assert np.min(host - fit_clock(device, host).host(device)) > -1e-6


def test_short_records_keep_the_nominal_rate_and_take_the_smallest_delay():
    device, host, _ = bluetooth(4, 8.0, skew=0.0)
    fit = fit_clock(device, host)
    assert fit.skew == 0.0
    assert fit.offset_s == pytest.approx(np.min(host - device), abs=1e-9)


def test_a_microcontroller_off_by_a_percent_is_followed():
    device, host, true = bluetooth(5, 60.0, skew=0.01)
    assert rms(fit_clock(device, host).host(device) - true) < 1e-3


def test_a_perfect_link_has_next_to_no_uncertainty():
    device = np.arange(0.0, 600.0, 0.01)
    assert fit_clock(device, device + ORIGIN_S).sigma_s < 1e-6
    assert fit_clock(device, device * (1 + 30e-6) + ORIGIN_S).skew == pytest.approx(30e-6, rel=1e-6)


def test_one_packet_is_a_fit_and_none_is_not():
    assert fit_clock(np.array([5.0]), np.array([7.0])).host(np.array([5.0])) == pytest.approx(7.0)
    with pytest.raises(ValueError, match="no packets"):
        fit_clock(np.empty(0), np.empty(0))


@pytest.mark.parametrize("seed", range(4))
def test_the_live_fit_ends_where_the_whole_record_does(seed):
    device, host, true = bluetooth(seed, 60.0)
    live = LiveClockFit()
    for piece in np.array_split(np.arange(len(device)), 600):
        fit = live.update(device[piece], host[piece])
    assert rms(fit.host(device) - true) < 1e-3
    assert rms(fit.host(device) - fit_clock(device, host).host(device)) < 0.3e-3


def test_the_live_fit_follows_half_an_hour_in_bounded_memory():
    device, host, true = bluetooth(7, 1800.0)
    live = LiveClockFit()
    for piece in np.array_split(np.arange(len(device)), 1200):
        fit = live.update(device[piece], host[piece])
    newest = slice(-60_000, None)
    assert rms((fit.host(device) - true)[newest]) < 0.3e-3
    assert live._table.shape[1] <= 1200  # columns, all that it holds


def test_after_a_restart_the_crystal_is_remembered():
    device, host, true = bluetooth(8, 120.0)
    live = LiveClockFit()
    live.update(device, host)
    live.restart()
    assert live.fit is None
    again, arrival, true = bluetooth(9, 8.0, drop_outs=False)
    fit = live.update(again, arrival)
    assert fit.skew == pytest.approx(50e-6, abs=10e-6)
    assert rms(fit.host(again) - true) < 2e-3


@pytest.mark.parametrize("skew", [-0.05, 0.03, 0.05])
def test_a_clock_that_is_off_by_more_than_any_clock_is_reported(skew):
    device, host, _ = bluetooth(1, 60.0, skew=skew)
    fit = fit_clock(device, host)
    assert fit.impossible_skew == pytest.approx(skew, abs=2e-3)


def test_possible_clocks_are_not_reported_however_late_their_packets():
    for seed in range(20):
        for duration_s in (10.5, 30.0, 120.0):
            for skew in (-0.01, 0.0, 0.01):
                device, host, _ = bluetooth(seed, duration_s, skew=skew)
                assert fit_clock(device, host).impossible_skew is None


# --- long records ---------------------------------------------------------------------------


def wandering(seed, hours, rate_hz=10.0):
    """Device clock, arrival and true time [s]: the crystal changes by 2 ppm in ten minutes."""
    rng = np.random.default_rng(seed)
    device = np.arange(int(hours * 3600 * rate_hz)) / rate_hz
    warm = 2e-6 * np.clip((device - hours * 1800) / 600, 0, 1)
    true = ORIGIN_S + device + np.cumsum(warm) / rate_hz
    return device, np.maximum.accumulate(true + rng.exponential(5e-3, len(device))), true


def test_a_long_record_is_followed_where_a_straight_line_cannot():
    device, host, true = wandering(1, 6.0)
    fit = fit_clock(device, host)
    straight = np.polynomial.Polynomial.fit(device, true, 1)
    assert np.abs(straight(device) - true).max() > 2e-3
    assert np.abs(fit.host(device) - true).max() < 0.3e-3
    assert np.abs(fit.host(device) - true).max() < 4 * fit.sigma_s


def test_a_long_record_maps_without_steps_or_steps_back_and_never_later_than_arrival():
    device, host, _ = wandering(2, 3.0)
    fit = fit_clock(device, host)
    assert np.min(host - fit.host(device)) > -1e-6
    fine = np.linspace(device[0] - 100.0, device[-1] + 100.0, 200_001)
    pace = np.diff(fit.host(fine)) / np.diff(fine)
    assert np.all(np.abs(pace - 1.0) < 1e-4)


def test_hours_of_silence_within_a_record_do_no_harm():
    device, host, true = wandering(3, 9.0)
    here = (device < 3600.0) | (device > 30_000.0)
    fit = fit_clock(device[here], host[here])
    assert np.abs(fit.host(device[here]) - true[here]).max() < 0.5e-3


def test_arrivals_of_any_kind_give_times_that_do_not_run_backwards():
    rng = np.random.default_rng(4)
    for _ in range(20):
        device = np.cumsum(rng.pareto(0.6, 3000))
        host = np.cumsum(rng.pareto(0.6, 3000))
        assert np.all(np.diff(fit_clock(device, host).host(device)) >= -1e-9)


def test_two_devices_on_one_clock_are_aligned_to_the_root_of_the_sum_of_squares():
    assert alignment_sigma_s(3e-4, 4e-4) == pytest.approx(5e-4)
