"""The ADIS16405 on its SPI lines: what the fact sheet says each register and command does."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_protocols.adis16405 import (
    BURST_WORDS,
    ERROR,
    NEW_DATA,
    Command,
    Diag,
    Misc,
    Register,
    read_frame,
    sens_avg,
    signed,
    unpack_bursts,
    write_frames,
)
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.adis16405_chip import FEED_HZ, Adis16405Chip
from simulators.inertial_sensor import Readings

EXAMPLE = bytes.fromhex("8813 8014 BFEC 8000 8000 8000 BED4 8190 8000 BCE0 8FDD 8000")


def motion(number, *, gyro_dps=(0.0, 0.0, 0.0), accel_g=(0.0, 0.0, 0.0), mag_g=(0.0,) * 3, c=25.0):
    """What the sensors feel, alike for a number of samples or as (number, 3)."""
    return Readings(
        accel=np.broadcast_to(np.asarray(accel_g, float), (number, 3)) * STANDARD_GRAVITY,
        gyro=np.broadcast_to(np.asarray(gyro_dps, float), (number, 3)) * DEG,
        mag=np.broadcast_to(np.asarray(mag_g, float), (number, 3)) * 100.0,
        temperature=np.full(number, c),
        saturated=np.zeros(number, bool),
        offsets=np.zeros((number, 6)),
    )


def part(readings, start, stop):
    return Readings(**{name: column[start:stop] for name, column in vars(readings).items()})


def run(chip, readings):
    """Play a motion; return at which rows data were ready."""
    return [row for row, ready in enumerate(chip.play(readings)) if ready]


def read(chip, register):
    chip.transfer(read_frame(register))
    return chip.transfer(0)


def write(chip, register, value):
    for frame in write_frames(register, value):
        chip.transfer(frame)


def command(chip, bit):
    chip.transfer(0x8000 | Register.GLOB_CMD << 8 | int(bit))


def burst(chip):
    """Start a burst and clock out its words."""
    chip.transfer(0x3E00)
    return b"".join(chip.transfer(0).to_bytes(2, "big") for _ in range(BURST_WORDS))


def burst_counts(chip):
    return unpack_bursts(burst(chip)).counts[0]


def gyro_x(chip, rows):
    """X rate in counts at every row of a motion."""
    return [signed(read(chip, Register.XGYRO_OUT), 14) for _ in chip.play(rows)]


def awake(**attributes):
    chip = Adis16405Chip()
    for name, value in attributes.items():
        setattr(chip, name, value)
    return chip


def test_registers_begin_as_the_fact_sheet_says():
    chip = awake()
    expected = {
        Register.MSC_CTRL: 0x0006,
        Register.SMPL_PRD: 0x0001,
        Register.SENS_AVG: 0x0402,
        Register.SLP_CNT: 0,
        Register.DIAG_STAT: 0,
        Register.PRODUCT_ID: 0x4015,
        Register.XMAGN_SIF: 0x0800,
        Register.YMAGN_SIF: 0x0800,
        Register.ZMAGN_SIF: 0x0800,
        Register.XGYRO_OFF: 0,
        Register.ZACCL_OFF: 0,
        Register.YMAGN_HIF: 0,
    }
    assert {register: read(chip, register) for register in expected} == expected


def test_an_answer_comes_with_the_next_frame():
    chip = awake()
    answers = [chip.transfer(f) for f in (0x5600, 0x3400, 0x3800, 0x0000)]
    assert answers[1:] == [0x4015, 0x0006, 0x0402]


def test_the_burst_of_the_fact_sheet():
    chip = awake(supply_v=2067 * 2.418e-3)
    felt = motion(
        20, gyro_dps=(1.0, -1.0, 0.0), accel_g=(0, 0, -0.9999), mag_g=(0.2, 0, -0.4), c=20.1
    )
    run(chip, felt)
    assert burst(chip) == EXAMPLE
    # Read again before the next sample: the same numbers, no longer new.
    again = unpack_bursts(burst(chip))
    assert again.counts.tolist() == unpack_bursts(EXAMPLE).counts.tolist()
    assert not again.new.any()


def test_a_register_is_new_until_it_is_read():
    chip = awake()
    for row, _ in enumerate(chip.play(motion(2))):
        if row == 0:
            assert read(chip, Register.XGYRO_OUT) & NEW_DATA
            assert not read(chip, Register.XGYRO_OUT) & NEW_DATA
            assert read(chip, Register.YGYRO_OUT) & NEW_DATA
        else:
            assert read(chip, Register.XGYRO_OUT) & NEW_DATA


def test_a_write_changes_one_byte_and_outputs_cannot_be_written():
    chip = awake()
    chip.transfer(0xB605)
    assert read(chip, Register.SMPL_PRD) == 0x0005
    chip.transfer(0xB901)
    assert read(chip, Register.SENS_AVG) == 0x0102
    for register in (Register.XGYRO_OUT, Register.PRODUCT_ID, Register.DIAG_STAT):
        before = read(chip, register)
        write(chip, register, 0x1234)
        assert read(chip, register) == before


@pytest.mark.parametrize(
    ("smpl_prd", "rows_per_sample"),
    [(0x01, 1.0), (0x02, 1.5), (0x05, 3.0), (0x0B, 6.0), (0x7F, 64.0), (0x80, 15.5), (0x81, 31.0)],
)
def test_samples_come_at_the_rate_of_smpl_prd(smpl_prd, rows_per_sample):
    chip = awake()
    write(chip, Register.SMPL_PRD, smpl_prd)
    ready = run(chip, motion(5000))
    assert len(ready) == pytest.approx(5000 / rows_per_sample, abs=1)
    assert set(np.diff(ready)) <= {int(rows_per_sample), int(np.ceil(rows_per_sample))}


@pytest.mark.parametrize("m", [0, 1, 2, 4, 6])
def test_the_averager_spreads_and_delays_as_told(m):
    """A pulse of one sample comes out as a triangle, (2 N + 1) / 2 samples after its middle."""
    chip = awake()
    write(chip, Register.SENS_AVG, sens_avg(4, m))
    taps = 2**m
    size = 0.05 * taps**2
    pulse = np.zeros((300, 3))
    pulse[50, 0] = size
    seen = np.array(gyro_x(chip, motion(300, gyro_dps=pulse)))
    triangle = [*range(1, taps + 1), *range(taps - 1, 0, -1)]
    first = int(np.flatnonzero(seen)[0])
    assert seen[first : first + len(triangle)].tolist() == triangle
    assert seen.sum() == taps**2
    # The sample of row 50 is the mean of what came before it: its middle is half a row earlier.
    delay = (seen * np.arange(300)).sum() / seen.sum() - (50 - 0.5)
    assert delay == pytest.approx((2 * taps + 1) / 2)


def test_the_delay_of_the_usual_filter_is_five_and_a_half_milliseconds():
    delay_s = (2 * 4 + 1) / 2 / FEED_HZ
    assert delay_s == pytest.approx(5.5e-3, abs=0.05e-3)


def test_the_averager_takes_the_noise_that_a_triangle_takes():
    rng = np.random.default_rng(1)
    chip = awake()
    felt = motion(40_000, gyro_dps=rng.normal(0.0, 10.0, (40_000, 3)))
    seen = np.array(gyro_x(chip, felt)) * 0.05
    expected = 10.0 * np.sqrt((2 * 4**2 + 1) / (3 * 4**3))
    assert seen.std() == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(
    ("bits", "full", "count"), [(4, 300, 0.05), (2, 150, 0.025), (1, 75, 0.0125)]
)
def test_ranges_scale_flag_and_clip(bits, full, count):
    for dps, over in ((0.9 * full, False), (-0.99 * full, False), (1.02 * full, True)):
        chip = awake()
        write(chip, Register.SENS_AVG, sens_avg(bits, 0))
        run(chip, motion(5, gyro_dps=(dps, 0.0, 0.0)))
        assert burst_counts(chip)[1] == pytest.approx(dps / count, abs=0.51)
        assert bool(read(chip, Register.DIAG_STAT) & Diag.OVER_RANGE) == over
    chip = awake()
    write(chip, Register.SENS_AVG, sens_avg(bits, 0))
    run(chip, motion(5, gyro_dps=(9999.0, -9999.0, 0.0)))
    assert burst_counts(chip)[1:3].tolist() == [8191, -8192]


def test_acceleration_and_field_have_their_ranges():
    chip = awake()
    run(chip, motion(20, accel_g=(17.9, 0, 0), mag_g=(2.4, 0, 0)))
    assert read(chip, Register.DIAG_STAT) == 0
    run(chip, motion(20, accel_g=(0, -18.2, 0)))
    assert read(chip, Register.DIAG_STAT) == Diag.OVER_RANGE
    chip = awake()
    run(chip, motion(20, accel_g=(0, 40, 0), mag_g=(0, 0, -9)))
    assert burst_counts(chip)[[5, 9]].tolist() == [8191, -8192]


def test_offsets_are_added_to_the_outputs():
    chip = awake()
    write(chip, Register.XGYRO_OFF, 80)  # 1 deg/s
    write(chip, Register.YGYRO_OFF, 0x1FB0)  # -80 in 13 bits
    write(chip, Register.ZGYRO_OFF, 0x0FFF)  # 51.2 deg/s, negative if only 12 bits counted
    write(chip, Register.XACCL_OFF, 300)
    write(chip, Register.ZACCL_OFF, 0xFFF & -300)
    write(chip, Register.YMAGN_HIF, 0x3FB9)  # -71
    run(chip, motion(20))
    counts = burst_counts(chip)
    assert counts[1:10].tolist() == [20, -20, 1024, 300, 0, -300, 0, -71, 0]


def test_a_soft_iron_factor_multiplies():
    chip = awake()
    write(chip, Register.XMAGN_SIF, 0x0400)
    write(chip, Register.YMAGN_SIF, 0x0FFF)
    run(chip, motion(20, mag_g=(0.5, 0.5, 0.5)))
    assert burst_counts(chip)[7:10].tolist() == [500, 2000, 1000]


def test_supply_and_auxiliary_input_are_measured():
    chip = awake(supply_v=4.7, aux_v=1.0)
    run(chip, motion(1))
    counts = burst_counts(chip)
    assert counts[0] * 2.418e-3 == pytest.approx(4.7, abs=2e-3)
    assert counts[11] * 0.806e-3 == pytest.approx(1.0, abs=1e-3)


def test_a_lasting_fault_comes_back_after_each_read():
    chip = awake(supply_v=4.6)
    for _ in chip.play(motion(3)):
        words = np.frombuffer(burst(chip), ">u2")
        assert (words & ERROR).all()
        assert read(chip, Register.DIAG_STAT) == Diag.SUPPLY_LOW
        assert read(chip, Register.DIAG_STAT) == 0
    chip.supply_v = 5.0
    run(chip, motion(2))
    assert not (np.frombuffer(burst(chip), ">u2") & ERROR).any()
    chip.supply_v = 5.4
    run(chip, motion(2))
    assert read(chip, Register.DIAG_STAT) == Diag.SUPPLY_HIGH


def test_a_frame_of_wrong_length_is_an_error_and_ends_a_burst():
    chip = awake()
    run(chip, motion(2))
    chip.transfer(0x3E00)
    chip.transfer(0)
    chip.transfer(0, clocks=15)
    assert chip.transfer(read_frame(Register.DIAG_STAT)) == 0
    assert chip.transfer(0) == Diag.SPI
    assert read(chip, Register.DIAG_STAT) == 0


def test_too_fast_a_clock_is_an_error():
    chip = awake(spi_hz=2e6)
    assert read(chip, Register.PRODUCT_ID) == 0x4015
    assert read(chip, Register.DIAG_STAT) == 0
    chip.transfer(0x3E00)
    chip.transfer(0)
    chip.spi_hz = 0.3e6
    assert read(chip, Register.DIAG_STAT) == Diag.SPI


def test_the_internal_self_test_takes_its_time_and_names_what_fails():
    chip = awake(failing=Diag.X_GYRO | Diag.Z_ACCEL)
    write(chip, Register.MSC_CTRL, 0x0006 | Misc.INTERNAL_SELF_TEST)
    run(chip, motion(8))
    assert read(chip, Register.MSC_CTRL) & Misc.INTERNAL_SELF_TEST
    run(chip, motion(4))
    assert read(chip, Register.MSC_CTRL) == 0x0006
    assert read(chip, Register.DIAG_STAT) == 1 << 5 | 1 << 12 | 1 << 15
    sound = awake()
    write(sound, Register.MSC_CTRL, 0x0006 | Misc.INTERNAL_SELF_TEST)
    run(sound, motion(12))
    assert read(sound, Register.DIAG_STAT) == 0


def test_the_memory_test_tells_of_changed_flash():
    for corrupt in (False, True):
        chip = awake(flash_corrupt=corrupt)
        write(chip, Register.MSC_CTRL, 0x0006 | Misc.MEMORY_TEST)
        run(chip, motion(12))
        assert read(chip, Register.DIAG_STAT) == (Diag.FLASH_CHECKSUM if corrupt else 0)


def test_a_self_test_by_hand_turns_the_sensors_either_way():
    chip = awake()
    run(chip, motion(20))
    write(chip, Register.MSC_CTRL, 0x0006 | Misc.POSITIVE_SELF_TEST)
    run(chip, motion(20))
    up = burst_counts(chip)[1:10]
    write(chip, Register.MSC_CTRL, 0x0006 | Misc.NEGATIVE_SELF_TEST)
    run(chip, motion(20))
    down = burst_counts(chip)[1:10]
    assert (up[:6] > 0).all()
    assert down.tolist() == (-up).tolist()
    write(chip, Register.MSC_CTRL, 0x0006)
    run(chip, motion(20))
    assert not burst_counts(chip)[1:10].any()


def test_autonull_makes_zero_of_what_it_sees():
    chip = awake()
    felt = motion(20, gyro_dps=(2.0, -3.0, 0.1))
    run(chip, felt)
    command(chip, Command.AUTONULL)
    run(chip, felt)
    assert burst_counts(chip)[1:4].tolist() == [0, 0, 0]
    assert signed(read(chip, Register.XGYRO_OFF), 13) == -160
    assert signed(read(chip, Register.YGYRO_OFF), 13) == 240


def test_the_precise_autonull_averages_for_half_a_minute():
    rng = np.random.default_rng(2)
    number = round(31 * FEED_HZ)
    felt = motion(number, gyro_dps=rng.normal((1.0, -2.0, 0.0), 0.5, (number, 3)))
    chip = awake()
    command(chip, Command.PRECISION_AUTONULL)
    run(chip, part(felt, 0, round(29 * FEED_HZ)))
    assert read(chip, Register.XGYRO_OFF) == 0
    run(chip, part(felt, round(29 * FEED_HZ), number))
    assert signed(read(chip, Register.XGYRO_OFF), 13) == pytest.approx(-80, abs=1)
    assert signed(read(chip, Register.YGYRO_OFF), 13) == pytest.approx(160, abs=1)


def test_a_factory_restore_forgets_offsets_and_keeps_the_rest():
    chip = awake()
    write(chip, Register.XGYRO_OFF, 5)
    write(chip, Register.XMAGN_SIF, 0x0700)
    write(chip, Register.SENS_AVG, sens_avg(2, 3))
    command(chip, Command.FACTORY_RESTORE)
    assert read(chip, Register.XGYRO_OFF) == 0
    assert read(chip, Register.XMAGN_SIF) == 0x0800
    assert read(chip, Register.SENS_AVG) == 0x0203


def test_only_what_was_written_to_flash_survives_a_reset():
    chip = awake()
    write(chip, Register.XGYRO_OFF, 5)
    command(chip, Command.FLASH_UPDATE)
    run(chip, motion(60))
    write(chip, Register.YGYRO_OFF, 6)
    command(chip, Command.SOFTWARE_RESET)
    run(chip, motion(200))
    assert read(chip, Register.XGYRO_OFF) == 5
    assert read(chip, Register.YGYRO_OFF) == 0
    assert read(chip, Register.FLASH_CNT) == 1


def test_a_flash_update_that_fails_says_so_and_keeps_nothing():
    chip = awake(flash_broken=True)
    write(chip, Register.XGYRO_OFF, 5)
    command(chip, Command.FLASH_UPDATE)
    run(chip, motion(60))
    assert read(chip, Register.DIAG_STAT) == Diag.FLASH_UPDATE
    command(chip, Command.SOFTWARE_RESET)
    run(chip, motion(200))
    assert read(chip, Register.XGYRO_OFF) == 0


def test_a_reset_is_silent_for_its_time():
    chip = awake()
    run(chip, motion(5))
    command(chip, Command.SOFTWARE_RESET)
    assert read(chip, Register.PRODUCT_ID) == 0
    ready = run(chip, motion(300))
    assert ready[0] / FEED_HZ == pytest.approx(0.17, abs=0.002)
    assert ready == list(range(ready[0], 300))
    assert read(chip, Register.PRODUCT_ID) == 0x4015


def test_sleep_lasts_as_long_as_told_or_until_the_reset_line():
    chip = awake()
    write(chip, Register.SLP_CNT, 2)
    ready = run(chip, motion(1000))
    assert ready[0] / FEED_HZ == pytest.approx(1.0, abs=0.002)
    chip.transfer(0x8000 | (Register.SLP_CNT + 1) << 8 | 0x01)
    assert not run(chip, motion(3000))
    chip.reset()
    assert run(chip, motion(200))


def test_without_the_data_ready_line_samples_still_come():
    chip = awake()
    write(chip, Register.MSC_CTRL, 0)
    assert not run(chip, motion(5))
    assert read(chip, Register.XGYRO_OUT) & NEW_DATA


def test_a_chip_that_is_not_connected_is_silent():
    chip = awake(connected=False)
    assert not run(chip, motion(5))
    assert read(chip, Register.PRODUCT_ID) == 0
    assert burst(chip) == bytes(24)


def test_alarms_watch_a_word_from_either_side():
    chip = awake()
    write(chip, Register.ALM_MAG1, 0x8000 | 1000)  # above 50 deg/s
    write(chip, Register.ALM_MAG2, 0x3FFF & -300)  # below -1 g
    write(chip, Register.ALM_CTRL, 7 << 12 | 2 << 8)  # z accelerometer, x gyroscope
    run(chip, motion(20, gyro_dps=(49.0, 0, 0), accel_g=(0, 0, -0.9)))
    assert read(chip, Register.DIAG_STAT) == 0
    run(chip, motion(20, gyro_dps=(51.0, 0, 0), accel_g=(0, 0, -0.9)))
    assert read(chip, Register.DIAG_STAT) == Diag.ALARM_1
    run(chip, motion(20, accel_g=(0, 0, -1.1)))
    read(chip, Register.DIAG_STAT)
    run(chip, motion(20, accel_g=(0, 0, -1.1)))
    assert read(chip, Register.DIAG_STAT) == Diag.ALARM_2


@pytest.mark.parametrize("seed", range(4))
def test_how_a_motion_is_cut_changes_nothing(seed):
    """Also with settings that change at any sample, and while the averager fills."""
    rng = np.random.default_rng(seed)
    number = 600
    felt = replace(
        motion(
            number, gyro_dps=rng.normal(0, 100, (number, 3)), accel_g=rng.normal(0, 5, (number, 3))
        ),
        temperature=rng.uniform(0, 50, number),
    )
    script = {
        40: (Register.SENS_AVG, sens_avg(2, 4)),
        170: (Register.SMPL_PRD, 0x05),
        230: (Register.MSC_CTRL, 0x0106),
        300: (Register.SMPL_PRD, 0x01),
        301: (Register.XGYRO_OFF, 77),
        340: (Register.GLOB_CMD, int(Command.SOFTWARE_RESET)),
        520: (Register.SMPL_PRD, 0x02),
    }

    def bursts(edges):
        chip, row, seen = awake(), 0, []
        for start, stop in zip([0, *edges], [*edges, number], strict=True):
            for ready in chip.play(part(felt, start, stop)):
                if row in script:
                    write(chip, *script[row])
                seen.append((ready, burst(chip)))
                row += 1
        return seen

    whole = bursts([])
    assert len({data for _, data in whole}) > 250
    assert bursts(sorted(rng.choice(np.arange(1, number), 9, replace=False).tolist())) == whole
    assert bursts(list(range(1, number))) == whole
