"""A replay gives its clients what was recorded, when it was, and nothing else."""

import math
import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
import serial

from imu_rig.clock import NS_PER_S, SteppedClock
from imu_rig.devices.ports import Port, open_port
from imu_rig.errors import DeviceLost, PortError
from simulators import replay_ports
from simulators.recorded_answers import RecordedAnswers
from simulators.replay import FAST, Replay
from simulators.replay_ports import SETTLE_S

PATIENCE_S = 5.0
MS = 1_000_000


def until(condition):
    deadline = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.002)
    return value


def script(*pieces, end_ns=None):
    """Chunks of source "a", or of another where a piece names it, and the end."""
    chunks = [(t, rest[0] if len(rest) == 2 else "a", "in", rest[-1]) for t, *rest in pieces]
    return [*chunks, (end_ns if end_ns is not None else chunks[-1][0], "", "end", b"")]


def read_all(port: Port) -> bytes:
    """Read until the port has gone."""
    data = bytearray()
    deadline = time.monotonic() + PATIENCE_S
    try:
        while time.monotonic() < deadline:
            data += port.read(0.05)
    except DeviceLost:
        return bytes(data)
    pytest.fail("the port stayed")


def read_now(port: Port, count: int = 0) -> bytes:
    """Read so many bytes, which a busy machine may hand over late, and what else is there."""
    data = bytearray()
    deadline = time.monotonic() + PATIENCE_S
    while (piece := port.read(0.02)) or (len(data) < count and time.monotonic() < deadline):
        data += piece
    return bytes(data)


@pytest.fixture(autouse=True)
def short_tail(monkeypatch):
    """Most tests end when the ports have gone, and need no time to hand bytes on."""
    monkeypatch.setattr(replay_ports, "TAIL_S", replay_ports.QUIET_S)


@pytest.fixture(params=["pty", "tcp"])
def transport(request):
    return request.param


def numbered(count: int) -> list[tuple[int, bytes]]:
    return [(0, number.to_bytes(4, "big") * 250) for number in range(count)]


def test_a_client_that_sleeps_in_the_middle_of_a_fast_replay_loses_no_byte(transport):
    """Two megabytes: far more than a terminal and the replay hold together."""
    pieces = numbered(2000)
    with Replay(["a"], script(*pieces), speed=FAST, transport=transport) as replay:
        port = open_port(replay.url("a"))
        got = bytearray()
        while len(got) < 500_000:
            got += port.read()
        if transport == "pty":
            until(lambda: replay.status.state == "held")
        got += read_all(port)
        assert replay.wait(PATIENCE_S)
        port.close()
        assert bytes(got) == b"".join(data for _, data in pieces)
        assert replay.status.lost == {"a": 0}


def test_a_slow_client_makes_the_time_of_all_sources_wait():
    """At 1x everything is due at once; the second source must not run ahead of the first."""
    big = [(0, "slow", bytes(1000)) for _ in range(1000)]
    with Replay(["slow", "other"], script(*big, (1, "other", b"after"))) as replay:
        slow, other = open_port(replay.url("slow")), open_port(replay.url("other"))
        until(lambda: replay.status.state == "held")
        assert other.read(0.05) == b""
        assert len(read_all(slow)) == 1_000_000
        assert read_all(other) == b"after"
        slow.close()
        other.close()


def test_a_read_that_waits_for_more_bytes_gets_the_last_ones(transport, monkeypatch):
    """Reading hands out what it has when its time is over; a port that goes before takes it."""
    monkeypatch.setattr(replay_ports, "TAIL_S", 1.0)
    got = bytearray()
    with Replay(["a"], script((0, b"first"), (MS, b"last")), transport=transport) as replay:
        with serial.serial_for_url(replay.url("a"), timeout=0.6) as port:
            begin = time.monotonic()
            with suppress(serial.SerialException):
                while time.monotonic() - begin < PATIENCE_S:
                    got += port.read(1000)
        assert replay.wait(PATIENCE_S)
    assert bytes(got) == b"firstlast"


def test_at_the_end_a_port_goes_at_once_if_nobody_has_it_or_the_replay_is_stopped(monkeypatch):
    monkeypatch.setattr(replay_ports, "TAIL_S", 1000.0)
    with Replay(["a", "b"], script((0, "a", b"x"), (0, "b", b"y"))) as replay:
        one, two = open_port(replay.url("a")), open_port(replay.url("b"))
        assert (read_now(one, 1), read_now(two, 1)) == (b"x", b"y")
        one.close()
        until(lambda: not os.path.lexists(replay.url("a")))
        waited = replay.wait(0.0)
        assert not waited
        assert "not read to the end" in repr(waited)
        replay.stop()
        assert read_all(two) == b""
        two.close()


