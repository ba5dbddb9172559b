"""Driver and simulated MTi over real ports, and recordings of one in its place."""

import time
from contextlib import contextmanager, suppress

import numpy as np
import pytest
import serial

from firmware_protocols.known import load_protocol
from firmware_protocols.xsens_frames import Mid, encode_message
from imu_rig.blocks import ImuBlock
from imu_rig.clock import ScaledClock, SystemClock
from imu_rig.devices import mti
from imu_rig.devices.imu import ImuDevice
from imu_rig.devices.stream_device import PacketDevice
from imu_rig.errors import DeviceError
from imu_rig.recorder.engine import Recorder
from imu_rig.recorder.setup import TrialSetup
from imu_rig.recording.reader import open_trial
from imu_rig.stopping import StopRequest
from imu_rig.testing import FAST, replayed
from simulators.rig import RigConfig, SimulatedRig

PATIENCE_S = 15.0
SPEED = 8.0
GO_TO_CONFIG = encode_message(Mid.GO_TO_CONFIG)


@contextmanager
def rig_with(kind, transport="pty"):
    clock = ScaledClock(SPEED)
    with SimulatedRig(RigConfig(imu=kind), clock=clock, transport=transport) as rig:
        yield rig, clock


def wait_for(condition, what):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.005)


def collect(imu, number):
    blocks = [ImuBlock.empty()]
    wait_for(lambda: blocks.append(imu.poll()) or sum(map(len, blocks)) >= number, "samples")
    return ImuBlock.concatenate(blocks)


def left_in_config(rig):
    """Somebody else stopped the unit and went."""
    with suppress(serial.SerialException), serial.serial_for_url(rig.imu_url, timeout=2) as port:
        port.write(GO_TO_CONFIG)
        port.read_until(bytes.fromhex("FAFF3100D0"))


def measuring(rig):
    wait_for(lambda: rig.state().t_s > 0.6, "the unit to measure")


STATES = {"waking": lambda rig: None, "measuring": measuring, "config": left_in_config}


@pytest.mark.parametrize(
    ("kind", "state"),
    [*(("xsens-mti", state) for state in STATES), ("xsens-mti-legacy", "measuring")],
)
def test_samples_come_whatever_state_the_unit_is_in(kind, state):
    sent = []
    with rig_with(kind) as (rig, clock):
        STATES[state](rig)
        imu = ImuDevice(
            "mti",
            rig.imu_url,
            load_protocol(kind),
            clock,
            sent=lambda t_ns, data: sent.append(data),
        )
        imu.start()
        block = collect(imu, 60)
        imu.stop()
    assert sent[0] == GO_TO_CONFIG
    assert np.linalg.norm(block.accel, axis=1) == pytest.approx(9.8, abs=0.2)
    assert np.linalg.norm(block.mag, axis=1) == pytest.approx(48.7, abs=3.0)
    known = block.temperature[np.isfinite(block.temperature)]  # not of every sample
    assert known == pytest.approx(np.full(len(known), 28.0), abs=1.0)
    assert len(known) >= 5
    steps = np.diff(block.counter)
    assert np.count_nonzero(steps != 1) <= 1  # where it was set up anew


def test_it_is_set_up_again_after_its_port_was_opened_anew_and_after_a_reset():
    sent = []
    with rig_with("xsens-mti", transport="tcp") as (rig, clock):
        imu = ImuDevice(
            "mti",
            rig.imu_url,
            load_protocol("xsens-mti"),
            clock,
            sent=lambda t_ns, data: sent.append(data),
        )
        imu.start()
        collect(imu, 30)
        said = len(sent)
        imu.reopen()
        collect(imu, 30)
        assert sent[said] == GO_TO_CONFIG
        assert imu.health.restarts == 0
        rig.fault("imu", "reset")  # it keeps what it was told, and its clock begins anew
        wait_for(lambda: imu.health.restarts == 1, "the restart")
        collect(imu, 30)
        assert imu.identify_problem() is None
        imu.stop()
    assert imu.health.good > 90
    assert imu.health.corrupt == 0


def test_the_wrong_generation_is_named_with_device_and_port():
    with rig_with("xsens-mti-legacy") as (rig, clock):
        imu = ImuDevice("waist", rig.imu_url, load_protocol("xsens-mti"), clock)
        with pytest.raises(DeviceError, match=r"waist on .*: the MTi has no MTData2.*mti-legacy"):
            imu.start()
        imu = ImuDevice("waist", rig.imu_url, load_protocol("xsens-mti-legacy"), clock)
        imu.start()  # the port was left free
        assert len(collect(imu, 10)) >= 10
        imu.stop()


def test_a_recording_of_one_stands_in_for_it(tmp_path, monkeypatch):
    """The recording answers when it likes, and hears nothing: it is taken as it is."""
    kind, path, stop = "xsens-mti", tmp_path / "original.imu-trial", StopRequest()
    with rig_with(kind) as (rig, _):
        told = {"devices": [{"name": "mti", "port": rig.imu_url, "layout": kind}]}
        Recorder(
            TrialSetup.of(told, "test"),
            path,
            SystemClock(),
            stop=stop,
            observe=lambda status: stop.make("enough") if status.recorded_s > 0.2 else None,
        ).run()
    original, heard = open_trial(path), []
    sent = original.wire("mti").data
    monkeypatch.setattr(mti, "ANSWER_S", 0.05)  # that it is waited for in vain
    with replayed(original, transport="tcp", speed=FAST) as replay:
        device = PacketDevice(
            "mti",
            replay.ports()["mti"],
            load_protocol(kind),
            SystemClock(),
            tap=lambda t_ns, data: heard.append(data),
        )
        device.start()
        wait_for(lambda: len(b"".join(heard)) >= len(sent), "all of the recording")
        device.stop()
    samples, again = original.samples("mti"), device.poll()[""]
    assert len(samples.t) > 100
    assert sent == b"".join(heard)
    assert np.array_equal(samples.values["accel"], again.rows["accel"])
    assert np.array_equal(samples.values["quaternion"], again.rows["quaternion"])
    assert np.array_equal(samples.counter, again.counter)
