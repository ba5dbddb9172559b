"""Both kinds of ports keep the same promises to their clients."""

import os
import time
from collections.abc import Callable, Iterator

import pytest
import serial

from simulators.ports import BUFFER_BYTES, PtyPort, SimulatedPort, TcpPort

PATIENCE_S = 5.0


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.002)


@pytest.fixture(params=["pty", "tcp"])
def port(request, tmp_path) -> Iterator[SimulatedPort]:
    made = PtyPort(tmp_path / "device") if request.param == "pty" else TcpPort()
    made.plug()
    yield made
    made.unplug()


def opened(port: SimulatedPort) -> serial.SerialBase:
    client = serial.serial_for_url(port.url, timeout=0.2)
    until(lambda: port.read() == b"" and port._connected())
    return client


def read_on(client: serial.SerialBase) -> None:
    for _ in range(50):
        client.read(1)


def received(port: SimulatedPort, number: int) -> bytes:
    got = bytearray()
    until(lambda: got.extend(port.read()) or len(got) >= number)
    return bytes(got)


def test_every_byte_passes_unchanged_in_both_directions(port):
    everything = bytes(range(256)) * 4
    with opened(port) as client:
        client.write(everything)
        assert received(port, len(everything)) == everything
        port.write(everything)
        assert client.read(len(everything)) == everything


def test_bytes_without_a_client_are_lost_and_do_not_wait_for_the_next(port):
    port.write(b"nobody hears this")
    with opened(port) as client:
        port.write(b"first")
        assert client.read(5) == b"first"
    until(lambda: port.read() == b"" and not port._connected())
    port.write(b"nobody hears this either")
    with opened(port) as client:
        port.write(b"second")
        assert client.read(100) == b"second"


def test_what_a_client_left_unread_is_gone_for_the_next(port):
    with opened(port):
        port.write(b"unread" * 100)
    until(lambda: port.read() == b"" and not port._connected())
    with opened(port) as client:
        port.write(b"fresh")
        assert client.read(100) == b"fresh"


def test_the_last_words_of_a_client_that_leaves_are_heard(port):
    with opened(port) as client:
        client.write(b"park!")
    assert received(port, 5) == b"park!"


def test_a_client_that_does_not_read_stalls_nothing_and_loses_the_oldest(port):
    with opened(port) as client:
        sent = 0
        while port.dropped == 0:
            port.write(sent.to_bytes(4, "big") * 256)
            sent += 1
            assert sent < 20_000, "nothing was ever dropped"
        assert len(port._waiting) <= BUFFER_BYTES
        client.timeout = 0.05
        got = bytearray()
        while chunk := client.read(4096):
            got += chunk
            port.write(b"")
        assert got[-4:] == (sent - 1).to_bytes(4, "big")
        assert len(got) + port.dropped == sent * 1024


def test_unplugging_reaches_the_client_and_replugging_restores_the_name(port):
    name = port.url
    with opened(port) as client:
        port.unplug()
        assert not port.plugged
        with pytest.raises(OSError):  # noqa: PT011  (each kind of port has its own text)
            read_on(client)
    with pytest.raises(serial.SerialException):
        serial.serial_for_url(name, timeout=0.2)
    port.write(b"lost")
    port.plug()
    assert port.url == name
    with opened(port) as client:
        port.write(b"back")
        assert client.read(4) == b"back"


def test_plug_and_unplug_twice_change_nothing(port):
    port.plug()
    port.unplug()
    port.unplug()
    assert port.read() == b""
    assert port.descriptors() == []


def test_a_pty_is_raw_for_clients_that_set_nothing_also_after_one_that_did(tmp_path):
    import termios

    port = PtyPort(tmp_path / "device")
    port.plug()
    try:
        spoiler = os.open(port.url, os.O_RDWR | os.O_NOCTTY)
        until(port._connected)
        attributes = termios.tcgetattr(spoiler)
        attributes[3] |= termios.ECHO | termios.ICANON
        termios.tcsetattr(spoiler, termios.TCSANOW, attributes)
        os.close(spoiler)
        until(lambda: not port._connected())
        plain = os.open(port.url, os.O_RDWR | os.O_NOCTTY)
        try:
            until(port._connected)
            port.write(b"\x03\r\x04\x11\n")
            assert os.read(plain, 10) == b"\x03\r\x04\x11\n"
            assert port.read() == b""
        finally:
            os.close(plain)
    finally:
        port.unplug()


def test_a_second_tcp_client_is_turned_away():
    port = TcpPort()
    port.plug()
    try:
        with opened(port) as first:
            second = serial.serial_for_url(port.url, timeout=0.2)
            port.read()
            with pytest.raises(serial.SerialException):
                read_on(second)
            second.close()
            port.write(b"mine")
            assert first.read(4) == b"mine"
    finally:
        port.unplug()