def test_nothing_is_sent_before_every_port_has_a_client(transport):
    chunks = script((0, "a", b"first"), (0, "b", b"second"))
    with Replay(["a", "b"], chunks, transport=transport) as replay:
        one = open_port(replay.url("a"))
        waited = replay.wait(3 * SETTLE_S)
        assert not waited
        assert repr(waited) == "<not ended: nobody has open the port of b>"
        assert replay.status.state == "waiting"
        assert replay.status.without_client == ("b",)
        assert one.read(0.0) == b""
        two = open_port(replay.url("b"))
        assert (read_all(one), read_all(two)) == (b"first", b"second")
        one.close()
        two.close()


def test_without_waiting_bytes_that_nobody_reads_are_lost_and_counted():
    chunks = script((0, b"nobody"), (NS_PER_S, b"somebody"))
    with Replay(["a"], chunks, wait=False) as replay:
        until(lambda: replay.status.lost["a"])
        port = open_port(replay.url("a"))
        assert read_all(port) == b"somebody"
        port.close()
        assert replay.status.lost == {"a": len(b"nobody")}
        assert replay.status.sent == {"a": len(b"somebody")}


def test_bytes_keep_the_distances_that_were_recorded():
    """Half as far at twice the speed: a client never sees bytes early."""
    apart = [(n * 100 * MS, bytes([n])) for n in range(4)]
    with Replay(["a"], script(*apart), speed=2.0) as replay:
        begin = time.monotonic()
        port = open_port(replay.url("a"))
        arrivals = []
        while len(arrivals) < 4:
            arrivals += [time.monotonic()] * len(port.read(0.2))
        assert replay.wait(PATIENCE_S)
        port.close()
        late = replay.lateness_s()
    assert all(t - begin > n * 0.05 for n, t in enumerate(arrivals))
    assert len(late) == 4
    assert min(late) >= 0


def test_steps_send_what_is_due_and_nothing_more(transport):
    pieces = (0, b"a"), (NS_PER_S, b"b"), (NS_PER_S, b"c"), (3 * NS_PER_S, b"d")
    chunks = script(*pieces, end_ns=4 * NS_PER_S)
    chunks.insert(1, (5, "a", "out", b"not sent to anybody"))
    clock = SteppedClock(start_ns=77)
    with Replay(["a"], chunks, clock=clock, transport=transport) as replay:
        with pytest.raises(RuntimeError, match="nobody has opened the port of a"):
            replay.step(1.0)
        port = open_port(replay.url("a"))
        assert replay.wait_for_clients(PATIENCE_S)
        assert replay.step_to_next() == 0.0
        assert read_now(port, 1) == b"a"
        replay.step(0.999_999_999)
        assert read_now(port) == b""
        assert replay.step_to_next() == pytest.approx(1e-9)
        assert read_now(port, 2) == b"bc"
        replay.step(1.0)
        assert read_now(port) == b""
        assert replay.status.t_s == 2.0
        assert replay.step_to_next() == 1.0
        assert read_now(port, 1) == b"d"
        assert replay.step_to_next() == 1.0  # the end
        assert replay.step_to_next() is None
        until(lambda: replay.step(0) or replay.status.state == "ended")
        with pytest.raises(DeviceLost):
            read_now(port)
        port.close()


def test_only_a_stepped_clock_is_stepped():
    with Replay(["a"], script((0, b"x"))) as replay, pytest.raises(RuntimeError, match="by itself"):
        replay.step(1.0)


def test_a_loop_begins_anew_until_it_is_stopped():
    chunks = script((0, b"one"), (10, b"two"), end_ns=20)
    with Replay(["a"], chunks, speed=FAST, loop=True) as replay:
        port = open_port(replay.url("a"))
        got = bytearray()
        while len(got) < 600:
            got += port.read()
        assert bytes(got) == (b"onetwo" * 1000)[: len(got)]
        assert replay.status.loops > 50
        port.close()


@pytest.mark.parametrize("unplug", [True, False])
def test_a_port_vanishes_where_it_was_unplugged_if_asked_to(unplug, transport):
    chunks = [
        (0, "a", "in", b"before"),
        (1000, "a", "unplug", b""),
        (50 * MS, "a", "plug", b""),
        (60 * MS, "a", "in", b"after"),
        (60 * MS, "", "end", b""),
    ]
    with Replay(["a"], chunks, transport=transport, unplug_in_gaps=unplug) as replay:
        port = open_port(replay.url("a"))
        first = read_all(port)
        port.close()
        if not unplug:
            assert first == b"beforeafter"
            return
        assert first == b"before"

        def opened():
            try:
                return open_port(replay.url("a"))
            except PortError:
                return None

        again = until(opened)
        assert read_all(again) == b"after"  # it waited for the client to find the port
        again.close()
        assert replay.status.lost == {"a": 0}


