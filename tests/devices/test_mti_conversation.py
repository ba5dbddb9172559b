"""The conversation with an MTi in every state that it may be found in, and over bad lines."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mti_line import Line

from firmware_protocols.known import load_protocol
from firmware_protocols.packets import encode
from firmware_protocols.xsens import XsensProtocol
from firmware_protocols.xsens_frames import Mid, answer_to, encode_message, find_messages
from imu_rig.devices import mti
from imu_rig.devices.conversation import conversation_for
from imu_rig.errors import DeviceError, DeviceLost
from simulators.mti import Memory, MtiUnit

MTI = load_protocol("xsens-mti")
OLD_MTI = load_protocol("xsens-mti-legacy")
ON_S = 0.6  # since it was switched on: it has just begun to measure
AFTER_S = 0.3  # that the unit is heard once it is set up
SENT = 30  # messages in that time
ENOUGH = range(SENT - 1, SENT + 2)  # perhaps one more or less around the beginning
NEW = [(0x1020, 0xFFFF), (0x1060, 0xFFFF), (0x4020, 100), (0x8020, 100)]


@pytest.fixture
def talk(monkeypatch):
    """Go through the conversation of a protocol on a line; return it and what came after it."""

    def run(protocol, line):
        monkeypatch.setattr(mti, "time", line)
        conversation = conversation_for(protocol)
        conversation.begin(line.write, line.hear)
        rows = protocol.decoder().feed(line.hear(AFTER_S))[""]
        return conversation, rows

    return run


def waking(unit):
    return Line(unit)


def measuring(unit):
    return Line(unit, on_s=ON_S)


def configuring(unit):
    line = Line(unit, on_s=ON_S)
    unit.receive(encode_message(Mid.GO_TO_CONFIG), line.now_s)
    return line


STATES = {"waking": waking, "measuring": measuring, "configuring": configuring}
MEMORIES = {
    "factory": Memory,
    "all off": lambda: Memory(skip=0xFFFF),
    "MTData2": lambda: Memory(outputs=list(NEW)),
    "50 Hz, fixed point": lambda: Memory(mode=2, settings=0x100, period=2304),
}


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize(
    ("generation", "protocol"), [("mark4", MTI), ("mark4", OLD_MTI), ("mark3", OLD_MTI)]
)
def test_a_unit_is_set_up_from_every_state(talk, generation, protocol, state, memory):
    unit = MtiUnit(generation, MEMORIES[memory]())
    if generation == "mark3":
        unit.memory.outputs = []
    conversation, packets = talk(protocol, STATES[state](unit))
    assert conversation.device_id == unit.device_id
    assert unit.state == "measurement"
    assert len(packets) in ENOUGH
    assert np.diff(packets.rows["counter"].astype(int)).tolist() == [1] * (len(packets) - 1)
    assert packets.rows["accel"] == pytest.approx(np.tile([0, 0, 9.81], (len(packets), 1)))
    if protocol is MTI:
        assert [identifier for identifier, _ in unit.memory.outputs] == list(MTI.outputs)
    else:
        assert (unit.memory.mode, unit.memory.settings) == (0x0007, 0x00000001)
        assert (unit.memory.period, unit.memory.skip, unit.memory.outputs) == (1152, 0, [])


def test_what_is_said_byte_by_byte(talk):
    outputs = (0x1020, 0x1060, 0x4020, 0x8020, 0xC020, 0x2010)
    line = configuring(MtiUnit("mark4"))
    talk(XsensProtocol("printed", outputs=outputs), line)
    assert [data.hex(" ").upper() for data in line.written] == [
        "FA FF 30 00 D1",
        "FA FF 00 00 01",
        "FA FF C0 00 41",
        "FA FF C0 18 10 20 FF FF 10 60 FF FF 40 20 00 64 80 20 00 64 C0 20 00 64 20 10 00 64 ED",
        "FA FF 10 00 F1",
    ]
    other = Memory(outputs=list(NEW), mode=4, settings=5, period=1000, skip=3)
    line = configuring(MtiUnit("mark4", other))
    talk(OLD_MTI, line)
    assert [data.hex(" ").upper() for data in line.written] == [
        "FA FF 30 00 D1",
        "FA FF 00 00 01",
        "FA FF C0 00 41",
        "FA FF C0 04 00 00 00 00 3D",
        "FA FF 04 00 FD",
        "FA FF 04 02 04 80 77",
        "FA FF D4 00 2D",
        "FA FF D4 02 00 00 2B",
        "FA FF D0 00 31",
        "FA FF D0 02 00 07 28",
        "FA FF D2 00 2F",
        "FA FF D2 04 00 00 00 01 2A",
        "FA FF 10 00 F1",
    ]


@pytest.mark.parametrize("protocol", [MTI, OLD_MTI])
def test_what_is_so_already_is_not_written_again(talk, protocol):
    """The unit keeps it in a memory that bears so many writes only."""
    unit = MtiUnit("mark4")
    talk(protocol, Line(unit, on_s=ON_S))
    again = Line(unit, on_s=ON_S)
    _, packets = talk(protocol, again)
    assert len(packets) in ENOUGH
    assert all(len(data) == 5 for data in again.written)  # requests, and changes of state


@pytest.mark.parametrize("state", STATES)
def test_a_first_generation_unit_is_sent_to_its_own_layout(talk, state):
    line = STATES[state](MtiUnit("mark3"))
    with pytest.raises(DeviceError, match=r"no MTData2 \(error 4: .*first gen.* xsens-mti-legacy"):
        talk(MTI, line)


def test_a_unit_that_is_refused_goes_on_measuring(talk):
    unit = MtiUnit("mark3")
    with pytest.raises(DeviceError):
        talk(MTI, measuring(unit))
    assert unit.state == "measurement"


@pytest.mark.parametrize("lost", [1, 3])
@pytest.mark.parametrize("protocol", [MTI, OLD_MTI])
def test_messages_that_get_lost_are_said_again(talk, protocol, lost):
    """Only every so many-th message reaches the unit."""
    line = Line(
        MtiUnit("mark4"), on_s=ON_S, reaches=lambda number, mid: number % (lost + 1) == lost
    )
    _, packets = talk(protocol, line)
    assert len(packets) in ENOUGH


def test_answers_are_found_among_garbage(talk):
    rng = np.random.default_rng(4)
    line = Line(
        MtiUnit("mark4"), on_s=ON_S, garble=lambda data: rng.bytes(20) + data + b"\xfa\xff\x36\x90"
    )
    _, packets = talk(MTI, line)
    assert len(packets) in ENOUGH


@pytest.mark.parametrize("number", range(5))
def test_a_unit_that_starts_anew_in_the_middle_is_held_and_set_up(talk, number):
    unit = MtiUnit("mark4")
    line = Line(unit, on_s=ON_S, reaches=lambda count, mid: count != number or restart())

    def restart():
        line.restart()
        return False

    _, packets = talk(MTI, line)
    assert len(packets) in ENOUGH
    assert [identifier for identifier, _ in unit.memory.outputs] == list(MTI.outputs)


@pytest.mark.parametrize(
    ("protocol", "memory"),
    [
        (MTI, Memory(outputs=[(i, 100) for i in MTI.outputs])),
        (MTI, Memory(outputs=list(NEW))),
        (OLD_MTI, Memory(mode=0x0007)),
    ],
)
def test_a_unit_that_does_not_hear_but_sends_what_is_wanted_is_taken(talk, protocol, memory):
    line = Line(MtiUnit("mark4", memory), on_s=ON_S, reaches=lambda number, mid: False)
    conversation, packets = talk(protocol, line)
    assert len(packets) >= SENT - 1
    assert conversation.device_id is None
    assert len(line.written) == mti.TRIES


@pytest.mark.parametrize(
    ("protocol", "memory", "words"),
    [
        (MTI, Memory(), "does not answer, and sends legacy MTData with 18 bytes: .*mti-legacy"),
        (OLD_MTI, Memory(outputs=list(NEW)), "MTData2 with 1020 1060 4020 8020: .*xsens-mti "),
        (OLD_MTI, Memory(), "18 bytes where the layout xsens-mti-legacy has 58: write a layout"),
        (MTI, Memory(outputs=NEW[2:]), "4020 8020, without 1020, 1060 that the layout"),
    ],
)
def test_a_unit_that_does_not_hear_and_sends_something_else_is_named(talk, protocol, memory, words):
    line = Line(MtiUnit("mark4", memory), on_s=ON_S, reaches=lambda number, mid: False)
    with pytest.raises(DeviceError, match=words):
        talk(protocol, line)


class Scripted:
    """In place of a unit: the same bytes every time that it is heard."""

    now_s = 0.0

    def __init__(self, says=b"", answers=None):
        self.says, self.answers = says, answers or {}
        self.waiting = b""

    def monotonic(self):
        return self.now_s

    def write(self, data):
        (message,), _ = find_messages(data)
        self.waiting += self.answers.get(message.mid, b"")

    def hear(self, seconds):
        self.now_s += seconds
        heard, self.waiting = self.waiting + self.says, b""
        return heard


NOISE = np.random.default_rng(1).bytes(3000)
CHANCE = encode_message(0x57, b"abc")  # one in 16 million places of noise looks like a message
CHANCE_DATA = encode_message(Mid.MT_DATA, b"abc")
OTHER = load_protocol("mpu9150-28")
PACKETS = encode(
    OTHER,
    {
        "seq": np.arange(20),
        "status": 0,
        "time": np.arange(20) * 10_000,
        "accel": [1, 2, 3],
        "gyro": [4, 5, 6],
        "mag": [7, 8, 9],
    },
)


@pytest.mark.parametrize(
    ("says", "kind", "words"),
    [
        (b"", DeviceLost, "neither answers nor sends: check its power"),
        (NOISE, DeviceError, "that are no messages of an MTi: the baud rate is wrong"),
        (b"\x00" * 50, DeviceError, "baud rate"),
        (CHANCE + NOISE, DeviceError, "that are no messages of an MTi"),
        (CHANCE_DATA + NOISE, DeviceError, "that are no messages of an MTi"),
        (PACKETS, DeviceError, "layout mpu9150-28"),
        (encode_message(Mid.CONFIGURATION, bytes(118)), DeviceError, "does not answer the message"),
    ],
)
def test_what_is_no_mti_or_a_silent_one_is_named(talk, says, kind, words):
    with pytest.raises(kind, match=words) as raised:
        talk(MTI, Scripted(says))
    assert type(raised.value) is kind


def answering(**changes):
    """Answers of a unit that takes everything, but for some."""
    answers = {
        Mid.GO_TO_CONFIG: b"",
        Mid.REQ_DID: bytes(4),
        Mid.SET_OUTPUT_CONFIGURATION: b"",
        Mid.SET_PERIOD: b"",
        Mid.SET_OUTPUT_MODE: b"",
        Mid.SET_OUTPUT_SETTINGS: b"",
        Mid.SET_OUTPUT_SKIP_FACTOR: b"",
        Mid.GO_TO_MEASUREMENT: b"",
    }
    frames = {mid: encode_message(answer_to(mid), data) for mid, data in answers.items()}
    return frames | {Mid[name]: frame for name, frame in changes.items()}


def error(number):
    return encode_message(Mid.ERROR, bytes([number]))


@pytest.mark.parametrize(
    ("protocol", "changes", "words"),
    [
        (MTI, {"GO_TO_CONFIG": error(0x28)}, "Config state: error 40: the device itself failed"),
        (MTI, {"SET_OUTPUT_CONFIGURATION": error(0x21)}, "outputs of .*: error 33: a parameter"),
        (
            MTI,
            {"SET_OUTPUT_CONFIGURATION": encode_message(0xC1, bytes.fromhex("1020FFFF1060FFFF"))},
            "does not have the outputs 0810, 4020, 8020, C020, 2010, E020: leave them out",
        ),
        (MTI, {"GO_TO_MEASUREMENT": error(0x1E)}, "begin to measure: error 30: its timer"),
        (MTI, {}, "took every setting, and sends nothing"),
        (OLD_MTI, {"SET_PERIOD": error(0x03)}, "does not run at 100 Hz: error 3: the period"),
        (OLD_MTI, {"SET_OUTPUT_MODE": error(0x21)}, "output mode 0x0007: error 33"),
        (OLD_MTI, {"SET_OUTPUT_SETTINGS": error(0x63)}, "0x00000001: error 99: which its manual"),
        (OLD_MTI, {"SET_OUTPUT_CONFIGURATION": error(0x28)}, "change to the legacy format: err"),
        (OLD_MTI, {"SET_OUTPUT_SKIP_FACTOR": b""}, r"does not answer the message D4 \(SET_OUTPUT"),
        (MTI, {"REQ_DID": encode_message(Mid.ERROR)}, "sends nothing"),
    ],
)
def test_refusals_are_named(talk, protocol, changes, words):
    with pytest.raises(DeviceError, match=words):
        talk(protocol, Scripted(answers=answering(**changes)))


def test_a_rate_that_the_unit_does_not_have_is_named(talk):
    fast = XsensProtocol("fast", rate_hz=1000.0, outputs=(0x1020, 0x1060, 0x4020, 0x8020))
    with pytest.raises(DeviceError, match="4020 at 400 Hz where the layout fast asks for 1000 Hz"):
        talk(fast, Line(MtiUnit("mark4"), on_s=ON_S))


def test_slow_items_may_come_less_often(talk):
    """What a unit measures less often than it sends is absent from most of its messages."""
    protocol = XsensProtocol("air", rate_hz=100.0, outputs=(0x1020, 0x1060, 0x4020, 0x3010))
    _, packets = talk(protocol, Line(MtiUnit("mark4"), on_s=ON_S))
    assert np.isfinite(packets.rows["accel"]).all()
    assert np.mean(np.isfinite(packets.rows["pressure"])) == pytest.approx(0.5, abs=0.02)


@settings(max_examples=15, deadline=None)
@given(st.data())
def test_nothing_that_comes_raises_anything_else(data):
    pieces = st.binary(max_size=30) | st.builds(
        encode_message,
        st.sampled_from([0x31, 0x01, 0xC1, 0x11, 0x42, 0x3E, 0x36, 0x32, 0x05, 0xD1]),
        st.binary(max_size=20),
    )
    says = data.draw(st.lists(pieces, max_size=4).map(b"".join))
    answers = {mid: data.draw(pieces) for mid in answering()}
    line = Scripted(says, answers)
    before, mti.time = mti.time, line
    try:
        for protocol in (MTI, OLD_MTI):
            conversation = conversation_for(protocol)
            with pytest.raises(DeviceError) as raised:
                conversation.begin(line.write, line.hear)
            assert re.fullmatch(r"[ -~]+\.", str(raised.value))
            conversation.heard(says)
            conversation.keep(line.write)
            assert re.fullmatch(r"[ -~]+", conversation.problem or "none")
    finally:
        mti.time = before


def test_what_it_says_while_it_measures_is_kept_for_a_second(talk):
    unit = MtiUnit("mark4")
    line = Line(unit, on_s=ON_S)
    conversation, _ = talk(MTI, line)

    def hear(first=b""):
        conversation.heard(first + line.hear(1.0))
        conversation.keep(line.write)

    hear()
    assert conversation.problem is None
    hear(error(0x1E))
    assert (
        conversation.problem == "reports error 30: its timer overflowed: it cannot keep up "
        "with the rate"
    )
    hear()
    assert conversation.problem is None
    unit.memory.outputs = []  # as if it had been replaced
    hear()
    assert conversation.problem.startswith("sends legacy MTData with 18 bytes: use the layout")


def test_what_comes_is_looked_at_once_a_second_and_not_all_of_a_flood(talk, monkeypatch):
    line = Line(MtiUnit("mark4"), on_s=ON_S)
    conversation, _ = talk(MTI, line)
    looks = []
    monkeypatch.setattr(
        mti, "find_messages", lambda data, *_: looks.append(len(data)) or ([], len(data))
    )
    for _ in range(200):
        conversation.heard(bytes(1 << 14))
    assert looks == []
    conversation.keep(line.write)
    assert len(looks) == 1
    assert looks[0] <= mti.MOST_WAITING_BYTES + (1 << 14)


HALF = {
    "a measurement that lost its end": encode_message(Mid.MT_DATA2, bytes(77))[:20],
    "two": 2 * encode_message(Mid.MT_DATA2, bytes(200))[:20],
    "a length that lies": bytes.fromhex("FAFF36FF00FC"),
}


@pytest.mark.parametrize("half", HALF)
def test_answers_are_found_behind_what_never_ends(talk, half):
    """A unit in its Config state sends no more than its answers: they never fill the frame."""
    ends = iter([HALF[half]])
    line = Line(MtiUnit("mark4"), on_s=ON_S)
    hear, write = line.hear, line.write
    line.write = lambda data: write(data)
    line.hear = lambda seconds: next(ends, b"") + hear(seconds)
    conversation, packets = talk(MTI, line)
    assert conversation.device_id == line.unit.device_id
    assert len(packets) in ENOUGH
    assert len(line.written) <= 5 + 3  # the first message again, a few times


def test_a_unit_that_somebody_stopped_is_sent_back_to_measuring(talk):
    unit = MtiUnit("mark4")
    line = Line(unit, on_s=ON_S)
    conversation, _ = talk(MTI, line)
    said = len(line.written)
    for _ in range(3):
        conversation.heard(line.hear(1.0))
        conversation.keep(line.write)
    assert len(line.written) == said
    unit.receive(encode_message(Mid.GO_TO_CONFIG), line.now_s)
    for _ in range(2):
        conversation.heard(line.hear(1.0))
        conversation.keep(line.write)
    assert unit.state == "measurement"
