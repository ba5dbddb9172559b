"""Watching devices on real ports: values, what goes wrong, and nothing kept."""

import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest

from imu_rig.clock import SystemClock
from imu_rig.errors import DeviceError, PortError
from imu_rig.monitor.engine import Monitor
from imu_rig.monitor.rings import Ring
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
    with pytest.raises(PortError, match="none"):
        Monitor((missing,), CLOCK, seconds=0.3).run()
    optional = missing.model_copy(update={"required": False})
    last = Monitor((optional,), CLOCK, seconds=0.2).run()
    assert [row.state for row in last.rows] == ["waiting"]
    with ServedDevices(CLOCK) as served:
        odd = DeviceSetup(name="odd", port=served.add("odd", "baro-16"))
        with pytest.raises(DeviceError, match="odd"):
            Monitor((odd,), CLOCK, seconds=0.5).run()
