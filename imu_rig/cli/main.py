"""The `imu-rig` program: its commands and its one way to report an error.

Commands import what they need when they run, so that `imu-rig --help` answers at once.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from typing import Annotated, NoReturn, TextIO

import typer

from imu_rig import __version__
from imu_rig.cli import (
    calibrate,
    certificate,
    demo,
    export,
    import_,
    info,
    noise,
    protocol,
    record,
    repair,
    replay,
    simulate,
    solve,
    verify,
)
from imu_rig.cli.signals import leave_on_signals
from imu_rig.cli.terminal import fitted
from imu_rig.errors import ImuRigError, StorageError

# Before numpy is imported: matrices are small here, and threads would wait for each other longer
# than they work.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

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
app.command("replay")(replay.replay)
app.command("info")(info.info)
app.command("repair")(repair.repair)
app.command("export")(export.export)
app.command("import")(import_.import_)
app.add_typer(certificate.app, name="certificate")
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


def run() -> None:
    """Run the program; every foreseen error is one sentence on stderr and an exit code."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started us
            setattr(sys, name, io.StringIO())
        elif isinstance(stream, io.TextIOWrapper):  # names in files may hold anything
            stream.reconfigure(errors="backslashreplace")
    leave_on_signals()
    try:
        app()
        sys.stdout.flush()
    except ImuRigError as error:
        if "--json" in sys.argv:
            answer = json.dumps({"error": str(error), "exit_code": error.exit_code})
            _say(sys.stdout, answer)
        _say(sys.stderr, fitted(f"imu-rig: {error}"))
        _leave(error.exit_code)
    except KeyboardInterrupt:
        _say(sys.stderr, "imu-rig: interrupted")
        _leave(130)
    except BrokenPipeError:  # the reader of our output went away, as with `| head`
        _leave(0)
    except OSError as error:
        _say(sys.stderr, f"imu-rig: the output cannot be written ({error.strerror}).")
        _leave(StorageError.exit_code)


def _say(stream: TextIO, text: str) -> None:
    """Write a last line, if anybody still takes it."""
    with contextlib.suppress(OSError, ValueError):
        stream.write(text + "\n")
        stream.flush()


def _leave(code: int) -> NoReturn:
    """Exit without another attempt to write what could not be written."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(code)
