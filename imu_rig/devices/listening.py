"""Listen to a port for a while without knowing what is there."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from imu_rig.devices.ports import DEFAULT_BAUD, NETWORK_SCHEMES, open_port
from imu_rig.errors import DeviceLost, PortError

MOST_BYTES = 1 << 18
"""So much is kept, from the beginning on; the rest is only counted."""

READ_S = 0.02
PAUSE_S = 0.003
"""Silence after which what comes next often begins a packet; longer than between two bytes."""

MOST_PAUSES = 1000

COMMON_BAUDS = (115_200, 57_600, 230_400, 460_800, 921_600, 38_400, 19_200, 9_600)
"""The order in which they are tried."""


@dataclass(frozen=True)
class Heard:
    """What a port delivered.

    Attributes
    ----------
    url : str
    baud : int
    data : bytes
        The first of it, at most `MOST_BYTES`.
    span_s : float
        Time that ``data`` took to come; 0 where that cannot be told.
    total : int
        All bytes, also those that were not kept.
    pauses : tuple of int
        Places in ``data`` that came after a pause on the line.
    error : str or None
        Why the port could not be opened, or why listening ended early.
    opened : bool
    """

    url: str
    baud: int
    data: bytes = b""
    span_s: float = 0.0
    total: int = 0
    pauses: tuple[int, ...] = ()
    error: str | None = None
    opened: bool = False

    def rate(self, number: int) -> float | None:
        """Return how many a second ``number`` things in ``data`` are; None if none can tell."""
        return number / self.span_s if self.span_s > 0 else None

    @property
    def bytes_per_s(self) -> float | None:
        """How fast bytes came."""
        return self.rate(len(self.data))


def listen(
    url: str,
    seconds: float,
    baud: int = DEFAULT_BAUD,
    *,
    stop: threading.Event | None = None,
    progress: Callable[[float, int], None] = lambda elapsed_s, total: None,
) -> Heard:
    """Open a port, read what comes, and close it. Nothing is written.

    Opening a port resets some boards (see `imu_rig.devices.ports`), which are silent for a second
    or two then.

    Parameters
    ----------
    url : str
        See `imu_rig.devices.ports.open_port`.
    seconds : float
    baud : int
    stop : threading.Event, optional
        Ends it early.
    progress : callable
        Told the seconds gone and the bytes so far.
    """
    try:
        port = open_port(url, baud=baud)
    except PortError as error:
        return Heard(url, baud, error=str(error))
    kept = bytearray()
    pauses: list[int] = []
    total = first = 0
    begin = time.monotonic()
    first_s = last_s = kept_s = begin
    reason = None
    try:
        while time.monotonic() - begin < seconds and not (stop is not None and stop.is_set()):
            data = port.read(READ_S)
            now = time.monotonic()
            progress(now - begin, total)
            if not data:
                continue
            if not total:
                first, first_s = len(data), now
            elif now - last_s > PAUSE_S and len(pauses) < MOST_PAUSES:
                pauses.append(total)
            last_s = now
            total += len(data)
            if len(kept) < MOST_BYTES:
                kept += data[: MOST_BYTES - len(kept)]
                kept_s = now
    except DeviceLost as error:
        reason = str(error)
    finally:
        port.close()
    # the first piece had come before its time was taken
    after = len(kept) - first
    span_s = (kept_s - first_s) * len(kept) / after if after > 0 else 0.0
    places = tuple(place for place in pauses if place < len(kept))
    return Heard(url, baud, bytes(kept), span_s, total, places, reason, opened=True)


def baud_matters(url: str) -> bool:
    """Return whether a port's baud rate is that of a line: not for Bluetooth, networks, terminals.

    A USB adapter's is; a board with USB of its own (ttyACM) takes any.
    """
    scheme = url.partition("://")[0].lower()
    if scheme in NETWORK_SCHEMES:
        return False
    try:
        real = str(Path(url).resolve()) if url.startswith("/") else url
    except OSError:
        real = url
    return not real.startswith(("/dev/pts/", "/dev/ttyACM", "/dev/rfcomm"))
