"""Numbers must read well and never lie about size."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imu_rig.report.numbers import counted, decimals_for, duration, fixed, significant


def parsed(text: str) -> float:
    return float(text.replace("−", "-"))


@given(st.floats(1e-6, 1e9), st.sampled_from([-1.0, 1.0]), st.integers(1, 6))
def test_significant_digits_keep_the_value(size, sign, digits):
    shown = parsed(significant(sign * size, digits))
    assert math.isclose(shown, sign * size, rel_tol=0.51 * 10.0 ** (1 - digits))


@given(st.floats(1e-7, 1e4))
def test_an_uncertainty_is_shown_with_about_two_digits(uncertainty):
    shown = parsed(fixed(uncertainty, decimals_for(uncertainty)))
    assert math.isclose(shown, uncertainty, rel_tol=0.051)


@given(st.floats())
def test_no_number_is_shown_as_nan_or_in_powers_of_ten(value):
    for shown in (significant(value), duration(value), fixed(value, 3, sign=True)):
        assert "nan" not in shown
        assert "inf" not in shown
        assert "e" not in shown


@pytest.mark.parametrize("value", [-0.0, -0.0004, 0.0])
def test_zero_has_no_minus_sign(value):
    assert fixed(value, 2) == "0.00"


def test_durations_and_counts_as_people_say_them():
    assert duration(82.4) == "82 s"
    assert duration(125.0) == "2 min 5 s"
    assert duration(7500.0) == "2 h 5 min"
    assert counted(1, "pose") == "1 pose"
    assert counted(0, "pose") == "0 poses"
