"""Watching devices on real ports: values, what goes wrong, and nothing kept."""

import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest

from firmware_protocols.known import load_protocol
from imu_rig.blocks import Samples
from imu_rig.clock import SystemClock
from imu_rig.errors import DeviceError, PortError
from imu_rig.monitor import engine
from imu_rig.monitor.engine import Monitor
from imu_rig.monitor.quantities import Quantity
from imu_rig.monitor.rings import Ring
from imu_rig.packet_stream import PacketBlock
from imu_rig.recorder.setup import DeviceSetup
from imu_rig.stopping import StopRequest
from simulators.served_devices import ServedDevices

CLOCK = SystemClock()
PATIENCE_S = 20.0


@contextmanager
def watching(devices, rings=None):
    stop, statuses, notices = StopRequest(), [], []
    monitor = Monitor(devices, CLOCK, stop=stop, observe=statuses.append, notify=notices.append)
    if rings is not None:
        rings += [Ring(2000, plan.columns) for plan in monitor.plans]
        monitor.fill(rings)
    thread = threading.Thread(target=monitor.run)
    thread.start()
    try:
        yield monitor, statuses, notices
    finally:
        stop.make("enough")
        thread.join(PATIENCE_S)
    assert not thread.is_alive()


def until(condition):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


def states(statuses):
    return [row.state for row in statuses[-1].rows] if statuses else []


def test_every_stream_has_its_figures_its_newest_values_and_its_ring(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rings = []
    with ServedDevices(CLOCK) as served:
        devices = (
            DeviceSetup(name="left", port=served.add("left", "mpu9150-28")),
            DeviceSetup(name="belt", port=served.add("belt", "waist-unit"), layout="waist-unit"),
        )
        with watching(devices, rings) as (monitor, statuses, _):
            until(lambda: states(statuses) == ["live"] * 3 and len(statuses[-1].readings) == 3)
            status = statuses[-1]
    assert [plan.name for plan in monitor.plans] == ["left", "belt/accel", "belt/barometer"]
    readings = {q.name: numbers for q, numbers in status.readings["left"]}
    assert 0.3 < np.linalg.norm(readings["accel"]) < 2.0  # in g, of a hand that moves
    pressure, temperature = status.readings["belt/barometer"]
    assert pressure[0].unit == "hPa"
    assert pressure[1][0] == pytest.approx(1013.25, abs=0.2)
    assert temperature[1][0] == pytest.approx(31.0, abs=0.3)
    for ring, plan in zip(rings, monitor.plans, strict=True):
        rows = ring.read()
        assert rows.shape[1] == 1 + plan.columns
        assert len(rows) >= 2
        assert np.all(np.diff(rows[:, 0]) > 0)
    assert list(tmp_path.iterdir()) == []  # nothing is kept


def test_a_port_that_goes_is_red_and_comes_back():
    with ServedDevices(CLOCK) as served:
        devices = (DeviceSetup(name="left", port=served.add("left", "mpu9150-28")),)
        with watching(devices) as (_, statuses, notices):
            until(lambda: states(statuses) == ["live"])
            served.unplug("left")
            until(lambda: states(statuses) == ["lost"])
            assert "left" in statuses[-1].rows[0].problem or statuses[-1].rows[0].problem
            served.plug("left")
            until(lambda: states(statuses) == ["live"])
            assert statuses[-1].rows[0].reconnects >= 1
    assert any("left is back" in sentence for sentence in notices)


def test_a_planned_look_at_devices_that_are_not_there_fails(tmp_path):
    missing = DeviceSetup(name="left", port=str(tmp_path / "none"))
    told = shortfall_of(missing, 0.3)
    assert isinstance(told, PortError)
    assert "none" in str(told)
    assert shortfall_of(missing.model_copy(update={"required": False}), 0.2) is None
    with ServedDevices(CLOCK) as served:
        odd = DeviceSetup(name="odd", port=served.add("odd", "baro-16"))
        told = shortfall_of(odd, 0.5)
    assert isinstance(told, DeviceError)
    assert "odd" in str(told)


def shortfall_of(device, seconds):
    monitor = Monitor((device,), CLOCK, seconds=seconds)
    monitor.run()
    return monitor.shortfall


def test_one_stream_that_never_comes_takes_nothing_from_the_others():
    with ServedDevices(CLOCK) as served:
        device = DeviceSetup(
            name="receiver", port=served.add("receiver", "two-imu"), layout="two-imu"
        )
        served.silence("receiver", stream="waist")
        monitor = Monitor((device,), CLOCK, seconds=0.5)
        last = monitor.run()
    assert isinstance(monitor.shortfall, DeviceError)
    assert "receiver/waist" in str(monitor.shortfall)
    assert "receiver on" not in str(monitor.shortfall)  # which is not silent
    assert last.rows[0].packets > 0
    assert "receiver/foot" in last.readings


def test_a_device_that_is_gone_at_the_planned_end_is_a_shortfall():
    with ServedDevices(CLOCK) as served:
        device = DeviceSetup(name="left", port=served.add("left", "mpu9150-28"))
        seen = []

        def observe(status):
            seen.append(status.rows[0].state)
            if seen[-1] == "live":
                served.unplug("left")

        monitor = Monitor((device,), CLOCK, seconds=0.9, observe=observe)
        monitor.run()
    assert "live" in seen
    assert isinstance(monitor.shortfall, DeviceError)


def test_a_reading_stays_until_there_is_a_new_one():
    layout = load_protocol("mpu9150-28").streams[""]
    monitor = Monitor((DeviceSetup(name="left", port="/dev/none"),), CLOCK)
    block = PacketBlock.empty(layout)
    monitor._quantities = {"left": (Quantity("mag", "uT", 1.0, 3),)}
    for value, shown in ((5.0, 5.0), (np.nan, 5.0), (7.0, 7.0)):
        numbers = np.full((1, 3), value)
        with pytest.MonkeyPatch.context() as patch:
            samples = Samples(np.zeros(1), np.zeros(1), None, None, {"mag": numbers}, {})
            patch.setattr(engine, "packet_samples", lambda *_, samples=samples: samples)
            monitor._take("left", block)
        [(_, reading)] = monitor._status().readings["left"]
        assert reading == (shown,) * 3
