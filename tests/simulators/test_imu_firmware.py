"""Packets of the simulated sensor: counter, clock, bursts, and any layout."""

import numpy as np
import pytest

from firmware_protocols.packets import values
from simulators.config import RigConfig
from simulators.encoders import STATUS_SATURATED
from simulators.models import FirmwareModel

IDEAL = RigConfig.ideal()


def with_firmware(config: RigConfig = IDEAL, **changes) -> RigConfig:
    return config.model_copy(update={"firmware": config.firmware.model_copy(update=changes)})


def test_ten_seconds_are_a_thousand_packets_in_order(talk):
    host = talk(IDEAL)
    rows = host.run(10.0)
    assert len(rows) == 1000
    assert host.decoder.stats.lost == host.decoder.stats.corrupt == 0
    assert (np.diff(rows["seq"].astype(int)) % 256 == 1).all()
    assert (np.diff(rows["time"].astype(int)) == 10_000).all()
    assert rows["time"][0] == 10_000
    assert not rows["status"].any()


def test_the_device_clock_runs_fast_and_wraps(talk):
    """A clock that is 3 % fast makes 3 % more samples."""
    wrap_s = 2**32 * 1e-6
    host = talk(with_firmware(skew_ppm=30_000.0, clock_offset_s=wrap_s - 1.0, burst_s=(0.1, 0.1)))
    rows = host.run(10.0)
    assert len(rows) == 1030
    time = rows["time"].astype(np.int64)
    assert (np.diff(time) % 2**32 == 10_000).all()
    assert time[0] == 2**32 - 1_000_000 + 10_000
    assert time[-1] == 1029 * 10_000 + 10_000 - 1_000_000


def test_samples_are_of_the_moment_that_the_skewed_clock_says(talk, exact):
    """A servo starts at a known time; the first packet that sees it tells the device's skew."""
    from firmware_protocols.maestro import SetTarget

    onsets = []
    for skew_ppm in (0.0, 50_000.0):
        host = talk(with_firmware(exact, skew_ppm=skew_ppm))
        host.send(SetTarget(2, 6000))
        host.run(4.0)
        host.send(SetTarget(2, 6600))
        rows = host.run(1.0)
        onset = np.flatnonzero(np.abs(host.gyro(rows)[:, 0]) > 1e-6)[0]
        onsets.append(values(host.layout, rows, "time")[onset] * 1e-6)
    assert onsets[0] == pytest.approx(4.01, abs=0.011)
    assert onsets[1] - onsets[0] == pytest.approx(4.01 * 0.05, abs=0.02)


def test_the_radio_delivers_in_bursts_and_late(talk):
    host = talk(with_firmware(burst_s=(0.02, 0.1), latency_s=0.004))
    sizes, gaps, last = [], [], 0.0
    for step in range(1, 20_000):
        host.world.advance(step * 0.001)
        data = host.world.take("imu")
        if data:
            packets = host.decoder.feed(data)
            newest = packets.rows["time"][-1] * 1e-6
            assert host.world.t_s - newest >= 0.004 - 1e-9
            assert host.world.t_s - packets.rows["time"][0] * 1e-6 <= 0.1 + 0.004 + 0.002
            sizes.append(len(packets))
            gaps.append(host.world.t_s - last)
            last = host.world.t_s
    assert min(sizes) == 1 or min(sizes) == 2
    assert 8 <= max(sizes) <= 11
    assert np.mean(gaps) == pytest.approx(0.06, rel=0.1)


def test_a_saturated_axis_sets_its_status_bit(talk):
    sensor = IDEAL.sensor.model_copy(update={"accel_offset": (80.0, 0.0, 0.0)})
    rows = talk(IDEAL.model_copy(update={"sensor": sensor})).run(0.1)
    assert (rows["accel"][:, 0] == 32767).all()
    assert (rows["status"] == STATUS_SATURATED).all()


def test_another_layout_and_rate_carry_the_same_motion(talk, exact):
    host = talk(with_firmware(exact, rate_hz=250.0))
    rows = host.run(1.0)
    assert len(rows) == 250
    assert host.accel(rows)[10] == pytest.approx([0.0, 0.0, exact.gravity])
    assert host.mag(rows)[10] == pytest.approx(exact.field_ut)
    assert values(host.layout, rows, "temperature")[10] == pytest.approx(25.0)
    assert np.diff(rows["time"].astype(int)) == pytest.approx(4000)


def test_the_magnetometer_speaks_on_its_own_axes(talk):
    host = talk(IDEAL.model_copy(update={"field_ut": (30.0, 60.0, -90.0)}))
    rows = host.run(0.1)
    assert rows["mag"][0].tolist() == [200, 100, 300]
    assert host.mag(rows)[0] == pytest.approx([30.0, 60.0, -90.0])


def test_a_layout_without_clock_counter_and_with_foreign_fields_is_served(talk, tmp_path):
    path = tmp_path / "bare.toml"
    path.write_text(
        'name = "bare"\ntitle = ""\nbyte_order = "big"\nheader = "55"\n'
        '[[fields]]\nname = "accel"\ntype = "i16"\ncount = 3\nunit = "m/s2"\n'
        "counts_per_unit = 100\n"
        '[[fields]]\nname = "battery"\ntype = "u8"\n'
        '[[fields]]\nname = "spare"\ntype = "pad"\ncount = 2\n'
        '[checksum]\nkind = "sum8"\n'
    )
    host = talk(with_firmware(layout=str(path)))
    rows = host.run(1.0)
    assert len(rows) == 100
    assert values(host.layout, rows, "accel")[0] == pytest.approx([0.0, 0.0, 9.81])
    assert not rows["battery"].any()


def test_an_unknown_layout_is_refused_by_name():
    from simulators.world import World

    with pytest.raises(ValueError, match="no-such-layout"):
        World(IDEAL.model_copy(update={"firmware": FirmwareModel(layout="no-such-layout")}))
