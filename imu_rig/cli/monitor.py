"""`imu-rig monitor`: how devices do right now, in figures and as a plot; nothing is recorded."""

from __future__ import annotations

import contextlib
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from imu_rig.cli.device_options import Devices, LayoutName, SetupFile, Simulated
from imu_rig.cli.options import Quiet
from imu_rig.cli.terminal import fitted
from imu_rig.cli.unheld import last_words
from imu_rig.errors import ImuRigError, InputError, reason_of

if TYPE_CHECKING:
    from imu_rig.cli.monitor_view import MonitorView
    from imu_rig.monitor.engine import Monitor
    from imu_rig.monitor.rings import Ring
    from imu_rig.monitor.status import MonitorStatus
    from imu_rig.recorder.setup import DeviceSetup, TrialSetup
    from imu_rig.stopping import StopRequest

SAVE_AFTER_S = 10.0
USUAL_WINDOW_S = 10.0
LONGEST_WINDOW_S = 600.0
PICTURES = (".png", ".svg", ".pdf")


class Seen(NamedTuple):
    """How a watch ended."""

    last: MonitorStatus
    picture: Path | None
    problems: list[ImuRigError]


def monitor(
    device: Devices = None,
    setup: SetupFile = None,
    layout: LayoutName = None,
    simulate: Simulated = None,
    plot: Annotated[
        bool, typer.Option("--plot", help="A window with the last seconds of every stream.")
    ] = False,
    save: Annotated[
        Path | None,
        typer.Option(
            "--save",
            metavar="FILE.png",
            help="Draw the last seconds into a file at the end; needs no screen.",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds", "-t", help="End by itself after so long; with --save 10 by default."
        ),
    ] = None,
    window: Annotated[
        float, typer.Option("--window", help="Seconds that --plot and --save look back.")
    ] = USUAL_WINDOW_S,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="A JSON object each second and the result last, to stdout."),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Watch any devices live: rates, losses, faults, values; until Ctrl-C."""
    from imu_rig.cli.monitor_view import MonitorView
    from imu_rig.cli.record_setup import Options, setup_from
    from imu_rig.cli.signals import stop_on_signals
    from imu_rig.stopping import StopRequest

    _check(seconds, window, save)
    if save is not None and seconds is None:
        seconds = SAVE_AFTER_S
    with contextlib.ExitStack() as stack:
        stop, view = StopRequest(), MonitorView(quiet=quiet, as_json=as_json)
        stack.enter_context(stop_on_signals(stop, view.notify, "Stopping.", to_the_end=True))
        if simulate is not None and (device or setup is not None):
            raise InputError("Give either --simulate or devices of your own, not both.")
        if plot:
            from imu_rig.monitor.window import require_screen

            require_screen()
        simulated: tuple[DeviceSetup, ...] = ()
        if simulate is not None:
            from imu_rig.cli.simulated_devices import simulated_devices

            simulated = stack.enter_context(simulated_devices(simulate, layout))
        plan = setup_from(
            Options(setup=setup, devices=device or (), layout=layout, doing="watch"), simulated
        )
        seen = _watch(plan, view, stop, seconds, plot=plot, save=save, window_s=window)
        code = 130 if seconds is not None and stop.cause is not None else 0
        code = next((problem.exit_code for problem in seen.problems), code)
        told = _tell(seen.last, seen.picture, code, as_json=as_json)
        told &= last_words(sys.stderr, [fitted(f"imu-rig: {problem}") for problem in seen.problems])
    if view.held_up or not told:
        # A thread that waits for a reader cannot be ended, and everything else is done.
        os._exit(code)
    raise typer.Exit(code)


def _check(seconds: float | None, window: float, save: Path | None) -> None:
    import tempfile

    from imu_rig.files import require_new

    if seconds is not None and not (math.isfinite(seconds) and seconds > 0):
        raise InputError(f"--seconds {seconds:g} is no time to watch: write a number above 0.")
    if not 1 <= window <= LONGEST_WINDOW_S:
        raise InputError(f"--window {window:g} is not between 1 and {LONGEST_WINDOW_S:g} s.")
    if save is not None:
        if save.suffix.lower() not in PICTURES:
            raise InputError(f"--save {save}: name a file that ends in {', '.join(PICTURES)}.")
        require_new(save, what="a picture")
        try:
            with tempfile.TemporaryFile(dir=save.parent):
                pass
        except OSError as error:
            raise InputError(
                f"--save {save}: nothing can be written there ({reason_of(error)})."
            ) from error


def _watch(
    plan: TrialSetup,
    view: MonitorView,
    stop: StopRequest,
    seconds: float | None,
    *,
    plot: bool,
    save: Path | None,
    window_s: float,
) -> Seen:
    """Watch, with a window if asked for; save the picture at the end, if anything came."""
    from imu_rig.cli.working import Working
    from imu_rig.clock import SystemClock
    from imu_rig.monitor.engine import Monitor
    from imu_rig.monitor.rings import Ring
    from imu_rig.monitor.window import PlotWindow

    monitor = Monitor(
        plan.devices,
        SystemClock(),
        stop=stop,
        seconds=seconds,
        observe=view.observe,
        notify=view.notify,
    )
    with contextlib.ExitStack() as stack:
        sizes = monitor.ring_sizes(window_s)
        rings: list[Ring] = []
        if plot:
            window = PlotWindow(monitor.plans, sizes, window_s)
            with Working("Opening the plot"):
                stack.enter_context(window)
            view.has_window(window)
            rings = window.rings
        elif save is not None:
            rings = [
                Ring(size, shown.columns) for shown, size in zip(monitor.plans, sizes, strict=True)
            ]
        if rings:
            monitor.fill(rings, smoothly=plot)
        with view:
            last = monitor.run()
        picture = save if any(len(ring.read()) for ring in rings) else None
        problems: list[ImuRigError] = [] if monitor.shortfall is None else [monitor.shortfall]
        if picture is not None:
            try:
                _save(monitor, rings, picture, min(window_s, last.elapsed_s))
            except ImuRigError as error:  # the figures are worth telling all the same
                problems.append(error)
                picture = None
    return Seen(last, picture, problems)


def _save(monitor: Monitor, rings: list[Ring], path: Path, window_s: float) -> None:
    """Draw the picture without a screen."""
    import io
    import time

    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from imu_rig.cli.working import Working
    from imu_rig.files import write_whole
    from imu_rig.monitor.figure import LiveFigure

    with Working("Drawing"):
        live = LiveFigure(monitor.plans, window_s)
        FigureCanvasAgg(live.figure)
        names = [plan.name for plan in monitor.plans]
        samples = {name: ring.read() for name, ring in zip(names, rings, strict=True)}
        newest = [float(rows[-1, 0]) for rows in samples.values() if len(rows)]
        live.update(samples, max(newest, default=time.monotonic()))
        picture = io.BytesIO()
        live.save(picture, path.suffix[1:].lower())
    write_whole(path, picture.getvalue(), what="a picture")


def _tell(last: MonitorStatus, save: Path | None, code: int, *, as_json: bool) -> bool:
    """Tell how the devices did; False if somebody who might read it does not."""
    from imu_rig.cli.monitor_json import result_line
    from imu_rig.cli.monitor_screen import plain_table
    from imu_rig.foreign_text import one_line

    if as_json:
        return last_words(sys.stdout, [result_line(last, save, code)])
    lines = plain_table(last)
    if save is not None:
        lines += ["", one_line(str(save), 400)]
    return last_words(sys.stdout, lines)
