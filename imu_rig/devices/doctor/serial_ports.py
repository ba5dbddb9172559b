"""Serial ports: whether they may be opened, who else wants them, and how long they keep bytes."""

from __future__ import annotations

import stat
from pathlib import Path

from imu_rig.devices.doctor.system import Check, Owner, System
from imu_rig.foreign_text import one_line

PORTS = ("ttyUSB*", "ttyACM*", "rfcomm*", "ttyAMA*")
PORT_GROUPS = ("dialout", "uucp")
"""Groups that own serial ports: on Debian, Ubuntu, Fedora; on Arch and others."""

GOOD_LATENCY_MS = 2
LATENCY_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
LATENCY_FILE = "/etc/udev/rules.d/99-imu-rig-latency.rules"
MODEM_FILE = "/etc/udev/rules.d/99-imu-rig-no-modem.rules"
RELOAD = "sudo udevadm control --reload && sudo udevadm trigger"

BRLTTY_USB = (("1a86", "7523"), ("10c4", "ea60"), ("0403", "6001"))
"""USB adapters that brltty takes for braille displays."""


def check_permissions(system: System) -> list[Check]:
    """Look whether every serial port may be opened, and if not, what would allow it."""
    found = [path for pattern in PORTS for path in system.files("dev", pattern)]
    if not found:
        return [_without_ports(system)]
    return [_permission(system, path) for path in found]


def _without_ports(system: System) -> Check:
    none = "no serial port is there now: no USB adapter is plugged in, no Bluetooth one bound"
    group = next((name for name in PORT_GROUPS if system.has_group(name)), None)
    if group is None or system.uid == 0 or _in_force(system, group):
        return Check("serial ports", "ok", f"{none}.")
    if system.is_member(group):
        return Check(
            "serial ports",
            "warn",
            f"{none}; {system.user} was added to the group {group}, which this session does not "
            "know yet.",
            "Log out and in again (or restart).",
        )
    return Check(
        "serial ports",
        "warn",
        f"{none}; when one is, {system.user} may not open it: such ports belong to the group "
        f"{group}.",
        "Join the group, then log out and in again:",
        (f"sudo usermod -aG {group} {system.user}",),
    )


def _in_force(system: System, group: str) -> bool:
    return any(system.group_name(gid) == group for gid in system.groups)


def _permission(system: System, path: Path) -> Check:
    shown = system.shown(path)
    about = path.name
    try:
        owner = system.owner(path)
    except OSError:
        return Check(about, "warn", f"{shown} vanished while it was looked at.", "Look again.")
    group = system.group_name(owner.gid)
    if system.may_use(path):
        by = _allowed_by(system, owner, group)
        return Check(about, "ok", f"{shown} may be opened ({by}).")
    if group is None or group == "root" or not owner.mode & stat.S_IWGRP:
        heir = next((name for name in PORT_GROUPS if system.has_group(name)), PORT_GROUPS[0])
        rule = f'KERNEL=="{path.name.rstrip("0123456789")}*", MODE="0660", GROUP="{heir}"'
        return Check(
            about,
            "bad",
            f"{shown} may not be opened: it belongs to {group or owner.gid} alone.",
            f"Give it to the group {heir} by a udev rule, and plug it in again:",
            (f"echo '{rule}' | sudo tee /etc/udev/rules.d/99-imu-rig-ports.rules", RELOAD),
        )
    if system.is_member(group):
        return Check(
            about,
            "bad",
            f"{shown} may not be opened yet: {system.user} was added to the group {group} after "
            "logging in.",
            "Log out and in again (or restart).",
        )
    return Check(
        about,
        "bad",
        f"{shown} may not be opened: it belongs to the group {group}, {system.user} does not.",
        "Join the group, then log out and in again:",
        (f"sudo usermod -aG {group} {system.user}",),
    )


def _allowed_by(system: System, owner: Owner, group: str | None) -> str:
    if system.uid == 0:
        return "as root"
    if owner.uid == system.uid and owner.mode & stat.S_IWUSR:
        return f"it belongs to {system.user}"
    if owner.gid in system.groups and owner.mode & stat.S_IWGRP:
        return f"group {group or owner.gid}"
    if owner.mode & stat.S_IWOTH:
        return "by anybody"
    return "by an access list"


