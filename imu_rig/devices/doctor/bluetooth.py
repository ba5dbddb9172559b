"""Bluetooth serial devices: bound to a port or not."""

from __future__ import annotations

import re

from imu_rig.devices.doctor.system import Check, System

_ADDRESS = re.compile(r"[0-9A-Fa-f]{2}(:[0-9A-Fa-f]{2}){5}")

BIND = ("bluetoothctl scan on", "bluetoothctl pair ADDRESS", "sudo rfcomm bind 0 ADDRESS 1")
HOW = "To use one, switch it on, pair it and bind it to a port, here /dev/rfcomm0:"


def check_bluetooth(system: System) -> list[Check]:
    """Look which Bluetooth devices are bound to ports, and whether any could be."""
    ports = system.files("dev", "rfcomm[0-9]*")
    if ports:
        told = []
        for port in ports:
            address = system.text("sys/class/tty", port.name, "address") or ""
            to = f" to {address.upper()}" if _ADDRESS.fullmatch(address) else ""
            told.append(f"{system.shown(port)} is bound{to}")
        return [Check("Bluetooth", "ok", f"{'; '.join(told)}. Opening the port connects.")]
    adapters = [path.name for path in system.files("sys/class/bluetooth", "hci*")]
    if not adapters:
        return [
            Check("Bluetooth", "ok", "this machine has no Bluetooth adapter; cables need none.")
        ]
    if system.which("rfcomm") is None:
        return [
            Check(
                "Bluetooth",
                "warn",
                "there is an adapter, but no program rfcomm, which binds serial devices to ports.",
                "It is among BlueZ's older tools (package bluez or bluez-deprecated-tools; on Arch "
                "bluez-deprecated). Needed for Bluetooth sensors only.",
                ("sudo apt install bluez",),
            )
        ]
    return [Check("Bluetooth", "ok", "no serial device is bound to a port.", HOW, BIND)]
