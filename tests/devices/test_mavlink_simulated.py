"""What is said to flight controllers and heard from them, in their own time and over real ports."""

import sys
import threading
import time

import numpy as np
import pytest
from flight_controller_port import AtRest, Table, served
from pymavlink.dialects.v20 import common as mavlink

from firmware_protocols.known import load_protocol, protocol_from_dict
from imu_rig.blocks import ImuBlock
from imu_rig.clock import SystemClock
from imu_rig.devices import mavlink as driver
from imu_rig.devices import mavlink_questions
from imu_rig.devices.imu import ImuDevice
from imu_rig.devices.mavlink import MavlinkConversation
from imu_rig.devices.mavlink_questions import read_parameters
from imu_rig.devices.ports import open_port
from imu_rig.devices.stream_device import PacketDevice
from imu_rig.errors import DeviceError, DeviceLost
from imu_rig.packet_stream import PacketStreams
from imu_rig.units import STANDARD_GRAVITY
from simulators import flight_controller
from simulators.flight_controller import FlightControllerModel

HIGHRES = load_protocol("mavlink-highres")
SCALED = load_protocol("mavlink-scaled")
RAW = load_protocol("mavlink-raw")
PATIENCE_S = 20.0

PX4 = FlightControllerModel("px4", {"HIGHRES_IMU": 4.0, "ATTITUDE": 10.0})
ARDUPILOT = FlightControllerModel("ardupilot", {"SCALED_IMU": 4.0}, cannot=("HIGHRES_IMU",))


def changed(model, **changes):
    return FlightControllerModel(**{**vars(model), **changes})


@pytest.fixture
def table(monkeypatch):
    """Put flight controllers on one line, with the only time that their driver knows."""

    def put(*models):
        made = Table(*models)
        for module in (driver, mavlink_questions):
            monkeypatch.setattr(module, "time", made)
        return made

    return put


def begun(table, protocol):
    conversation = MavlinkConversation(protocol)
    conversation.begin(table.write, table.hear)
    return conversation


def refusal(table, protocol):
    with pytest.raises(DeviceError) as caught:
        begun(table, protocol)
    return str(caught.value)


def said(messages, name):
    parser = mavlink.MAVLink(None)
    every = [m for data in messages for m in parser.parse_buffer(bytearray(data)) or []]
    return [m for m in every if m.get_type() == name]


def test_the_message_is_asked_for_at_its_rate_and_pressure_beside_it(table):
    line = table(PX4)
    conversation = begun(line, HIGHRES)
    assert line.now_s < 2.0
    heard = line.run(conversation, 3)
    assert line.controllers[0].rates["HIGHRES_IMU"] == 100.0
    assert line.controllers[0].rates["SCALED_PRESSURE"] == 10.0
    asked = [(m.param1, m.param2) for m in said(line.sent, "COMMAND_LONG")]
    assert asked == [(105, 10_000), (29, 100_000)]  # each of them once
    assert {(m.type, m.autopilot) for m in said(line.sent, "HEARTBEAT")} == {(6, 8)}
    packets = HIGHRES.quick_decoder().feed(heard)
    assert len(packets["imu"]) == pytest.approx(300, abs=5)
    assert len(packets["pressure"]) >= 20
    assert conversation.problem is None
    assert conversation.description == "PX4, MAVLink 2, system 1 component 1"


def test_a_heartbeat_is_said_each_second(table):
    line = table(PX4)
    conversation = begun(line, HIGHRES)
    before = len(said(line.sent, "HEARTBEAT"))
    line.run(conversation, 5)
    assert len(said(line.sent, "HEARTBEAT")) - before == 5


def test_px4_on_usb_is_silent_until_it_hears_us(table):
    line = table(changed(PX4, waits=True))
    assert line.hear(1.0) == b""
    begun(line, HIGHRES)
    assert line.controllers[0].rates["HIGHRES_IMU"] == 100.0


