"""What is told of a silent device while its port is opened again and again."""

import numpy as np

from firmware_protocols.layout import load_layout
from imu_rig.clock import SystemClock
from imu_rig.recorder import keeper, stream_watch
from imu_rig.recorder.engine import Recorder
from imu_rig.recorder.setup import DeviceSetup, TrialSetup
from imu_rig.stopping import StopRequest
from simulators.served_devices import ServedDevices

CLOCK = SystemClock()
REOPENED = 2


def test_a_silent_device_stays_silent_and_its_age_grows_while_its_port_is_reopened(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(keeper, "REVIVE_S", 0.1)
    stop, seen = StopRequest(), []
    with ServedDevices(CLOCK) as served:
        port = served.add("left", load_layout("mpu9150-28"), 200.0)

        def observe(status):
            [device] = status.devices
            if device.state == "live" and not seen:
                served.silence("left", True)
            if device.state == "silent" or seen:
                seen.append(device)
            if device.reconnects == REOPENED:
                stop.make("seen enough")

        setup = TrialSetup(devices=(DeviceSetup(name="left", port=port),), duration_s=20.0)
        Recorder(setup, tmp_path / "walk.imu-trial", CLOCK, stop=stop, observe=observe).run()
    assert seen[-1].reconnects == REOPENED
    assert {device.state for device in seen} == {"silent"}
    assert np.all(np.diff([device.age_s for device in seen]) >= 0)
    assert seen[-1].age_s > seen[0].age_s > stream_watch.SILENT_S
