"""The forwarder: frames that a layout reads, the sync pulse, ranges, and faults by their names."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocols.adis16405 import GYRO_RANGE_DPS, Command, Diag, Register, unpack_bursts
from firmware_protocols.layout import load_layout
from firmware_protocols.packets import counts, flag, values
from imu_rig.imu_scaling import field_values
from imu_rig.row_faults import faults_of
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.adis16405 import ADIS16405, EVERY, Adis16405Forwarder
from simulators.adis16405_chip import FEED_HZ
from simulators.encoders import MadeSamples
from simulators.inertial_sensor import InertialSensor, Readings
from simulators.sampling import Means

LAYOUT = load_layout("adis16405-36")
NOT_NEW = "sensor gives no new data"
NO_ANSWER = "sensor does not answer"
EA = "error flag (EA) set"


def at_rest(number, *, gyro_dps=(0.0, 0.0, 0.0), accel_g=(0.0, 0.0, 1.0), mag_g=(0.2, 0.0, -0.4)):
    return Readings(
        accel=np.tile(np.asarray(accel_g, float), (number, 1)) * STANDARD_GRAVITY,
        gyro=np.tile(np.asarray(gyro_dps, float), (number, 1)) * DEG,
        mag=np.tile(np.asarray(mag_g, float), (number, 1)) * 100.0,
        temperature=np.full(number, 25.0),
        saturated=np.zeros(number, bool),
        offsets=np.zeros((number, 6)),
    )


def samples(readings, first=0, clock_s=0.0):
    number = len(readings)
    index = first + np.arange(number)
    t = (index + 1) / FEED_HZ
    return MadeSamples(
        t=t,
        device_s=clock_s + t,
        counter=index,
        readings=readings,
        pressure=np.full(number, 101_325.0),
        air_c=np.full(number, 20.0),
    )


def decode(frames):
    data = b"".join(frames)
    decoder = LAYOUT.decoder()
    rows = decoder.feed(data)[""].rows
    assert decoder.stats.corrupt == decoder.stats.skipped_bytes == decoder.pending == 0
    return rows


def started(**options):
    forwarder = Adis16405Forwarder(**options)
    assert forwarder.boot(0.0) == b""
    return forwarder


def told(forwarder, number=300, first=10_000, **motion):
    """Faults that the frames of a motion tell of."""
    return set(
        faults_of(LAYOUT, decode(forwarder.encode(samples(at_rest(number, **motion), first))))
    )


def test_every_third_sample_is_forwarded_with_counter_and_time():
    forwarder = started()
    frames = forwarder.encode(samples(at_rest(3000)))
    assert [bool(frame) for frame in frames] == [row % EVERY == EVERY - 1 for row in range(3000)]
    assert {len(frame) for frame in frames if frame} == {36}
    rows = decode(frames)
    assert np.array_equal(rows["seq"], np.arange(1000) % 256)
    # The clock reads half a millisecond more than the end of the interval: the analog filters.
    expected_us = (np.arange(1000) + 1) * 3 / 819.2 * 1e6 + 500
    assert np.abs(rows["time"] - expected_us).max() <= 0.5
    rate = 1e6 / np.diff(rows["time"].astype(float)).mean()
    assert rate == pytest.approx(273.0667, abs=1e-3)
    assert faults_of(LAYOUT, rows) == {}
    assert flag(LAYOUT, rows, "gyro", 15).all()


def test_frames_hold_what_the_sensor_felt():
    frames = started().encode(
        samples(at_rest(60, gyro_dps=(10, -20, 30), accel_g=(0.1, -0.2, 1.0)))
    )
    row = decode(frames)[-1:]
    assert values(LAYOUT, row, "gyro")[0] == pytest.approx([10, -20, 30], abs=0.025)
    assert values(LAYOUT, row, "accel")[0] == pytest.approx([0.1, -0.2, 1.0], abs=1.7e-3)
    assert values(LAYOUT, row, "mag")[0] == pytest.approx([0.2, 0.0, -0.4], abs=2.6e-4)
    assert values(LAYOUT, row, "temperature") == pytest.approx([25.0], abs=0.07)
    assert values(LAYOUT, row, "supply") == pytest.approx([5.0], abs=1.3e-3)
    assert counts(LAYOUT, row, "range") == [4]


def test_the_words_on_the_wire_are_those_of_the_sensor():
    frame = started().encode(samples(at_rest(6)))[-1]
    burst = unpack_bursts(frame[10:34])
    assert burst.counts[0].tolist() == [2068, 0, 0, 0, 0, 0, 300, 400, 0, -800, 0, 0]
    assert burst.new.all()
    assert not burst.error.any()


def test_two_sync_pulses_each_second_for_ever():
    forwarder = started()
    clock_s = 2**32 * 1e-6 - 7.3  # the clock of 32 bits comes round on the way
    number = round(20 * FEED_HZ)
    rows = decode(forwarder.encode(samples(at_rest(number), clock_s=clock_s)))
    pulses = field_values(LAYOUT, rows)[0]["sync_pulse"] == 1.0
    assert np.count_nonzero(pulses) == 40
    at_us = np.unwrap(rows["time"].astype(float), period=2.0**32)[pulses]
    frame_us = 1e6 / LAYOUT.rate_hz
    # Each pulse is told of by the first frame after it, so never early and never a frame late.
    late_us = at_us % 500_000
    assert late_us.max() < frame_us + 1
    assert np.diff(at_us).mean() == pytest.approx(500_000, abs=100)


@pytest.mark.parametrize(("gyro_range", "full"), GYRO_RANGE_DPS.items())
def test_the_range_is_that_of_the_sensor(gyro_range, full):
    forwarder = started(gyro_range=gyro_range)
    rows = decode(forwarder.encode(samples(at_rest(60, gyro_dps=(0.9 * full, 1.0, 0.0)))))
    assert (counts(LAYOUT, rows, "range") == gyro_range).all()
    half_count = full / 6000 / 2
    assert values(LAYOUT, rows, "gyro")[-1] == pytest.approx([0.9 * full, 1.0, 0], abs=half_count)
    assert EA in told(forwarder, gyro_dps=(1.1 * full, 0, 0))


def test_diag_stat_is_asked_for_only_when_the_words_say_so(monkeypatch):
    """A burst takes 13 frames on SPI, and DIAG_STAT two more."""
    forwarder = started()
    told(forwarder)
    sent = []
    transfer = forwarder.chip.transfer
    monkeypatch.setattr(
        forwarder.chip, "transfer", lambda word: sent.append(word) or transfer(word)
    )
    told(forwarder, number=EVERY)
    assert sent == [0x3E00] + [0] * 12
    forwarder.chip.supply_v = 4.6
    sent.clear()
    told(forwarder, number=EVERY)
    assert sent == [0x3E00] + [0] * 12 + [0x3C00, 0]


def test_a_still_sensor_in_order_has_no_faults():
    assert told(started()) == set()


def test_over_range_is_named_while_it_lasts():
    forwarder = started()
    assert told(forwarder, gyro_dps=(350.0, 0, 0)) == {"sensor over range", EA}
    assert told(forwarder, number=30) == {"sensor over range", EA}  # the averager runs out
    assert told(forwarder) == set()
    assert told(forwarder, accel_g=(0, 0, 19.0)) == {"sensor over range", EA}


def test_a_supply_that_sags_or_rises_is_named():
    forwarder = started()
    forwarder.chip.supply_v = 4.6
    assert told(forwarder) == {"supply below 4.75 V", EA}
    forwarder.chip.supply_v = 5.4
    assert told(forwarder) == {"supply above 5.25 V", EA}


def test_what_fails_a_self_test_is_named():
    forwarder = started()
    told(forwarder)
    forwarder.chip.failing = Diag.Y_GYRO | Diag.X_ACCEL
    forwarder.chip.transfer(0x8000 | (Register.MSC_CTRL + 1) << 8 | 0x04)
    assert told(forwarder) == {
        "self-test failed",
        "self-test failed: gyroscope y",
        "self-test failed: accelerometer x",
        EA,
    }
    assert told(forwarder) == set()


@pytest.mark.parametrize(
    ("upset", "name"),
    [
        (lambda chip: chip.transfer(0, clocks=9), "SPI transfer of wrong length"),
        (lambda chip: _command(chip, Command.FLASH_UPDATE), "flash update failed"),
        (lambda chip: chip.transfer(0x8000 | 0x35 << 8 | 0x08), "flash checksum wrong"),
        (lambda chip: _alarm(chip, Register.ALM_MAG1, 0x0100), "alarm 1"),
        (lambda chip: _alarm(chip, Register.ALM_MAG2, 0x1000), "alarm 2"),
    ],
)
def test_other_bits_of_diag_stat_are_named(upset: Callable[[Any], None], name):
    forwarder = started()
    told(forwarder)
    forwarder.chip.flash_broken = forwarder.chip.flash_corrupt = True
    upset(forwarder.chip)
    assert told(forwarder) >= {name, EA}


def _command(chip, bit):
    chip.transfer(0x8000 | Register.GLOB_CMD << 8 | int(bit))


def _alarm(chip, register, source):
    """Let the supply's being above 0 be an alarm."""
    chip.transfer(0x8000 | (register + 1) << 8 | 0x80)
    chip.transfer(0x8000 | (Register.ALM_CTRL + 1) << 8 | source >> 8)


