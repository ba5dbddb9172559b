"""Whose messages count where several systems share a port."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_writer import Writer

from firmware_protocols.known import load_protocol, protocol_from_dict
from firmware_protocols.mavlink_senders import MOST_WAITING, WAIT_S, Sender

SCALED = load_protocol("mavlink-scaled")
HIGHRES = load_protocol("mavlink-highres")
GROUND_STATION, CAMERA = (6, 8), (30, 8)


def asking(**asked):
    return protocol_from_dict({**SCALED.to_dict(), **asked})


def times(protocol, data, decoder=None):
    """Times of the rows that bytes are decoded to; every message here has its own."""
    decoder = decoder or protocol.decoder()
    return decoder.feed(data)["imu"].rows["time"].tolist()


def test_the_first_autopilot_that_beats_counts_and_others_are_named():
    one, two = Writer(1, 1), Writer(7, 100)
    pressure = one("SCALED_PRESSURE", 1, 1000, 0, 0)
    foreign = two("SCALED_PRESSURE", 2, 900, 0, 0)
    data = two.scaled(999) + one.scaled(998) + pressure + one.heartbeat() + two.heartbeat()
    data += b"".join(one.scaled(k) + two.scaled(1000 + k) for k in range(5))
    last, data = len(data), data + foreign + pressure
    decoder = SCALED.decoder()
    packets = decoder.feed(data)
    assert packets["imu"].rows["time"].tolist() == [0, 1, 2, 3, 4]
    assert packets["imu"].rows["seq"].tolist() == [0, 1, 2, 3, 4]
    assert packets["pressure"].rows["pressure"].tolist() == [1000.0]
    assert decoder.sender == Sender(1, 1, 0)
    assert decoder.others == {Sender(7, 100, 0): 5}
    sentence = "system 7 component 100 sends SCALED_IMU too (choose with system, component)"
    assert decoder.take_faults() == {sentence: last}
    assert decoder.take_faults() == {}


def test_who_is_asked_for_counts_at_once_and_nobody_else_is_a_fault():
    one, two = Writer(1, 1), Writer(7, 100)
    data = one.heartbeat() + b"".join(one.scaled(k) + two.scaled(1000 + k) for k in range(3))
    decoder = asking(system=7, component=100).decoder()
    assert times(None, data, decoder) == [1000, 1001, 1002]
    assert decoder.others == {Sender(1, 1, 0): 3}
    assert decoder.take_faults() == {}
    assert times(asking(system=7), data) == []  # until it beats
    assert times(asking(system=7), data + two.heartbeat() + two.scaled(5)) == [5]


@pytest.mark.parametrize("beat", [GROUND_STATION, CAMERA])
def test_what_is_no_autopilot_does_not_count_by_its_heartbeat(beat):
    camera, autopilot = Writer(1, 100), Writer(1, 1)
    data = camera.heartbeat(*beat) + camera.scaled(1) + autopilot.heartbeat() + camera.scaled(2)
    assert times(SCALED, data + autopilot.scaled(3)) == [3]


def test_without_heartbeats_the_first_that_goes_on_for_long_enough_counts():
    stray, sender = Writer(9, 1), Writer(5, 1)
    data = stray.scaled(0)
    data += b"".join(sender.scaled(1000 + 10 * k) for k in range(400))
    decoder = SCALED.decoder()
    first = round(1000 * WAIT_S) + 1000
    assert times(None, data, decoder) == list(range(first, 5000, 10))
    assert decoder.sender == Sender(5, 1, 0)
    late = Writer(1, 1)  # it stays
    assert times(None, late.heartbeat() + late.scaled(7) + sender.scaled(6000), decoder) == [6000]
    assert len(decoder.take_faults()) == 1


def test_a_clock_that_stands_still_does_not_hold_it_up_forever():
    sender = Writer(5, 1)
    assert times(SCALED, b"".join(sender.scaled(7) for _ in range(1990))) == []
    assert times(SCALED, b"".join(sender.scaled(7) for _ in range(2010)))


def test_heartbeats_are_waited_for_by_the_clock_however_fast_messages_come():
    stranger, autopilot = Writer(9, 1), Writer(1, 1)
    data = b"".join(stranger.scaled(k) for k in range(1000)) + autopilot.heartbeat()
    assert times(SCALED, data + autopilot.scaled(5)) == [5]


def test_other_sensors_of_the_same_sender_are_named():
    writer = Writer()
    data = writer.heartbeat() + b"".join(
        writer("HIGHRES_IMU", k, *[1.0] * 9, 1000, 0, 0, 20, 0x1FFF, k % 2) for k in range(6)
    )
    decoder = HIGHRES.decoder()
    decoder.feed(data)
    assert decoder.take_faults() == {
        "sensor 1 sends HIGHRES_IMU too (choose with sensor)": len(data)
    }
    second = protocol_from_dict({**HIGHRES.to_dict(), "sensor": 1}).decoder()
    second.feed(data)
    assert second.take_faults() == {}


def test_a_stretch_of_bytes_is_recognized_without_a_heartbeat():
    data = b"".join(Writer(5, 1).scaled(k) for k in range(5))
    assert times(None, data, SCALED.quick_decoder()) == [0, 1, 2, 3, 4]


def test_countless_senders_that_never_beat_take_little_room():
    data = b"".join(Writer(n // 200, n % 200).scaled(n) for n in range(400))
    decoder = SCALED.decoder()
    assert times(None, data, decoder) == []
    assert len(decoder._choice._waiting) == MOST_WAITING


MESSAGES = st.tuples(st.integers(0, 2), st.sampled_from(["imu", "imu", "imu", "beat", "camera"]))


@settings(max_examples=30)
@given(sent=st.lists(MESSAGES, max_size=40), cuts=st.lists(st.floats(0, 1), max_size=4))
def test_the_choice_does_not_depend_on_chunks_and_never_changes(sent, cuts):
    writers = [Writer(1, 1), Writer(2, 1), Writer(2, 2)]
    pieces = []
    for k, (who, what) in enumerate(sent):
        writer = writers[who]
        beats = {"beat": (2, 3), "camera": CAMERA}
        made = writer.scaled(k * 200) if what == "imu" else writer.heartbeat(*beats[what])
        pieces.append(made)
    data = b"".join(pieces)
    whole = times(SCALED, data)
    decoder, rows, chosen = SCALED.decoder(), [], []
    edges = [0, *sorted(int(c * len(data)) for c in cuts), len(data)]
    for start, stop in pairwise(edges):
        rows += times(None, data[start:stop], decoder)
        chosen.append(decoder._choice.address)
    assert rows == whole
    assert len({address for address in chosen if address is not None}) <= 1
    owner = {k * 200: (1, 1) if who == 0 else (2, who) for k, (who, _) in enumerate(sent)}
    assert {owner[t] for t in rows} <= {chosen[-1]}
    assert np.all(np.diff(rows) > 0)
