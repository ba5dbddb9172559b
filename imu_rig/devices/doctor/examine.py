"""All checks, in the order of what a session needs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from imu_rig.devices.doctor.bluetooth import check_bluetooth
from imu_rig.devices.doctor.disk import check_disk
from imu_rig.devices.doctor.machine import (
    check_clock,
    check_python,
    check_simulated_ports,
    check_windows_ports,
)
from imu_rig.devices.doctor.maestro import check_maestro
from imu_rig.devices.doctor.serial_ports import check_grabbers, check_latency, check_permissions
from imu_rig.devices.doctor.system import Check, System
from imu_rig.devices.ports import seen_ports


def examine(
    folder: Path,
    maestro: str | None = None,
    system: System | None = None,
    progress: Callable[[str], None] = lambda what: None,
) -> list[Check]:
    """Look at everything.

    Parameters
    ----------
    folder : Path
        Where trials are to be recorded; need not exist yet.
    maestro : str, optional
        Command port of a Maestro that is to be asked; this clears its register of errors.
    system : System, optional
        The machine; otherwise this one.
    progress : callable
        Told what is being looked at.
    """
    system = System.here() if system is None else system
    progress("looking at packages")
    checks = check_python()
    progress("looking at serial ports")
    ports = seen_ports()
    if system.platform == "win32":
        checks += check_windows_ports(system, ports)
    elif system.platform == "linux":
        checks += check_permissions(system) + check_grabbers(system) + check_latency(system)
        checks += check_bluetooth(system)
    progress("asking the Maestro")
    checks += check_maestro(maestro, ports)
    progress(f"writing to {folder}")
    checks += check_disk(system, folder)
    return checks + check_clock(system) + check_simulated_ports(system)
