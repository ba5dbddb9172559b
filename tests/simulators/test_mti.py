"""The simulated MTi: states, answers and memory by the documents, orientation by the physics."""

import struct

import numpy as np
import pytest

from firmware_protocols.xsens import XsensProtocol
from firmware_protocols.xsens_frames import Mid, answer_to, encode_message, find_messages
from imu_rig import rotation
from imu_rig.units import DEG
from simulators.encoders import MadeSamples
from simulators.inertial_sensor import Readings
from simulators.mti import Memory, MtiUnit
from simulators.mti_attitude import Attitude

GRAVITY = np.array([0.0, 0.0, 9.81])
FIELD = np.array([0.0, 30.0, -40.0])  # to the north and down
OUTPUTS = (0x1020, 0x1060, 0x4020, 0x8020, 0xC020, 0x2010, 0x4030, 0x4010, 0x8030, 0x3010, 0xE020)


def samples(number, *, start=0, hz=100.0, accel=GRAVITY, gyro=(0, 0, 0), mag=FIELD):
    t = (start + 1 + np.arange(number)) / hz

    def rows(triad):
        return np.broadcast_to(np.asarray(triad, dtype=float), (number, 3))

    return MadeSamples(
        t=t,
        device_s=t,
        counter=start + np.arange(number),
        readings=Readings(
            rows(accel),
            rows(gyro),
            rows(mag),
            np.full(number, 30.0),
            np.zeros(number, bool),
            np.zeros((number, 6)),
        ),
        pressure=np.full(number, 100_062.0),
        air_c=np.full(number, 20.0),
    )


def say(unit, mid, data=b"", now_s=0.1):
    """Send one message; return identifier and data of each answer."""
    messages, _ = find_messages(unit.receive(encode_message(mid, data), now_s))
    return [(message.mid, message.data) for message in messages]


def messages_of(sent):
    return [[m.mid for m in find_messages(data)[0]] for data in sent]


def configured(generation="mark4", memory=None):
    unit = MtiUnit(generation, memory)
    unit.boot(0.0)
    assert say(unit, Mid.GO_TO_CONFIG) == [(answer_to(Mid.GO_TO_CONFIG), b"")]
    return unit


def test_it_wakes_up_and_measures_if_nobody_answers():
    unit = MtiUnit("mark3")
    assert unit.boot(0.0) == bytes.fromhex("FAFF3E00C3")
    sent = messages_of(unit.encode(samples(60)))
    assert sent[:49] == [[]] * 49
    assert sent[49] == [Mid.CONFIGURATION, Mid.MT_DATA]
    assert sent[50:] == [[Mid.MT_DATA]] * 10


@pytest.mark.parametrize(("now_s", "state"), [(0.3, "config"), (0.6, "measurement")])
def test_a_wake_up_that_is_answered_in_time_leads_to_the_config_state(now_s, state):
    unit = MtiUnit("mark4")
    unit.boot(0.0)
    unit.encode(samples(round(100 * now_s)))
    assert say(unit, Mid.WAKE_UP_ACK, now_s=now_s) == []
    assert unit.state == state


CONFIG_ONLY = [
    (Mid.REQ_DID, b""),
    (Mid.REQ_CONFIGURATION, b""),
    (Mid.GO_TO_MEASUREMENT, b""),
    (Mid.SET_PERIOD, b"\x04\x80"),
    (Mid.SET_OUTPUT_MODE, b"\x00\x06"),
    (Mid.SET_OUTPUT_SETTINGS, bytes(4)),
    (Mid.SET_OUTPUT_SKIP_FACTOR, bytes(2)),
    (Mid.SET_BAUD_RATE, b""),
]


@pytest.mark.parametrize(("mid", "data"), CONFIG_ONLY)
def test_what_belongs_to_the_config_state_is_an_error_while_it_measures(mid, data):
    unit = configured()
    assert say(unit, mid, data)[0][0] == answer_to(mid)
    say(unit, Mid.GO_TO_CONFIG)
    say(unit, Mid.GO_TO_MEASUREMENT)
    assert say(unit, mid, data) == [(Mid.ERROR, b"\x04")]


def test_settings_are_told_and_survive_power_down():
    unit = configured("mark3")
    told = {
        Mid.SET_PERIOD: b"\x09\x00",
        Mid.SET_OUTPUT_MODE: b"\x00\x07",
        Mid.SET_OUTPUT_SETTINGS: b"\x00\x00\x01\x01",
        Mid.SET_OUTPUT_SKIP_FACTOR: b"\x00\x01",
    }
    for mid, data in told.items():
        assert say(unit, mid, data) == [(answer_to(mid), b"")]
    ((mid, _), *rest) = say(unit, Mid.RESET)
    assert (mid, rest) == (answer_to(Mid.RESET), [(Mid.WAKE_UP, b"")])
    say(unit, Mid.WAKE_UP_ACK)
    for mid, data in told.items():
        assert say(unit, mid) == [(answer_to(mid), data)]
    assert unit.sample_hz == 50.0
    ((_, configuration),) = say(unit, Mid.REQ_CONFIGURATION)
    # 32 bytes of the head, twice 32 reserved, number of units, then what is sent
    assert len(configuration) == 118
    assert configuration[:8] == struct.pack(">IHH", 0x00300001, 0x0900, 1)
    number, device, length, mode, settings = struct.unpack(">HIHHI", configuration[96:110])
    assert (number, device, mode, settings) == (1, 0x00300001, 7, 0x101)
    say(unit, Mid.GO_TO_MEASUREMENT)
    ((message,), _) = find_messages(b"".join(unit.encode(samples(1))))
    assert length == len(message.data) == 4 + 36 + 16 + 2