def test_an_error_of_the_recording_is_raised_by_who_waits_and_takes_the_ports_away():
    def broken():
        yield (0, "a", "in", b"x")
        raise OSError("the disk was pulled out")

    with Replay(["a"], broken()) as replay:
        port = open_port(replay.url("a"))
        read_all(port)
        port.close()
        with pytest.raises(OSError, match="pulled out"):
            replay.wait(PATIENCE_S)


def test_names_of_sources_never_lead_out_of_the_folder_and_never_meet(tmp_path):
    names = ["../../etc/x", "left shoe", "left-shoe", "LEFT SHOE", "\x1b[2J", "", "é" * 300]
    with Replay(names, script((0, b"")), folder=tmp_path / "ports") as replay:
        links = [os.path.realpath(url) for url in replay.ports().values()]
        assert len(set(links)) == len(names)
        for url in replay.ports().values():
            assert Path(url).parent == tmp_path / "ports"
            assert url.isascii()
    assert list((tmp_path / "ports").iterdir()) == []


def test_a_port_never_takes_the_place_of_a_file(tmp_path):
    (tmp_path / "a").write_text("precious")
    with pytest.raises(PortError, match="exists already"):
        Replay(["a"], script((0, b"x")), folder=tmp_path).start()
    assert (tmp_path / "a").read_text() == "precious"


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_a_speed_that_is_none_is_refused(speed):
    with pytest.raises(ValueError, match="above 0"):
        Replay(["a"], [], speed=speed)


# --- request and reply -------------------------------------------------------------------------

ASKED = [
    (0, b"\xa1", ((MS, b"\x00"), (2 * MS, b"\x00"))),
    (1 * NS_PER_S, b"\x90\x00", ((MS, b"\x10\x27"),)),
    (2 * NS_PER_S, b"\x84\x00\x01\x02", ()),
    (3 * NS_PER_S, b"\x90\x00", ((MS, b"\x20\x27"),)),
]


def answers_of(model, data, t_s=0.0, now_s=0.0):
    replies = model.answer(data, round(t_s * NS_PER_S), now_s)
    return [b"".join(piece for _, piece in reply) for reply in replies]


@pytest.mark.parametrize(
    ("t_s", "reply"), [(0, b"\x10\x27"), (1.9, b"\x10\x27"), (2.1, b"\x20\x27"), (9, b"\x20\x27")]
)
def test_the_reply_nearest_in_time_is_given(t_s, reply):
    assert answers_of(RecordedAnswers(ASKED), b"\x90\x00", t_s) == [reply]


MOVES = [
    (0, b"where?", ((1, b"nowhere"),)),
    (1 * NS_PER_S, b"go left", ()),
    (int(1.1 * NS_PER_S), b"where?", ((1, b"on the way left"),)),
    (2 * NS_PER_S, b"where?", ((1, b"left"),)),
    (9 * NS_PER_S, b"go right", ()),
    (int(9.1 * NS_PER_S), b"where?", ((1, b"on the way right"),)),
    (10 * NS_PER_S, b"where?", ((1, b"right"),)),
    (11 * NS_PER_S, b"go left", ()),
    (int(11.5 * NS_PER_S), b"where?", ((1, b"left again"),)),
]


def test_a_program_that_is_ahead_or_behind_gets_the_answers_to_its_own_commands():
    """The device stands where the program sent it, however late or early that was."""
    model = RecordedAnswers(MOVES)
    for command_s, asked_s, reply in [
        (None, 0.3, b"nowhere"),
        (0.4, 0.5, b"on the way left"),
        (None, 1.4, b"left"),
        (None, 8.0, b"left"),
        (4.0, 4.2, b"on the way right"),
        (None, 5.1, b"right"),
        (10.5, 11.0, b"left again"),
    ]:
        if command_s is not None:
            command = b"go right" if b"right" in reply else b"go left"
            assert answers_of(model, command, command_s) == [b""]
        assert answers_of(model, b"where?", asked_s) == [reply]


