"""A walk on ports: it begins when somebody listens to every device, and its bytes are whole."""

import time

import serial

from firmware_protocols.known import load_protocol
from imu_rig.clock import ScaledClock
from simulators.walker.path import Straight
from simulators.walker.scenarios import Scenario
from simulators.walker.served import SimulatedWalk
from simulators.walker.steps import Stand, Walk

SHORT = Scenario("short", "Short", (Stand(0.5), Walk((Straight(0.7),)), Stand(0.2)))


def read_until(ports, got, done, seconds=20.0):
    end = time.monotonic() + seconds
    while not done() and time.monotonic() < end:
        for name, port in ports.items():
            got[name] += port.read(65536)
        time.sleep(0.005)
    assert done()


def test_a_walk_waits_for_its_listeners_and_loses_nothing():
    devices = {"left foot": "mpu9150", "waist": "waist-unit"}
    with SimulatedWalk(SHORT, devices, clock=ScaledClock(8.0)) as walk:
        urls, got = walk.ports(), dict.fromkeys(devices, b"")
        ports = {"waist": serial.serial_for_url(urls["waist"], timeout=0)}
        time.sleep(0.1)
        assert walk.t_s is None
        ports["left foot"] = serial.serial_for_url(urls["left foot"], timeout=0)
        read_until(ports, got, lambda: walk.wait(0.0))
        units = {unit.name: unit for unit in walk.units()}
        last = len(units["left foot"]) + 20
        decoder = load_protocol(walk.protocols()["left foot"]).decoder()
        rows = decoder.feed(got["left foot"])[""].rows
        assert walk.dropped() == {"left foot": 0, "waist": 0}
        for port in ports.values():
            port.close()
    assert decoder.stats.lost == 0
    truth = units["left foot"]
    assert truth.t[0] <= 0.02
    assert truth.t[-1] >= walk.walker.end_s - 0.1
    assert len(rows) <= last + 100
    # Every packet of the walk has its row in the truth, by counter and clock.
    clocks = set((truth.device_s * 1e6 + 0.5).astype("int64").tolist())
    walked = [clock for clock in rows["time"].tolist() if clock >= min(clocks)]
    assert len(walked) > 100
    assert set(walked[:-1]) <= clocks


def test_a_walk_can_begin_at_once_with_nobody_listening():
    with SimulatedWalk(SHORT, {"waist": "mpu9150"}, clock=ScaledClock(20.0), waits=False) as walk:
        assert walk.wait(20.0)
        assert walk.t_s > walk.walker.end_s
        (unit,) = walk.units()
    assert unit.counter[0] == 0
