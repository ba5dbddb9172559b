"""Serial ports and what stands in for them, with errors a person can act on.

The only module that knows pyserial. Whatever pyserial, the driver or the kernel raise becomes a
`PortError` while a port is being opened and a `DeviceLost` afterwards, in one sentence that names
the port.

Opening sets DTR and RTS as pyserial does by default, both on: boards of the Arduino kind take
that for a reset and begin to send a second or two later.
"""

from __future__ import annotations

import errno
import os
import re
import select
import socket
import stat
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import serial
from serial.tools import list_ports

from firmware_protocols.unconfirmed import MAESTRO_COMMAND_INTERFACE
from imu_rig.errors import DeviceLost, PortError, PortMissing, reason_of
from imu_rig.foreign_text import one_line

try:
    import grp
    import termios

    _TERMIOS_ERRORS: tuple[type[Exception], ...] = (termios.error,)
except ImportError:  # not a POSIX system
    grp = None  # type: ignore[assignment]  # absent on Windows only
    _TERMIOS_ERRORS = ()

DEFAULT_BAUD = 115_200
CHUNK_BYTES = 65_536  # that one read returns at most

# Constants of time.
READ_S = 0.05  # that a read waits for the first byte
WRITE_S = 0.5  # until a device that takes no bytes is called lost
CONNECT_S = 3.0  # for a network port to answer
AT_ONCE_S = 1.0  # within which a network port hangs up on whoever is one too many

MAESTRO_VENDOR = 0x1FFB
FTDI_VENDOR = 0x0403
USB = "usb:"
NETWORK_SCHEMES = ("socket", "rfc2217")

_INTERFACE = re.compile(r":\d+\.(\d+)$")
_SERIAL = re.compile(r"[A-Za-z0-9._-]{1,64}")
"""Serial numbers that an option may hold as they are: a comma would begin another option."""

LONGEST_DESCRIPTION = 60

# SerialException is an OSError
_FAILURES: tuple[type[Exception], ...] = (OSError, ValueError, *_TERMIOS_ERRORS)


@dataclass(frozen=True)
class SeenPort:
    """A serial port that the system lists.

    Attributes
    ----------
    url : str
        What to open: "/dev/ttyACM0", "COM7".
    description : str
        What its driver calls it; empty where it says nothing.
    vendor, product : int or None
        USB identification.
    serial_number : str or None
    location : str or None
        Where on the bus it is and, behind the last dot, which of the device's interfaces.
    """

    url: str
    description: str
    vendor: int | None
    product: int | None
    serial_number: str | None
    location: str | None = None

    @property
    def is_maestro(self) -> bool:
        """Whether this is one of the two ports of a Pololu device."""
        return self.vendor == MAESTRO_VENDOR

    @property
    def interface(self) -> int | None:
        """Which of its device's USB interfaces this port is; None where nothing tells it."""
        found = _INTERFACE.search(self.location or "")
        return None if found is None else int(found[1])


def seen_ports() -> list[SeenPort]:
    """List the serial ports of this machine; simulated ones (pseudo-terminals) are not among them.

    Returns
    -------
    list of SeenPort
        Sorted by name.
    """
    found = []
    for port in list_ports.comports():
        description = "" if port.description in (None, "n/a") else str(port.description)
        description = one_line(description, LONGEST_DESCRIPTION)
        place = getattr(port, "location", None)
        found.append(
            SeenPort(port.device, description, port.vid, port.pid, port.serial_number, place)
        )
    return sorted(found, key=lambda seen: seen.url)


def find_usb(address: str) -> str:
    """Return the port at which a USB device is plugged in now.

    Parameters
    ----------
    address : str
        "usb:SERIAL", "usb:VID:PID" or "usb:VID:PID:SERIAL", vendor and product in hexadecimal. Of
        the two ports of a Maestro it is the command port.

    Raises
    ------
    PortMissing
        If no port belongs to such a device now.
    PortError
        If several do, or the address is none.
    """
    parts = address.removeprefix(USB).split(":", 2)
    try:
        if not parts[-1]:
            raise ValueError
        vendor, product = (int(p, 16) for p in parts[:2]) if len(parts) > 1 else (None, None)
    except ValueError:
        raise PortError(
            f"{address} is no USB address: write usb:SERIAL, usb:VID:PID or usb:VID:PID:SERIAL."
        ) from None
    wanted = parts[0] if len(parts) == 1 else parts[2] if len(parts) == 3 else None
    found = [
        port
        for port in seen_ports()
        if (vendor is None or (port.vendor, port.product) == (vendor, product))
        and (wanted is None or _same_serial(port, wanted))
        and port.vendor is not None
    ]
    found = _command_ports(found)
    if not found:
        raise PortMissing(
            f"No device {address} is plugged in: plug it in and switch it on; {_ports_sentence()}"
        )
    if len(found) > 1:
        names = ", ".join(port.url for port in found)
        raise PortError(f"{address} is more than one port ({names}): name the one you mean.")
    return found[0].url


