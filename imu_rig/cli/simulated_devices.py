"""Devices that are not there, for whoever wants to try a command: `--simulate`."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line

if TYPE_CHECKING:
    from imu_rig.recorder.setup import DeviceSetup

MOST_SIMULATED = 16
SKEW_PPM = 10.0  # of the first device's clock; the second's is twice as wrong ...
ALL = "all"


@contextlib.contextmanager
def simulated_devices(text: str, layout: str | None) -> Iterator[tuple[DeviceSetup, ...]]:
    """Serve simulated devices on ports of this machine, and yield how to reach them.

    Parameters
    ----------
    text : str
        Of the option: a number, names of protocols with commas, or "all".
    layout : str or None
        What those speak of which only the number is given.

    Raises
    ------
    InputError
        If there is no such protocol, or no simulator that speaks it, or there are too many.
    """
    from firmware_protocols.layout import DEFAULT_LAYOUT_NAME
    from imu_rig.recorder.setup import DeviceSetup
    from simulators.served_devices import ServedDevices

    wanted = _wanted(text, layout or DEFAULT_LAYOUT_NAME)
    with ServedDevices(transport="tcp" if sys.platform == "win32" else "pty") as served:
        devices = []
        for number, (name, speaks) in enumerate(wanted, 1):
            setup = DeviceSetup(name=name, port="none", layout=speaks)
            try:
                port = served.add(name, setup.protocol(), seed=number, skew_ppm=SKEW_PPM * number)
            except ValueError as error:
                raise InputError(f"--simulate {one_line(text, 60)}: {error}") from error
            devices.append(setup.model_copy(update={"port": port}))
        yield tuple(devices)


def _wanted(text: str, layout: str) -> list[tuple[str, str]]:
    """Names of the devices, and what each speaks."""
    from firmware_protocols.known import builtin_protocols
    from simulators.device_voices import is_spoken

    parts = [part.strip() for part in text.split(",")]
    if parts == [ALL]:
        parts = [name for name, protocol in builtin_protocols().items() if is_spoken(protocol)]
    if all(part.isdecimal() and len(part) < 6 for part in parts):
        count = sum(int(part) for part in parts)
        if not 1 <= count <= MOST_SIMULATED:
            raise InputError(f"--simulate takes 1 to {MOST_SIMULATED} devices, not {count}.")
        return [(f"simulated {number}", layout) for number in range(1, count + 1)]
    if not 1 <= len(parts) <= MOST_SIMULATED or not all(parts):
        raise InputError(
            f"--simulate {one_line(text, 60)!r} names no devices: write how many, or what they "
            f"speak with commas between, 1 to {MOST_SIMULATED} of {', '.join(builtin_protocols())}."
        )
    seen: dict[str, int] = {}
    wanted = []
    for part in parts:
        short = part.rsplit("/", 1)[-1].removesuffix(".toml")[:50]
        seen[short] = seen.get(short, 0) + 1
        wanted.append((short if seen[short] == 1 else f"{short} {seen[short]}", part))
    return wanted
