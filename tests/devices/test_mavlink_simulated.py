"""The real driver and simulated flight controllers over pseudo-terminals."""

import time

import numpy as np
import pytest
from flight_controller_port import flight_controllers
from pymavlink.dialects.v20 import common as mavlink

from firmware_protocols.known import load_protocol, protocol_from_dict
from imu_rig.clock import SystemClock
from imu_rig.devices import mavlink as driver
from imu_rig.devices.imu import ImuDevice
from imu_rig.devices.stream_device import PacketDevice
from imu_rig.errors import DeviceError
from imu_rig.units import STANDARD_GRAVITY
from simulators.flight_controller import FlightControllerModel

HIGHRES = load_protocol("mavlink-highres")
SCALED = load_protocol("mavlink-scaled")
RAW = load_protocol("mavlink-raw")
PATIENCE_S = 10.0


def until(condition):
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, "waited in vain"
        time.sleep(0.01)


def collected(device, number=40):
    """Poll for samples of the streams until there are enough inertial ones."""
    parts = []
    until(lambda: parts.append(device.poll()) or sum(map(len, parts)) >= number)
    return parts


def said(messages):
    parser = mavlink.MAVLink(None)
    return [m for data in messages for m in parser.parse_buffer(data) or []]


def test_px4_speaks_once_it_hears_us_and_sends_what_is_asked_for():
    """On USB it is silent before; it starts at 4 per second and is asked for 100."""
    sent, heard = [], []
    model = FlightControllerModel("px4", {"HIGHRES_IMU": 4.0, "ATTITUDE": 10.0}, waits=True)
    with flight_controllers(model) as served:
        device = PacketDevice(
            "pixhawk",
            served.url,
            HIGHRES,
            SystemClock(),
            tap=lambda t_ns, data: heard.append(data),
            sent=lambda t_ns, data: sent.append(data),
        )
        device.start()
        blocks = []
        until(
            lambda: (
                blocks.append(device.poll())
                or (
                    sum(len(b["imu"]) for b in blocks) >= 60
                    and sum(len(b["pressure"]) for b in blocks) >= 3
                )
            )
        )
        until(lambda: device.stream_health("imu").rate_hz > 90)
        health = device.health
        assert device.identify_problem() is None
        device.stop()
        assert served.controllers[0].rates["HIGHRES_IMU"] == 100.0
        assert served.controllers[0].rates["SCALED_PRESSURE"] == 10.0
    rows = np.concatenate([block["imu"].rows for block in blocks])
    assert rows["accel"].mean(axis=0) == pytest.approx([0, 0, -STANDARD_GRAVITY], abs=0.05)
    assert (health.corrupt, health.skipped_bytes, health.restarts) == (0, 0, 0)
    asked = [m for m in said(sent) if m.get_type() == "COMMAND_LONG"]
    assert [(m.param1, m.param2) for m in asked[:1]] == [(105, 10_000)]
    assert (29, 100_000) in [(m.param1, m.param2) for m in asked]
    beats = [m for m in said(sent) if m.get_type() == "HEARTBEAT"]
    assert {(m.type, m.autopilot) for m in beats} == {(6, 8)}
    assert {m.get_srcSystem() for m in beats} == {255}
    assert b"".join(heard)


def test_samples_of_ardupilot_are_on_our_axes_in_si_units():
    model = FlightControllerModel("ardupilot", {"RAW_IMU": 2.0}, cannot=("HIGHRES_IMU",))
    with flight_controllers(model) as served:
        device = ImuDevice("pixhawk", served.url, SCALED, SystemClock())
        device.start()
        blocks = collected(device)
        device.stop()
    accel = np.concatenate([b.accel for b in blocks])
    assert accel.mean(axis=0) == pytest.approx([0, 0, STANDARD_GRAVITY], abs=0.05)
    counts = accel / (STANDARD_GRAVITY / 1000)
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    mag = np.concatenate([b.mag for b in blocks])
    assert mag.mean(axis=0) == pytest.approx([18, 0, -44], abs=0.5)
    t = np.concatenate([b.t for b in blocks])
    assert np.all(np.diff(t) > 0)


@pytest.mark.parametrize(
    ("refusal", "word"),
    [
        (mavlink.MAV_RESULT_DENIED, "denied"),
        (mavlink.MAV_RESULT_UNSUPPORTED, "unsupported"),
        (mavlink.MAV_RESULT_FAILED, "failed"),
    ],
)
def test_a_refusal_names_the_layout_to_use_instead(refusal, word, monkeypatch):
    monkeypatch.setattr(driver, "SAY_S", 0.2)
    model = FlightControllerModel(
        "ardupilot", {"SCALED_IMU": 10.0}, cannot=("HIGHRES_IMU",), refusal=refusal
    )
    with flight_controllers(model) as served:
        device = ImuDevice("pixhawk", served.url, HIGHRES, SystemClock())
        with pytest.raises(DeviceError) as caught:
            device.start()
    assert str(caught.value) == (
        f"pixhawk on {served.url}: the flight controller (ArduPilot, MAVLink 2, system 1 "
        f"component 1) refuses to send HIGHRES_IMU ({word}): use --layout mavlink-scaled."
    )


