"""Ports of simulated devices: a pseudo-terminal under a stable name, or a TCP socket.

Both are plugged and unplugged, opened again by the next client, and never wait: reading takes what
is there, writing keeps what does not fit in a bounded buffer and drops the oldest bytes beyond it.
Without a client, bytes are lost, as those of a radio that is not connected.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import selectors
import socket
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from imu_rig.errors import PortError, reason_of

if sys.platform != "win32":
    import fcntl
    import termios
    import tty

BUFFER_BYTES = 64 * 1024
"""What a client that does not read can fall behind, besides the system's own buffers."""

CHUNK_BYTES = 4096
LOCALHOST = "127.0.0.1"
LONGEST_LINK = 60

Transport = Literal["pty", "tcp"]
"""Pseudo-terminals, or sockets on this machine."""

_Selector: type[selectors.BaseSelector] = getattr(
    selectors, "PollSelector", selectors.SelectSelector
)


class SimulatedPort(ABC):
    """One end of a connection whose other end any program can open.

    Attributes
    ----------
    dropped : int
        Bytes lost because a client did not read.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting = bytearray()

    @property
    @abstractmethod
    def url(self) -> str:
        """What a client opens; the same for the whole life of the port."""

    @abstractmethod
    def plug(self) -> None:
        """Make the port appear."""

    @abstractmethod
    def unplug(self) -> None:
        """Make the port vanish, also under the feet of a client. Does nothing the second time."""

    @property
    @abstractmethod
    def plugged(self) -> bool:
        """Whether the port is there."""

    @abstractmethod
    def descriptors(self) -> list[int]:
        """Return what to wait on for something to read."""

    @abstractmethod
    def read(self) -> bytes:
        """Return what the client wrote, or nothing."""

    @property
    def connected(self) -> bool:
        """Whether a client has the port open."""
        return self._connected()

    def write(self, data: bytes | memoryview) -> None:
        """Send to the client as much as it takes, and keep the rest for the next call."""
        if not self._connected():
            self._waiting.clear()
            return
        self._waiting += data
        while self._waiting:
            sent = self._send(bytes(self._waiting[:CHUNK_BYTES]))
            if not sent:
                break
            del self._waiting[:sent]
        excess = len(self._waiting) - BUFFER_BYTES
        if excess > 0:
            del self._waiting[:excess]
            self.dropped += excess

    def offer(self, data: bytes) -> int:
        """Send at once what fits, keep nothing, and return how many bytes the client's side took.

        For senders that wait for a slow client instead of dropping bytes.
        """
        return self._send(data) if data and self._connected() else 0

    def all_taken(self) -> bool:
        """Return whether the client has read all that it was sent, as far as that can be told."""
        return True

    def end_of_data(self) -> None:  # noqa: B027  (a terminal has no way to say so)
        """Tell the client that nothing more will come, where the port has a way to do so."""

    @abstractmethod
    def _connected(self) -> bool:
        """Return whether a client has the port open."""

    @abstractmethod
    def _send(self, data: bytes) -> int:
        """Send at once what fits; return how many bytes did."""


class PtyPort(SimulatedPort):
    """A pseudo-terminal behind a symbolic link that outlives unplugging.

    The terminal's slave side is open only while a client has it open, so that its absence can be
    told from the hang-up of the master side. Its raw mode stays with the master.

    Parameters
    ----------
    link : Path
        Where the stable name goes.
    """

    def __init__(self, link: Path) -> None:
        super().__init__()
        self._link = link
        self._master: int | None = None
        self._slave_name = ""
        self._had_client = False

    @property
    def url(self) -> str:
        """Path of the link."""
        return str(self._link)

    @property
    def plugged(self) -> bool:
        """Whether there is a terminal."""
        return self._master is not None

    def plug(self) -> None:
        """Make a terminal, raw and without echo, and point the link at it."""
        if self._master is not None:
            return
        master, slave = os.openpty()
        tty.setraw(slave)
        self._slave_name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(master, False)
        self._master = master
        self._had_client = False
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(self._slave_name)

    def unplug(self) -> None:
        """Take away the link and hang up the terminal."""
        if self._master is None:
            return
        self._link.unlink(missing_ok=True)
        os.close(self._master)
        self._master = None
        self._waiting.clear()

    def descriptors(self) -> list[int]:
        """Return the master while there is a client; a hung-up master would wake all the time."""
        return [] if self._master is None or not self._connected() else [self._master]

    def read(self) -> bytes:
        """Return what the client wrote, also the last words of one that has gone."""
        if self._master is None:
            return b""
        received = bytearray()
        with contextlib.suppress(OSError):  # nothing more to read, or hung up
            while chunk := os.read(self._master, CHUNK_BYTES):
                received += chunk
                if len(received) >= BUFFER_BYTES:
                    break
        return bytes(received)

    def all_taken(self) -> bool:
        """Look from the client's side, which a terminal's master cannot."""
        if self._master is None or not self._connected():
            return True
        try:
            slave = os.open(self._slave_name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:  # locked by the client, or gone
            return True
        try:
            poll = select.poll()
            poll.register(slave, select.POLLIN)
            return not any(event & select.POLLIN for _, event in poll.poll(0))
        finally:
            os.close(slave)

    def _connected(self) -> bool:
        if self._master is None:
            return False
        poll = select.poll()
        poll.register(self._master, 0)
        connected = not any(event & select.POLLHUP for _, event in poll.poll(0))
        if self._had_client and not connected:
            self._forget_client()
        self._had_client = connected
        return connected

    def _forget_client(self) -> None:
        """Drop what the client left unread, and its terminal settings."""
        slave = os.open(self._slave_name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(slave)
            termios.tcflush(slave, termios.TCIFLUSH)
        finally:
            os.close(slave)
        self._waiting.clear()

    def _send(self, data: bytes) -> int:
        if self._master is None:
            return 0
        try:
            return os.write(self._master, data)
        except OSError:  # full, or hung up just now
            return 0


class TcpPort(SimulatedPort):
    """A TCP server on this machine, for one client at a time; a second one is turned away."""

    def __init__(self) -> None:
        super().__init__()
        self._number = 0
        self._server: socket.socket | None = None
        self._client: socket.socket | None = None

    @property
    def url(self) -> str:
        """``socket://`` address for pyserial."""
        return f"socket://{LOCALHOST}:{self._number}"

    @property
    def plugged(self) -> bool:
        """Whether the server listens."""
        return self._server is not None

    def plug(self) -> None:
        """Listen; the first time on a port that the system chooses, then always on that one."""
        if self._server is not None:
            return
        server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            if sys.platform != "win32":  # there it would let two servers share the port
                server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            server.bind((LOCALHOST, self._number))
            server.listen(1)
            server.setblocking(False)
        except OSError as error:
            server.close()
            raise PortError(
                f"TCP port {self._number} of this machine cannot be opened for the simulated "
                f"device ({error.strerror}); end the program that has it."
            ) from error
        self._number = server.getsockname()[1]
        self._server = server

    def unplug(self) -> None:
        """Refuse new connections and close the one there is; a client may try again at once."""
        if self._server is not None:
            self._server.close()
            self._server = None
        self._hang_up()

    def descriptors(self) -> list[int]:
        """Return the server's socket and the client's."""
        return [s.fileno() for s in (self._server, self._client) if s is not None]

    def read(self) -> bytes:
        """Return what the client wrote, and let in a new one."""
        received = self._receive()
        self._accept()
        return received

    def _receive(self) -> bytes:
        received = bytearray()
        while self._client is not None and len(received) < BUFFER_BYTES:
            try:
                chunk = self._client.recv(CHUNK_BYTES)
            except BlockingIOError:
                break
            except OSError:  # reset by the client
                chunk = b""
            if not chunk:
                self._hang_up()
            received += chunk
        return bytes(received)

    def _accept(self) -> None:
        while self._server is not None:
            try:
                client, _ = self._server.accept()
            except OSError:  # nobody there, or gone again
                return
            if self._client is not None:
                client.close()
                continue
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client

    def all_taken(self) -> bool:
        """Ask the system what the client's end has not confirmed."""
        if self._client is None or sys.platform != "linux":
            return True
        try:
            unsent = fcntl.ioctl(self._client, termios.TIOCOUTQ, bytes(4))
        except OSError:
            return True
        return not any(unsent)

    def end_of_data(self) -> None:
        """Close this direction; the client reads on to the end of what was sent."""
        if self._client is not None:
            with contextlib.suppress(OSError):  # the client has gone
                self._client.shutdown(socket.SHUT_WR)

    def _connected(self) -> bool:
        return self._client is not None

    def _send(self, data: bytes) -> int:
        if self._client is None:
            return 0
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:  # reset by the client
            self._hang_up()
            return 0

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
        self._waiting.clear()


