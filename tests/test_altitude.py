"""Altitude against the standard atmosphere and the published formula."""

from __future__ import annotations

import numpy as np
import pytest

from imu_rig import altitude as air

PRESSURES = np.linspace(30_000.0, 110_000.0, 41)


def test_altitudes_are_those_of_the_standard_atmosphere():
    heights = air.altitude([101_325.0, 100_000.0, 90_000.0])

    np.testing.assert_allclose(heights, [0.0, 110.884, 988.499], atol=5e-4)


def test_one_hectopascal_at_sea_level_is_832_centimetres():
    step = air.altitude(101_275.0) - air.altitude(101_375.0)

    assert step == pytest.approx(8.32, abs=0.005)


def test_the_published_formula_is_the_one_printed():
    assert air.paper_altitude(101_300.0) == 0.0
    assert air.paper_altitude(90_000.0) == pytest.approx((1 - (900 / 1013) ** 0.19) / 2.2558e-5)


def test_the_two_formulas_differ_by_little_in_slope():
    standard = np.diff(air.altitude(PRESSURES))
    paper = np.diff(air.paper_altitude(PRESSURES))

    np.testing.assert_allclose(paper, standard, rtol=1.6e-3)


def test_both_have_an_inverse():
    np.testing.assert_allclose(air.pressure_at(air.altitude(PRESSURES)), PRESSURES, rtol=1e-12)
    np.testing.assert_allclose(
        air.paper_pressure_at(air.paper_altitude(PRESSURES)), PRESSURES, rtol=1e-12
    )


def test_the_reference_is_where_altitude_is_nothing():
    assert air.altitude(98_000.0, reference_pa=98_000.0) == 0.0
    assert air.pressure_at(0.0, reference_pa=98_000.0) == 98_000.0


def test_what_was_not_measured_stays_unknown():
    assert np.isnan(air.altitude(np.nan))
    assert np.isnan(air.altitude(-1.0))
