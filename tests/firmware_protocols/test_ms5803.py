"""The barometer's arithmetic against the printed examples, plain integers and its own inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocols import ms5803

PROM_02BA = [0x0000, 0xB524, 0xABCD, 0x7183, 0x6CC2, 0x7B41, 0x6E05, 0x0008]
PROMS = {
    "01BA": ms5803.with_crc([0, 40127, 36924, 23317, 23282, 33464, 28312, 0]),
    "02BA": np.array(PROM_02BA),
    "05BA": ms5803.with_crc([0, 46546, 42845, 29751, 29457, 32745, 29059, 0]),
    "14BA": ms5803.with_crc([0, 46546, 42845, 29751, 29457, 32745, 29059, 0]),
}
D1 = 6465444

word = st.integers(0, 0xFFFF)
count = st.integers(0, ms5803.MAX_COUNT)


class TestProm:
    def test_the_application_notes_example_has_crc_b(self):
        words = [0x3132, 0x3334, 0x3536, 0x3738, 0x3940, 0x4142, 0x4344, 0x4500]

        assert ms5803.prom_crc(words).tolist() == [0xB]

    @pytest.mark.parametrize("low_byte", [0x00, 0x08, 0xFF])
    def test_the_byte_of_the_crc_does_not_count(self, low_byte):
        assert ms5803.prom_crc([*PROM_02BA[:7], low_byte]).tolist() == [8]

    def test_a_prom_with_its_crc_is_sound(self):
        assert ms5803.prom_is_sound(PROM_02BA).all()
        assert ms5803.prom_is_sound([PROM_02BA] * 3).tolist() == [True] * 3

    @pytest.mark.parametrize("bit", [0, 3, 8, 20, 50, 66, 90, 111])
    def test_one_wrong_bit_is_seen(self, bit):
        words = np.array(PROM_02BA)
        words[bit // 16] ^= 1 << (bit % 16)

        assert ms5803.prom_is_sound([words, PROM_02BA]).tolist() == [False, True]

    @pytest.mark.parametrize("level", [0x0000, 0xFFFF])
    def test_a_line_that_never_changes_is_no_prom(self, level):
        assert not ms5803.prom_is_sound([level] * 8).any()


class TestPrintedExamples:
    def test_the_sister_sheets_example_of_the_02ba(self):
        between = ms5803.intermediate("02BA", PROM_02BA, [8077636])
        pressure, temperature = ms5803.compensate("02BA", PROM_02BA, [D1], [8077636])

        assert (between.dt[0], between.off[0], between.sens[0]) == (68, 5764707214, 3039050829)
        assert (pressure[0], temperature[0]) == (110002, 20.00)

    @pytest.mark.parametrize(
        ("d2", "temperature", "pressure"), [(7779730, 9.59, 107523), (6737297, -33.36, 97195)]
    )
    def test_the_cold_examples_of_the_02ba(self, d2, temperature, pressure):
        got = ms5803.compensate("02BA", PROM_02BA, [D1], [d2])

        assert (got[0][0], got[1][0]) == (pressure, temperature)

    def test_the_corrections_of_the_cold_are_those_of_the_example(self):
        d2 = [7779730, 6737297]
        between = ms5803.intermediate("02BA", PROM_02BA, d2)
        first_off = (43981 << 17) + ((27842 * between.dt) >> 6)
        first_sens = (46372 << 16) + ((29059 * between.dt) >> 7)

        assert between.dt[0] == -297838
        assert (first_off - between.off).tolist() == [3812500, 97203125]
        assert (first_sens - between.sens).tolist() == [2000000, 52500000]

    def test_the_example_of_the_01ba(self):
        got = ms5803.compensate("01BA", PROMS["01BA"], [9085466], [8569150])

        assert (got[0][0], got[1][0]) == (100009, 20.07)

    def test_the_example_of_the_14ba_is_in_tenths_of_a_millibar(self):
        between = ms5803.intermediate("14BA", PROMS["14BA"], [8387300])
        got = ms5803.compensate("14BA", PROMS["14BA"], [4311550], [8387300])

        assert between.dt[0] == 4580
        assert got[1][0] == 20.15
        assert got[0][0] == pytest.approx(100_050)

    def test_the_correction_of_the_heat_is_rounded_before_it_is_taken(self):
        """SENS2 = SENS2 - (TEMP - 4500)^2 / 2^3: not a quotient below 0, which rounds away."""
        prom, d2 = PROMS["01BA"], np.arange(9_600_000, 9_600_900)
        between = ms5803.intermediate("01BA", prom, d2)
        first = (int(prom[1]) << 15) + ((int(prom[3]) * between.dt) >> 8)
        hot = between.temp - 4500

        assert hot.min() > 0
        assert (between.sens - first).tolist() == (hot**2 >> 3).tolist()

    def test_the_shifts_of_the_01ba_halve_the_pressure_of_a_02ba(self):
        pressure, _ = ms5803.compensate("01BA", PROM_02BA, [D1], [8077636])

        assert pressure[0] == 55001

    def test_the_example_of_the_inverse(self):
        d1, d2 = ms5803.counts_for("02BA", PROM_02BA, [101325.0], [25.0])

        assert (d1[0], d2[0]) == (6244467, 8226488)


class TestCompensation:
    @pytest.mark.parametrize("variant", ms5803.VARIANTS)
    @settings(max_examples=60)
    @given(words=st.lists(word, min_size=8, max_size=8), d1=count, d2=count)
    def test_no_input_overflows(self, variant, words, d1, d2):
        """Against integers of any length, worked as the data sheets print them."""
        expected = _plain(variant, words, d1, d2)
        words[7] = (words[7] & 0xFF00) | int(ms5803.prom_crc(words)[0])
        pressure, temperature = ms5803.compensate(variant, [words], [d1], [d2])

        if 0 in words[1:7] or 0 in (d1, d2):
            assert np.isnan(pressure).all()
            assert np.isnan(temperature).all()
        else:
            assert pressure[0] == expected[0]
            assert temperature[0] == expected[1] / 100

    @pytest.mark.parametrize("beyond", [2**24, D1 | 1 << 31, 2**32 - 1])
    def test_more_than_24_bits_are_no_reading(self, beyond):
        """A field of 32 bits can hold them, and a damaged or strange packet does."""
        raw = [8077636, beyond, 8077636], [8077636, 8077636, beyond]
        pressure, temperature = ms5803.compensate("02BA", PROM_02BA, *raw)

        assert np.isnan(pressure).tolist() == [False, True, True]
        assert np.isnan(temperature).tolist() == [False, True, True]

    @pytest.mark.parametrize("variant", ms5803.VARIANTS)
    @pytest.mark.parametrize("extreme", [(65535, 1), (65535, 2**24 - 1), (1, 2**24 - 1), (1, 1)])
    def test_the_ends_of_the_range_do_not_overflow(self, variant, extreme):
        words = ms5803.with_crc([0, *[extreme[0]] * 6, 0])
        pressure, _ = ms5803.compensate(variant, words, [2**24 - 1], [extreme[1]])

        assert pressure[0] == _plain(variant, words.tolist(), 2**24 - 1, extreme[1])[0]

    def test_each_row_is_computed_with_its_own_prom(self):
        other = ms5803.with_crc([7, 46000, 44000, 29000, 27800, 31500, 28100, 0])
        both = ms5803.compensate("02BA", [PROM_02BA, other], [D1, D1], [8077636, 8077636])
        alone = ms5803.compensate("02BA", other, [D1], [8077636])

        assert both[0].tolist() == [110002.0, alone[0][0]]

    def test_what_cannot_be_computed_is_nan(self):
        broken = [*PROM_02BA[:7], 0x0009]
        pressure, temperature = ms5803.compensate(
            "02BA",
            [PROM_02BA, broken, PROM_02BA, PROM_02BA],
            [D1, D1, 0, D1],
            [8077636, 8077636, 8077636, 0],
        )

        assert np.isnan(pressure).tolist() == [False, True, True, True]
        assert np.isnan(temperature).tolist() == [False, True, True, True]

    def test_no_rows_give_no_rows(self):
        pressure, _ = ms5803.compensate("02BA", np.empty((0, 8), int), [], [])

        assert pressure.shape == (0,)


class TestInverse:
    @pytest.mark.parametrize("variant", ms5803.VARIANTS)
    def test_the_whole_range_comes_back(self, variant):
        unit = ms5803.VARIANTS[variant].count_pa
        rng = np.random.default_rng(1)
        pressure = np.rint(rng.uniform(30_000, 110_000, 20_000) / unit) * unit
        temperature = np.round(rng.uniform(-20.0, 60.0, 20_000), 2)

        counts = ms5803.counts_for(variant, PROMS[variant], pressure, temperature)
        back, warm = ms5803.compensate(variant, PROMS[variant], *counts)

        np.testing.assert_array_equal(back, pressure)
        np.testing.assert_allclose(warm, temperature, atol=0.0101)

    def test_what_24_bits_cannot_hold_stays_at_the_end(self):
        d1, d2 = ms5803.counts_for("02BA", PROM_02BA, [9e6, -9e6], [900.0, -900.0])

        assert d1.tolist() == [ms5803.MAX_COUNT, 1]
        assert d2.tolist()[0] == ms5803.MAX_COUNT


def _plain(variant: str, words: list[int], d1: int, d2: int) -> tuple[int, int]:
    """The printed equations in integers without limits; pressure [Pa], temperature [0.01 degC]."""
    _, c1, c2, c3, c4, c5, c6, _ = (int(w) for w in words)
    dt = d2 - c5 * 256
    temp = 2000 + dt * c6 // 2**23
    x, cold, hot = temp - 2000, temp + 1500, temp - 4500
    t2 = off2 = sens2 = 0
    if variant == "02BA":
        off, sens = c2 * 2**17 + c4 * dt // 2**6, c1 * 2**16 + c3 * dt // 2**7
        if temp < 2000:
            t2, off2, sens2 = dt**2 // 2**31, 61 * x**2 // 16, 2 * x**2
        if temp < -1500:
            off2, sens2 = off2 + 20 * cold**2, sens2 + 12 * cold**2
    elif variant == "05BA":
        off, sens = c2 * 2**18 + c4 * dt // 2**5, c1 * 2**17 + c3 * dt // 2**7
        if temp < 2000:
            t2, off2, sens2 = 3 * dt**2 // 2**33, 3 * x**2 // 8, 7 * x**2 // 8
        if temp < -1500:
            sens2 += 3 * cold**2
    else:
        off, sens = c2 * 2**16 + c4 * dt // 2**7, c1 * 2**15 + c3 * dt // 2**8
        if variant == "01BA":
            if temp < 2000:
                t2, off2, sens2 = dt**2 // 2**31, 3 * x**2, 7 * x**2 // 8
            if temp < -1500:
                sens2 += 2 * cold**2
            if temp > 4500:
                sens2 = -(hot**2 // 8)  # the sheet takes (TEMP - 4500)^2 / 2^3 from SENS2
        elif temp < 2000:
            t2, off2, sens2 = 3 * dt**2 // 2**33, 3 * x**2 // 2, 5 * x**2 // 8
            if temp < -1500:
                off2, sens2 = off2 + 7 * cold**2, sens2 + 4 * cold**2
        else:
            t2, off2 = 7 * dt**2 // 2**37, x**2 // 16
    pressure = (d1 * (sens - sens2) // 2**21 - (off - off2)) // 2**15
    return pressure * (10 if variant == "14BA" else 1), temp - t2
