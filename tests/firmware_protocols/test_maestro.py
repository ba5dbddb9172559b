"""The Maestro's bytes: the worked examples of its guide, and both ends against each other."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocols.maestro import (
    DEFAULT_DEVICE,
    CommandParser,
    GetErrors,
    GetMovingState,
    GetPosition,
    GetScriptStatus,
    GoHome,
    MaestroErrors,
    MiniSscTarget,
    RestartScript,
    RestartScriptWithParameter,
    SetAcceleration,
    SetMultipleTargets,
    SetPwm,
    SetSpeed,
    SetTarget,
    StopScript,
    crc7,
    decode_reply_u16,
    encode,
    encode_reply_u16,
    reply_length,
)

PROTOCOL = MaestroErrors.SERIAL_PROTOCOL
CRC = MaestroErrors.SERIAL_CRC

channels = st.integers(0, 23)
fourteen_bits = st.integers(0, 0x3FFF) | st.sampled_from([0, 0x3FFF])
seven_bits = st.integers(0, 127)


@st.composite
def multiple_targets(draw):
    first = draw(channels)
    targets = draw(st.lists(fourteen_bits, min_size=1, max_size=24 - first))
    return SetMultipleTargets(first, tuple(targets))


OF_BYTES = st.builds(MiniSscTarget, st.integers(0, 23), st.integers(0, 254))
COMMANDS = st.one_of(
    st.builds(SetTarget, channels, fourteen_bits),
    multiple_targets(),
    st.builds(SetSpeed, channels, st.integers(0, 10_000)),
    st.builds(SetAcceleration, channels, st.integers(0, 255)),
    st.builds(SetPwm, fourteen_bits, fourteen_bits),
    st.builds(GetPosition, channels),
    st.builds(RestartScript, seven_bits),
    st.builds(RestartScriptWithParameter, seven_bits, fourteen_bits),
    st.sampled_from([GetMovingState(), GetErrors(), GoHome(), StopScript(), GetScriptStatus()]),
)

# compact form and, where the guide prints it, the Pololu form for device 12
WORKED = [
    (SetTarget(0, 6000), "84 00 70 2E", "AA 0C 04 00 70 2E"),
    (SetTarget(2, 6000), "84 02 70 2E", None),
    (SetTarget(5, 0), "84 05 00 00", None),
    (SetSpeed(5, 140), "87 05 0C 01", "AA 0C 07 05 0C 01"),
    (SetMultipleTargets(3, (0, 6000)), "9F 02 03 00 00 70 2E", "AA 0C 1F 02 03 00 00 70 2E"),
    (SetAcceleration(1, 255), "89 01 7F 01", "AA 0C 09 01 7F 01"),
    (SetPwm(4800, 9600), "8A 40 25 00 4B", "AA 0C 0A 40 25 00 4B"),
    (GetPosition(7), "90 07", "AA 0C 10 07"),
    (GetMovingState(), "93", "AA 0C 13"),
    (GetErrors(), "A1", "AA 0C 21"),
    (GoHome(), "A2", "AA 0C 22"),
    (StopScript(), "A4", "AA 0C 24"),
    (RestartScript(3), "A7 03", "AA 0C 27 03"),
    (RestartScriptWithParameter(3, 6000), "A8 03 70 2E", "AA 0C 28 03 70 2E"),
    (GetScriptStatus(), "AE", "AA 0C 2E"),
]


def parse(data, **settings):
    return CommandParser(**settings).feed(bytes.fromhex(data) if isinstance(data, str) else data)


@pytest.mark.parametrize(("command", "compact", "pololu"), WORKED)
def test_worked_examples(command, compact, pololu):
    assert encode(command) == bytes.fromhex(compact)
    assert parse(compact) == [command]
    if pololu is not None:
        assert encode(command, device=12) == bytes.fromhex(pololu)
        assert parse(pololu) == [command]


def test_mini_ssc_examples():
    assert encode(MiniSscTarget(0, 127)) == bytes.fromhex("FF 00 7F")
    assert parse("FF 00 7F") == [MiniSscTarget(0, 127)]
    # 1023.75, 1500 and 1976.25 us, 15 quarter-us a step
    assert [MiniSscTarget(0, v).target() for v in (0, 127, 254)] == [4095, 6000, 7905]
    assert {b - a for a, b in pairwise(MiniSscTarget(0, v).target() for v in range(255))} == {15}


@pytest.mark.parametrize(
    ("data", "crc"),
    [
        ("83 01", 0x17),
        ("84 00 70 2E", 0x2B),
        ("AA 0C 04 00 70 2E", 0x22),
        ("9F 02 03 00 00 70 2E", 0x24),
    ],
)
def test_crc_examples(data, crc):
    assert crc7(bytes.fromhex(data)) == crc


def test_crc_covers_every_byte_of_the_packet():
    target = SetTarget(0, 6000)
    assert encode(target, crc=True) == bytes.fromhex("84 00 70 2E 2B")
    assert encode(target, device=12, crc=True) == bytes.fromhex("AA 0C 04 00 70 2E 22")
    multiple = SetMultipleTargets(3, (0, 6000))
    assert encode(multiple, crc=True) == bytes.fromhex("9F 02 03 00 00 70 2E 24")
    assert encode(MiniSscTarget(0, 127), crc=True) == bytes.fromhex("FF 00 7F")


def test_position_reply_example():
    assert encode_reply_u16(6000) == bytes.fromhex("70 17")
    assert decode_reply_u16(bytes.fromhex("70 17")) == 6000


@given(st.integers(0, 0xFFFF))
def test_two_byte_replies(value):
    assert decode_reply_u16(encode_reply_u16(value)) == value


def test_replies_of_the_wrong_kind_are_refused():
    with pytest.raises(ValueError, match="1 bytes"):
        decode_reply_u16(b"\x70")
    with pytest.raises(ValueError, match="reply must be 0 to 65535"):
        encode_reply_u16(65536)


def test_reply_lengths():
    asked = {type(c): reply_length(c) for c, _, _ in WORKED}
    replies = {c: n for c, n in asked.items() if n}
    assert replies == {GetPosition: 2, GetErrors: 2, GetMovingState: 1, GetScriptStatus: 1}
    assert reply_length(MiniSscTarget(0, 0)) == 0


@settings(max_examples=60)
@given(
    st.lists(st.tuples(COMMANDS, st.booleans()) | st.tuples(OF_BYTES, st.just(False)), max_size=20),
    st.integers(0, 127),
    st.booleans(),
    st.lists(st.integers(0, 200), max_size=8),
)
def test_what_is_encoded_is_parsed(sent, device, crc, cuts):
    """Every command in every form mixed freely, over its full range, in any chunking."""
    stream = b"".join(
        encode(command, device=device if pololu else None, crc=crc) for command, pololu in sent
    )
    parser = CommandParser(device, crc)
    edges = [0, *sorted(c for c in cuts if c <= len(stream)), len(stream)]
    got = [event for start, stop in pairwise(edges) for event in parser.feed(stream[start:stop])]
    assert got == [command for command, _ in sent]


@given(COMMANDS, st.sampled_from([None, DEFAULT_DEVICE]), st.booleans())
def test_only_the_first_byte_of_a_compact_command_has_its_high_bit(command, device, crc):
    packet = encode(command, device=device, crc=crc)
    assert packet[0] >= 0x80
    assert max(packet[1:], default=0) < 0x80


@given(st.binary(max_size=300), st.lists(st.integers(0, 300), max_size=8), st.booleans())
def test_any_bytes_make_events_and_never_an_exception(data, cuts, crc):
    whole = CommandParser(crc=crc).feed(data)
    parser = CommandParser(crc=crc)
    edges = [0, *sorted(c for c in cuts if c <= len(data)), len(data)]
    assert [e for a, b in pairwise(edges) for e in parser.feed(data[a:b])] == whole
    for event in whole:
        if isinstance(event, MaestroErrors):
            assert event in (PROTOCOL, CRC)
        else:  # what a board takes, a driver can send
            encode(event)


@given(st.lists(st.binary(max_size=12), max_size=10), COMMANDS)
def test_a_command_is_understood_after_any_bytes(noise, command):
    """Two filler bytes complete a Mini SSC packet begun in the noise; then all is in order."""
    parser = CommandParser()
    for data in noise:
        parser.feed(data)
    parser.feed(b"\x00\x00")
    assert parser.feed(encode(command))[-1] == command


@given(COMMANDS, st.integers(0, 6), COMMANDS)
def test_an_interrupted_command_is_a_protocol_error(command, at, following):
    packet = encode(command, device=DEFAULT_DEVICE)
    start = encode(GoHome())
    begun = packet[: 1 + at % (len(packet) - 1)]
    got = parse(start + begun + encode(following))
    assert got == [GoHome(), PROTOCOL, following]


@given(COMMANDS, st.booleans(), st.integers(0, 6))
def test_a_wrong_crc_refuses_the_command(command, pololu, bit):
    packet = bytearray(encode(command, device=DEFAULT_DEVICE if pololu else None, crc=True))
    packet[-1] ^= 1 << bit
    again = encode(GetErrors(), crc=True)
    assert parse(bytes(packet) + again, crc=True) == [CRC, GetErrors()]


@given(COMMANDS, st.integers(0, 127), st.integers(0, 127))
def test_another_device_is_not_addressed(command, addressed, own):
    got = parse(encode(command, device=addressed) + encode(GoHome()), device=own)
    assert got == ([command, GoHome()] if addressed == own else [GoHome()])


@pytest.mark.parametrize(
    ("data", "events"),
    [
        ("85 A1", [PROTOCOL, GetErrors()]),  # a command that there is not
        ("85 01 02 03 A1", [PROTOCOL, GetErrors()]),  # with its data passed over
        ("AA 0C 05 01 A1", [PROTOCOL, GetErrors()]),
        ("2E", [PROTOCOL]),  # data without a command
        ("84 00 70 84 00 70 2E", [PROTOCOL, SetTarget(0, 6000)]),
        ("84 00 70 2E 2E A1", [SetTarget(0, 6000), PROTOCOL, GetErrors()]),
        ("84 18 70 2E", [PROTOCOL]),  # channel 24
        ("9F 02 17 00 00 70 2E", [PROTOCOL]),  # channels 23 and 24
        ("9F 00 00 A1", [PROTOCOL, GetErrors()]),  # no targets
        ("A1 AA 84 00 70 2E", [GetErrors(), PROTOCOL, SetTarget(0, 6000)]),
        ("AA 84 00 70 2E", [SetTarget(0, 6000)]),  # AA tells the baud rate
        ("AA 0C 04 00 70 2E", [SetTarget(0, 6000)]),  # and may begin a packet
        ("AA 0C 84 00 70 2E", [PROTOCOL, SetTarget(0, 6000)]),
        ("AA 0B 04 00 70 2E 70 2E A1", [GetErrors()]),
        ("87 00 7F 7F", [SetSpeed(0, 10_000)]),  # clipped by the board
        ("89 00 7F 7F", [SetAcceleration(0, 255)]),
        ("FF 00 FE FF 17 80", [MiniSscTarget(0, 254), MiniSscTarget(23, 128)]),
        ("FF 00 00 A1", [MiniSscTarget(0, 0), GetErrors()]),  # the guide's way out
        ("FF 03 00 00 A1", [MiniSscTarget(3, 0), PROTOCOL, GetErrors()]),
        ("FF FF 00 7F", [PROTOCOL, MiniSscTarget(0, 127)]),
        ("FF 18 7F A1", [GetErrors()]),  # a servo of another board
    ],
)
def test_what_a_board_makes_of(data, events):
    assert parse(data) == events


def test_mini_ssc_offset_shifts_the_channels():
    data = "FF 07 10 FF 08 10 FF 1F 10 FF 20 10"
    expected = [MiniSscTarget(0, 16), MiniSscTarget(23, 16)]
    assert parse(data, mini_ssc_offset=8) == expected


def test_a_board_with_fewer_channels():
    assert parse("84 05 70 2E 84 06 70 2E", channels=6) == [SetTarget(5, 6000), PROTOCOL]
    assert parse("9F 02 04 00 00 70 2E", channels=6) == [SetMultipleTargets(4, (0, 6000))]
    assert parse("9F 02 05 00 00 70 2E", channels=6) == [PROTOCOL]


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (SetTarget(24, 6000), "channel must be 0 to 23 for a Maestro, not 24"),
        (SetTarget(-1, 6000), "channel must be 0 to 23"),
        (SetTarget(0, 16384), "target must be 0 to 16383"),
        (SetTarget(0, -1), "target must be 0 to 16383"),
        (SetMultipleTargets(20, (0,) * 5), "channel must be 0 to 23"),
        (SetMultipleTargets(0, ()), "the number of targets must be 1 to 24"),
        (SetMultipleTargets(0, (16384,)), "target must be"),
        (SetSpeed(0, 10_001), "speed must be 0 to 10000"),
        (SetAcceleration(0, 256), "acceleration must be 0 to 255"),
        (SetPwm(16384, 0), "on_time must be"),
        (SetPwm(0, 16384), "period must be"),
        (GetPosition(24), "channel must be"),
        (RestartScript(128), "sub must be 0 to 127"),
        (RestartScriptWithParameter(128, 0), "sub must be"),
        (RestartScriptWithParameter(0, 16384), "parameter must be"),
        (MiniSscTarget(255, 0), "servo must be 0 to 254"),
        (MiniSscTarget(0, 255), "value must be 0 to 254"),
    ],
)
def test_numbers_out_of_range_are_refused(command, sentence):
    with pytest.raises(ValueError, match=sentence):
        encode(command)


def test_device_numbers_out_of_range_are_refused():
    with pytest.raises(ValueError, match="device must be 0 to 127"):
        encode(GoHome(), device=128)
    with pytest.raises(ValueError, match="no device number"):
        encode(MiniSscTarget(0, 0), device=12)


def test_error_register_bits():
    names = [
        *["SERIAL_SIGNAL", "SERIAL_OVERRUN", "SERIAL_BUFFER_FULL", "SERIAL_CRC"],
        *["SERIAL_PROTOCOL", "SERIAL_TIMEOUT"],
        *["SCRIPT_STACK", "SCRIPT_CALL_STACK", "SCRIPT_PROGRAM_COUNTER"],
    ]
    assert [MaestroErrors[name].value for name in names] == [1 << bit for bit in range(9)]


@given(st.integers(0, 0xFFFF))
def test_every_register_is_described(register):
    text = MaestroErrors(register).describe()
    assert ("protocol error" in text) == bool(register & 0x10)
    assert ("unknown" in text.replace("command was unknown", "")) == bool(register & 0xFE00)
    assert (text == "no error") == (register == 0)
    assert encode_reply_u16(MaestroErrors(register)) == register.to_bytes(2, "little")
