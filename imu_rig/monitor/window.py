"""The plot's window, in a process of its own: whatever becomes of it, the devices are read on.

The two processes share the rings of the last samples and a pipe by which one notices the end of
the other. Nothing waits for the window: one that is slow shows fewer pictures.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from imu_rig.errors import InputError, reason_of
from imu_rig.monitor.figure import LiveFigure, StreamPlan
from imu_rig.monitor.rings import Ring

FRAME_MS = 50  # between pictures, where drawing is quick enough
OPEN_S = 60.0  # for matplotlib to find its fonts, the first time on a slow machine
CLOSE_S = 3.0

NO_SCREEN = (
    "--plot needs a screen and there is none ({why}): --save FILE.png draws the same picture "
    "into a file."
)


class PlotWindow:
    """A window with live streams; a context manager.

    Parameters
    ----------
    plans : sequence of StreamPlan
    sizes : sequence of int
        Samples kept of each.
    seconds : float
        How far back it shows.

    Attributes
    ----------
    rings : list of Ring
        Where to put samples, one for each plan.
    """

    def __init__(self, plans: Sequence[StreamPlan], sizes: Sequence[int], seconds: float) -> None:
        require_screen()
        self._plans, self._seconds = tuple(plans), seconds
        # a fork would take threads and open ports with it
        self._context = multiprocessing.get_context("spawn")
        self.rings = [
            Ring(
                size,
                plan.columns,
                self._context.RawArray("d", size * (plan.columns + 1)),
                self._context.RawArray("q", 2),
            )
            for plan, size in zip(plans, sizes, strict=True)
        ]
        self._ours: Connection | None = None
        self._process: Any = None

    def __enter__(self) -> PlotWindow:
        """Open it.

        Raises
        ------
        InputError
            If there is no screen to open it on.
        """
        self._ours, theirs = self._context.Pipe()
        memory = [(r.size, r.columns, r.numbers, r.written) for r in self.rings]
        self._process = self._context.Process(
            target=show,
            args=(theirs, self._plans, memory, self._seconds),
            name="imu-rig plot",
            daemon=True,
        )
        self._process.start()
        theirs.close()
        try:
            said = self._ours.recv() if self._ours.poll(OPEN_S) else "it takes too long to open"
        except EOFError:
            said = "its process ended at once"
        if said:
            self.close()
            raise InputError(NO_SCREEN.format(why=said))
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether the window is there: its user may have closed it."""
        return self._process is not None and self._process.is_alive()

    def close(self) -> None:
        """Take the window away."""
        if self._ours is not None:
            self._ours.close()
            self._ours = None
        if self._process is not None:
            self._process.join(CLOSE_S)
            if self._process.is_alive():  # it hangs, or somebody halted it
                self._process.kill()
                self._process.join()
            self._process.close()
            self._process = None


def require_screen() -> None:
    """Refuse to plot where the system has no screen for this program.

    Raises
    ------
    InputError
        Saying what to do instead.
    """
    no_windows = ("win32", "darwin")
    if sys.platform in no_windows or os.environ.get("MPLBACKEND"):
        return
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(NO_SCREEN.format(why="DISPLAY is not set"))


def show(
    connection: Connection,
    plans: Sequence[StreamPlan],
    memory: Sequence[tuple[int, int, Any, Any]],
    seconds: float,
) -> None:
    """Show the window until it is closed or the other process ends; runs in its own process.

    Says an empty word when it is open, or why it cannot be.
    """
    # Ctrl-C is for the program, which closes the window
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        from matplotlib import pyplot

        figure = pyplot.figure("imu-rig monitor")
        if figure.canvas.required_interactive_framework is None:
            connection.send("matplotlib has no window toolkit, such as tkinter")
            return
        live = LiveFigure(plans, seconds, figure)
    except Exception as error:  # what a toolkit raises without a screen is its own
        connection.send(reason_of(error))
        return
    rings = [Ring(*parts) for parts in memory]
    frame = framer(live, {p.name: r for p, r in zip(plans, rings, strict=True)})

    def tick() -> None:
        if connection.poll():  # the other end is gone
            pyplot.close(figure)
            return
        frame()

    timer = figure.canvas.new_timer(interval=FRAME_MS)
    timer.add_callback(tick)
    timer.start()
    connection.send("")
    with suppress(KeyboardInterrupt):
        pyplot.show(block=True)


def framer(live: LiveFigure, rings: dict[str, Ring]) -> Callable[[], None]:
    """Return what draws the present moment; a new range costs a whole drawing, otherwise lines."""

    def frame() -> None:
        samples = {name: ring.read() for name, ring in rings.items()}
        if live.update(samples, time.monotonic()):
            live.figure.canvas.draw()
        else:
            live.draw_lines()

    return frame
