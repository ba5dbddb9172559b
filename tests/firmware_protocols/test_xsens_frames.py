"""Frames of the MTi: every message that the maker's documents print, and lengths that lie."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocols.variable_framing import find_many, find_short
from firmware_protocols.xsens_frames import (
    ERRORS,
    MAX_DATA,
    XSENS_FORMAT,
    Message,
    Mid,
    answer_to,
    encode_message,
    error_words,
    find_messages,
)

PRINTED = {
    "GoToConfig": (Mid.GO_TO_CONFIG, "", "FA FF 30 00 D1"),
    "GoToConfigAck": (answer_to(Mid.GO_TO_CONFIG), "", "FA FF 31 00 D0"),
    "GoToMeasurement": (Mid.GO_TO_MEASUREMENT, "", "FA FF 10 00 F1"),
    "GoToMeasurementAck": (answer_to(Mid.GO_TO_MEASUREMENT), "", "FA FF 11 00 F0"),
    "WakeUp": (Mid.WAKE_UP, "", "FA FF 3E 00 C3"),
    "WakeUpAck": (Mid.WAKE_UP_ACK, "", "FA FF 3F 00 C2"),
    "ReqDID": (Mid.REQ_DID, "", "FA FF 00 00 01"),
    "DeviceID": (Mid.DEVICE_ID, "00300001", "FA FF 01 04 00 30 00 01 CB"),
    "ReqConfiguration": (Mid.REQ_CONFIGURATION, "", "FA FF 0C 00 F5"),
    "Reset": (Mid.RESET, "", "FA FF 40 00 C1"),
    "Error": (Mid.ERROR, "04", "FA FF 42 01 04 BA"),
    "SetOutputMode": (Mid.SET_OUTPUT_MODE, "0006", "FA FF D0 02 00 06 29"),
    "SetOutputModeAck": (answer_to(Mid.SET_OUTPUT_MODE), "", "FA FF D1 00 30"),
    "SetOutputSettings": (Mid.SET_OUTPUT_SETTINGS, "00000001", "FA FF D2 04 00 00 00 01 2A"),
    "SetPeriod": (Mid.SET_PERIOD, "0480", "FA FF 04 02 04 80 77"),
    "SetOutputSkipFactor": (Mid.SET_OUTPUT_SKIP_FACTOR, "0000", "FA FF D4 02 00 00 2B"),
    "SetOutputConfiguration": (
        Mid.SET_OUTPUT_CONFIGURATION,
        "1020FFFF 1060FFFF 40200064 80200064 C0200064 20100064",
        "FA FF C0 18 1020FFFF 1060FFFF 40200064 80200064 C0200064 20100064 ED",
    ),
    "legacy mode": (Mid.SET_OUTPUT_CONFIGURATION, "00000000", "FA FF C0 04 00 00 00 00 3D"),
    "ReqBaudrate": (Mid.SET_BAUD_RATE, "", "FA FF 18 00 E9"),  # MT0605P, section 5.3.2
    "ReqFWRev, recorded": (Mid.REQ_FIRMWARE, "", "FA FF 12 00 EF"),
    "OutputConfiguration, recorded": (
        answer_to(Mid.SET_OUTPUT_CONFIGURATION),
        "1020FFFF 1060FFFF",
        "FA FF C1 08 10 20 FF FF 10 60 FF FF 9C",
    ),
}

DATA = st.binary(max_size=40) | st.binary(min_size=250, max_size=262)
MESSAGES = st.builds(Message, st.integers(0, 255), DATA)
TRICKY = st.lists(st.sampled_from([0xFA, 0xFF, 0x32, 0x00, 0x05]), max_size=40).map(bytes)


@pytest.mark.parametrize("name", PRINTED)
def test_every_printed_message(name):
    mid, data, frame = PRINTED[name]
    sent = bytes.fromhex(frame)
    assert encode_message(mid, bytes.fromhex(data)) == sent
    assert find_messages(sent) == ([Message(mid, bytes.fromhex(data))], len(sent))


@settings(max_examples=20)
@given(st.lists(MESSAGES, max_size=5))
def test_messages_come_back_as_they_were_sent(messages):
    stream = b"".join(encode_message(m.mid, m.data) for m in messages)
    assert find_messages(stream) == (messages, len(stream))
    if len(stream) > 8:
        assert find_many(XSENS_FORMAT, stream).decided == len(stream)


@settings(max_examples=25)
@given(TRICKY)
def test_preambles_inside_the_data_do_not_matter(data):
    frame = encode_message(0x36, data)
    assert find_messages(frame * 3) == ([Message(0x36, data)] * 3, 3 * len(frame))


@settings(max_examples=25)
@given(st.lists(st.builds(lambda m: encode_message(m.mid, m.data), MESSAGES) | TRICKY, max_size=6))
def test_arrays_find_what_plain_python_finds(pieces):
    stream = b"".join(pieces)
    short, many = find_short(XSENS_FORMAT, stream), find_many(XSENS_FORMAT, stream)
    assert short.starts.tolist() == many.starts.tolist()
    assert short.lengths.tolist() == many.lengths.tolist()
    assert (short.decided, short.corrupt) == (many.decided, many.corrupt)


@pytest.mark.parametrize("size", [0, 254, 255, 256, MAX_DATA])
def test_long_messages_have_two_more_length_bytes(size):
    frame = encode_message(0x36, bytes(size))
    assert len(frame) == size + (5 if size < 255 else 7)
    assert sum(frame[1:]) % 256 == 0
    for missing in range(1, 8):
        assert find_messages(frame[:-missing])[0] == []
    assert find_messages(frame)[0] == [Message(0x36, bytes(size))]


def test_more_data_than_a_message_may_have_is_refused():
    with pytest.raises(ValueError, match="2048"):
        encode_message(0x36, bytes(MAX_DATA + 1))
    too_long = bytes.fromhex("FAFF36FF0801")
    assert find_short(XSENS_FORMAT, too_long + bytes(8)).corrupt == 1
    assert XSENS_FORMAT.longest == len(encode_message(0x36, bytes(MAX_DATA)))


def test_a_wrong_byte_costs_one_message():
    good = encode_message(0x32, bytes(range(54)))
    for place in (0, 1, 2, 20, len(good) - 1):
        hurt = bytearray(good)
        hurt[place] ^= 0x10
        messages, decided = find_messages(good + bytes(hurt) + good * 6)
        assert len(messages) == 7
        assert decided == 8 * len(good)


def test_a_length_that_lies_holds_back_no_more_than_it_says():
    lying = bytes.fromhex("FAFF36F0")
    stream = lying + encode_message(0x32, bytes(20)) * 20
    for size in range(len(stream)):
        found = find_short(XSENS_FORMAT, stream[:size])
        assert size - found.decided <= 0xF0 + 5
    assert len(find_short(XSENS_FORMAT, stream).starts) == 20


def test_headers_all_over_take_bounded_memory():
    stream = bytes.fromhex("FAFF36FF0800") * 6_000
    tracemalloc.start()
    try:
        found = find_many(XSENS_FORMAT, stream)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(found.starts) == 0
    assert len(stream) - found.decided < XSENS_FORMAT.longest
    assert peak < 100 * len(stream)


def test_noise_makes_as_many_messages_as_its_checksum_lets_through():
    """A header is there once in 65536 bytes, and one in 256 of them passes by chance."""
    noise = np.random.default_rng(5).bytes(2_000_000)
    found = find_many(XSENS_FORMAT, noise)
    assert found.corrupt + len(found.starts) == pytest.approx(len(noise) / 65536, abs=5 * 5.5)
    assert len(found.starts) <= 3


def test_every_error_is_named():
    for number, words in ERRORS.items():
        assert error_words(bytes([number])) == f"error {number}: {words}"
    assert "254" in error_words(b"\xfe")
    assert error_words(b"")
