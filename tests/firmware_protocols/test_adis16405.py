"""The ADIS16405's words against the fact sheet's bytes, over every value and every flag."""

import binascii
import itertools

import numpy as np
import pytest

from firmware_protocols.adis16405 import (
    BURST,
    BURST_BYTES,
    DIAG_WORDS,
    GYRO_COUNT_DPS,
    GYRO_RANGE_DPS,
    NEW_DATA,
    Diag,
    Register,
    averager,
    diag_names,
    line_load,
    max_spi_hz,
    pack_bursts,
    read_frame,
    sample_rate_hz,
    sens_avg,
    signed,
    unpack_bursts,
    write_frame,
    write_frames,
)
from firmware_protocols.known import builtin_protocols
from firmware_protocols.layout import load_layout
from firmware_protocols.packets import counts, encode, flag, values

LAYOUT = load_layout("adis16405-36")

# The burst of the fact sheet, ND set on all words.
EXAMPLE = bytes.fromhex("8813 8014 BFEC 8000 8000 8000 BED4 8190 8000 BCE0 8FDD 8000")
EXAMPLE_COUNTS = [2067, 20, -20, 0, 0, 0, -300, 400, 0, -800, -35, 0]
BURST_FIELDS = ("supply", "gyro", "accel", "mag", "temperature", "aux")