def usb_address(url: str) -> str | None:
    """Return by what address the device at a port can be found again; None where there is none.

    A device file changes with the order of plugging in, a serial number does not. One with other
    characters than letters, digits, dots and dashes is none that a command could name.
    """
    ports = seen_ports()
    here = next((port for port in ports if port.url == url and port.serial_number), None)
    if here is None or here.vendor is None or here.product is None:
        return None
    if not _SERIAL.fullmatch(here.serial_number or ""):
        return None
    same = [p for p in ports if (p.vendor, p.serial_number) == (here.vendor, here.serial_number)]
    if _command_ports(same) != [here]:  # one device with several ports
        return None
    return f"{USB}{here.vendor:04X}:{here.product:04X}:{here.serial_number}"


def _same_serial(port: SeenPort, wanted: str) -> bool:
    # Windows appends the letter of the channel to FTDI's serial numbers
    seen = port.serial_number
    return seen in (wanted, f"{wanted}A") or (port.vendor == FTDI_VENDOR and f"{seen}A" == wanted)


def _command_ports(found: list[SeenPort]) -> list[SeenPort]:
    """Leave out the TTL ports of Maestros, where the system tells which those are."""
    command = (None, MAESTRO_COMMAND_INTERFACE)
    return [port for port in found if not port.is_maestro or port.interface in command]


