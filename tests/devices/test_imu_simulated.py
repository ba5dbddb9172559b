"""The sensor's driver against simulated hardware on real ports, with every fault it can have."""

import time
from contextlib import contextmanager

import numpy as np
import pytest
from one_stream import ImuStream

from firmware_protocols.layout import load_layout
from imu_rig.blocks import ImuBlock
from imu_rig.clock import ScaledClock, SystemClock
from imu_rig.devices import stream_device
from imu_rig.devices.imu import ImuDevice
from imu_rig.errors import DeviceLost, PortError
from imu_rig.imu_stream import imu_block
from imu_rig.packet_stream import assemble_packets
from imu_rig.units import STANDARD_GRAVITY
from simulators.models import FirmwareModel
from simulators.rig import RigConfig, SimulatedRig
from simulators.world import World

MPU = load_layout("mpu9150-28")
PATIENCE_S = 15.0
SPEED = 4.0  # of the rig's clock where a test need not run in real time


@contextmanager
def running(config=None, *, speed=SPEED, layout=MPU, transport="pty", tap=None):
    clock = SystemClock() if speed == 1 else ScaledClock(speed)
    with SimulatedRig(config or RigConfig.random(3), clock=clock, transport=transport) as rig:
        imu = ImuDevice("foot", rig.imu_url, layout, clock, tap=tap)
        imu.start()
        try:
            yield rig, imu, clock
        finally:
            imu.stop()


def wait_until(condition, imu=None):
    """Poll the sensor, if one is given, until the condition holds; return what it sent."""
    end = time.monotonic() + PATIENCE_S
    blocks = []
    while not condition():
        assert time.monotonic() < end, f"waited in vain: {imu and imu.health}"
        if imu is not None:
            blocks.append(imu.poll())
        time.sleep(0.005)
    return ImuBlock.concatenate(blocks)


def collect(imu, number):
    blocks = [ImuBlock.empty()]
    wait_until(lambda: blocks.append(imu.poll()) or sum(map(len, blocks)) >= number)
    return ImuBlock.concatenate(blocks)


@pytest.mark.parametrize("transport", ["pty", "tcp"])
def test_samples_come_in_order_at_their_rate_and_every_byte_passes_the_tap(transport):
    tapped = []
    with running(transport=transport, tap=lambda t, data: tapped.append((t, data))) as (_, imu, _):
        block = collect(imu, 250)
        health = imu.health
    assert np.linalg.norm(block.accel, axis=1).mean() == pytest.approx(STANDARD_GRAVITY, rel=0.1)
    np.testing.assert_array_equal(np.diff(block.counter), 1)
    assert np.all(np.diff(block.t) > 0)
    assert health.rate_hz == pytest.approx(100, rel=0.06)
    assert (health.lost, health.corrupt, health.restarts, health.stuck) == (0, 0, 0, False)
    assert health.error is None
    assert imu.health.error == f"foot on {imu.url} is stopped."

    data = b"".join(piece for _, piece in tapped)
    stops = np.cumsum([len(p) for _, p in tapped])
    packets = assemble_packets(MPU, data, stops, np.array([t for t, _ in tapped]) / 1e9)[""]
    recorded = imu_block(MPU, packets.block)
    np.testing.assert_array_equal(recorded.accel[: len(block)], block.accel)
    np.testing.assert_array_equal(recorded.host_s[: len(block)], block.host_s)