@pytest.mark.parametrize(
    ("generation", "mid", "data", "number"),
    [
        ("mark3", Mid.SET_PERIOD, b"\x00\x10", 0x03),
        ("mark3", Mid.SET_OUTPUT_MODE, b"\x00\x00", 0x21),
        ("mark3", Mid.SET_OUTPUT_MODE, b"\x00", 0x21),
        ("mark3", Mid.SET_OUTPUT_SETTINGS, b"\x00\x00\x00\x03", 0x21),
        ("mark3", Mid.SET_OUTPUT_CONFIGURATION, bytes(4), 0x04),
        ("mark3", 0x77, b"", 0x04),
        ("mark4", Mid.SET_OUTPUT_CONFIGURATION, b"\x10\x20\xff", 0x21),
        ("mark4", 0x77, b"", 0x04),
    ],
)
def test_what_it_cannot_do_is_an_error_with_its_number(generation, mid, data, number):
    assert say(configured(generation), mid, data) == [(Mid.ERROR, bytes([number]))]


def test_outputs_are_told_as_it_will_send_them():
    unit = configured("mark4")
    asked = bytes.fromhex("10200064 402003E8 301001F4 12340064 20140032")
    given = bytes.fromhex("1020FFFF 40200190 30100032 20140032")
    set_outputs = answer_to(Mid.SET_OUTPUT_CONFIGURATION)
    assert say(unit, Mid.SET_OUTPUT_CONFIGURATION, asked) == [(set_outputs, given)]
    assert say(unit, Mid.SET_OUTPUT_CONFIGURATION) == [(set_outputs, given)]
    assert unit.sample_hz == 400.0
    assert say(unit, Mid.SET_OUTPUT_CONFIGURATION, bytes(4)) == [(set_outputs, bytes(4))]
    assert unit.sample_hz == 100.0


def test_a_skip_factor_of_ffff_sends_on_request_only():
    unit = configured("mark3", Memory(skip=0xFFFF))
    assert say(unit, Mid.REQ_DATA) == [(Mid.ERROR, b"\x04")]
    say(unit, Mid.GO_TO_MEASUREMENT)
    assert unit.encode(samples(20)) == [b""] * 20
    ((mid, data),) = say(unit, Mid.REQ_DATA)
    assert (mid, data[-2:]) == (Mid.MT_DATA, b"\x00\x13")


def test_every_second_sample_with_a_skip_factor_of_one():
    unit = configured("mark3", Memory(skip=1))
    say(unit, Mid.GO_TO_MEASUREMENT)
    assert [bool(frame) for frame in unit.encode(samples(6))] == [True, False] * 3


def turned(degrees):
    """How gravity and field look from a sensor that is turned so."""
    q = rotation.from_rotation_vector(np.asarray(degrees, dtype=float) * DEG)
    back = rotation.conjugate(q)
    return q, rotation.rotate(back, GRAVITY), rotation.rotate(back, FIELD)


@pytest.mark.parametrize("number_format", range(4))
@pytest.mark.parametrize("axes", [0x0, 0x4, 0x8])
@pytest.mark.parametrize("shown", [0x2010, 0x2020, 0x2030])
def test_what_it_sends_is_what_it_measures(number_format, axes, shown):
    """In every format, in every axes of the earth, orientation shown in every way."""
    q, accel, mag = turned([20.0, -30.0, 100.0])
    outputs = tuple(
        (shown | axes if i == 0x2010 else i | axes if i == 0x4030 else i) | number_format
        if i & 0xF000 in (0x2000, 0x4000, 0x8000, 0xC000)
        else i
        for i in OUTPUTS
    )
    protocol = XsensProtocol("all", outputs=outputs)
    unit = configured("mark4", Memory(outputs=[(i, 100) for i in outputs]))
    say(unit, Mid.GO_TO_MEASUREMENT)
    gyro = np.array([0.1, -0.2, 0.3])
    sent = unit.encode(samples(1, start=65_537, accel=accel, gyro=gyro, mag=mag))
    rows = protocol.decoder().feed(b"".join(sent))[""].rows
    close = {"abs": 3e-6 if number_format in (0, 1) else 1e-9}
    assert rows["counter"].tolist() == [1]
    assert rows["time"].tolist() == [6_553_800]
    assert rows["accel"][0] == pytest.approx(accel, **close)
    assert rows["gyro"][0] == pytest.approx(gyro, **close)
    assert 49.0 * rows["mag"][0] == pytest.approx(mag, abs=50 * close["abs"])
    assert abs(rows["quaternion"][0] @ q) == pytest.approx(1.0, abs=1e-6)
    assert rows["free_accel"][0] == pytest.approx([0, 0, 9.81 - 9.80665], abs=1e-5)
    assert rows["delta_v"][0] == pytest.approx(accel / 100.0, **close)
    assert 200.0 * rows["delta_q"][0, 1:] == pytest.approx(gyro, abs=1e-3)
    assert rows["pressure"].tolist() == [100_062]
    assert (rows["status"][0], rows["alarms"][0]) == (3, 0)


