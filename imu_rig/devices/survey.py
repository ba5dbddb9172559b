"""What is on the ports of this machine: who speaks there, and how it can be addressed."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from firmware_protocols.known import builtin_protocols
from firmware_protocols.protocol import DeviceProtocol
from firmware_protocols.unconfirmed import MAESTRO_COMMAND_INTERFACE
from imu_rig.clock import SystemClock
from imu_rig.devices.known_messages import known_messages
from imu_rig.devices.listening import COMMON_BAUDS, Heard, baud_matters, listen
from imu_rig.devices.maestro import MaestroClient
from imu_rig.devices.ports import DEFAULT_BAUD, SeenPort, seen_ports, usb_address
from imu_rig.devices.recognize import (
    Recognized,
    explain_unknown,
    find_protocol,
    text_in,
)
from imu_rig.devices.unknown.analysis import UnknownPackets
from imu_rig.devices.unknown.kinds import analyse_kinds
from imu_rig.devices.unknown.variable import VariableFrames, find_frames_of_variable_length
from imu_rig.devices.usb_names import usb_name
from imu_rig.errors import ImuRigError

BY_ID = Path("/dev/serial/by-id")
MOST_AT_ONCE = 16  # ports that are listened to
SHORT_S = 0.7  # at each further baud rate

State = Literal["recognized", "known", "unknown", "text", "noise", "silent", "closed", "listed"]
"""What was found out about a port.

