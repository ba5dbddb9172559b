"""The Maestro: whether there is one, and whether it listens to its command port."""

from __future__ import annotations

from imu_rig.clock import SystemClock
from imu_rig.devices.doctor.system import Check
from imu_rig.devices.maestro import MaestroClient
from imu_rig.devices.ports import SeenPort
from imu_rig.errors import DeviceError, PortError
from imu_rig.foreign_text import printable


def check_maestro(port: str | None, ports: list[SeenPort]) -> list[Check]:
    """Ask the Maestro on a port for its errors, or say which ports are those of one.

    The answer is the register of errors, which the question clears.
    """
    if port is not None:
        return [_asked(port)]
    seen = [one.url for one in ports if one.is_maestro]
    if not seen:
        return []
    both = len(seen) > 1
    return [
        Check(
            "Maestro",
            "ok",
            f"{' and '.join(seen)} belong{'' if both else 's'} to a Maestro"
            + ("; the first is usually its command port." if both else "."),
            "To ask whether it listens (which clears its register of errors):",
            (f"imu-rig doctor --maestro {seen[0]}",),
        )
    ]


def _asked(port: str) -> Check:
    client = MaestroClient(port, SystemClock())
    try:
        client.open()
        errors = client.errors()
    except PortError as error:
        return Check("Maestro", "bad", str(error))
    except DeviceError as error:
        found, _, advice = str(error).partition(": ")
        return Check("Maestro", "bad", f"{found}.".replace("..", "."), _capital(advice))
    finally:
        client.close()
    shown = printable(port)
    if errors:
        names = ", ".join(str(e.name).lower().replace("_", " ") for e in type(errors) if e & errors)
        return Check(
            "Maestro",
            "warn",
            f"the Maestro on {shown} listens, and had noted errors: {names}; they are cleared now.",
            "Ask again: if they come back, another program writes to its ports.",
        )
    return Check("Maestro", "ok", f"the Maestro on {shown} listens and has noted no errors.")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
