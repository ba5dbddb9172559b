"""What the USB identification of a port says it is."""

from __future__ import annotations

import re

from firmware_protocols.unconfirmed import (
    MAESTRO_COMMAND_INTERFACE,
    MAESTRO_PRODUCTS,
    USB_ADAPTERS,
)
from imu_rig.devices.ports import SeenPort

_INTERFACE = re.compile(r"-if(\d{2})(?:-port\d+)?$")


def usb_name(port: SeenPort, stable_name: str | None = None) -> str:
    """Return what a port is by its USB identification; empty if that says nothing.

    Parameters
    ----------
    port : SeenPort
    stable_name : str, optional
        Its name below /dev/serial/by-id, which tells which of a device's ports it is.
    """
    if port.vendor is None:
        return ""
    if port.is_maestro:
        board = MAESTRO_PRODUCTS.get(port.product or 0, "Maestro")
        number = interface(port, stable_name)
        if number is None:
            return board
        which = "command port" if number == MAESTRO_COMMAND_INTERFACE else "TTL port"
        return f"{board}, {which}"
    names = (USB_ADAPTERS.get((port.vendor, product)) for product in (port.product, None))
    return next((name for name in names if name), "")


def interface(port: SeenPort, stable_name: str | None) -> int | None:
    """Return the number of the USB interface that a port is; None where nothing tells it."""
    found = _INTERFACE.search(stable_name or "")
    return port.interface if found is None else int(found[1])
