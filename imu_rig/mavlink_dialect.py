"""The one way in which pymavlink is imported: its dialect "common", as MAVLink 2 and as MAVLink 1.

The modules of a dialect state their version themselves. The other way, `pymavlink.mavutil`, takes
its version from the environment and speaks MAVLink 1 unless that says otherwise. Loading a dialect
takes a tenth of a second: import this module where it is needed.

In the dialect of MAVLink 1 messages have no extension fields; a frame of version 1 that is made
with the other one has them all the same, and no flight controller sends such a frame.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

__all__ = ["mavlink", "mavlink_1", "packed", "sender"]


@lru_cache(maxsize=1)
def mavlink_1() -> Any:
    """Return the dialect of MAVLink 1."""
    return import_module("pymavlink.dialects.v10.common")


def sender(system: int, component: int, *, version: int = 2) -> Any:
    """Return what encodes messages of a system and component, with their sequence numbers.

    Pass it to ``pack`` of a message of the same version's dialect and raise its ``seq`` by one.
    """
    dialect = mavlink if version == 2 else mavlink_1()
    return dialect.MAVLink(None, srcSystem=system, srcComponent=component)


def packed(sender: Any, message: Any) -> bytes:
    """Return a message as the next frame of its sender."""
    frame = bytes(message.pack(sender))
    sender.seq = (sender.seq + 1) % 256
    return frame
