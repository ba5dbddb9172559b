"""Program, packages, clocks and simulated ports of this machine."""

from __future__ import annotations

import os
import re
import sys
import time
from importlib import metadata

from imu_rig.devices.doctor.system import Check, System
from imu_rig.devices.ports import FTDI_VENDOR, SeenPort

PROGRAM = "imu-rig"
LEAST_PYTHON = (3, 11)
EXTRAS = {"parquet": "exports to Parquet", "c3d": "exports to C3D"}

COARSE_CLOCK_S = 1e-3
SLEPT_S = 1.0

_REQUIREMENT = re.compile(r"\s*([A-Za-z0-9._-]+)(?:\[[^\]]*\])?\s*(?:>=\s*([0-9.]+))?")
_EXTRA = re.compile(r"""extra\s*==\s*['"]([^'"]+)['"]""")


def check_python(version: tuple[int, ...] = tuple(sys.version_info[:3])) -> list[Check]:
    """Look at Python and at the packages that imu-rig needs or can use."""
    own = _version(PROGRAM) or "of a folder"
    text = ".".join(map(str, version))
    state = f"imu-rig {own} on Python {text}"
    if version[:2] < LEAST_PYTHON:
        least = ".".join(map(str, LEAST_PYTHON))
        first = Check("Python", "bad", f"{state}: too old.", f"Install Python {least} or newer.")
    else:
        first = Check("Python", "ok", f"{state}.")
    try:
        required = metadata.requires(PROGRAM) or []
    except metadata.PackageNotFoundError:
        return [first]
    return [first, *check_packages(required)]


def check_packages(required: list[str]) -> list[Check]:
    """Look whether packages are there and new enough.

    Parameters
    ----------
    required : list of str
        As a package states them: "numpy>=1.26", "pyarrow>=17; extra == 'parquet'".
    """
    wrong, there, without = [], [], []
    for text in required:
        named, extra = _REQUIREMENT.match(text), _EXTRA.search(text)
        if named is None or (extra is not None and extra[1] not in EXTRAS):
            continue
        name, least = named[1], named[2]
        version = _version(name)
        if version is None and extra is not None:
            without.append((name, extra[1]))
        elif version is None:
            wrong.append(f"{name} is missing")
        elif least is not None and _numbers(version) < _numbers(least):
            wrong.append(f"{name} is {version}, older than {least}")
        else:
            there.append(f"{name} {version}")
    checks = []
    if wrong:
        again = ("python -m pip install --upgrade imu-rig",)
        checks.append(Check("packages", "bad", f"{'; '.join(wrong)}.", "Install it again:", again))
    else:
        checks.append(Check("packages", "ok", f"{', '.join(there)}."))
    checks += [
        Check(
            "packages",
            "ok",
            f"{name} is not installed; only {EXTRAS[extra]} need it.",
            "To have it:",
            (f"python -m pip install 'imu-rig[{extra}]'",),
        )
        for name, extra in without
    ]
    return checks


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version)[:3])


def check_clock(system: System, resolution_s: float | None = None) -> list[Check]:
    """Look how finely the clock counts that stamps arrivals, and whether the machine sleeps."""
    fine = time.get_clock_info("monotonic").resolution if resolution_s is None else resolution_s
    counts = f"arrivals are stamped to {_duration(fine)}"
    if fine > COARSE_CLOCK_S:
        checks = [
            Check(
                "clock",
                "warn",
                f"{counts}: coarse. Devices with a clock of their own are timed well all the same.",
                "Use device layouts that name a clock.",
            )
        ]
    else:
        checks = [Check("clock", "ok", f"{counts}.")]
    slept = slept_s()
    if slept is not None and slept > SLEPT_S:
        checks.append(
            Check(
                "sleep",
                "ok",
                f"this machine has slept for {slept / 60:.0f} min since it was started; a "
                "recording stops meanwhile.",
                "For long recordings keep it awake:",
                ("systemd-inhibit imu-rig record ...",) if system.platform == "linux" else (),
            )
        )
    synchronized = system.path("run", "systemd", "timesync")
    if synchronized.is_dir() and not (synchronized / "synchronized").exists():
        checks.append(
            Check(
                "wall clock",
                "warn",
                "the wall clock has not been set by a time server since the start: dates of "
                "trials may be wrong, times inside them are not.",
                "Connect to the network for a moment, or set the clock.",
            )
        )
    return checks


def slept_s() -> float | None:
    """Return how long this machine has slept since it was started [s]; None where nobody knows."""
    if not hasattr(time, "CLOCK_BOOTTIME"):
        return None
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)


def _duration(seconds: float) -> str:
    for unit, name in ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")):
        if seconds >= unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds / 1e-9:.3g} ns"


def check_simulated_ports(system: System) -> list[Check]:
    """Look whether simulated devices can be put on pseudo-terminals here."""
    if system.platform == "win32":
        found = "this system has no pseudo-terminals; simulated devices use TCP ports (--tcp)."
        return [Check("simulators", "ok", found)]
    try:
        for descriptor in os.openpty():
            os.close(descriptor)
    except (OSError, AttributeError):
        return [
            Check(
                "simulators",
                "warn",
                "no pseudo-terminal can be made: --simulate and the demo need one.",
                "See that /dev/ptmx and /dev/pts are there, or simulate on TCP ports:",
                ("imu-rig simulate rig --tcp",),
            )
        ]
    return [Check("simulators", "ok", "simulated devices can be put on pseudo-terminals.")]


def check_windows_ports(system: System, ports: list[SeenPort]) -> list[Check]:
    """Say what Windows keeps about its ports and where to change it."""
    if system.platform != "win32":
        return []
    named = ", ".join(port.url for port in ports) or "none"
    checks = [Check("serial ports", "ok", f"COM ports now: {named}.")]
    if any(port.vendor == FTDI_VENDOR for port in ports):
        checks.append(
            Check(
                "latency",
                "warn",
                "FTDI adapters keep bytes for 16 ms unless told otherwise.",
                "Device Manager, Ports, the adapter, Port Settings, Advanced: set the latency "
                "timer to 1 ms (in the registry: LatencyTimer under "
                "HKLM\\SYSTEM\\CurrentControlSet\\Enum\\FTDIBUS).",
            )
        )
    return checks