def test_a_command_sent_twice_in_a_row_is_the_second_of_the_recording():
    """A servo is first taken hold of where it is, then sent there: the same bytes."""
    asked = [
        (0, b"where?", ((1, b"released"),)),
        (1 * NS_PER_S, b"go", ()),
        (1 * NS_PER_S + 2 * MS, b"go", ()),
        (1 * NS_PER_S + 3 * MS, b"where?", ((1, b"there"),)),
        (5 * NS_PER_S, b"release", ()),
        (6 * NS_PER_S, b"where?", ((1, b"released"),)),
    ]
    model = RecordedAnswers(asked)
    assert answers_of(model, b"gogowhere?", 0.1) == [b"", b"", b"there"]
    assert answers_of(model, b"where?", 3.0) == [b"there"]
    once = RecordedAnswers(asked)
    assert answers_of(once, b"gowhere?", 0.1) == [b"", b"there"]


def test_requests_are_told_apart_however_the_line_cuts_them():
    line = b"\x84\x00\x01\x02\x90\x00\xa1"
    whole = answers_of(RecordedAnswers(ASKED), line)
    assert whole == [b"", b"\x20\x27", b"\x00\x00"]
    byte_by_byte = RecordedAnswers(ASKED)
    assert [r for b in line for r in answers_of(byte_by_byte, bytes([b]))] == whole
    assert byte_by_byte.unknown_bytes == 0


def test_what_was_never_asked_gets_silence_and_does_not_hide_what_follows():
    model = RecordedAnswers(ASKED)
    assert answers_of(model, b"\x90\x05\xa1") == [b"\x00\x00"]
    assert model.unknown_bytes == 2


def test_half_a_request_that_never_goes_on_is_forgotten():
    model = RecordedAnswers(ASKED)
    assert answers_of(model, b"\x84\x00", now_s=0.0) == []
    assert answers_of(model, b"", now_s=1.0) == []
    assert answers_of(model, b"\xa1", now_s=1.0) == [b"\x00\x00"]
    assert model.unknown_bytes == 2


def test_a_long_run_of_the_same_reply_takes_no_memory_and_changes_nothing():
    polls = [(n, b"?", ((1, b"moving" if 3000 <= n < 3003 else b"still"),)) for n in range(9000)]
    model = RecordedAnswers(polls)
    for n in (0, 1500, 2999, 3000, 3001, 3002, 3003, 8999, 99_999):
        expected = b"moving" if 3000 <= n < 3003 else b"still"
        assert answers_of(model, b"?", n / NS_PER_S) == [expected]
    assert len(model._answers[b"?"]) == 6


def test_a_replay_answers_and_keeps_what_it_was_asked(transport):
    end = [(10 * NS_PER_S, "", "end", b"")]
    answering = {"maestro": ASKED}
    with Replay(["maestro"], end, transport=transport, answers=answering) as replay:
        port = open_port(replay.url("maestro"))
        for question, reply in [(b"\xa1", b"\x00\x00"), (b"\x90\x00", b"\x10\x27")]:
            port.write(question)
            got = b""
            deadline = time.monotonic() + PATIENCE_S
            while len(got) < 2 and time.monotonic() < deadline:
                got += port.read(0.1)
            assert got == reply
        port.write(b"\x99")
        until(lambda: replay.unknown_bytes("maestro") == 1)
        assert replay.received("maestro") == b"\xa1\x90\x00\x99"
        port.close()


def test_a_device_answers_while_others_are_not_open_yet():
    chunks = [(0, "imu", "in", b"data"), (10 * NS_PER_S, "", "end", b"")]
    with Replay(["maestro", "imu"], chunks, answers={"maestro": ASKED}) as replay:
        port = open_port(replay.url("maestro"))
        port.write(b"\x90\x00")
        assert port.read(PATIENCE_S)[:1] == b"\x10"
        assert replay.status.state == "waiting"
        port.close()


def test_a_stepped_replay_answers_at_the_next_look():
    end = [(10 * NS_PER_S, "", "end", b"")]
    with Replay(["m"], end, clock=SteppedClock(), answers={"m": ASKED}) as replay:
        port = open_port(replay.url("m"))
        replay.wait_for_clients(PATIENCE_S)
        replay.step(2.9)
        port.write(b"\x90\x00")
        until(lambda: replay.step(0) or replay.received("m"))
        assert read_now(port, 2) == b"\x20\x27"
        port.close()


def test_as_many_sources_as_a_trial_holds_are_served_by_one_thread():
    names = [str(n) for n in range(255)]
    with Replay(names, [(10 * NS_PER_S, "", "end", b"")], wait=False) as replay:
        assert len({os.path.realpath(url) for url in replay.ports().values()}) == 255
        assert sum(thread.name == "replay" for thread in threading.enumerate()) == 1