def test_an_error_flag_without_a_reason_is_named_all_the_same():
    frame = bytearray(started().encode(samples(at_rest(6)))[-1])
    from firmware_protocols.checksums import checksum

    for place in range(10, 34, 2):
        frame[place] |= 0x40
    frame[-2:] = checksum("crc16-ccitt-false", bytes(frame[:-2])).to_bytes(2, "big")
    rows = decode([bytes(frame)])
    assert rows["diag_stat"] == 0
    assert set(faults_of(LAYOUT, rows)) == {EA}


def test_a_sensor_that_sleeps_gives_no_new_data_and_says_so():
    forwarder = started()
    told(forwarder)
    forwarder.chip.transfer(0x8000 | (Register.SLP_CNT + 1) << 8 | 0x01)
    frames = forwarder.encode(samples(at_rest(900)))
    assert 90 <= sum(map(bool, frames)) <= 101
    rows = decode(frames)
    assert set(faults_of(LAYOUT, rows)) == {NOT_NEW, NO_ANSWER}
    assert not flag(LAYOUT, rows, "gyro", 15).any()


def test_a_sensor_that_falls_off_and_comes_back_is_set_up_again():
    forwarder = started(gyro_range=2)
    told(forwarder)
    forwarder.chip.connected = False
    assert told(forwarder) == {NOT_NEW, NO_ANSWER}
    forwarder.chip.reset()  # as it does when its supply returns
    forwarder.chip.connected = True
    told(forwarder)
    rows = decode(forwarder.encode(samples(at_rest(90, gyro_dps=(100.0, 0, 0)))))
    assert faults_of(LAYOUT, rows) == {}
    assert (counts(LAYOUT, rows, "range") == 2).all()
    assert values(LAYOUT, rows, "gyro")[-1, 0] == pytest.approx(100.0, abs=0.02)