@pytest.mark.parametrize(
    ("result", "word"),
    [
        (mavlink.MAV_RESULT_DENIED, "denied"),
        (mavlink.MAV_RESULT_UNSUPPORTED, "unsupported"),
        (mavlink.MAV_RESULT_FAILED, "failed"),
    ],
)
def test_a_refusal_names_the_layout_to_use_instead(table, result, word):
    assert refusal(table(changed(ARDUPILOT, refusal=result)), HIGHRES) == (
        "the flight controller (ArduPilot, MAVLink 2, system 1 component 1) refuses to send "
        f"HIGHRES_IMU ({word}): use --layout mavlink-scaled."
    )


def test_without_another_message_those_to_try_are_named(table):
    silent = changed(ARDUPILOT, rates={})
    assert "use --layout mavlink-scaled or --layout mavlink-raw" in refusal(table(silent), HIGHRES)
    promising = changed(silent, refusal=mavlink.MAV_RESULT_ACCEPTED)
    assert (
        "and sends neither that nor another message of its IMU: use --layout mavlink-scaled or "
        "--layout mavlink-raw, or look at the stream settings of this port."
    ) in refusal(table(promising), HIGHRES)


def test_what_never_comes_though_it_was_promised_is_named(table):
    """Older firmware acknowledges the request and knows no such message."""
    promising = changed(ARDUPILOT, refusal=mavlink.MAV_RESULT_ACCEPTED)
    assert refusal(table(promising), HIGHRES).endswith(
        "sends SCALED_IMU but no HIGHRES_IMU: use --layout mavlink-scaled."
    )


def test_the_old_way_of_asking_where_the_new_one_is_refused(table, monkeypatch):
    line = table(changed(ARDUPILOT, rates={}))
    monkeypatch.setattr(
        line.controllers[0], "_set_interval", lambda *_: mavlink.MAV_RESULT_UNSUPPORTED
    )
    begun(line, RAW)
    assert line.controllers[0].rates["RAW_IMU"] == 100.0
    assert [m.req_stream_id for m in said(line.sent, "REQUEST_DATA_STREAM")][:1] == [1]


def test_version_1_is_spoken_to_in_its_own_way_and_named(table):
    line = table(changed(ARDUPILOT, version=1))
    conversation = begun(line, SCALED)
    assert line.controllers[0].rates["SCALED_IMU"] == 100.0
    assert conversation.description == "ArduPilot, MAVLink 1 only, system 1 component 1"
    packets = SCALED.quick_decoder().feed(line.run(conversation, 1))
    assert len(packets["imu"]) > 50
    assert np.isnan(packets["imu"].rows["temperature"]).all()
    again = table(changed(ARDUPILOT, version=1))
    assert "(ArduPilot, MAVLink 1 only, system 1" in refusal(again, HIGHRES)


def test_several_on_one_line_are_told_apart(table):
    both = PX4, changed(ARDUPILOT, system=7)
    line = table(*both)
    conversation = begun(line, HIGHRES)
    assert "HIGHRES_IMU" not in line.controllers[1].rates
    assert conversation.description.endswith("system 1 component 1, beside system 7 component 1")
    asked = protocol_from_dict({**HIGHRES.to_dict(), "system": 7})
    assert "system 7 component 1, beside system 1" in refusal(table(*both), asked)
    third = protocol_from_dict({**HIGHRES.to_dict(), "system": 3})
    assert begun(table(*both), third).problem is None  # it may come


def frame(line, name, *fields, system=1, component=1):
    """Bytes of a message of any sender."""
    message = getattr(line.controllers[0]._dialect, f"MAVLink_{name}_message")(*fields)
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=component)))


def test_countless_senders_take_little_room(table):
    """Frames that are sound need not be honest."""
    line = table(PX4)
    conversation, decoder = begun(line, HIGHRES), HIGHRES.decoder()
    decoder.feed(frame(line, "heartbeat", 2, 12, 0, 0, 3, 3))
    for system in range(2, 7):
        for component in range(250):
            fields = (*[0] * 15, system)
            data = frame(line, "highres_imu", *fields, system=system, component=component)
            conversation.heard(data)
            decoder.feed(data)
    conversation.keep(line.write)
    assert len(decoder.others) == 64
    assert len(decoder.take_faults()) == 3
    assert len(conversation._seen) <= driver.MOST_SEEN
    assert "system 2 component 2 and 252 more" in conversation.description