def rows_of(bursts, **columns):
    """Rows of the layout that carry these bursts."""
    rows = np.zeros(len(bursts) // BURST_BYTES, dtype=LAYOUT.dtype)
    first = LAYOUT.dtype.fields["supply"][1]
    table = rows.view(np.uint8).reshape(len(rows), LAYOUT.length)
    table[:, first : first + BURST_BYTES] = np.frombuffer(bursts, np.uint8).reshape(len(rows), -1)
    rows["range"] = 4
    for name, column in columns.items():
        rows[name] = column
    return rows


def test_the_burst_of_the_fact_sheet():
    burst = unpack_bursts(EXAMPLE)
    assert burst.counts.tolist() == [EXAMPLE_COUNTS]
    assert burst.new.all()
    assert not burst.error.any()
    assert pack_bursts(EXAMPLE_COUNTS) == EXAMPLE


def test_the_values_of_the_fact_sheet():
    rows = rows_of(EXAMPLE)
    assert values(LAYOUT, rows, "supply") == pytest.approx([4.998], abs=5e-4)
    assert values(LAYOUT, rows, "gyro")[0] == pytest.approx([1.0, -1.0, 0.0])
    assert values(LAYOUT, rows, "accel")[0] == pytest.approx([0.0, 0.0, -0.9999])
    assert values(LAYOUT, rows, "mag")[0] == pytest.approx([0.2, 0.0, -0.4])
    assert values(LAYOUT, rows, "temperature") == pytest.approx([20.1])
    assert values(LAYOUT, rows, "aux") == pytest.approx([0.0])


def test_the_sign_extended_form_of_the_same_acceleration():
    assert signed(0xBED4, 14).to_bytes(2, "big", signed=True) == bytes.fromhex("FED4")


def test_spi_frames_of_the_fact_sheet():
    assert write_frame(Register.SMPL_PRD, 5) == 0xB605
    assert read_frame(Register.GLOB_CMD) == 0x3E00
    assert write_frames(Register.SENS_AVG, sens_avg(4, 2)) == (0xB802, 0xB904)
    with pytest.raises(ValueError, match="address"):
        write_frame(0x80, 0)


def test_rates_of_the_fact_sheet():
    assert sample_rate_hz(0x01) == pytest.approx(819.2)
    assert sample_rate_hz(0x05) == pytest.approx(273.0667, abs=1e-4)
    assert 1.0 / sample_rate_hz(0x80) == pytest.approx(18.921e-3, abs=1e-6)
    assert 1.0 / sample_rate_hz(0x00) == pytest.approx(0.61035e-3, abs=1e-8)


def test_spi_clocks_of_the_fact_sheet():
    assert max_spi_hz(0x01, burst=False) == 2e6
    assert max_spi_hz(0x01, burst=True) == 1e6
    assert max_spi_hz(0x0A, burst=True) == max_spi_hz(0x81, burst=False) == 0.3e6


@pytest.mark.parametrize("m", range(7))
def test_the_averager_is_a_triangle_of_unit_area(m):
    weights = averager(m)
    taps = 2**m
    assert len(weights) == 2 * taps - 1
    assert weights.sum() == pytest.approx(1.0)
    assert weights == pytest.approx(weights[::-1])
    assert weights[taps - 1] == pytest.approx(1 / taps)
    # Two stages one after the other delay by one sample less than the taps of one.
    assert (weights * np.arange(len(weights))).sum() == pytest.approx(taps - 1)


def test_settings_that_there_are_not_are_refused():
    for range_bits, m in ((3, 0), (4, 7), (4, -1)):
        with pytest.raises(ValueError, match="SENS_AVG"):
            sens_avg(range_bits, m)


def test_every_value_with_every_flag_goes_both_ways():
    """All 16384 numbers of 14 bits and 4096 of 12, each with the four settings of ND and EA."""
    every = np.arange(1 << 14)
    columns = []
    for _, bits, is_signed in BURST:
        least = -(1 << bits >> 1) if is_signed else 0
        columns.append(every % (1 << bits) + least)
    table = np.column_stack(columns)
    for new, error in itertools.product((False, True), repeat=2):
        packed = pack_bursts(table, new, error)
        back = unpack_bursts(packed)
        assert np.array_equal(back.counts, table)
        assert (back.new == new).all()
        assert (back.error == error).all()
        words = np.frombuffer(packed, ">u2")
        assert (words >> 14 == 2 * new + error).all()
        # The layout reads the same numbers from the same bytes, and gives the bytes back.
        rows = rows_of(packed)
        read = np.column_stack([counts(LAYOUT, rows, name) for name in BURST_FIELDS])
        assert np.array_equal(read, table)
        assert (flag(LAYOUT, rows, "gyro", 15) == new).all()
        for name in BURST_FIELDS:
            assert (flag(LAYOUT, rows, name, 14) == error).all()
        sent = LAYOUT.decoder().feed(encode(LAYOUT, rows))[""].rows
        first = LAYOUT.dtype.fields["supply"][1]
        table_sent = sent.view(np.uint8).reshape(len(sent), -1)[:, first : first + BURST_BYTES]
        assert table_sent.tobytes() == packed


def test_every_word_of_sixteen_bits_survives():
    words = np.arange(1 << 16, dtype=">u2").repeat(12)
    burst = unpack_bursts(words.tobytes())
    # Bits 12 and 13 of the two words of 12 bits are not theirs and come back as zero.
    meant = words.reshape(-1, 12).copy()
    meant[:, 10:] &= 0xCFFF
    assert pack_bursts(burst.counts, burst.new, burst.error) == meant.tobytes()


@pytest.mark.parametrize(
    ("place", "count"), [(0, -1), (0, 1 << 14), (1, 8192), (9, -8193), (10, 2048), (11, 4096)]
)
def test_counts_that_do_not_fit_are_refused(place, count):
    table = [0] * 12
    table[place] = count
    with pytest.raises(ValueError, match=BURST[place][0].name):
        pack_bursts(table)


def test_part_of_a_burst_is_refused():
    with pytest.raises(ValueError, match="25 bytes"):
        unpack_bursts(EXAMPLE + b"\0")


@pytest.mark.parametrize("range_bits", GYRO_RANGE_DPS)
def test_the_range_scales_the_gyroscope(range_bits):
    rows = rows_of(EXAMPLE, range=range_bits)
    expected = 20 * GYRO_COUNT_DPS[range_bits]
    assert values(LAYOUT, rows, "gyro")[0] == pytest.approx([expected, -expected, 0.0])
    # Full scale is 6000 counts in each range.
    assert GYRO_RANGE_DPS[range_bits] / GYRO_COUNT_DPS[range_bits] == pytest.approx(6000)


def test_an_unknown_range_gives_no_rate_and_the_flags_beside_it_do_not_matter():
    rows = rows_of(EXAMPLE * 3, range=[0, 0x80 | 4, 0xE0 | 2])
    gyro = values(LAYOUT, rows, "gyro")
    assert np.isnan(gyro[0]).all()
    assert gyro[1:, 0] == pytest.approx([1.0, 0.5])


def test_the_frame_fits_its_line_and_the_full_rate_does_not():
    assert LAYOUT.rate_hz == pytest.approx(sample_rate_hz(0x01) / 3)
    bits_per_s = LAYOUT.length * 10 * LAYOUT.rate_hz
    assert bits_per_s == pytest.approx(98_304)
    assert bits_per_s < 115_200
    assert line_load(LAYOUT.length, LAYOUT.rate_hz) == pytest.approx(0.853, abs=1e-3)
    # The bare burst of every sample takes 196608 bit/s, and even 15 bytes are too many.
    assert line_load(BURST_BYTES, 819.2) * 115_200 == pytest.approx(196_608)
    assert line_load(LAYOUT.length, 819.2) > 1
    assert line_load(14, 819.2) < 1 < line_load(15, 819.2)
    assert line_load(42, LAYOUT.rate_hz) < 1 < line_load(43, LAYOUT.rate_hz)


def test_the_layout_names_the_faults_as_the_register_does():
    named = dict(LAYOUT.field("diag_stat").faults)
    assert named == {words: int(bit).bit_length() - 1 for bit, words in DIAG_WORDS.items()}
    assert {int(bit) for bit in DIAG_WORDS} == {int(bit) for bit in Diag}
    assert diag_names(0x0011) == ("supply below 4.75 V", "sensor over range")
    assert diag_names(0) == ()
    # Bit 7 means nothing.
    assert diag_names(0x0080) == ()


def test_its_header_is_nobody_elses():
    for name, protocol in builtin_protocols().items():
        for layout in protocol.streams.values():
            header = getattr(layout, "header", b"")
            assert name == LAYOUT.name or not header.startswith(LAYOUT.header[:2])


def test_only_bit_fifteen_is_new_data():
    """Linux takes bit 14 for both flags."""
    assert NEW_DATA == 0x8000
    only_error = (0x4000).to_bytes(2, "big") * 12
    burst = unpack_bursts(only_error)
    assert burst.error.all()
    assert not burst.new.any()


def test_the_frame_of_the_documentation():
    """The fact sheet's burst, in frame 7, after one second, at a pulse, range +-300 deg/s."""
    frame = bytes.fromhex("A55E 07 84 000F4240 0000") + EXAMPLE + bytes.fromhex("97C5")
    assert binascii.crc_hqx(frame[:-2], 0xFFFF) == 0x97C5
    decoder = LAYOUT.decoder()
    rows = decoder.feed(frame)[""].rows
    assert decoder.stats.good == 1
    assert rows["seq"] == 7
    assert counts(LAYOUT, rows, "range") == 4
    assert flag(LAYOUT, rows, "range", 7)
    assert counts(LAYOUT, rows, "time") * LAYOUT.clock_tick_s == pytest.approx([1.0])
    assert rows["diag_stat"] == 0
    assert values(LAYOUT, rows, "accel")[0] == pytest.approx([0.0, 0.0, -0.9999])
    assert encode(LAYOUT, rows) == frame
