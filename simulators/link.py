"""The way from a device to its port: bytes in order, each with the moment it arrives."""

from __future__ import annotations

from collections import deque

from simulators.faults import DELAY_S, FaultSet


class Outbox:
    """Bytes on their way to the host, first in, first out."""

    def __init__(self) -> None:
        self._items: deque[tuple[float, bytes]] = deque()
        self._latest_s = 0.0

    def put(self, data: bytes, at_s: float, faults: FaultSet) -> None:
        """Send bytes that arrive at ``at_s``, later if the fault "delayed" is in effect.

        Bytes never overtake one another.
        """
        if faults.has("delayed"):
            at_s += DELAY_S
        self._latest_s = max(self._latest_s, at_s)
        self._items.append((self._latest_s, data))

    def take(self, now_s: float) -> bytes:
        """Return, and forget, what has arrived by now."""
        arrived = bytearray()
        while self._items and self._items[0][0] <= now_s + 1e-9:
            arrived += self._items.popleft()[1]
        return bytes(arrived)

    def clear(self) -> None:
        """Lose what is on its way."""
        self._items.clear()
        self._latest_s = 0.0
