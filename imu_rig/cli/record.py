"""`imu-rig record`: a trial of any number of devices, into a file that nothing can lose."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import sys
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.device_options import Devices, LayoutName, SetupFile, Simulated
from imu_rig.cli.hardware import MaestroCrc, MaestroDevice, MaestroPort
from imu_rig.cli.options import Quiet, named
from imu_rig.cli.terminal import fitted
from imu_rig.cli.unheld import last_words
from imu_rig.errors import ImuRigError, InputError, NameTaken

if TYPE_CHECKING:
    from imu_rig.cli.record_view import RecordView
    from imu_rig.recorder.engine import RecordingOutcome
    from imu_rig.recorder.setup import DeviceSetup, TrialSetup
    from imu_rig.recorder.status import RecorderStatus
    from imu_rig.stopping import StopRequest

DEFAULT_OUTPUT = Path("recordings")
DEFAULT_MAX_LOSS = 5.0
WAIT_S = 30.0  # for required devices where nobody sits at a terminal


def record(
    device: Devices = None,
    setup: SetupFile = None,
    layout: LayoutName = None,
    certificate: Annotated[
        Path | None,
        typer.Option("--certificate", help="Certificate of the device, if there is only one."),
    ] = None,
    simulate: Simulated = None,
    maestro: MaestroPort = None,
    jig: Annotated[
        str | None,
        typer.Option("--jig", help="With --maestro: paper-jig, or a TOML file; parked at the end."),
    ] = None,
    maestro_device: MaestroDevice = None,
    maestro_crc: MaestroCrc = False,
    duration: Annotated[
        str | None,
        typer.Option("--duration", "-t", help="60, 2min, 1h30min; until you stop it if left out."),
    ] = None,
    subject: Annotated[str | None, typer.Option("--subject", help="Who; kept in the file.")] = None,
    session: Annotated[
        str | None,
        typer.Option("--session", help="Folder of the trials; by default day and subject."),
    ] = None,
    trial: Annotated[
        str | None, typer.Option("--trial", help="Name of the trial; a number is added.")
    ] = None,
    note: Annotated[str | None, typer.Option("--note", help="Anything; kept in the file.")] = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", parser=named, metavar="PATH", help="Folder of the sessions."
        ),
    ] = DEFAULT_OUTPUT,
    wait: Annotated[
        float | None,
        typer.Option(
            "--wait",
            help="Seconds to wait for required devices; without end on a terminal, else 30.",
        ),
    ] = None,
    max_loss: Annotated[
        float,
        typer.Option("--max-loss", help="Lost packets of a required device to accept [%]."),
    ] = DEFAULT_MAX_LOSS,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="A JSON object each second and the result last, to stdout."),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Record any number of devices until Ctrl-C, q or the planned duration."""
    from imu_rig.cli.record_setup import Options, setup_from
    from imu_rig.cli.record_view import RecordView
    from imu_rig.cli.signals import stop_on_signals
    from imu_rig.stopping import StopRequest

    if wait is not None and not (math.isfinite(wait) and wait >= 0):
        raise InputError(f"--wait {wait} is no number of seconds to wait.")
    if not 0 <= max_loss <= 100:
        raise InputError(f"--max-loss {max_loss} is not between 0 and 100 %.")
    if wait is None and not _somebody_watches():
        wait = WAIT_S
    with contextlib.ExitStack() as stack:
        if simulate is not None and (device or setup is not None):
            raise InputError("Give either --simulate or devices of your own, not both.")
        simulated: tuple[DeviceSetup, ...] = ()
        if simulate is not None:
            from imu_rig.cli.simulated_devices import simulated_devices

            simulated = stack.enter_context(simulated_devices(simulate, layout))
        plan = setup_from(
            Options(
                setup=setup,
                devices=device or (),
                layout=layout,
                certificate=certificate,
                maestro=maestro,
                jig=jig,
                maestro_device=maestro_device,
                maestro_crc=maestro_crc,
                duration=duration,
                subject=subject,
                session=session,
                trial=trial,
                note=note,
            ),
            simulated,
        )
        stop, view = StopRequest(), RecordView(quiet=quiet, as_json=as_json)
        # also while the end is told: who presses Ctrl-C twice wants to know where the file is
        stack.enter_context(stop_on_signals(stop, view.notify, _stopping(plan)))
        with view:
            outcome = _record(plan, output, view, stop, wait_s=wait)
        code, told = _tell(outcome, stop, max_loss / 100.0, as_json=as_json)
    if view.held_up or not told:
        # A thread that waits for a reader cannot be ended, and everything else is done.
        os._exit(code)
    raise typer.Exit(code)


