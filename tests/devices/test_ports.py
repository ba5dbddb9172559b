"""Ports over real pseudo-terminals and sockets: bytes through, errors in sentences."""

import os
import select
import socket
import struct
import threading
import time
import tty
from contextlib import contextmanager
from pathlib import Path

import pytest

from imu_rig.clock import SystemClock
from imu_rig.devices import ports
from imu_rig.devices.ports import open_port
from imu_rig.devices.reader import PortReader
from imu_rig.errors import DeviceLost, PortError, PortMissing

PATIENCE_S = 10.0


class Terminal:
    """A pseudo-terminal under a stable name that can be pulled and plugged in again."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self.master: int | None = None
        self.plug()

    def plug(self) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.name.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        if self.master is not None:
            self.name.unlink()
            os.close(self.master)
            os.close(self._slave)
            self.master = None

    def write(self, data: bytes) -> None:
        assert os.write(self.master, data) == len(data)

    def read(self, number: int) -> bytes:
        data = b""
        while len(data) < number and select.select([self.master], [], [], PATIENCE_S)[0]:
            data += os.read(self.master, number - len(data))
        return data


@pytest.fixture
def terminal(tmp_path):
    made = Terminal(tmp_path / "ttyIMU")
    yield made
    made.unplug()


@contextmanager
def server():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening, f"socket://127.0.0.1:{listening.getsockname()[1]}"


def wait_until(condition):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def read_all(port, number):
    data = b""
    end = time.monotonic() + PATIENCE_S
    while len(data) < number and time.monotonic() < end:
        data += port.read()
    return data


# --- bytes through ------------------------------------------------------------------------


def test_every_byte_value_passes_both_ways(terminal):
    every = bytes(range(256)) * 8
    port = open_port(str(terminal.name))
    try:
        terminal.write(every)
        assert read_all(port, len(every)) == every
        port.write(every)
        assert terminal.read(len(every)) == every
        assert port.read(timeout_s=0.0) == b""
    finally:
        port.close()
        port.close()


def test_the_same_over_a_socket():
    every = bytes(range(256)) * 64
    with server() as (listening, url):
        port = open_port(url)
        other, _ = listening.accept()
        with other:
            other.sendall(every)
            assert read_all(port, len(every)) == every
            port.write(every)
            assert other.recv(len(every), socket.MSG_WAITALL) == every
        with pytest.raises(DeviceLost, match="has gone"):
            read_all(port, 1)
        port.close()


@pytest.mark.parametrize("linger_s", [None, 0], ids=["closed", "reset"])
def test_a_network_port_that_hangs_up_at_once_may_be_held_by_another_program(linger_s):
    """What a recorder sees that comes second to a device with one connection."""
    with server() as (listening, url):
        port = open_port(url)
        other, _ = listening.accept()
        if linger_s is not None:
            other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, linger_s))
        other.close()
        with pytest.raises(DeviceLost, match=f"{url} closed the connection at once: another"):
            read_all(port, 1)
        port.close()


def test_pyserials_other_urls_work_too():
    port = open_port("loop://")
    port.write(b"\x00\xff")
    assert read_all(port, 2) == b"\x00\xff"
    port.close()


def test_a_device_that_reads_nothing_is_reported_not_waited_for(terminal):
    port = open_port(str(terminal.name))
    with pytest.raises(DeviceLost, match="takes no bytes"):
        port.write(bytes(1_000_000))
    port.close()


# --- opening that fails ---------------------------------------------------------------------


def test_a_missing_port_lists_those_there_are(monkeypatch):
    seen = ports.SeenPort("/dev/ttyACM0", "Maestro command port", 0x1FFB, 0x8A, "00123")
    monkeypatch.setattr(ports, "seen_ports", lambda: [seen])
    with pytest.raises(PortError, match=r"no port /dev/ttyIMU9.*ttyACM0 \(Maestro command port\)"):
        open_port("/dev/ttyIMU9")
    assert seen.is_maestro


def test_a_port_that_is_in_use_says_so(terminal):
    port = open_port(str(terminal.name))
    with pytest.raises(PortError, match="open in another program"):
        open_port(str(terminal.name))
    port.close()
    open_port(str(terminal.name)).close()


def test_a_forbidden_port_names_the_group_and_the_command(terminal, monkeypatch):
    def forbid(*args, **kwargs):
        raise ports.serial.SerialException(13, "could not open port: Permission denied")

    monkeypatch.setattr(ports.serial, "serial_for_url", forbid)
    monkeypatch.setattr(
        ports.grp, "getgrgid", lambda gid: type("Group", (), {"gr_name": "dialout"})
    )
    with pytest.raises(PortError, match=r"dialout.*usermod -aG dialout.*log out and in"):
        open_port(str(terminal.name))


@pytest.mark.parametrize(("name", "word"), [("folder", "a directory"), ("file", "not a device")])
def test_what_is_no_device_is_refused(tmp_path, name, word):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(PortError, match=f"{name} is {word}"):
        open_port(str(tmp_path / name))


def test_a_device_that_is_no_terminal_is_refused():
    with pytest.raises(PortError, match="/dev/null"):
        open_port("/dev/null")


@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
@pytest.mark.parametrize("rest", ["", "localhost", ":80", "host:port", "host:99999", "[::1"])
def test_bad_network_ports_are_explained(scheme, rest):
    with pytest.raises(PortError, match=f"write {scheme}://HOST:PORT") as caught:
        open_port(f"{scheme}://{rest}")
    assert "None" not in str(caught.value)


@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
def test_nobody_listening_is_explained(scheme):
    with server() as (_, url):
        pass
    with pytest.raises(PortMissing, match="refused the connection: nothing listens there"):
        open_port(url.replace("socket", scheme))


@pytest.mark.parametrize("url", ["", "nonsense://x", "/dev", "\0", "[::1", "http://[::1"])
def test_any_other_text_ends_in_a_port_error(url):
    with pytest.raises(PortError):
        open_port(url)


# --- the reader ---------------------------------------------------------------------------


class Heard:
    def __init__(self) -> None:
        self.chunks: list[tuple[int, bytes]] = []

    def __call__(self, t_ns: int, data: bytes) -> None:
        self.chunks.append((t_ns, data))

    @property
    def data(self) -> bytes:
        return b"".join(data for _, data in self.chunks)


def test_the_reader_stamps_what_arrives_and_stops(terminal):
    clock, heard = SystemClock(), Heard()
    reader = PortReader(str(terminal.name), clock, heard, "imu")
    reader.start()
    before = clock.now_ns()
    terminal.write(b"abc")
    wait_until(lambda: heard.data == b"abc")
    assert before <= heard.chunks[0][0] <= clock.now_ns()
    assert reader.alive
    reader.stop()
    assert not reader.alive
    assert reader.error is None
    with pytest.raises(RuntimeError):
        reader.start()


def test_unplugging_ends_the_reader_within_a_second_and_the_name_opens_again(terminal):
    for _ in range(5):
        heard = Heard()
        reader = PortReader(str(terminal.name), SystemClock(), heard, "imu")
        reader.start()
        terminal.write(b"x")
        wait_until(lambda heard=heard: heard.data == b"x")
        pulled = time.monotonic()
        terminal.unplug()
        wait_until(lambda reader=reader: not reader.alive)
        assert time.monotonic() - pulled < 1.0
        assert isinstance(reader.error, DeviceLost)
        assert str(terminal.name) in str(reader.error)
        reader.stop()
        with pytest.raises(PortError):
            open_port(str(terminal.name))
        terminal.plug()


def test_what_the_callback_raises_is_kept(terminal):
    def refuse(t_ns, data):
        raise KeyError("full")

    reader = PortReader(str(terminal.name), SystemClock(), refuse, "imu")
    reader.start()
    terminal.write(b"x")
    wait_until(lambda: reader.error is not None)
    assert isinstance(reader.error, KeyError)
    reader.stop()


def test_a_port_that_does_not_open_raises_where_it_was_asked_for(tmp_path):
    reader = PortReader(str(tmp_path / "ttyNone"), SystemClock(), Heard(), "imu")
    with pytest.raises(PortError):
        reader.start()
    reader.stop()
    assert not reader.alive


def test_a_stream_at_full_speed_arrives_whole(terminal):
    heard = Heard()
    reader = PortReader(str(terminal.name), SystemClock(), heard, "imu")
    reader.start()
    sent = os.urandom(200_000)

    def pour():
        for i in range(0, len(sent), 2000):
            os.write(terminal.master, sent[i : i + 2000])

    writer = threading.Thread(target=pour)
    writer.start()
    writer.join(PATIENCE_S)
    wait_until(lambda: len(heard.data) == len(sent))
    assert heard.data == sent
    stamps = [t for t, _ in heard.chunks]
    assert stamps == sorted(stamps)
    reader.stop()
