"""`imu-rig protocol`: the protocols there are, and one designed for a jig and a time."""

from __future__ import annotations

import contextlib
import shlex
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.options import Json, Quiet
from imu_rig.cli.status_line import StatusLine
from imu_rig.errors import ImuRigError, InputError

if TYPE_CHECKING:
    from imu_rig.devices.jig_config import JigConfig
    from imu_rig.session.design import Designed
    from imu_rig.session.protocol import AxisName

app = typer.Typer(help="See the protocols there are; design one for a jig.", no_args_is_help=True)

Jig = Annotated[
    str | None, typer.Option(help="Jig: paper-jig, which is taken by default, or a TOML file.")
]
UNCHECKED = (
    "It holds no check poses, so its result will count as not verified: add steps with kind = "
    '"check", as full has, or verify it afterwards by imu-rig verify.'
)
PlanMethod = Annotated[str, typer.Option("--method", help="Method that will solve the session.")]


@app.command("list")
def list_protocols(jig: Jig = None, as_json: Json = False) -> None:
    """List the protocols that come with imu-rig, with their time on a jig."""
    import json

    from imu_rig.session.plan import plan_session
    from imu_rig.session.protocol import builtin_protocols, load_protocol

    config = _jig(jig)
    rows = []
    for name in builtin_protocols():
        protocol = load_protocol(name)
        seconds: float | None = None
        with contextlib.suppress(InputError):  # outside the limits of this jig
            seconds = plan_session(protocol, config).duration_s
        rows.append((protocol, seconds))
    if as_json:
        told = [
            {
                "name": protocol.name,
                "title": protocol.title,
                "stops": len(protocol.steps),
                "mountings": max(1, len(protocol.mountings)),
                "duration_s": seconds,
            }
            for protocol, seconds in rows
        ]
        sys.stdout.write(json.dumps({"jig": config.name, "protocols": told}) + "\n")
        return
    width = max(len(protocol.name) for protocol, _ in rows)
    for protocol, seconds in rows:
        time = "beyond its reach" if seconds is None else f"{seconds:4.0f} s"
        sys.stdout.write(f"  {protocol.name:{width}}  {time}  {protocol.title}\n")
    sys.stdout.write(f"Times on jig '{config.name}'. See one by: imu-rig protocol show NAME\n")


@app.command()
def show(
    protocol: Annotated[str, typer.Argument(help="Name of a protocol, or a TOML file.")],
    jig: Jig = None,
    method: PlanMethod = "joint",
    as_json: Json = False,
) -> None:
    """Show the stops of a protocol and what a session of it is expected to tell."""
    import json

    from imu_rig.cli.outlook import expected_json, expected_lines, plan_json, plan_lines
    from imu_rig.session.observability import outlook
    from imu_rig.session.plan import plan_session
    from imu_rig.session.protocol import load_protocol

    config = _jig(jig)
    plan = plan_session(load_protocol(protocol), config)
    refused: str | None = None
    try:
        told = outlook(plan, config, method)
    except ImuRigError as error:
        refused = str(error)
    if as_json:
        content = {**plan_json(plan), "name": plan.protocol.name, "title": plan.protocol.title}
        if refused is None:
            content["expected"] = expected_json(told.expected, told.warnings)
        else:
            content["refused"] = refused
        sys.stdout.write(json.dumps(content) + "\n")
        return
    sys.stdout.write(f"{plan.protocol.name}: {plan.protocol.title}\n\n")
    lines = plan_lines(plan, config.name)
    lines += (
        ["", *_paragraph(refused)]
        if refused
        else ["", *expected_lines(told.expected, told.warnings)]
    )
    sys.stdout.write("\n".join(lines) + "\n")