def _tell(
    outcome: RecordingOutcome, stop: StopRequest, max_loss: float, *, as_json: bool
) -> tuple[int, bool]:
    """Tell how a recording ended; return the exit code, and whether everything could be told."""
    from imu_rig.cli.record_json import json_line, result_json
    from imu_rig.cli.record_summary import exit_code, shortfalls, summary_lines, times_of

    times = times_of(outcome, stop)
    short = shortfalls(outcome, max_loss, times)
    code = exit_code(outcome, short)
    if as_json:
        lines = [json_line("result", result_json(outcome, short, code))]
    else:
        lines = summary_lines(outcome, times)
    told = last_words(sys.stdout, lines)
    told &= last_words(sys.stderr, [fitted(f"imu-rig: {sentence}") for sentence in short])
    return code, told


def _stopping(plan: TrialSetup) -> str:
    parks = "" if plan.jig is None else "the jig parks and "
    return f"Stopping: {parks}the file is closed now; once more to hurry."


def _record(
    plan: TrialSetup, output: Path, view: RecordView, stop: StopRequest, *, wait_s: float | None
) -> RecordingOutcome:
    """Record under the next free name; return how it ended."""
    from imu_rig.cli.keys import Keys
    from imu_rig.clock import SystemClock
    from imu_rig.recorder.engine import Recorder
    from imu_rig.recorder.naming import free_paths, session_part

    part = session_part(plan.session, plan.subject, datetime.now().astimezone().date())

    def attempt(path: Path) -> RecordingOutcome:
        listens = False
        numbers = itertools.count(1)
        with contextlib.ExitStack() as listening:

            def observe(status: RecorderStatus) -> None:
                nonlocal listens
                if not listens:  # from now on there is a file to put markers into
                    listens = True
                    keys = listening.enter_context(Keys(mark, stop_by_key, view.notify))
                    view.listens_to_keys(on_terminal=keys.by_key)
                view.observe(status)

            def mark(label: str) -> None:
                number = next(numbers)
                label = label or f"marker {number}"
                recorder.mark(label)
                view.marked(label)

            recorder = Recorder(
                plan,
                path,
                SystemClock(),
                stop=stop,
                observe=observe,
                notify=view.notify,
                wait_s=wait_s,
            )
            return recorder.run()

    def stop_by_key() -> None:
        if stop.cause is None:
            view.notify(_stopping(plan))
        stop.make("Stopped by the key q.")

    with _folder(output, part) as folder:
        for path in free_paths(folder, plan.trial):
            try:
                return attempt(path)
            except NameTaken:  # another recorder was faster
                continue
            except ImuRigError as error:
                if str(path) in str(error) or not path.is_file():
                    raise
                raise type(error)(f"{error} What was received is kept in {path}.") from error
    raise AssertionError  # names do not end without an error


@contextlib.contextmanager
def _folder(output: Path, part: str) -> Iterator[Path]:
    """Make the folder of a session; what was made for nothing is taken away again."""
    from imu_rig.recorder.naming import make_folder

    whole = output / part
    missing = [p for p in (whole, *whole.parents) if not os.path.lexists(p)]
    folder = make_folder(output, part)
    try:
        yield folder
    finally:
        with contextlib.suppress(OSError):  # not empty
            for made in missing:
                made.rmdir()


def _somebody_watches() -> bool:
    try:
        return sys.stdin.isatty() and sys.stderr.isatty()
    except (AttributeError, ValueError):
        return False
