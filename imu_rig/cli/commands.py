"""The commands of the `imu-rig` program.

They import what they need when they run, so that `imu-rig --help` answers at once.
"""

from __future__ import annotations

from typing import Annotated

import typer

from imu_rig import __version__
from imu_rig.cli import (
    analyze,
    calibrate,
    certificate,
    demo,
    devices,
    doctor,
    export,
    import_,
    info,
    monitor,
    noise,
    protocol,
    record,
    repair,
    replay,
    simulate,
    solve,
    verify,
)

app = typer.Typer(
    name="imu-rig",
    help="Calibrate inertial sensors on a servo jig and keep recordings that nothing can lose.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("demo")(demo.demo)
app.command("calibrate")(calibrate.calibrate)
app.command("solve")(solve.solve)
app.command("verify")(verify.verify)
app.command("noise")(noise.noise)
app.command("record")(record.record)
app.command("monitor")(monitor.monitor)
app.command("replay")(replay.replay)
app.command("info")(info.info)
app.command("repair")(repair.repair)
app.command("export")(export.export)
app.command("import")(import_.import_)
app.command("doctor")(doctor.doctor)
app.add_typer(analyze.app, name="analyze")
app.add_typer(certificate.app, name="certificate")
app.add_typer(devices.app, name="devices")
app.add_typer(protocol.app, name="protocol")
app.add_typer(simulate.app, name="simulate")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"imu-rig {__version__}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Say which.")
    ] = False,
) -> None:
    """Calibrate inertial sensors on a servo jig and keep recordings that nothing can lose."""
