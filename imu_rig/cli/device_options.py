"""Options that say which devices to read, the same for every command that reads some."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Devices = Annotated[
    list[str] | None,
    typer.Option(
        "--device",
        "-d",
        help='A device: PORT or NAME=PORT, as in "left shoe=/dev/ttyUSB0". What is unusual '
        "follows, with commas: layout=xsens-mti, baud=460800, certificate=FILE, optional, or "
        "optional=STREAM for one of several on a port. Repeat it for each device.",
    ),
]
SetupFile = Annotated[
    Path | None,
    typer.Option("--setup", help="TOML file of devices, jig and trial; options replace and add."),
]
LayoutName = Annotated[
    str | None,
    typer.Option(
        "--layout",
        help="What every --device that states none speaks: a name such as mpu9150-28 or xsens-mti, "
        "or a TOML file.",
    ),
]
Simulated = Annotated[
    str | None,
    typer.Option(
        "--simulate",
        metavar="N or NAMES",
        help="Simulated devices instead: how many, or what they speak, as in "
        "mpu9150-28,adis16405-36; all is one of each.",
    ),
]