def test_what_never_comes_though_it_was_promised_is_named(monkeypatch):
    """Older firmware acknowledges the request and knows no such message."""
    monkeypatch.setattr(driver, "SAY_S", 0.2)
    monkeypatch.setattr(driver, "BEGIN_S", 1.5)
    for rates, expected in (
        ({"SCALED_IMU": 20.0}, "sends SCALED_IMU but no HIGHRES_IMU: use --layout mavlink-scaled."),
        ({}, "sends neither that nor another message of its IMU: use --layout mavlink-scaled or"),
    ):
        model = FlightControllerModel(
            "ardupilot", rates, cannot=("HIGHRES_IMU",), refusal=mavlink.MAV_RESULT_ACCEPTED
        )
        with flight_controllers(model) as served:
            device = ImuDevice("pixhawk", served.url, HIGHRES, SystemClock())
            with pytest.raises(DeviceError) as caught:
                device.start()
        assert expected in str(caught.value)


def test_the_old_way_of_asking_where_the_new_one_is_refused(monkeypatch):
    monkeypatch.setattr(driver, "SAY_S", 0.2)
    model = FlightControllerModel("ardupilot", {})
    with flight_controllers(model) as served:
        controller = served.controllers[0]
        monkeypatch.setattr(controller, "_set_interval", lambda *_: mavlink.MAV_RESULT_UNSUPPORTED)
        device = ImuDevice("pixhawk", served.url, RAW, SystemClock())
        device.start()
        collected(device)
        device.stop()
        assert controller.rates["RAW_IMU"] == 100.0


def test_version_1_is_spoken_to_in_its_own_way_and_named(monkeypatch):
    monkeypatch.setattr(driver, "SAY_S", 0.2)
    model = FlightControllerModel("ardupilot", {}, version=1, cannot=("HIGHRES_IMU",))
    with flight_controllers(model) as served:
        device = ImuDevice("pixhawk", served.url, SCALED, SystemClock())
        device.start()
        blocks = collected(device)
        device.stop()
        assert served.controllers[0].rates["SCALED_IMU"] == 100.0
        assert np.isnan(np.concatenate([b.temperature for b in blocks])).all()
        refused = ImuDevice("pixhawk", served.url, HIGHRES, SystemClock())
        with pytest.raises(DeviceError, match=r"\(ArduPilot, MAVLink 1 only, system 1"):
            refused.start()


def test_signed_frames_are_read():
    model = FlightControllerModel("px4", {"HIGHRES_IMU": 100.0}, key=bytes(range(32)))
    with flight_controllers(model) as served:
        device = ImuDevice("pixhawk", served.url, HIGHRES, SystemClock())
        device.start()
        collected(device)
        assert device.health.skipped_bytes == 0
        device.stop()


def test_several_on_one_port_are_told_apart(monkeypatch):
    monkeypatch.setattr(driver, "SAY_S", 0.2)
    monkeypatch.setattr(driver, "BEGIN_S", 1.5)
    models = [
        FlightControllerModel("px4", {"HIGHRES_IMU": 100.0}),
        FlightControllerModel("ardupilot", {"SCALED_IMU": 20.0}, system=7, cannot=("HIGHRES_IMU",)),
    ]
    asked = protocol_from_dict({**HIGHRES.to_dict(), "system": 7})
    with flight_controllers(*models) as served:
        device = ImuDevice("pixhawk", served.url, HIGHRES, SystemClock())
        device.start()
        collected(device)
        device.stop()
        assert "HIGHRES_IMU" not in served.controllers[1].rates
        other = ImuDevice("pixhawk", served.url, asked, SystemClock())
        with pytest.raises(DeviceError, match=r"system 7 component 1.*refuses to send HIGHRES_IMU"):
            other.start()


def test_a_rate_that_is_lost_is_asked_for_again():
    """Another ground station, or a restart, sets it back."""
    model = FlightControllerModel("px4", {})
    with flight_controllers(model) as served:
        device = ImuDevice("pixhawk", served.url, HIGHRES, SystemClock())
        device.start()
        controller = served.controllers[0]
        controller.rates["HIGHRES_IMU"] = 5.0
        until(lambda: device.poll() is not None and controller.rates["HIGHRES_IMU"] == 100.0)
        device.stop()


def test_a_silent_port_is_left_to_come_later(monkeypatch):
    monkeypatch.setattr(driver, "START_S", 0.3)
    model = FlightControllerModel("px4", {})
    with flight_controllers(model) as served:
        controller = served.controllers[0]
        controller._awake = False
        monkeypatch.setattr(controller, "receive", lambda data, now_s: b"")
        device = ImuDevice("pixhawk", served.url, HIGHRES, SystemClock())
        device.start()
        assert "sends nothing" in device.identify_problem()
        monkeypatch.undo()
        controller._awake = True
        collected(device)
        device.stop()