def test_times_over_the_simulated_radio_are_good_to_2_ms_after_half_a_minute():
    config = RigConfig.random(0)
    config = config.model_copy(
        update={"firmware": config.firmware.model_copy(update={"burst_s": (0.02, 0.1)})}
    )
    world, stream, blocks = World(config), ImuStream(MPU), []
    pieces = []
    for step in range(1, 7_200):  # 36 s
        world.advance(step * 0.005)
        if data := world.take("imu"):
            pieces.append((round(world.t_s * 1e9), data))
            blocks.append(stream.feed(*pieces[-1]))
    live = ImuBlock.concatenate(blocks)

    def error(block):
        device_s = block.device_s - config.firmware.clock_offset_s
        true = device_s / (1.0 + config.firmware.skew_ppm * 1e-6)
        return block.t - true - config.firmware.latency_s

    late = live.t > 30
    assert np.sqrt(np.mean(error(live)[late] ** 2)) < 2e-3 + 0.005  # the world's steps add up to 5
    assert np.std(error(live)[late]) < 2e-3
    stops = np.cumsum([len(p) for _, p in pieces])
    arrival = np.array([t for t, _ in pieces]) / 1e9
    packets = assemble_packets(MPU, b"".join(p for _, p in pieces), stops, arrival)[""]
    recorded = imu_block(MPU, packets.block)
    assert np.std(error(recorded)) < 2e-3
    assert recorded.t.shape == live.t.shape


@pytest.mark.parametrize("transport", ["pty", "tcp"])
def test_unplugging_is_noticed_within_a_second_and_the_same_name_opens_again(transport):
    with running(speed=1, transport=transport) as (rig, imu, _):
        collect(imu, 20)
        rig.fault("imu", "unplug")
        pulled = time.monotonic()
        wait_until(lambda: imu.health.error is not None, imu)
        assert time.monotonic() - pulled < 1.0
        assert "foot" in imu.health.error
        assert imu.url in imu.health.error
        assert imu.identify_problem() == imu.health.error
        wait_until(lambda: not _reopens(imu))
        with pytest.raises(DeviceLost, match="not back"):
            imu.reopen()
        time.sleep(0.2)
        rig.clear("imu")
        wait_until(lambda: _reopens(imu))
        block = collect(imu, 20)
        health = imu.health
    assert np.all(np.diff(block.t) > 0)
    assert health.reconnects >= 1
    assert health.restarts == 0  # its clock ran on
    assert health.lost > 0
    assert health.error is None


def _reopens(imu):
    try:
        imu.reopen()
    except DeviceLost:
        return False
    return True


def test_a_brownout_is_a_restart_and_time_goes_on():
    with running() as (rig, imu, _):
        before = collect(imu, 150)
        rig.fault("imu", "brownout")
        after = wait_until(lambda: imu.health.restarts == 1, imu)
        after = ImuBlock.concatenate([after, collect(imu, 100)])
        health = imu.health
    both = ImuBlock.concatenate([before, after])
    assert np.all(np.diff(both.t) > 0)
    assert np.all(np.diff(both.counter) > 0)
    assert np.max(np.diff(both.t)) > 0.6
    assert health.restarts == 1


def test_a_stuck_sensor_is_noticed():
    with running() as (rig, imu, _):
        collect(imu, 50)
        assert not imu.health.stuck
        rig.fault("imu", "stuck")
        wait_until(lambda: imu.health.stuck, imu)
        rig.clear("imu")
        wait_until(lambda: not imu.health.stuck, imu)


def test_late_data_and_a_slow_sensor_show_in_the_figures():
    with running() as (rig, imu, _):
        collect(imu, 100)
        assert imu.health.lag_s < 0.2
        rig.fault("imu", "delayed")
        wait_until(lambda: imu.health.lag_s > 0.4, imu)
        rig.clear("imu")
        wait_until(lambda: imu.health.lag_s < 0.2, imu)
        rig.fault("imu", "slow")
        wait_until(lambda: imu.health.rate_hz < 55, imu)
        assert imu.health.rate_hz > 45


def test_drop_outs_are_counted_and_silence_has_an_age():
    with running() as (rig, imu, _):
        collect(imu, 100)
        rig.fault("imu", "intermittent")
        wait_until(lambda: imu.health.lost > 60, imu)
        rig.clear("imu")
        rig.fault("imu", "off")
        wait_until(lambda: imu.health.last_packet_age_s > 2.5, imu)
        health = imu.health
        assert health.last_byte_age_s > 2.5
        assert health.rate_hz == 0.0
        assert health.error is None
        assert "sends nothing" in imu.identify_problem()