@app.command()
def plan(
    time: Annotated[float, typer.Option("--time", help="Time the jig may take [s].")] = 115.0,
    jig: Jig = None,
    reach: Annotated[
        float | None,
        typer.Option(help="Largest tilt and roll of a pose [deg]; the jig's limits by default."),
    ] = None,
    reach_tilt: Annotated[float | None, typer.Option(help="Largest tilt [deg].")] = None,
    reach_roll: Annotated[float | None, typer.Option(help="Largest roll [deg].")] = None,
    reach_pan: Annotated[float | None, typer.Option(help="Largest pan [deg].")] = None,
    mountings: Annotated[
        int, typer.Option(min=1, max=2, help="Mountings of the sensor on the plate, 1 or 2.")
    ] = 1,
    gyro_only: Annotated[
        bool, typer.Option("--gyro-only", help="Only the gyroscope's figures count.")
    ] = False,
    name: Annotated[str, typer.Option(help="Name of the protocol.")] = "planned",
    search: Annotated[
        int, typer.Option(min=0, max=5000, help="Steps of the search; 0 for the readable list.")
    ] = 120,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; stdout by default.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Design poses and turns for a jig, its reach and the time there is."""
    import json
    import math

    from imu_rig.cli.outlook import expected_json, expected_lines
    from imu_rig.session.design import Task, design_protocol
    from imu_rig.session.protocol_text import protocol_text

    if output is not None and (output.exists() or output.is_symlink()):
        raise InputError(f"{output} exists already and is never overwritten: name another -o.")
    given: dict[AxisName, float | None] = {
        "pan": reach_pan,
        "tilt": reach_tilt if reach_tilt is not None else reach,
        "roll": reach_roll if reach_roll is not None else reach,
    }
    limits = {axis: value for axis, value in given.items() if value is not None}
    if not all(math.isfinite(value) and value >= 0 for value in limits.values()):
        raise InputError("A reach must be a number of degrees, zero or more.")
    if not (math.isfinite(time) and 0 < time <= 7200):
        raise InputError("--time must be between 0 and 7200 seconds.")
    if not (name.isprintable() and 0 < len(name) <= 80):
        raise InputError("--name must be 1 to 80 printable characters.")
    config = _jig(jig)
    task = Task.on(config, time, reach=limits, mountings=mountings, gyro_only=gyro_only, name=name)
    with contextlib.closing(StatusLine(quiet=quiet)) as line:
        found = design_protocol(
            task,
            search=search,
            progress=lambda done, total: line.show(f"searching: {done} of {total}"),
        )
    text = protocol_text(found.protocol, _header(found, config, limits, gyro_only))
    table = expected_lines(found.outlook.expected, found.outlook.warnings)
    if output is not None:
        try:
            output.write_text(text, encoding="utf-8")
        except OSError as error:
            raise InputError(f"{output} cannot be written ({error.strerror}).") from error
    if as_json:
        content = {
            "protocol": found.protocol.model_dump(mode="json"),
            "duration_s": found.plan.duration_s,
            "expected": expected_json(found.outlook.expected, found.outlook.warnings),
            "file": None if output is None else str(output),
        }
        sys.stdout.write(json.dumps(content) + "\n")
        return
    told = [_summary(found, config), "", *_paragraph(UNCHECKED), "", *table]
    if found.turned_over is not None:
        told += ["", *_paragraph(_proposal(found))]
    if output is None:
        sys.stdout.write(text)
        if not quiet:
            sys.stderr.write("\n".join(["", *told, ""]))
        return
    told += ["", f"Run it: imu-rig calibrate --protocol {shlex.quote(str(output))}"]
    sys.stdout.write("\n".join([*told, ""]))


def _summary(found: Designed, jig: JigConfig) -> str:
    """Say what was designed in one line."""
    protocol = found.protocol
    remounting = ", and a person turns the sensor over once" if len(protocol.mountings) > 1 else ""
    kind = "a ring of roll angles" if found.structured else "a searched list"
    return (
        f"{len(protocol.steps)} poses ({kind}) held {protocol.hold_s:g} s each take "
        f"{found.plan.duration_s:.0f} s on jig '{jig.name}'{remounting}."
    )


def _proposal(found: Designed) -> str:
    times = found.score / (found.turned_over or found.score)
    return (
        f"This reach shows gravity too little of some axis. With --mountings 2 (the sensor turned "
        f"over once by hand) the worst figure would be {times:.0f} times as certain in the same "
        "time."
    )


def _header(
    found: Designed, jig: JigConfig, reach: Mapping[AxisName, float], gyro_only: bool
) -> list[str]:
    """Comments at the top of the file."""
    from imu_rig.cli.outlook import expected_lines

    what = "Gyroscope gains" if gyro_only else "Accelerometer and gyroscope"
    within = ", ".join(f"{axis} up to {value:g} degrees" for axis, value in reach.items())
    return [
        f"{what} on jig '{jig.name}'{f', {within}' if within else ''}; made by imu-rig protocol "
        "plan.",
        _summary(found, jig),
        "\n".join(f" {line}" for line in expected_lines(found.outlook.expected)),
    ]


def _paragraph(sentence: str) -> list[str]:
    return textwrap.wrap(sentence, 78)


def _jig(name: str | None) -> JigConfig:
    from imu_rig.devices.jig import DEFAULT_JIG_NAME, load_jig

    return load_jig(name or DEFAULT_JIG_NAME)
