"""The hardware of a session as options describe it, the same for every command that moves a jig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.session.protocol import JigProtocol
    from imu_rig.session.run import SessionSetup

ImuPort = Annotated[str | None, typer.Option("--imu", help="Port of the IMU.")]
MaestroPort = Annotated[str | None, typer.Option("--maestro", help="Command port of the Maestro.")]
JigFile = Annotated[
    str | None,
    typer.Option("--jig", help="Jig: paper-jig, which is taken by default, or a TOML file."),
]
LayoutFile = Annotated[
    str | None,
    typer.Option(
        "--layout",
        help="What the IMU sends: mpu9150-28 (default), another built-in name, or a TOML file.",
    ),
]
StreamName = Annotated[
    str | None,
    typer.Option("--stream", help="Which of several IMUs on the port: foot or waist of two-imu."),
]
Baud = Annotated[int, typer.Option("--baud", help="Baud rate of the IMU's port.")]
MaestroDevice = Annotated[
    int | None,
    typer.Option("--maestro-device", help="Pololu device number, where controllers share a line."),
]
MaestroCrc = Annotated[bool, typer.Option("--maestro-crc", help="The Maestro expects a CRC byte.")]
Simulate = Annotated[
    bool, typer.Option("--simulate", help="Simulated hardware in place of --imu and --maestro.")
]
Speed = Annotated[
    float, typer.Option("--speed", help="How much faster than life, with --simulate.")
]
Seed = Annotated[int, typer.Option("--seed", help="Which simulated hardware.")]

DEFAULT_BAUD = 115200


@dataclass(frozen=True)
class Hardware:
    """What the options of a command say about its hardware."""

    imu: str | None = None
    maestro: str | None = None
    jig: str | None = None
    layout: str | None = None
    baud: int = DEFAULT_BAUD
    maestro_device: int | None = None
    maestro_crc: bool = False
    simulate: bool = False
    seed: int = 1
    speed: float = 1.0
    stream: str | None = None

    def require_ports(self) -> None:
        """Refuse hardware that is neither named nor simulated.

        Raises
        ------
        InputError
            Saying which options to give.
        """
        if not self.simulate and (self.imu is None or self.maestro is None):
            raise InputError(
                "Give the ports with --imu PORT and --maestro PORT, or --simulate to run without "
                "hardware."
            )

    def require_one_kind(self) -> None:
        """Refuse ports beside simulated hardware.

        Raises
        ------
        InputError
            If both were asked for.
        """
        if self.simulate and (self.imu is not None or self.maestro is not None):
            raise InputError("Give either --simulate or the ports --imu and --maestro, not both.")

    def setup(self, protocol: JigProtocol, device: str, serial: str) -> SessionSetup:
        """Return a session's setup.

        Raises
        ------
        InputError
            If the jig or the layout cannot be read, or it is not said which of several IMUs.
        """
        from firmware_protocols.fields import LayoutError
        from firmware_protocols.known import load_protocol
        from firmware_protocols.layout import DEFAULT_LAYOUT_NAME
        from imu_rig.devices.imu import inertial_stream
        from imu_rig.devices.jig import DEFAULT_JIG_NAME, load_jig
        from imu_rig.session.run import SessionSetup

        try:
            layout = load_protocol(self.layout or DEFAULT_LAYOUT_NAME)
        except LayoutError as error:
            raise InputError(str(error)) from error
        inertial_stream(layout, self.stream)
        return SessionSetup(
            imu_url=self.imu or "",
            maestro_url=self.maestro or "",
            layout=layout,
            jig=load_jig(self.jig or DEFAULT_JIG_NAME),
            protocol=protocol,
            device=device,
            serial=serial,
            baud=self.baud,
            maestro_device=self.maestro_device,
            crc=self.maestro_crc,
            stream=self.stream,
        )

    @property
    def options(self) -> str:
        """Options by which a stopped session finds its hardware again."""
        if self.simulate:
            speed = "" if self.speed == 1.0 else f" --speed {self.speed:g}"
            return f"--simulate --seed {self.seed}{speed}"
        options = f"--imu {self.imu} --maestro {self.maestro}"
        if self.baud != DEFAULT_BAUD:
            options += f" --baud {self.baud}"
        if self.maestro_device is not None:
            options += f" --maestro-device {self.maestro_device}"
        return options + (" --maestro-crc" if self.maestro_crc else "")