def test_after_power_up_frames_begin_when_the_sensor_does():
    forwarder = started()
    forwarder.encode(samples(at_rest(300)))
    forwarder.boot(3.0)
    frames = forwarder.encode(samples(at_rest(300)))
    first = next(row for row, frame in enumerate(frames) if frame)
    assert (first + 1) / FEED_HZ == pytest.approx(0.17 + 2 / FEED_HZ, abs=0.002)
    rows = decode(frames)
    assert rows["seq"][0] == 0
    assert faults_of(LAYOUT, rows) == {}


def test_a_sensor_that_never_starts_is_told_of():
    forwarder = started()
    forwarder.chip.connected = False
    assert told(forwarder) == {NOT_NEW, NO_ANSWER}


def test_the_host_is_not_heard():
    forwarder = started()
    assert forwarder.receive(b"anything", 1.0) == b""


@pytest.mark.parametrize("seed", range(2))
def test_how_samples_are_cut_into_calls_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    number = 900
    readings = at_rest(number)
    readings.gyro[:] = rng.normal(0, 6.0, (number, 3))
    readings.accel[:] = rng.normal(0, 60.0, (number, 3))  # over range now and then
    whole = started().encode(samples(readings))
    assert 0 < sum(1 for frame in whole if frame and frame[9]) < 300
    for edges in (np.arange(1, number), np.sort(rng.choice(number, 12, replace=False))):
        forwarder, frames = started(), []
        for part in np.split(np.arange(number), edges):
            cut = Readings(**{name: column[part] for name, column in vars(readings).items()})
            frames += forwarder.encode(samples(cut, int(part[0]) if len(part) else 0))
        assert frames == whole


