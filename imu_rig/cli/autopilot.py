"""`imu-rig devices autopilot`: what a flight controller corrects its sensors with itself."""

from __future__ import annotations

import json
import sys
from contextlib import closing
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_rig.cli.options import Json, Quiet
from imu_rig.errors import DeviceError, DeviceLost, InputError

if TYPE_CHECKING:
    from imu_rig.devices.mavlink_questions import Parameters

INDENT = 13
LONGEST_NAME = 16
ENCODINGS = {
    "bytewise": "whole numbers travel as their bytes",
    "cast": "whole numbers travel as floats",
    None: "it does not say how whole numbers travel; taken as their bytes",
}


def autopilot(
    port: Annotated[str, typer.Argument(help="Port of the flight controller, or any URL.")],
    parameter: Annotated[
        list[str] | None,
        typer.Option("--parameter", "-p", help="Read this one instead; may be repeated."),
    ] = None,
    baud: Annotated[int, typer.Option("--baud", help="Baud rate of the port.")] = 115_200,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Ask a flight controller for what it corrects its sensors with, by MAVLink."""
    from imu_rig.cli.status_line import StatusLine
    from imu_rig.devices.mavlink_questions import read_parameters
    from imu_rig.devices.ports import open_port

    for name in parameter or ():
        if not (name.isascii() and name.isprintable() and 1 <= len(name) <= LONGEST_NAME):
            raise InputError(f"{name!r} is no name of a parameter: it has up to 16 letters.")
    with closing(StatusLine(quiet=quiet, silent_s=1.0)) as line:
        opened = open_port(port, baud=baud)
        try:
            line.show(f"asking the flight controller on {port}")
            found = read_parameters(opened.write, opened.read, parameter or None)
        except DeviceLost as error:
            raise DeviceLost(f"{port}: {error}") from error
        except DeviceError as error:
            raise DeviceError(f"{port}: {error}") from error
        finally:
            opened.close()
    if as_json:
        sys.stdout.write(json.dumps(_json(port, found)) + "\n")
    else:
        _print(port, found, named=bool(parameter))


def _json(port: str, found: Parameters) -> dict[str, Any]:
    return {
        "port": port,
        "autopilot": found.autopilot,
        "encoding": found.encoding,
        "parameters": {name: _number(found.value(name)) for name in found.values},
        "missing": list(found.missing),
        "own_calibration": {name: _number(v) for name, v in found.own_calibration.items()},
        "contradictions": list(found.contradictions),
    }


def _number(value: float) -> float | None:
    """Return a number as JSON has it: NaN is none."""
    return None if value != value or abs(value) == float("inf") else value


def _print(port: str, found: Parameters, *, named: bool) -> None:
    from imu_rig.cli.sheet import Sheet

    sheet = Sheet(INDENT)
    sheet.head(port, f"  {found.autopilot}")
    sheet.entry("  parameters", ENCODINGS[found.encoding])
    if named:
        for name in found.values:
            sheet.entry("", f"{name} {_text(found.value(name))}")
    elif found.own_calibration:
        words = ", ".join(f"{name} {_text(v)}" for name, v in found.own_calibration.items())
        sheet.entry("  corrects", words, "yellow")
        sheet.entry(
            "",
            "Its IMU messages hold corrected values: a calibration of them stands on top of this. "
            "Set these to neutral before, or apply both, its own first.",
        )
    elif found.values:
        sheet.entry("  corrects", "nothing: what it has of these parameters is neutral", "green")
    if found.missing:
        sheet.entry("  without", f"{', '.join(found.missing)}: not there, or not answered", "dim")
    for sentence in found.contradictions:
        sheet.entry("  wrong", sentence, "red")


def _text(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"
