"""Numbers as text: right to the stated digit, whatever they are."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from imu_rig.exporting.number_text import (
    constant,
    decimals_of,
    integer_text,
    joined,
    number_text,
    rows,
    utc_text,
)


def lines(table: np.ndarray) -> list[str]:
    return joined([table, constant("\n", len(table))]).decode().splitlines()


def columns(largest: float) -> st.SearchStrategy[np.ndarray]:
    return arrays(float, st.integers(1, 40), elements=st.floats(-largest, largest))


@given(st.one_of(*map(columns, (1e-3, 1.0, 80.0, 1e6, 1e14))))
def test_a_number_is_off_by_a_billionth_of_the_largest_at_most(values: np.ndarray) -> None:
    decimals = decimals_of(values)
    back = np.array([float(line) for line in lines(number_text(values, decimals))])
    assert np.all(np.abs(back - values) <= 1e-9 * np.abs(values).max())


@given(st.integers(0, 4), arrays(np.int64, st.integers(1, 30), elements=st.integers(-9999, 9999)))
def test_short_decimals_are_written_exactly_and_as_short_as_they_are(places, whole) -> None:
    values = whole / 10.0**places
    decimals = decimals_of(values)
    assert decimals is not None
    assert decimals <= places
    texts = lines(number_text(values, decimals))
    assert [float(text) for text in texts] == values.tolist()


@given(
    st.sampled_from([0.1, 0.3, 0.15, 0.005]), arrays(np.int64, 20, elements=st.integers(0, 4095))
)
def test_counts_times_a_short_scale_are_short(scale: float, counts: np.ndarray) -> None:
    """86 * 0.3 is 25.799999999999997; who reads 25.80000000 takes it for better than it is."""
    texts = lines(number_text(counts * scale, decimals_of(counts * scale)))
    assert max(len(text.partition(".")[2]) for text in texts) <= 3
    assert [float(text) for text in texts] == pytest.approx(list(counts * scale), rel=1e-12)


@given(arrays(float, st.integers(1, 20), elements=st.floats(allow_subnormal=False)))
def test_anything_is_written_without_a_warning(values: np.ndarray) -> None:
    texts = lines(number_text(values, decimals_of(values)))
    back = np.array([float(text) for text in texts])
    finite = np.isfinite(values)
    assert np.array_equal(back[~finite], values[~finite], equal_nan=True)
    largest = np.abs(values[finite]).max(initial=0.0)
    assert np.all(np.abs(back[finite] - values[finite]) <= 1e-9 * largest)


def test_what_is_not_finite_has_a_word() -> None:
    values = np.array([np.nan, 1.5, -np.inf, -0.25])
    assert lines(number_text(values, 2)) == ["nan", "1.50", "-inf", "-0.25"]
    assert lines(number_text(np.array([np.inf, 3.0]), 0)) == ["inf", "3"]
    assert lines(number_text(np.array([np.nan, 1e30]), None)) == ["nan", "1e+30"]


@pytest.mark.parametrize(
    ("number", "decimals", "text"),
    [
        *((0, 0, "0"), (-7, 0, "-7"), (0, 3, "0.000"), (-5, 3, "-0.005"), (-12345, 3, "-12.345")),
        *((10**17, 0, "1" + "0" * 17), (99_999, 0, "99999"), (100_000, 6, "0.100000")),
    ],
)
def test_whole_numbers(number: int, decimals: int, text: str) -> None:
    others = np.array([number, 0, 123_456], np.int64)  # columns are as wide as their widest
    assert lines(integer_text(others, decimals))[0] == text


def test_rows_come_apart_where_they_were_put_together() -> None:
    texts = rows([integer_text(np.array([1, -200, 30])), constant(";", 3)])
    assert texts == [b"1;", b"-200;", b"30;"]
    assert rows([integer_text(np.array([], np.int64))]) == []


@given(st.lists(st.integers(-(10**15), 10**16), min_size=1, max_size=10))
def test_wall_clock_times(times: list[int]) -> None:
    epoch = datetime(1970, 1, 1, tzinfo=UTC)
    for time, text in zip(times, lines(utc_text(np.array(times))), strict=True):
        moment = epoch + timedelta(microseconds=time)
        assert text == moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ").rjust(27, "0")