def test_garbage_is_named_and_survived():
    with running() as (rig, imu, _):
        collect(imu, 50)
        assert imu.identify_problem() is None
        rig.fault("imu", "garbage")
        wait_until(lambda: imu.health.last_packet_age_s > 2.2, imu)
        assert "baud rate (115200) is wrong" in imu.identify_problem()
        good = imu.health.good
        rig.clear("imu")
        wait_until(lambda: imu.health.good > good + 50, imu)
        assert imu.health.skipped_bytes > 1000
        assert imu.identify_problem() is None


def test_another_builtin_layout_is_named():
    config = RigConfig.random(3).model_copy(
        update={"firmware": FirmwareModel(layout="mpu9150-burst-30")}
    )
    with running(config) as (_, imu, _):
        wait_until(lambda: "mpu9150-burst-30" in (imu.identify_problem() or ""), imu)
        assert imu.health.good == 0


def test_what_the_tap_raises_reaches_the_owner():
    def full(t_ns, data):
        raise OSError("the disk is full")

    clock = ScaledClock(SPEED)
    with SimulatedRig(RigConfig.random(3), clock=clock) as rig:
        imu = ImuDevice("foot", rig.imu_url, MPU, clock, tap=full)
        imu.start()
        wait_until(lambda: imu.health.error is not None)
        with pytest.raises(OSError, match="disk is full"):
            imu.poll()
        imu.stop()


def test_a_port_that_is_not_there_is_a_port_error(tmp_path):
    imu = ImuDevice("foot", str(tmp_path / "none"), MPU, SystemClock())
    with pytest.raises(PortError, match="There is no port"):
        imu.start()
    assert "not been started" in imu.health.error
    imu.stop()


def test_a_poll_does_a_bounded_work_and_the_next_ones_the_rest(monkeypatch):
    monkeypatch.setattr(stream_device, "DECODED_BYTES", 2000)
    monkeypatch.setattr(stream_device, "DECODE_S", 0.0)
    received = []
    with running(tap=lambda t, data: received.append(len(data))) as (_, imu, _):
        wait_until(lambda: sum(received) > 6_000)
        imu.stop()
        assert max(received) < 2000
        blocks = [imu.poll() for _ in range(2 * sum(received) // 2000 + 2)]
        unread = imu.health.unread
    assert max(len(block) for block in blocks) <= 2000 // 28 + 1
    assert sum(len(block) for block in blocks) >= sum(received) // 28 - 1
    assert unread == 0


def test_of_more_than_can_be_decoded_the_newest_is(monkeypatch):
    monkeypatch.setattr(stream_device, "DECODED_BYTES", 500)
    monkeypatch.setattr(stream_device, "DECODE_S", 0.0)
    monkeypatch.setattr(stream_device, "MAX_BEHIND_BYTES", 1000)
    received = []
    with running(tap=lambda t, data: received.append((t, len(data)))) as (_, imu, _):
        wait_until(lambda: sum(size for _, size in received) > 7_000)
        imu.stop()
        blocks = [imu.poll() for _ in range(10)]
        unread = imu.health.unread
    assert unread > 200
    assert sum(len(block) for block in blocks) <= 2500 // 28
    assert blocks[-1].host_s.size == 0
    assert max(block.host_s[-1] for block in blocks if len(block)) * 1e9 >= received[-1][0] - 1e8


def test_what_nobody_polls_is_bounded_and_counted(monkeypatch):
    monkeypatch.setattr(stream_device, "MAX_UNREAD_BYTES", 3000)
    received = []
    with running(tap=lambda t, data: received.append(len(data))) as (_, imu, _):
        wait_until(lambda: sum(received) > 9_000)
        block, health = imu.poll(), imu.health
    assert 0 < len(block) < 9_000 // 28 - 100
    assert health.unread > 100
    assert np.all(np.diff(block.t) > 0)