def standing(number, rng, **changes):
    """What this kind of sensor reads at rest, one g along z, not rounded yet."""
    model = ADIS16405.sensor.model_copy(
        update={
            "accel_gain": np.eye(3).tolist(),
            "gyro_gain": np.eye(3).tolist(),
            "mag_gain": np.eye(3).tolist(),
            "accel_offset": (0.0,) * 3,
            "gyro_offset": (0.0,) * 3,
            "mag_offset": (0.0,) * 3,
            "accel_walk_mg": 0.0,
            "gyro_walk_dps": 0.0,
            "warm_up_c": 0.0,
            **changes,
        }
    )
    sensor = InertialSensor(model, ADIS16405.sensor_ranges, rng)
    means = Means(
        t=(np.arange(number) + 1) / FEED_HZ,
        duration=np.full(number, 1 / FEED_HZ),
        force=np.tile((0.0, 0.0, STANDARD_GRAVITY), (number, 1)),
        rate=np.zeros((number, 3)),
        field=np.tile((20.0, 0.0, -40.0), (number, 1)),
    )
    return sensor.read(means, None)


def allan(x, tau, rate):
    per = round(tau * rate)
    means = x[: len(x) // per * per].reshape(-1, per, x.shape[1]).mean(axis=1)
    return np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2, axis=0))


def test_noise_at_rest_is_that_of_the_data_sheet():
    """Densities [one-sided] by the Allan deviation, d / sqrt(2 tau), and the spread of samples."""
    rng = np.random.default_rng(5)
    rows = decode(started().encode(samples(standing(round(120 * FEED_HZ), rng))))[100:]
    data = {name: values(LAYOUT, rows, name) for name in ("gyro", "accel", "mag")}
    density = {"gyro": 0.05, "accel": 0.5e-3, "mag": 0.066e-3}
    count = {"gyro": 0.05, "accel": 3.333e-3, "mag": 0.5e-3}
    averaged = np.sqrt((2 * 4**2 + 1) / (3 * 4**3))
    for name, x in data.items():
        white = density[name] * np.sqrt(FEED_HZ / 2) * averaged
        expected = np.hypot(white, count[name] / np.sqrt(12))
        assert x.std(axis=0) == pytest.approx(expected, rel=0.1), name
        for tau in (0.1, 0.3, 1.0):
            of_density = density[name] / np.sqrt(2 * tau)
            assert allan(x, tau, LAYOUT.rate_hz).mean() == pytest.approx(of_density, rel=0.1), name
    # As the published record of this sensor at rest: about 0.49 deg/s, 1.5 mgauss at most.
    assert 0.35 < data["gyro"].std() < 0.6
    assert data["mag"][:, 0].std() < 1.5e-3


def test_means_at_rest_are_true_through_the_rounding():
    """The noise is more than a count, so the mean of many samples is far better than one count."""
    rng = np.random.default_rng(6)
    rows = decode(started().encode(samples(standing(round(30 * FEED_HZ), rng))))[100:]
    assert values(LAYOUT, rows, "accel").mean(axis=0) == pytest.approx([0, 0, 1], abs=0.4e-3)
    assert values(LAYOUT, rows, "gyro").mean(axis=0) == pytest.approx(np.zeros(3), abs=0.03)


def test_without_noise_the_rounding_stays():
    rng = np.random.default_rng(7)
    quiet = {"accel_noise_ug": 0.0, "gyro_noise_dps": 0.0, "mag_noise_ut": 0.0}
    tilted = standing(900, rng, **quiet)
    tilted.accel[:, 0] = 0.010 * STANDARD_GRAVITY
    rows = decode(started().encode(samples(tilted)))[5:]
    assert set(counts(LAYOUT, rows, "accel")[:, 0].tolist()) == {3}  # 9.999 mg
    assert values(LAYOUT, rows, "accel")[0, 0] == pytest.approx(0.009999)
