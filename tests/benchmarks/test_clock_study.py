"""The study's figures, in short: times are true and their uncertainty is honest."""

import sys

import clock_study as study
import numpy as np
import pytest


@pytest.mark.parametrize(
    ("kind", "link"),
    [
        ("clock", study.bluetooth),
        ("counter", study.bluetooth),
        # whether samples that nothing counts are late or lost in a drop-out, nobody can tell
        ("arrival", study.in_reach),
    ],
)
def test_half_a_minute_over_bluetooth_is_within_2_ms(kind, link, monkeypatch):
    monkeypatch.setattr(study, "LINKS", {"Bluetooth": link})
    monkeypatch.setattr(study, "RATES_HZ", (100.0,))
    layouts = {kind: study.layouts()[kind]}
    monkeypatch.setattr(study, "layouts", lambda: layouts)
    ((_, _, _, whole, after),) = study.transport_cases(3)
    for timed in (*whole, *after):
        assert timed.rms_s < 2e-3


def test_the_stated_uncertainty_holds_on_every_link():
    """About 95 % inside two sigma, over links that are kind to the fit and links that are not."""
    shares = []
    for name, rate_hz, span_s, timed in study.coverage_cases(6, (12.0, 30.0, 120.0)):
        all_of = study.pooled(timed)
        shares.append(study.inside(all_of, 2.0))
        assert study.inside(all_of, 10.0) > 0.99, (name, rate_hz, span_s)
    assert np.mean(shares) > 0.9


def test_a_crystal_that_wanders_is_followed_for_hours():
    device, whole, growing = study.day_case(study.polled, 5.0, 4.0, 1, step_s=10.0)
    assert np.ptp(study.wandering(device, np.random.default_rng(1))) > 3e-3
    assert whole.worst_s < 0.5e-3
    assert study.inside(whole, 2.0) > 0.95
    settled = device > 60.0
    assert study.drift_s_per_h(device[settled], growing.error_s[settled]) < 1e-3
    assert np.max(np.abs(growing.error_s[settled])) < 1e-3


def test_the_script_prints_its_figures(monkeypatch, capsys):
    monkeypatch.setattr(study, "LINKS", {"polled 10 ms": study.polled})
    monkeypatch.setattr(study, "RATES_HZ", (10.0,))
    for part in (["transport", "--seeds", "1"], ["coverage", "--seeds", "1"]):
        monkeypatch.setattr(sys, "argv", ["study", *part])
        study.main()
    printed = capsys.readouterr().out
    assert "polled 10 ms  counter" in printed
    assert "inside 2 sigma" in printed
