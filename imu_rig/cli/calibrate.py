"""`imu-rig calibrate`: a jig session on real or simulated hardware, to certificate and report."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.hardware import (
    DEFAULT_BAUD,
    Baud,
    Hardware,
    ImuPort,
    JigFile,
    LayoutFile,
    MaestroCrc,
    MaestroDevice,
    MaestroPort,
    Seed,
    Simulate,
    Speed,
    StreamName,
)
from imu_rig.cli.options import (
    DEFAULT_METHOD,
    Gravity_,
    Height,
    Json,
    Latitude,
    Method,
    Output,
    Quiet,
    gravity_from,
)
from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.session.observability import Outlook
    from imu_rig.session.plan import SessionPlan


def calibrate(
    imu: ImuPort = None,
    maestro: MaestroPort = None,
    jig: JigFile = None,
    protocol: Annotated[
        str | None,
        typer.Option(help="Protocol: full (default), a name of imu-rig protocol list, or a file."),
    ] = None,
    layout: LayoutFile = None,
    stream: StreamName = None,
    name: Annotated[
        str | None, typer.Option(help="Name of the sensor, for the certificate.")
    ] = None,
    serial: Annotated[str | None, typer.Option(help="Serial number, for the certificate.")] = None,
    baud: Baud = DEFAULT_BAUD,
    maestro_device: MaestroDevice = None,
    maestro_crc: MaestroCrc = False,
    method: Method = DEFAULT_METHOD,
    gravity: Gravity_ = None,
    latitude: Latitude = None,
    height: Height = None,
    output: Output = None,
    resume: Annotated[
        Path | None, typer.Option(help="Trial file of a stopped session to go on with.")
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Check protocol and jig, print the plan, move nothing."),
    ] = False,
    yes: Annotated[
        bool,
        typer.Option(
            "--yes",
            "-y",
            help="Ask nothing: where the sensor must be turned over, stop, for --resume later.",
        ),
    ] = False,
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    worn: Annotated[
        bool,
        typer.Option(
            "--worn",
            help="With --simulate: the very sensor that imu-rig simulate walk carries under --name "
            "with the same --seed.",
        ),
    ] = False,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="With --simulate: DEVICE:WORD@POSE[:move|hold[:SECONDS]], "
            "for example imu:unplug@5:move:2."
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Step an IMU on a servo jig through poses and turns; write certificate and report."""
    from contextlib import ExitStack
    from dataclasses import replace

    from imu_rig.cli import sessions
    from imu_rig.cli.outlook import expected_lines, other_noise
    from imu_rig.clock import Clock, SystemClock
    from imu_rig.session.observability import outlook
    from imu_rig.session.progress import Progress, ignore
    from imu_rig.session.protocol import DEFAULT_PROTOCOL, load_protocol
    from imu_rig.session.run import resumed_setup

    local_gravity = gravity_from(gravity, latitude, height)
    stated = {"gravity": gravity, "latitude": latitude, "height": height}
    solved_by = "" if method == DEFAULT_METHOD else f" --method {method}"
    solved_by += "".join(
        f" --{name} {value}" for name, value in stated.items() if value is not None
    )
    if not simulate and fault:
        raise InputError("--fault needs --simulate: real hardware brings its own.")
    if worn and not (simulate and name):
        raise InputError("--worn needs --simulate, and --name for the device of the walk.")
    hardware = Hardware(
        imu, maestro, jig, layout, baud, maestro_device, maestro_crc, simulate, seed, speed, stream
    )
    if not dry_run:
        hardware.require_ports()
    hardware.require_one_kind()
    if resume is not None:
        own = {"jig": jig, "protocol": protocol, "layout": layout, "name": name, "serial": serial}
        own["stream"] = stream
        given = [f"--{option}" for option, value in own.items() if value is not None]
        if given or output is not None:
            raise InputError(
                f"{', '.join(given) or '--output'} cannot be given with --resume: the session goes "
                "on as it began, in its own folder."
            )
    setup = hardware.setup(load_protocol(protocol or DEFAULT_PROTOCOL), name or "imu", serial or "")
    if resume is not None:
        setup = resumed_setup(resume, setup)
    plan = setup.plan()
    forecast = outlook(plan, setup.jig, method)
    forecast = replace(forecast, warnings=(*forecast.warnings, *other_noise(setup.layout.name)))
    if dry_run:
        _print_plan(plan, forecast, setup.jig.name, as_json=as_json)
        return
    with ExitStack() as stack:
        clock: Clock = SystemClock()
        simulated = None
        watch: Callable[[Progress], None] = ignore
        if simulate:
            from imu_rig.cli.simulated import FaultPlan, simulated_session, together

            simulated = stack.enter_context(
                simulated_session(setup, seed=seed, speed=speed, worn=name if worn else None)
            )
            clock, setup = simulated.clock, simulated.setup
            if resume is not None:
                simulated.mount_for(resume)
            faults = FaultPlan(fault or [], simulated.rig, steps=len(plan.steps))
            watch = together(simulated.observe, faults)
        folder = resume.parent if resume is not None else sessions.new_folder(output)
        trial = resume or folder / sessions.TRIAL_NAME
        sessions.run_in_view(
            setup,
            trial,
            clock,
            resume=resume is not None,
            quiet=quiet,
            ports=hardware.options + solved_by,
            watch=watch,
            hands=None if yes else simulated,
            ask=not yes,
            opening=[*expected_lines(forecast.expected, forecast.warnings), ""],
        )
        # a resumed session saw two simulations, whose offsets walked differently
        truth = simulated.truth() if simulated is not None and resume is None else None
    sessions.finish(
        trial, folder, method=method, gravity=local_gravity, as_json=as_json, truth=truth
    )


def _print_plan(plan: SessionPlan, forecast: Outlook, jig: str, *, as_json: bool) -> None:
    import json

    from imu_rig.cli.outlook import expected_json, expected_lines, plan_json, plan_lines

    if as_json:
        expected = expected_json(forecast.expected, forecast.warnings)
        sys.stdout.write(json.dumps({**plan_json(plan), "expected": expected}) + "\n")
        return
    table = expected_lines(forecast.expected, forecast.warnings)
    sys.stdout.write("\n".join([*plan_lines(plan, jig), "", *table, ""]))