def check_grabbers(system: System) -> list[Check]:
    """Look for programs that take serial ports for themselves."""
    processes = system.processes()
    names = {name for _, name in processes}
    checks = []
    if "ModemManager" in names:
        checks.append(
            Check(
                "ModemManager",
                "warn",
                "ModemManager runs: it opens new ports and sends modem commands to them, which a "
                "Maestro takes for errors.",
                "Keep it off serial devices, then plug them in again:",
                (
                    f'echo \'ENV{{ID_BUS}}=="usb", SUBSYSTEM=="tty", '
                    f'ENV{{ID_MM_DEVICE_IGNORE}}="1"\' | sudo tee {MODEM_FILE}',
                    RELOAD,
                ),
            )
        )
    if "brltty" in names or _brltty_rule(system):
        plugged = _usb_ids(system)
        taken = [
            f"{vendor}:{product}" for vendor, product in BRLTTY_USB if (vendor, product) in plugged
        ]
        if "brltty" in names or taken:
            devices = f" ({', '.join(taken)} is one)" if taken else ""
            checks.append(
                Check(
                    "brltty",
                    "warn",
                    "brltty, for braille displays, takes some USB adapters as soon as they are "
                    f"plugged in{devices}; their port then vanishes.",
                    "If nobody here reads braille, remove it and plug the adapter in again:",
                    ("sudo apt remove brltty",),
                )
            )
    return checks + _holders(system, processes)


def _brltty_rule(system: System) -> bool:
    folders = ("usr/lib/udev/rules.d", "lib/udev/rules.d", "etc/udev/rules.d")
    return any(system.files(folder, "*brltty*.rules") for folder in folders)


def _usb_ids(system: System) -> set[tuple[str, str]]:
    found = set()
    for folder in system.files("sys/bus/usb/devices", "*"):
        vendor = system.text("sys/bus/usb/devices", folder.name, "idVendor")
        product = system.text("sys/bus/usb/devices", folder.name, "idProduct")
        if vendor and product:
            found.add((vendor.lower(), product.lower()))
    return found


def _holders(system: System, processes: list[tuple[int, str]]) -> list[Check]:
    """Return which programs have a port open, as far as this user may see it."""
    ports = {system.shown(p): p.name for pattern in PORTS for p in system.files("dev", pattern)}
    held: dict[str, list[str]] = {}
    for number, name in processes if ports else []:
        for descriptor in system.files(f"proc/{number}/fd", "*"):
            try:
                target = str(descriptor.readlink())
            except OSError:
                continue
            if target in ports:
                held.setdefault(target, []).append(f"{one_line(name, 20)} (process {number})")
    return [
        Check(
            ports[port],
            "warn",
            f"{port} is open in {', '.join(sorted(set(programs)))}: a port serves one program.",
            "Close it there before a session or a recording.",
        )
        for port, programs in sorted(held.items())
    ]


def check_latency(system: System) -> list[Check]:
    """Look how long FTDI adapters keep bytes before they hand them on."""
    checks = []
    for folder in system.files("sys/bus/usb-serial/devices", "*"):
        text = system.text("sys/bus/usb-serial/devices", folder.name, "latency_timer")
        if text is None or not text.isdecimal():
            continue
        path = f"/sys/bus/usb-serial/devices/{folder.name}/latency_timer"
        milliseconds = int(text[:6])
        if milliseconds <= GOOD_LATENCY_MS:
            found = f"the FTDI adapter {folder.name} hands bytes on within {milliseconds} ms."
            checks.append(Check("latency", "ok", found))
            continue
        checks.append(
            Check(
                "latency",
                "warn",
                f"the FTDI adapter {folder.name} keeps bytes for up to {milliseconds} ms: samples "
                "come in clumps, and times of devices without a clock are that uncertain.",
                "The first until it is unplugged, the others for good:",
                (
                    f"echo 1 | sudo tee {path}",
                    f"echo '{LATENCY_RULE}' | sudo tee {LATENCY_FILE}",
                    RELOAD,
                ),
            )
        )
    return checks