recognized: packets of a known layout. known: a known device that sends no measurements. unknown:
packets of no known layout. text, noise: what the words say. silent: nothing came. closed: it could
not be opened. listed: nobody listened.
"""

Listen = Callable[..., Heard]


@dataclass(frozen=True)
class Finding:
    """What a port was found to be.

    Attributes
    ----------
    state : str
        See `State`.
    heard : Heard
    says : str
        What it is or what is wrong, in half a sentence.
    recognized : Recognized or None
    kinds : tuple of UnknownPackets
        Of packets of no known layout, where that was found.
    frames : VariableFrames or None
    layouts : tuple of str
        Layouts to record a known device with that sends no measurements by itself.
    """

    state: State
    heard: Heard
    says: str
    recognized: Recognized | None = None
    kinds: tuple[UnknownPackets, ...] = ()
    frames: VariableFrames | None = None
    layouts: tuple[str, ...] = ()

    @property
    def rates_hz(self) -> dict[str, float | None]:
        """Packets per second of each stream; empty where no layout was recognized."""
        if self.recognized is None:
            return {}
        return {name: self.heard.rate(n) for name, n in self.recognized.packets.items()}


@dataclass(frozen=True)
class Surveyed:
    """A port, how to address it, and what was found on it.

    Attributes
    ----------
    port : SeenPort
    stable_name : str or None
        Name below /dev/serial/by-id, which stays when the port's number changes.
    address : str
        What to open it by: the stablest there is.
    usb : str or None
        "usb:VID:PID:SERIAL", if that is one port only.
    kind : str
        What its USB identification says it is; empty for others.
    may_open : bool
    finding : Finding
    """

    port: SeenPort
    stable_name: str | None
    address: str
    usb: str | None
    kind: str
    may_open: bool
    finding: Finding


def stable_names(folder: Path = BY_ID) -> dict[str, str]:
    """Return the names of ports that stay, by the device file that each is a link to now."""
    found: dict[str, str] = {}
    try:
        links = sorted(folder.iterdir())
    except OSError:
        return found
    for link in links:
        try:
            found[str(link.resolve(strict=True))] = str(link)
        except (OSError, RuntimeError):  # a link to nowhere or to itself
            continue
    return found


def judge(heard: Heard, protocols: Mapping[str, DeviceProtocol] | None = None) -> Finding:
    """Say what it is that was heard."""
    if not heard.opened:
        return Finding("closed", heard, heard.error or "cannot be opened")
    data = heard.data
    if not data:
        gone = heard.error is not None
        return Finding("closed" if gone else "silent", heard, heard.error or "sends nothing")
    recognized = find_protocol(data, protocols)
    if recognized is not None:
        return Finding("recognized", heard, f"speaks {recognized.name}", recognized)
    messages = known_messages(data)
    if messages is not None:
        return Finding("known", heard, messages.says, layouts=messages.layouts)
    text = text_in(data)
    if text is not None:
        return Finding("text", heard, f"sends text ({text!r})")
    frames = find_frames_of_variable_length(data)
    if frames is not None:
        words = (
            f"sends frames of {min(frames.lengths)} to {max(frames.lengths)} bytes that begin with "
            f"{frames.header.hex(' ').upper()}"
        )
        return Finding("unknown", heard, words, frames=frames)
    kinds = analyse_kinds(data, heard.span_s or None, heard.pauses)
    if kinds:
        each = " and ".join(
            f"{found.length} bytes that begin with {found.header.hex(' ').upper()}"
            for found in kinds
        )
        return Finding("unknown", heard, f"sends packets of {each}", kinds=tuple(kinds))
    baud = heard.baud if baud_matters(heard.url) else None
    return Finding("noise", heard, explain_unknown(data, baud, protocols=protocols))


def find_out(
    url: str,
    seconds: float,
    baud: int | None = None,
    protocols: Mapping[str, DeviceProtocol] | None = None,
    *,
    stop: threading.Event | None = None,
    progress: Callable[[str], None] = lambda what: None,
    listen_to: Listen = listen,
) -> Finding:
    """Listen to a port and say what is there; noise is listened to at other baud rates too.

    Parameters
    ----------
    url : str
    seconds : float
        For the first baud rate; for the others less.
    baud : int, optional
        The only one to try; otherwise the common ones.
    protocols : mapping, optional
        What to recognize; built-in ones by default.
    """
    first = DEFAULT_BAUD if baud is None else baud
    heard = listen_to(
        url,
        seconds,
        first,
        stop=stop,
        progress=lambda gone, total: progress(
            f"listening to {url}: {gone:.0f} of {seconds:.0f} s, {total} bytes"
        ),
    )
    progress(f"looking at what {url} said")
    finding = judge(heard, protocols)
    if finding.state != "noise" or baud is not None or not baud_matters(url):
        return finding
    for other in COMMON_BAUDS:
        if other == first or (stop is not None and stop.is_set()):
            continue
        progress(f"listening to {url} at {other} baud")
        found = judge(listen_to(url, min(seconds, SHORT_S), other, stop=stop), protocols)
        if found.state in ("recognized", "known", "text", "unknown"):
            return found
    return finding


def survey(
    urls: Sequence[str] = (),
    *,
    seconds: float | None = 1.5,
    baud: int | None = None,
    protocols: Mapping[str, DeviceProtocol] | None = None,
    probe: bool = False,
    progress: Callable[[str], None] = lambda what: None,
) -> list[Surveyed]:
    """Look at the ports of this machine, all at once.

    Parameters
    ----------
    urls : sequence of str
        Ports to look at besides those that the system lists, such as simulated ones.
    seconds : float, optional
        How long to listen to each; None to list them only.
    baud : int, optional
        The only baud rate to try.
    protocols : mapping, optional
        What to recognize; built-in ones by default.
    probe : bool
        Ask what is silent whether it is a Maestro. The question clears its register of errors.
    """
    known = builtin_protocols() if protocols is None else protocols
    ports = seen_ports()
    listed = {_device_file(port.url) for port in ports}
    for url in urls:
        if _device_file(url) not in listed:  # one port opened twice would be busy
            listed.add(_device_file(url))
            ports.append(SeenPort(url, "", None, None, None))
    names = stable_names()
    stop = threading.Event()
    if seconds is None:
        found = [Finding("listed", Heard(port.url, baud or DEFAULT_BAUD), "") for port in ports]
    else:
        of_s = seconds

        def look(port: SeenPort) -> Finding:
            finding = find_out(port.url, of_s, baud, known, stop=stop, progress=progress)
            silent = finding.state == "silent"
            if silent and probe and _may_be_maestro(port):
                return _ask_maestro(finding)
            return finding

        with ThreadPoolExecutor(max_workers=MOST_AT_ONCE) as pool:
            try:
                found = list(pool.map(look, ports))
            except BaseException:
                stop.set()
                raise
    return [_described(port, finding, names) for port, finding in zip(ports, found, strict=True)]


def _device_file(url: str) -> str:
    """Return the file that a path leads to; other addresses as they are."""
    return os.path.realpath(url) if url.startswith("/") and "\0" not in url else url


def _described(port: SeenPort, finding: Finding, names: Mapping[str, str]) -> Surveyed:
    stable = names.get(port.url)
    usb = usb_address(port.url)
    return Surveyed(
        port,
        stable,
        usb or stable or port.url,
        usb,
        usb_name(port, stable),
        _may_open(port.url) if finding.state == "listed" else finding.heard.opened,
        finding,
    )


def _may_open(url: str) -> bool:
    return not url.startswith("/") or os.access(url, os.R_OK | os.W_OK)


def _may_be_maestro(port: SeenPort) -> bool:
    """Return whether a port may be asked: not a Maestro's TTL port, nor another USB device."""
    if port.vendor is None:
        return True
    return port.is_maestro and port.interface in (None, MAESTRO_COMMAND_INTERFACE)


def _ask_maestro(finding: Finding) -> Finding:
    client = MaestroClient(finding.heard.url, SystemClock())
    try:
        client.open()
        errors = client.errors()
    except ImuRigError:
        return finding
    finally:
        client.close()
    noted = f", had noted errors ({errors!s})" if errors else ""
    return Finding("known", finding.heard, f"answers as a Maestro's command port{noted}")
