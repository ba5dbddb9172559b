"""`imu-rig simulate`: hardware that is not there, on real ports."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from imu_rig.cli.options import Json
from imu_rig.cli.simulate_walk import walk
from imu_rig.errors import InputError

app = typer.Typer(help="Put simulated hardware on real ports.", no_args_is_help=True)
app.command("walk")(walk)


@app.callback()
def simulate() -> None:
    """Put simulated hardware on real ports."""


@app.command("rig")
def rig(
    seed: Annotated[int, typer.Option(help="Which sensor and jig: errors are drawn by it.")] = 1,
    tcp: Annotated[
        bool, typer.Option("--tcp", help="TCP ports (socket://) in place of pseudo-terminals.")
    ] = sys.platform == "win32",
    imu: Annotated[
        str | None,
        typer.Option("--imu", help="Kind of IMU: mpu9150 (default); an unknown one lists them."),
    ] = None,
    factory: Annotated[
        bool, typer.Option("--factory", help="The Maestro in its factory mode: it ignores bytes.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Serve a jig with a Maestro and an IMU until Ctrl-C: by default an MPU-9150 over Bluetooth."""
    import threading

    from imu_rig.cli.signals import stop_on_signals
    from imu_rig.clock import SystemClock
    from imu_rig.stopping import StopRequest
    from simulators.imu_kinds import DEFAULT_KIND, kind_of
    from simulators.rig import RigConfig, SimulatedRig

    try:
        config = RigConfig.random(seed, imu=kind_of(imu or DEFAULT_KIND))
    except ValueError as error:
        raise InputError(f"--imu: {error}") from error
    if factory:
        config = config.model_copy(update={"maestro_mode": "uart-detect"})
    stop, wait = StopRequest(), threading.Event()
    with (
        stop_on_signals(stop),
        SimulatedRig(config, clock=SystemClock(), transport="tcp" if tcp else "pty") as simulated,
    ):
        if as_json:
            ports = {"imu": simulated.imu_url, "maestro": simulated.maestro_url}
            sys.stdout.write(json.dumps(ports) + "\n")
        else:
            layout = f" --layout {config.protocol.name}" if imu else ""
            layout += f" --stream {config.kind.stream}" if config.kind.stream else ""
            sys.stdout.write(
                f"IMU      {simulated.imu_url}   {config.kind.title}\n"
                f"Maestro  {simulated.maestro_url}\n\n"
                "In another terminal:\n"
                f"  imu-rig calibrate --imu {simulated.imu_url} --maestro {simulated.maestro_url}"
                f"{layout}\n\nCtrl-C ends it.\n"
            )
        sys.stdout.flush()
        while stop.cause is None:
            wait.wait(0.1)