@pytest.mark.parametrize("settings", [0x001, 0x005, 0x009, 0x101, 0x201, 0x301, 0x80000001])
def test_what_it_sends_in_the_legacy_format_is_what_it_measures(settings):
    q, accel, mag = turned([-40.0, 10.0, 60.0])
    protocol = XsensProtocol("old", format="legacy", output_mode=0x0807, output_settings=settings)
    unit = configured("mark3", Memory(mode=0x0807, settings=settings))
    say(unit, Mid.GO_TO_MEASUREMENT)
    rows = protocol.decoder().feed(b"".join(unit.encode(samples(1, accel=accel, mag=mag))))[""].rows
    assert rows["temperature"].tolist() == [30.0]
    assert rows["accel"][0] == pytest.approx(accel, abs=3e-6)
    assert 49.0 * rows["mag"][0] == pytest.approx(mag, abs=1e-4)
    assert abs(rows["quaternion"][0] @ q) == pytest.approx(1.0, abs=1e-6)
    assert (rows["counter"][0], rows["status"][0]) == (0, 3)


def test_axes_that_clip_are_told():
    unit = configured("mark4", Memory(outputs=[(i, 100) for i in OUTPUTS]))
    say(unit, Mid.GO_TO_MEASUREMENT)
    sent = unit.encode(samples(1, accel=[0, -50.0, 9.8], gyro=[0, 0, 300.0 * DEG]))
    rows = XsensProtocol("all", outputs=OUTPUTS).decoder().feed(b"".join(sent))[""].rows
    assert rows["status"][0] == 0x3 | 1 << 9 | 1 << 13 | 1 << 19


def test_samples_may_be_handed_over_one_by_one():
    def run(cuts):
        unit = MtiUnit("mark4", Memory(outputs=[(i, 50 if i == 0xC020 else 100) for i in OUTPUTS]))
        unit.boot(0.0)
        sent = []
        for start, number in cuts:
            sent += unit.encode(samples(number, start=start, gyro=[0.1, 0.2, 0.3]))
        return sent

    whole = run([(0, 80)])
    assert run([(n, 1) for n in range(80)]) == whole
    assert run([(0, 33), (33, 47)]) == whole
    assert {len(frame) for frame in whole[51:]} == {len(whole[-1]), len(whole[-2])}


def test_the_orientation_follows_a_turn():
    """A turn of 90 degrees to the left in two seconds, and back, with the field at rest."""
    attitude = Attitude()
    rate = np.zeros((400, 3))
    rate[:200, 2], rate[200:, 2] = np.pi / 4, -np.pi / 4
    heading = np.cumsum(rate[:, 2]) / 100.0
    heading[0] = 0.0  # the first tells where it stands
    mag = np.stack([30 * np.sin(heading), 30 * np.cos(heading), np.full(400, -40.0)], axis=1)
    q = attitude.follow(np.tile(GRAVITY, (400, 1)), rate, mag, 0.01)
    found = 2.0 * np.arctan2(q[:, 3], q[:, 0])
    assert found[199] == pytest.approx(np.pi / 2, abs=0.01)
    assert np.max(np.abs(found - heading)) < 0.01
    assert np.abs(q[:, 1:3]).max() < 1e-6


def test_the_orientation_finds_up_and_north_again():
    """After a turn that it did not hear of, the errors shrink, by half in about 1.4 s."""
    attitude = Attitude()
    attitude.follow(GRAVITY[np.newaxis], np.zeros((1, 3)), FIELD[np.newaxis], 0.01)
    truth, accel, mag = turned([10.0, -15.0, 20.0])
    still = np.zeros((1500, 3))
    q = attitude.follow(np.tile(accel, (1500, 1)), still, np.tile(mag, (1500, 1)), 0.01)
    error = 2.0 * np.arccos(np.clip(np.abs(q @ truth), 0.0, 1.0)) / DEG
    assert error[0] > 25.0
    assert error[-1] < 0.1
    assert np.all(np.diff(error[::100]) < 1e-3)


def test_without_field_or_force_there_is_no_orientation_and_no_error():
    nothing = np.zeros((3, 3))
    assert Attitude().follow(nothing, nothing, nothing, 0.01)[0].tolist() == [1, 0, 0, 0]
