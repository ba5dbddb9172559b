"""The simulated barometer: what a host that follows, or breaks, the rules of its bus reads."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_protocols import ms5803
from firmware_protocols.unconfirmed import MS5803_LONGEST_CONVERSION_S, MS5803_PRESSURE_NOISE_PA
from simulators.ms5803_chip import TYPICAL_CONVERSION_S, Ms5803Chip, draw_prom, typical_prom

PRESSURE, TEMPERATURE = 98_000.0, 23.0


def chip(variant="02BA", seed=1):
    rng = np.random.default_rng(seed)
    prom = draw_prom(rng, variant)
    return Ms5803Chip(prom, rng, variant, air=lambda _: (PRESSURE, TEMPERATURE))


def number(of, command, now_s, length):
    of.command(command, now_s)
    return int.from_bytes(of.read(length), "big")


def read_prom(of, now_s=1.0):
    return [number(of, ms5803.PROM_READ + 2 * word, now_s, 2) for word in range(8)]


def convert(of, which, oversampling, now_s, wait_s):
    command = which + {256: 0, 512: 2, 1024: 4, 2048: 6, 4096: 8}[oversampling]
    of.command(command, now_s)
    return number(of, ms5803.ADC_READ, now_s + wait_s, 3)


@pytest.mark.parametrize("variant", ms5803.VARIANTS)
def test_a_driver_reads_the_air(variant):
    of = chip(variant)
    of.command(ms5803.RESET, 0.0)
    prom = read_prom(of)
    d1 = convert(of, ms5803.CONVERT_D1, 4096, 1.0, 0.01)
    d2 = convert(of, ms5803.CONVERT_D2, 4096, 1.1, 0.01)
    pressure, temperature = ms5803.compensate(variant, [prom], [d1], [d2])

    assert ms5803.prom_is_sound(prom).all()
    assert pressure[0] == pytest.approx(PRESSURE, abs=30.0)
    assert temperature[0] == pytest.approx(TEMPERATURE, abs=0.03)


@pytest.mark.parametrize("oversampling", ms5803.OVERSAMPLING)
def test_a_conversion_takes_its_time(oversampling):
    of = chip()
    typical, longest = TYPICAL_CONVERSION_S[oversampling], MS5803_LONGEST_CONVERSION_S[oversampling]

    assert convert(of, ms5803.CONVERT_D1, oversampling, 1.0, 0.99 * typical) == 0
    assert convert(of, ms5803.CONVERT_D1, oversampling, 2.0, longest) > 0


def test_a_result_is_read_once_and_an_early_read_spoils_it():
    of = chip()
    assert convert(of, ms5803.CONVERT_D1, 256, 1.0, 0.001) > 0
    assert number(of, ms5803.ADC_READ, 1.1, 3) == 0
    assert convert(of, ms5803.CONVERT_D1, 4096, 2.0, 0.001) == 0
    assert number(of, ms5803.ADC_READ, 3.0, 3) == 0


def test_nothing_is_read_before_the_reset_is_over():
    of = chip()
    of.command(ms5803.RESET, 1.0)
    assert read_prom(of, 1.001) == [0] * 8
    assert any(read_prom(of, 1.003))


def test_an_unknown_command_says_nothing():
    of = chip()
    assert number(of, 0x4A, 1.0, 3) == 0
    assert number(of, ms5803.ADC_READ, 2.0, 3) == 0
    assert of.read(2) == b"\0\0"


def test_a_damaged_prom_is_not_sound():
    of = chip()
    of.damage_prom(3, 5)
    assert not ms5803.prom_is_sound(read_prom(of)).any()


@pytest.mark.parametrize("oversampling", [256, 4096])
def test_the_noise_is_that_of_the_oversampling(oversampling):
    """Over 4000 readings the estimate itself is known to 1.1 %."""
    of = chip()
    n = 4000
    d1, d2 = of.counts(np.full(n, PRESSURE), np.full(n, TEMPERATURE), oversampling)
    pressure, _ = ms5803.compensate("02BA", of.prom, d1, d2)

    expected = MS5803_PRESSURE_NOISE_PA[oversampling]
    assert np.std(pressure) == pytest.approx(np.hypot(expected, 12**-0.5), rel=0.06)
    assert np.mean(pressure) == pytest.approx(PRESSURE, abs=0.5 + 5 * expected / np.sqrt(n))


def test_the_noise_is_a_fifth_of_a_metre_at_the_finest():
    """As the maker's front page says; 8.32 m per hPa."""
    assert MS5803_PRESSURE_NOISE_PA[4096] * 8.32 / 100 == pytest.approx(0.20, abs=0.005)


def test_drawn_chips_differ_and_are_sound():
    proms = np.array([draw_prom(np.random.default_rng(seed)) for seed in range(20)])
    assert ms5803.prom_is_sound(proms).all()
    assert len({tuple(prom) for prom in proms.tolist()}) == 20
    assert ms5803.prom_is_sound(typical_prom("05BA")).all()


def test_a_variant_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match=r"MS5803-03BA.*01BA, 02BA, 05BA, 14BA"):
        Ms5803Chip(typical_prom(), np.random.default_rng(0), "03BA")
