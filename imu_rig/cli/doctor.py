"""`imu-rig doctor`: what of this machine stands in the way, and what to do about it."""

from __future__ import annotations

import json
import sys
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.options import Json, Quiet, named
from imu_rig.errors import NOT_READY_EXIT

if TYPE_CHECKING:
    from imu_rig.devices.doctor.system import Check

INDENT = 22
DEFAULT_FOLDER = Path("recordings")


def doctor(
    maestro: Annotated[
        str | None,
        typer.Option(
            "--maestro",
            help="Command port of a Maestro to ask whether it listens; clears its errors.",
        ),
    ] = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", parser=named, metavar="PATH", help="Folder that trials will go to."
        ),
    ] = DEFAULT_FOLDER,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check ports, permissions, latency, Bluetooth, disk and packages; exit code 9 if one fails."""
    from imu_rig.cli.status_line import StatusLine
    from imu_rig.devices.doctor.examine import examine

    with closing(StatusLine(quiet=quiet, silent_s=1.0)) as line:
        checks = examine(output, maestro, progress=line.show)
    warned, bad = (sum(check.state == state for check in checks) for state in ("warn", "bad"))
    if as_json:
        state = "bad" if bad else "warn" if warned else "ok"
        told = {"state": state, "checks": [asdict(check) for check in checks]}
        sys.stdout.write(json.dumps(told) + "\n")
    else:
        _print(checks, _verdict(warned, bad))
    if bad:
        raise typer.Exit(NOT_READY_EXIT)


def _print(checks: list[Check], verdict: str) -> None:
    from imu_rig.cli.sheet import MARKS, Sheet

    sheet = Sheet(INDENT)
    for check in checks:
        state = (f"{check.state:<6}", MARKS[check.state])
        sheet.parts([state, (check.about[: INDENT - 7], "bold")], check.found)
        if check.advice:
            sheet.parts([], check.advice, "dim" if check.state == "ok" else "")
        for command in check.commands:
            sheet.command(f"  {command}")
    sheet.blank()
    sheet.row([(verdict, "bold")])


def _verdict(warned: int, bad: int) -> str:
    better = f"{_things(warned)} could be better" if warned else ""
    if bad:
        return f"{_things(bad)} will not work as it is{', ' + better if better else ''}."
    return f"{better}; all works." if better else "All is well."


def _things(number: int) -> str:
    return f"{number} thing{'s'[: number != 1]}"