def port_maker(
    transport: Transport, resources: ExitStack, folder: Path | None = None
) -> Callable[[str], SimulatedPort]:
    """Return what makes ports of devices by their names, plugged in until ``resources`` close.

    Parameters
    ----------
    transport : str
    resources : ExitStack
        Takes the ports away, and what was made for them.
    folder : Path, optional
        Where pseudo-terminals get their stable names; otherwise a temporary one.

    Raises
    ------
    PortError
        If the folder cannot be made; from the function, if a name or a port cannot be had.
    """
    if transport == "pty":
        if folder is None:
            temporary = tempfile.TemporaryDirectory(prefix="imu-rig-")
            resources.callback(temporary.cleanup)
            folder = Path(temporary.name)
        _require_folder(folder)
    links: list[str] = []

    def make(name: str) -> SimulatedPort:
        port: SimulatedPort
        if folder is None or transport == "tcp":
            port = TcpPort()
        else:
            links.append(_link(name, links))
            _require_free(folder / links[-1])
            port = PtyPort(folder / links[-1])
        resources.callback(port.unplug)
        port.plug()
        return port

    return make


def wait_readable(descriptors: Iterable[int], seconds: float) -> None:
    """Wait until a client writes, for ``seconds`` at most."""
    with _Selector() as selector:
        for descriptor in set(descriptors):
            selector.register(descriptor, selectors.EVENT_READ)
        selector.select(seconds)


def _link(name: str, taken: list[str]) -> str:
    """Return a file name for a device, whatever it is called."""
    number = len(taken) + 1
    word = re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-")[:LONGEST_LINK] or f"source-{number}"
    known = {link.lower() for link in taken}
    while word.lower() in known:
        word += f"-{number}"
    return word


def _require_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PortError(
            f"The folder {folder} for the ports cannot be made ({reason_of(error)})."
        ) from error


def _require_free(link: Path) -> None:
    """Refuse to put a port in the place of anything but the trace of one that is gone."""
    if link.exists():
        raise PortError(
            f"{link} exists already: end the replay that has it, or name another folder."
        )