class Port(ABC):
    """An open port. One thread may read while another writes.

    Attributes
    ----------
    url : str
        What it was opened by.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self._open = True

    def read(self, timeout_s: float = READ_S) -> bytes:
        """Wait for the first byte at most ``timeout_s`` and return all that is there.

        Raises
        ------
        DeviceLost
            If the port has gone.
        """
        with self._translated("read"):
            return self._read(timeout_s)

    def write(self, data: bytes) -> None:
        """Write all of ``data``.

        Raises
        ------
        DeviceLost
            If the port has gone or takes no bytes.
        """
        with self._translated("write"):
            self._write(data)

    def close(self) -> None:
        """Close the port; a closed or vanished one may be closed again."""
        if self._open:
            self._open = False
            self._close()

    @contextmanager
    def _translated(self, verb: str) -> Iterator[None]:
        if not self._open:
            raise DeviceLost(f"Port {self.url} is closed.")
        try:
            yield
        except serial.SerialTimeoutException as error:
            raise DeviceLost(
                f"{self.url} takes no bytes: the device behind it does not read; "
                "check its power and that this is its port."
            ) from error
        except _FAILURES as error:
            raise DeviceLost(
                f"{self.url} has gone ({verb} failed): the device was unplugged, switched off or "
                "is out of reach."
            ) from error

    @abstractmethod
    def _read(self, timeout_s: float) -> bytes: ...

    @abstractmethod
    def _write(self, data: bytes) -> None: ...

    @abstractmethod
    def _close(self) -> None: ...


def open_port(url: str, *, baud: int = DEFAULT_BAUD) -> Port:
    """Open a serial port for this process alone.

    Parameters
    ----------
    url : str
        A device ("/dev/ttyACM0", "COM7"), a USB device wherever it is plugged in ("usb:SERIAL",
        "usb:VID:PID" or "usb:VID:PID:SERIAL"), "socket://host:port", or any other URL that
        pyserial knows ("rfc2217://", "spy://", "loop://").
    baud : int
        Bits per second; without meaning for USB, Bluetooth and network ports.

    Raises
    ------
    PortError
        If there is no such port, or it may not be opened, or is in use.
    """
    if not url.strip():
        raise PortError("No port is named: `imu-rig devices` lists them.")
    address = _network_address(url)
    if address is not None and url.lower().startswith("socket:"):
        return _SocketPort(url, address)
    device = find_usb(url) if url.startswith(USB) else url
    _check_device_file(device)
    try:
        opened = serial.serial_for_url(
            device, baudrate=baud, timeout=0, write_timeout=WRITE_S, exclusive=True
        )
    except _FAILURES as error:
        raise _not_opened(url, baud, error) from error
    return _SerialPort(url, opened)


class _SerialPort(Port):
    """A port that pyserial opened."""

    def __init__(self, url: str, opened: serial.Serial) -> None:
        super().__init__(url)
        self._serial = opened
        try:
            self._selectable = os.name == "posix" and isinstance(opened.fileno(), int)
        except (OSError, AttributeError):
            self._selectable = False

    def _read(self, timeout_s: float) -> bytes:
        if self._selectable:
            ready, _, _ = select.select([self._serial], [], [], timeout_s)
            return bytes(self._serial.read(CHUNK_BYTES)) if ready else b""
        if self._serial.timeout != timeout_s:
            self._serial.timeout = timeout_s
        first = bytes(self._serial.read(1))
        return first + bytes(self._serial.read(self._serial.in_waiting)) if first else b""

    def _write(self, data: bytes) -> None:
        self._serial.write(data)

    def _close(self) -> None:
        try:
            self._serial.close()
        except _FAILURES:
            return  # it has gone, and its descriptor with it


class _SocketPort(Port):
    """A TCP connection; pyserial's own hands bytes over one by one and sleeps when closed."""

    def __init__(self, url: str, address: tuple[str, int]) -> None:
        super().__init__(url)
        try:
            self._socket = socket.create_connection(address, timeout=CONNECT_S)
        except OSError as error:
            raise _not_reached(url, error) from error
        self._opened_s = time.monotonic()
        self._heard = False
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(WRITE_S)

    def _read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        if not ready:
            return b""
        try:
            data = self._socket.recv(CHUNK_BYTES)
        except ConnectionResetError:
            data = b""
        if not data:
            if not self._heard and time.monotonic() - self._opened_s < AT_ONCE_S:
                raise DeviceLost(
                    f"{self.url} closed the connection at once: another program may hold it; "
                    "close it there (another imu-rig, or another device of this recording)."
                )
            raise ConnectionResetError("the other end closed the connection")
        self._heard = True
        return data

    def _write(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except TimeoutError as error:
            raise serial.SerialTimeoutException("write timeout") from error

    def _close(self) -> None:
        self._socket.close()


def _network_address(url: str) -> tuple[str, int] | None:
    """Return host and number of a network port; None for any other port."""
    scheme = url.partition(":")[0].lower()
    if scheme not in NETWORK_SCHEMES:
        return None
    try:
        parts = urlsplit(url)
        host, number = parts.hostname, parts.port
    except ValueError:
        host, number = None, None
    if not host or number is None:
        raise PortError(
            f"{url} is no network port: write {scheme}://HOST:PORT, for example "
            f"{scheme}://192.168.4.1:3000."
        )
    return host, number


def _not_reached(url: str, error: Exception) -> PortMissing:
    """Say why a network port did not open."""
    if _errno(error) == errno.ECONNREFUSED:
        return PortMissing(
            f"{url} refused the connection: nothing listens there; start the device or the "
            "simulator and check host and port."
        )
    cause = error.__context__ if isinstance(error.__context__, OSError) else error
    return PortMissing(
        f"{url} cannot be reached ({reason_of(cause)}): check host, port and network."
    )


def _check_device_file(url: str) -> None:
    """Refuse what is no device before a driver gets to see it."""
    path = Path(url)
    if "://" in url or not path.is_absolute():
        return
    try:
        mode = path.stat().st_mode
    except OSError:
        return  # opening it tells why
    if not stat.S_ISCHR(mode):
        kind = "a directory" if stat.S_ISDIR(mode) else "not a device"
        raise PortError(f"{url} is {kind}, no serial port; {_ports_sentence()}")


def _not_opened(url: str, baud: int, error: Exception) -> PortError:
    """Say in one sentence why a port did not open and what to do."""
    number = _errno(error)
    if _network_address(url) is not None:
        return _not_reached(url, error)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or isinstance(error, FileNotFoundError):
        return PortMissing(
            f"There is no port {url}: plug the device in and switch it on; {_ports_sentence()}"
        )
    if number in (errno.EHOSTDOWN, errno.ECONNREFUSED, errno.ETIMEDOUT, errno.EHOSTUNREACH):
        return PortMissing(
            f"The Bluetooth device behind {url} does not answer: switch it on, bring it near and "
            "see that it is paired and not connected elsewhere."
        )
    if number in (errno.EACCES, errno.EPERM) or isinstance(error, PermissionError):
        return PortError(_permission_sentence(url))
    if number in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY):
        return PortError(
            f"{url} is open in another program: close it there (a serial monitor, another "
            "imu-rig, ModemManager) and try again."
        )
    if number in (errno.ENOTTY, errno.EINVAL):
        return PortError(
            f"{url} is no serial port or does not know {baud} baud; {_ports_sentence()}"
        )
    return PortError(f"{url} cannot be opened ({reason_of(error)}); {_ports_sentence()}")


def _errno(error: Exception) -> int | None:
    """Error number of an exception or of what caused it; pyserial does not always pass it on."""
    cause: BaseException | None = error
    while cause is not None:
        number: Any = getattr(cause, "errno", None)
        if number is None and isinstance(cause, _TERMIOS_ERRORS) and cause.args:
            number = cause.args[0]
        if isinstance(number, int):
            return number
        cause = cause.__cause__ or cause.__context__
    return None


def _permission_sentence(url: str) -> str:
    try:
        group = None if grp is None else grp.getgrgid(Path(url).stat().st_gid).gr_name
    except (OSError, KeyError):
        group = None
    if group in (None, "root"):
        return (
            f"You may not open {url}: give yourself the right to it (on Linux by a udev rule) or, "
            "on Windows, close the program that holds it."
        )
    return (
        f"You may not open {url}: it belongs to the group {group}. Run "
        f"'sudo usermod -aG {group} $USER', then log out and in again."
    )


def _ports_sentence() -> str:
    try:
        seen = seen_ports()
    except _FAILURES:
        seen = []
    if not seen:
        return "this machine lists no serial ports now."
    names = [f"{p.url} ({p.description})" if p.description else p.url for p in seen[:12]]
    return f"ports seen now: {', '.join(names)}."