def test_after_countless_senders_there_is_still_room_for_the_one_spoken_to(table):
    line = table(PX4)
    conversation = MavlinkConversation(HIGHRES)
    strangers = b"".join(
        frame(line, "highres_imu", *[0] * 16, system=2 + n // 250, component=n % 250)
        for n in range(driver.MOST_SEEN)
    )
    conversation.heard(strangers)
    conversation.keep(line.write)
    conversation.begin(line.write, line.hear)
    assert line.now_s < 2.0
    assert conversation.description.startswith("PX4, MAVLink 2, system 1 component 1, beside")
    line.controllers[0]._set_interval = lambda *_: 0
    line.controllers[0].rates["HIGHRES_IMU"] = 0.0
    line.run(conversation, 5)
    assert "has stopped sending HIGHRES_IMU" in conversation.problem


class Intruded(Table):
    """Beside the flight controllers a system sends its IMU five times a second."""

    def __init__(self, *models):
        super().__init__(*models)
        self._intruder = AtRest(changed(PX4, system=9, rates={"HIGHRES_IMU": 5.0}))
        self._intruder.controller.rates.pop("HEARTBEAT")

    def hear(self, timeout_s):
        return self._intruder.until(self.now_s + timeout_s) + super().hear(timeout_s)


@pytest.mark.parametrize("beats_first", [True, False])
def test_the_one_spoken_to_is_the_one_that_is_read(monkeypatch, beats_first):
    """The system that is asked takes its time; what another sends meanwhile is not its."""
    line = Intruded(changed(PX4, rates={}))
    monkeypatch.setattr(driver, "time", line)
    conversation, streams = MavlinkConversation(HIGHRES), PacketStreams(HIGHRES)
    if not beats_first:
        line.controllers[0]._due["HEARTBEAT"] = 0.9
    heard = []

    def hear(timeout_s):
        data = line.hear(timeout_s)
        heard.append((round(line.now_s * 1e9), data))
        return data

    conversation.begin(line.write, hear)
    later = line.run(conversation, 3)
    heard.append((round(line.now_s * 1e9), later))
    blocks = streams.feed_many(heard)
    assert conversation.description.endswith("system 1 component 1, beside system 9 component 1")
    assert streams._decoder.sender[:2] == (1, 1)
    assert np.diff(blocks["imu"].device_s) == pytest.approx(0.01, abs=1e-4)
    said_of = "system 9 component 1 sends HIGHRES_IMU too (choose with system, component)"
    assert streams.faults("imu", line.now_s - 1.0) == (said_of,)
    asked = PacketStreams(protocol_from_dict({**HIGHRES.to_dict(), "system": 1, "component": 1}))
    asked.feed_many(heard)
    assert asked.faults("imu", 0.0) == ()


def test_a_port_opened_anew_goes_on_with_the_same_flight_controller(table):
    line = table(PX4, changed(PX4, system=7))
    before = begun(line, HIGHRES)
    after = MavlinkConversation(HIGHRES)
    after.remember(before)
    late = table(changed(PX4, system=7), PX4)
    after.begin(late.write, late.hear)
    assert after.description == "PX4, MAVLink 2, system 1 component 1, beside system 7 component 1"
    assert "HIGHRES_IMU" in late.controllers[1].rates
    assert late.controllers[0].rates["HIGHRES_IMU"] == 4.0


def test_what_is_wrong_may_be_asked_for_while_new_senders_are_met(table):
    """By the thread that keeps a device, of the one that reads its port."""
    line = table(PX4)
    conversation = MavlinkConversation(HIGHRES)
    beat = frame(line, "heartbeat", 2, 12, 0, 0, 3, 3)
    strangers = [
        frame(line, "scaled_imu", *[0] * 10, system=2 + n // 250, component=n % 250)
        for n in range(driver.MOST_SEEN)
    ]
    failed, done = [], threading.Event()

    def ask():
        while not done.is_set():
            try:
                conversation.problem, conversation.description  # noqa: B018
            except RuntimeError as error:
                failed.append(error)

    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread = threading.Thread(target=ask)
    thread.start()
    try:
        for _ in range(20):
            with conversation._knowing:
                conversation._seen.clear()
            for start in range(0, len(strangers), 32):
                conversation.heard(beat + b"".join(strangers[start : start + 32]))
                conversation.keep(line.write)
    finally:
        sys.setswitchinterval(interval_s)
        done.set()
        thread.join()
    assert failed == []


def test_a_rate_that_is_lost_is_asked_for_again(table):
    """Another ground station, or a restart, sets it back."""
    line = table(PX4)
    conversation = begun(line, HIGHRES)
    line.controllers[0].rates["HIGHRES_IMU"] = 5.0
    line.run(conversation, 3)
    assert line.controllers[0].rates["HIGHRES_IMU"] == 100.0
    line.controllers[0].boot(0.0)
    line.run(conversation, 3)
    assert line.controllers[0].rates["HIGHRES_IMU"] == 100.0


def test_a_rate_that_is_never_reached_is_taken_and_seldom_asked_for(table, monkeypatch):
    """ArduPilot sends no faster than its main loop runs."""
    monkeypatch.setattr(flight_controller, "MOST_HZ", 25.0)
    line = table(PX4)
    conversation = begun(line, HIGHRES)
    line.run(conversation, 60)
    asked = [m for m in said(line.sent, "COMMAND_LONG") if m.param1 == 105]
    assert driver.REQUESTS <= len(asked) <= driver.REQUESTS + 3
    assert conversation.problem is None


def test_a_message_that_stops_is_named_while_the_flight_controller_speaks(table, monkeypatch):
    line = table(PX4)
    conversation = begun(line, HIGHRES)
    monkeypatch.setattr(line.controllers[0], "_set_interval", lambda *_: 0)
    line.controllers[0].rates["HIGHRES_IMU"] = 0.0
    line.run(conversation, 5)
    assert conversation.problem == (
        "(PX4, MAVLink 2, system 1 component 1) has stopped sending HIGHRES_IMU and is asked for "
        "it every second"
    )


def test_garbage_and_silence_are_nobody_to_speak_to(table):
    line = table()
    conversation = begun(line, HIGHRES)
    conversation.keep(line.write)
    rng = np.random.default_rng(0)
    for _ in range(20):
        conversation.heard(rng.bytes(20_000))
        conversation.keep(line.write)
    assert conversation.problem is None
    assert conversation.description == "no flight controller"
    assert not said(line.sent, "COMMAND_LONG")


def test_parameters_are_read_in_the_encoding_of_their_autopilot(table):
    line = table(PX4)
    line.controllers[0].parameters["CAL_ACC0_XOFF"] = 0.12
    names = ["CAL_ACC0_ID", "CAL_MAG0_ROT", "CAL_ACC0_XOFF", "NONE"]
    found = read_parameters(line.write, line.hear, names)
    assert (found.autopilot, found.encoding, found.missing) == ("PX4", "bytewise", ("NONE",))
    assert found.value("CAL_ACC0_ID") == 1310988
    assert found.value("CAL_MAG0_ROT") == -1
    assert found.value("CAL_ACC0_XOFF") == pytest.approx(0.12)
    assert found.contradictions == ()
    line = table(changed(ARDUPILOT, version=1))
    found = read_parameters(line.write, line.hear, ["INS_ACC_ID", "INS_ACCSCAL_X"])
    assert (found.autopilot, found.encoding) == ("ArduPilot", "cast")
    assert found.value("INS_ACC_ID") == 2753028
    assert found.contradictions == ()


def test_parameters_in_the_other_encoding_are_recognized(table, monkeypatch):
    """As by a bridge that converts them, or firmware that says one thing and does the other."""
    monkeypatch.setitem(flight_controller._CAPABILITIES, "px4", 131_072)
    line = table(PX4)
    found = read_parameters(line.write, line.hear, ["CAL_ACC0_ID", "CAL_MAG0_ROT"])
    assert found.encoding == "cast"
    named = [sentence.split()[0] for sentence in found.contradictions]
    assert named == ["CAL_ACC0_ID", "CAL_MAG0_ROT"]


def test_what_the_flight_controller_corrects_itself_is_named(table):
    line = table(PX4)
    assert read_parameters(line.write, line.hear).own_calibration == {}
    line.controllers[0].parameters |= {"CAL_ACC0_XOFF": 0.12, "CAL_MAG0_ZSCALE": 0.98}
    found = read_parameters(line.write, line.hear)
    assert found.own_calibration == {
        "CAL_ACC0_XOFF": pytest.approx(0.12),
        "CAL_MAG0_ZSCALE": pytest.approx(0.98),
    }
    assert found.missing == ()


def test_no_flight_controller_is_a_sentence(table):
    line = table()
    with pytest.raises(DeviceLost, match="no flight controller is heard"):
        read_parameters(line.write, line.hear)


def test_whole_numbers_that_are_cut_off_are_right_on_average(table):
    """Both firmwares do so; the noise here is 2 mg and the steps are 1 mg."""
    line = table(ARDUPILOT)
    heard = line.run(begun(line, SCALED), 20)
    rows = SCALED.decoder().feed(heard)["imu"].rows
    assert len(rows) > 1900
    assert np.abs(np.modf(rows["accel"][:, 2])[0]) == pytest.approx(0.5)
    assert rows["accel"][:, 2].mean() == pytest.approx(-1000, abs=5 * 2 / np.sqrt(len(rows)))


def until(condition):
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, "waited in vain"
        time.sleep(0.01)


def test_over_a_real_port_samples_come_on_our_axes_and_every_byte_is_recorded():
    heard, sent = [], []
    with served(changed(PX4, waits=True, key=bytes(range(32)))) as controller:
        device = PacketDevice(
            "pixhawk",
            controller.url,
            HIGHRES,
            SystemClock(),
            tap=lambda t_ns, data: heard.append(data),
            sent=lambda t_ns, data: sent.append(data),
        )
        device.start()
        blocks = []
        until(lambda: blocks.append(device.poll()) or sum(len(b["imu"]) for b in blocks) >= 40)
        assert device.identify_problem() is None
        health = device.health
        device.stop()
        blocks.append(device.poll())
    assert (health.corrupt, health.skipped_bytes, health.restarts) == (0, 0, 0)
    recorded = HIGHRES.decoder().feed(b"".join(heard))["imu"].rows
    polled = np.concatenate([block["imu"].rows for block in blocks])
    assert polled.tobytes() == recorded.tobytes()
    assert polled["accel"].mean(axis=0) == pytest.approx([0, 0, -STANDARD_GRAVITY], abs=0.05)
    assert [m.param1 for m in said(sent, "COMMAND_LONG")] == [105, 29]


def test_over_a_real_port_ardupilot_in_version_1_and_its_refusal(monkeypatch):
    monkeypatch.setattr(driver, "SAY_S", 0.2)
    with served(changed(ARDUPILOT, version=1)) as controller:
        refused = ImuDevice("pixhawk", controller.url, HIGHRES, SystemClock())
        with pytest.raises(DeviceError) as caught:
            refused.start()
        assert str(caught.value) == (
            f"pixhawk on {controller.url}: the flight controller (ArduPilot, MAVLink 1 only, "
            "system 1 component 1) refuses to send HIGHRES_IMU (failed): use --layout "
            "mavlink-scaled."
        )
        device = ImuDevice("pixhawk", controller.url, SCALED, SystemClock())
        device.start()
        blocks = []
        until(lambda: blocks.append(device.poll()) or sum(map(len, blocks)) >= 40)
        device.stop()
        block = ImuBlock.concatenate(blocks)
        accel = block.accel
        assert accel.mean(axis=0) == pytest.approx([0, 0, STANDARD_GRAVITY], abs=0.05)
        counts = accel / (STANDARD_GRAVITY / 1000)
        np.testing.assert_allclose(np.modf(counts[:, 2])[0], 0.5, atol=1e-3)
        assert block.mag.mean(axis=0) == pytest.approx([18, 0, -44], abs=0.5)
        port = open_port(controller.url)
        found = read_parameters(port.write, port.read, ["INS_ACC_ID"])
        port.close()
        assert found.value("INS_ACC_ID") == 2753028
